//! Bodies: round objects, ellipses and rectangles, which move.

#![allow(non_snake_case)] // textbook letters

use super::element::{State, exceeds};
use super::modes::{Measurement, Modes, Motion, Step, new_state};
use super::outline::{Outline, OutlineMeasurement};
use super::parameters::Patience;
use super::rules::Rules;
use super::view::viewpoint::Viewpoint;
use super::view::visibility::Visibility;
use crate::Error;
use crate::estimation::assignment::{Pair, assign};
use crate::estimation::kalman::Gaussian;
use nalgebra::{Matrix2, Vector3};
use serde::{Deserialize, Serialize};

/// Offsets from its centre at which a body is looked for, in standard deviations along each axis.
const LOOK: [f64; 4] = [-2.0, -1.0, 1.0, 2.0];

/// Least ratio of the radii of two measurements of one object, if one of them is large.
const LEAST_RATIO: f64 = 0.5;

/// A body as one segment of one scan shows it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct BodyMeasurement {
    /// Circle of the body, or the circle that represents it.
    pub(super) circle: Measurement,
    /// Circle that its rays may show, if its shape looks different.
    pub(super) round: Option<Measurement>,
    /// Outline, if it is no circle.
    pub(super) outline: Option<OutlineMeasurement>,
    /// Only one face was seen, which does not show its kind.
    pub(super) is_face: bool,
}

/// A body: its circle, or the circle that represents it, and its outline.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Body {
    circle: Modes<5>,
    pub(super) outline: Outline,
}

impl Body {
    /// True if the parts of a restored state agree.
    pub(super) fn fits(&self, motion: &Motion) -> bool {
        self.circle.fits(motion) && self.outline.fits(motion)
    }

    pub(super) fn circle(&self) -> Gaussian<5> {
        self.circle.combined()
    }

    /// True if a measurement may be of this body by its size. A large body and what stands inside
    /// its circle are two objects.
    fn is_alike(&self, seen: &BodyMeasurement) -> bool {
        if !self.outline.is_large() && !seen.outline.is_some_and(|outline| outline.is_large) {
            return true;
        }
        let (one, other) = (self.circle().mean[4], seen.circle.z[2]);
        one.min(other) >= LEAST_RATIO * one.max(other)
    }
}

impl State for Body {
    type Measurement = BodyMeasurement;

    fn new(seen: &BodyMeasurement, rules: &Rules) -> Self {
        Self {
            circle: Modes::new(new_state(&seen.circle, rules.speed()), rules.motion()),
            outline: Outline::new(seen.outline.as_ref(), rules),
        }
    }

    /// A measurement that nearly touches a larger one is a part of it, as an arm is of a person.
    fn wholes(seen: &[BodyMeasurement], rules: &Rules) -> Vec<usize> {
        let is_small = |one: &BodyMeasurement| !one.outline.is_some_and(|outline| outline.is_large);
        let mut order: Vec<usize> = (0..seen.len()).filter(|&i| is_small(&seen[i])).collect();
        // The largest first: a part belongs to a whole, never to another part.
        order.sort_by(|&i, &j| seen[j].circle.z[2].total_cmp(&seen[i].circle.z[2]));
        let mut wholes: Vec<usize> = (0..seen.len()).collect();
        let mut larger: Vec<usize> = Vec::new();
        for index in order {
            let z = &seen[index].circle.z;
            let is_near = |&&other: &&usize| is_one(z, &seen[other].circle.z, rules);
            match larger.iter().find(is_near) {
                Some(&whole) => wholes[index] = whole,
                None => larger.push(index),
            }
        }
        wholes
    }

    fn predict(&mut self, step: &Step) {
        self.circle.predict(&step.circles);
        self.outline.predict(step);
    }

    fn correct(&mut self, seen: &BodyMeasurement, rules: &Rules) -> Result<(), Error> {
        if !seen.is_face {
            self.outline.correct(seen.outline.as_ref(), rules)?;
        }
        // One scan may take a circle for something else, of which it hardly knows the centre.
        if let Some(round) = seen.round.filter(|_| self.outline.is_round())
            && self.circle.cost(&round, rules.gate())?.is_some()
        {
            return self.circle.correct(&round);
        }
        self.circle.correct(&seen.circle)
    }

    /// At most one measurement per body: the assignment that explains all of them best.
    fn associate<'a>(
        all: impl ExactSizeIterator<Item = &'a Self> + Clone,
        seen: &[BodyMeasurement],
        wholes: &[usize],
        rules: &Rules,
    ) -> Result<Vec<Option<usize>>, Error> {
        // Costs are -2 log likelihoods, so that of a new body is that of the density of births.
        let unassigned = -2.0 * libm::log(rules.parameters().birth_density);
        let count = all.len();
        let mut pairs = Vec::new();
        for (row, body) in all.enumerate() {
            for (column, measurement) in seen.iter().enumerate() {
                if wholes[column] == column
                    && let Some(cost) = body.circle.cost(&measurement.circle, rules.gate())?
                    && body.is_alike(measurement)
                {
                    pairs.push(Pair { row, column, cost });
                }
            }
        }
        let mut owners = vec![None; seen.len()];
        let columns = assign(count, seen.len(), &pairs, unassigned)?;
        for (row, column) in columns.into_iter().enumerate() {
            if let Some(column) = column {
                owners[column] = Some(row);
            }
        }
        Ok(owners)
    }

    /// The body counts as seen through only if rays pass at every place where it may be.
    fn look(&self, from: &Viewpoint, rules: &Rules) -> Visibility {
        let Some(view) = &from.view else { return Visibility::SeenThrough };
        let state = self.circle();
        let ask = |[x, y]: [f64; 2]| {
            let circle = from.pose.level([state.mean[0] + x, state.mean[1] + y], state.mean[4]);
            view.of(&circle, rules.looking())
        };
        let here = ask([0.0, 0.0]);
        if here != Visibility::SeenThrough {
            return here;
        }
        let around = axes(&state)
            // A predicted place may be wrong by its deviation: before the body counts as gone, the
            // places around must be free as well.
            .into_iter()
            .flat_map(|axis| LOOK.map(|reach| axis.map(|value| value * reach)));
        around.map(ask).fold(here, Visibility::max)
    }

    /// True if an eigenvalue of a block of the covariance exceeds its limit, or no radius is left.
    fn is_vague(&self, rules: &Rules) -> bool {
        let (state, limits) = (self.circle(), &rules.parameters().limits);
        let P = &state.covariance;
        exceeds(&P.fixed_view::<2, 2>(0, 0).into_owned(), limits.position * limits.position)
            || exceeds(&P.fixed_view::<2, 2>(2, 2).into_owned(), limits.velocity * limits.velocity)
            || state.mean[4] <= 0.0
            || P[(4, 4)] > limits.radius * limits.radius
    }

    /// True if the centre of one body lies inside the other, or the gap between them is small.
    /// Large bodies have corners, between which there may be others: they are never twins.
    fn is_twin(&self, other: &Self, rules: &Rules) -> bool {
        if self.outline.is_large() || other.outline.is_large() {
            return false;
        }
        let [one, two] = [self, other].map(|body| {
            let mean = body.circle().mean;
            Vector3::new(mean[0], mean[1], mean[4])
        });
        is_one(&one, &two, rules)
    }

    fn absorb(&mut self, twin: Self, is_newer: bool) {
        if is_newer {
            *self = twin;
        }
    }

    fn patience(rules: &Rules) -> Patience {
        rules.parameters().patience
    }
}

/// True if two circles (x, y, r) are one object.
fn is_one(one: &Vector3<f64>, two: &Vector3<f64>, rules: &Rules) -> bool {
    let gap = rules.parameters().merge_gap;
    let [x, y] = [one[0] - two[0], one[1] - two[1]];
    let touching = if gap > 0.0 { one[2] + two[2] + gap } else { 0.0 };
    let reach = one[2].max(two[2]).max(touching);
    x * x + y * y < reach * reach
}

/// Axes of the ellipse of one standard deviation of the centre [m].
fn axes(state: &Gaussian<5>) -> [[f64; 2]; 2] {
    let P: Matrix2<f64> = state.covariance.fixed_view::<2, 2>(0, 0).into_owned();
    let (mean, half) = (0.5 * (P[(0, 0)] + P[(1, 1)]), 0.5 * (P[(0, 0)] - P[(1, 1)]));
    // Eigenvalues of a 2x2 matrix in closed form: fixed operations, the same bits everywhere.
    let root = (half * half + P[(0, 1)] * P[(0, 1)]).sqrt();
    let [long, short] = [mean + root, mean - root].map(|value| value.max(0.0).sqrt());
    let angle = 0.5 * libm::atan2(P[(0, 1)], half);
    let (sin, cos) = (libm::sin(angle), libm::cos(angle));
    [[long * cos, long * sin], [-short * sin, short * cos]]
}
