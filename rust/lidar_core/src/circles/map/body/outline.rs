//! Outlines of bodies that are not circles: ellipses and rectangles.

#![allow(non_snake_case)] // textbook letters

use crate::Error;
use crate::circles::fit::circle::CircleEstimate;
use crate::circles::map::circle_measurement::{Measures, at_rest, centre_matrix};
use crate::circles::map::element_motion::{ElementMotion, ElementStep};
use crate::circles::map::modes::ElementModes;
use crate::circles::map::rules::Rules;
use crate::circles::shape::{ShapeEstimate, ShapeKind};
use crate::estimation::kalman::{Gaussian, Linearised, mahalanobis, symmetrised};
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_2, PI};

/// Shape of a segment that is represented by a circle in the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutlineEstimate {
    /// Ellipse, rectangle, or line: one face of an unknown object.
    pub shape: ShapeEstimate,
    /// True if the shape is too large to be reported as a circle.
    pub is_large: bool,
    /// Circle fitted to the same rays, used if the element is known to be round; None without such
    /// a circle.
    pub round: Option<CircleEstimate>,
}

/// Kinds of bodies.
const KINDS: [ShapeKind; 3] = [ShapeKind::Circle, ShapeKind::Ellipse, ShapeKind::Rectangle];
/// Weight of the newest measurement in the kind of a body.
const NEWEST: f64 = 0.1;
/// Weight of circles in the recent measurements from which on a body counts as certainly round: a
/// circle looks like another shape in few scans.
const SURE: f64 = 0.7;
/// Weight of the newest measurement in the doubt that a body is round.
const LATEST: f64 = 0.03;
/// Share of other shapes among the measurements up to which there is no doubt that a body is round.
const ROUND: f64 = 0.15;
/// Standard deviation of the centre of a body that is not round, along the line of sight, in half
/// widths: its depth may be less than half of its width, or more than twice.
const DEPTH: f64 = 1.0;
/// Standard deviation of the centre of a body that is not round, across the line of sight, in half
/// widths.
const WIDTH: f64 = 0.35;
/// Ratio of half lengths up to which an ellipse certainly is one bent face, and from which on it is
/// not.
const FLAT: [f64; 2] = [0.35, 0.5];
/// Sines of the angle between the longer axis of an ellipse and the line of sight: up to the first
/// one it is not seen broadside, from the second one on it is.
const BROAD: [f64; 2] = [0.5, 0.8];
/// Difference in weight that another kind needs before the kind of a body changes.
const AHEAD: f64 = 0.1;

/// An ellipse or rectangle in the world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(in crate::circles::map) struct OutlineMeasurement {
    pub(in crate::circles::map) kind: ShapeKind,
    /// Centre x and y [m], bearing of the first half length [rad], both half lengths [m].
    pub(in crate::circles::map) z: SVector<f64, 5>,
    /// Covariance of the measured values.
    pub(in crate::circles::map) R: SMatrix<f64, 5, 5>,
    /// Time of the measurement after the stamp of the scan [s].
    pub(in crate::circles::map) delay: f64,
    /// True if it is too large to be reported as a circle.
    pub(in crate::circles::map) is_large: bool,
}

impl Measures<7, 5> for OutlineMeasurement {
    fn against(&self, state: &SVector<f64, 7>) -> Linearised<7, 5> {
        let H = centre_matrix(self.delay);
        Linearised { y: self.z - H * state, H, R: self.R }
    }
}

impl OutlineMeasurement {
    /// Equivalent outline, described with the other half length first.
    fn turned(&self) -> Self {
        let z = SVector::from([self.z[0], self.z[1], self.z[2] + FRAC_PI_2, self.z[4], self.z[3]]);
        let mut R = self.R;
        R.swap_rows(3, 4);
        R.swap_columns(3, 4);
        Self { z, R, ..*self }
    }

    /// Outline with the heading nearest to `heading`; half a turn is the same outline.
    fn near(mut self, heading: f64) -> Self {
        self.z[2] -= PI * libm::round((self.z[2] - heading) / PI);
        self
    }
}

/// Outline of a body over time: the kind that most measurements show, and the state of its filter.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(in crate::circles::map) struct Outline {
    state: Option<ElementModes<7>>,
    /// Weights of the kinds in recent measurements.
    shares: [f64; 3],
    kind: usize,
    /// Share of recent measurements that were too large for a circle.
    large: f64,
    /// Share of measurements that do not look like a circle, over a longer time.
    unround: f64,
}

impl Outline {
    /// True if the parts of a restored state agree.
    pub(in crate::circles::map) fn fits(&self, motion: &ElementMotion) -> bool {
        self.kind < self.shares.len() && self.state.iter().all(|state| state.fits(motion))
    }

    /// Outline from the first measurement; `seen` is None for a circle.
    pub(in crate::circles::map) fn new(
        seen: Option<&OutlineMeasurement>,
        is_face: bool,
        rules: &Rules,
    ) -> Self {
        let mut outline = Self::default();
        if let Some(seen) = seen {
            outline.kind = number(seen.kind);
            outline.state = Some(started(seen, rules));
            outline.large = f64::from(u8::from(seen.is_large));
        }
        outline.shares[outline.kind] = 1.0;
        outline.unround = f64::from(u8::from(is_face || outline.kind > 0));
        outline
    }

    /// Doubt that the body is round, 0 to 1: a circle looks like another shape in few scans.
    pub(in crate::circles::map) fn doubt(&self) -> f64 {
        ((self.unround - ROUND) / (1.0 - SURE - ROUND)).clamp(0.0, 1.0)
    }

    pub(in crate::circles::map) fn predict(&mut self, step: &ElementStep) {
        if let Some(state) = &mut self.state {
            state.predict(&step.outlines);
        }
    }

    /// Correct with a measurement of the body; `seen` is None for a circle. A measurement outside
    /// the gate gets a larger covariance, so that it is inside.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`]; nothing changes then.
    pub(in crate::circles::map) fn correct(
        &mut self,
        seen: Option<&OutlineMeasurement>,
        rules: &Rules,
    ) -> Result<(), Error> {
        if let Some(seen) = seen {
            match &mut self.state {
                Some(state) => {
                    let (mut seen, squared) = nearest(&state.combined(), seen)?;
                    seen.R *= (squared / rules.outline_gate()).max(1.0);
                    state.correct(&seen, None)?;
                }
                None => self.state = Some(started(seen, rules)),
            }
        }
        let is_large = seen.is_some_and(|seen| seen.is_large);
        self.vote(seen.map_or(ShapeKind::Circle, |seen| seen.kind), is_large);
        Ok(())
    }

    /// True if the body is treated as a circle.
    pub(in crate::circles::map) fn is_round(&self) -> bool {
        self.kind == 0
    }

    /// True if the body is treated as a rectangle.
    pub(super) fn is_angular(&self) -> bool {
        KINDS[self.kind] == ShapeKind::Rectangle
    }

    /// True if the body looks like a circle in nearly all scans.
    pub(in crate::circles::map) fn is_surely_round(&self) -> bool {
        self.is_round() && self.shares[0] > SURE
    }

    /// True if most recent measurements were too large for a circle.
    pub(in crate::circles::map) fn is_large(&self) -> bool {
        self.large > 0.5
    }

    /// Covariance of the centre of a body because its depth is not visible [m^2]. The body is
    /// represented by a circle of this radius [m] and was seen in the direction `sight`. Zero for
    /// certainly round bodies. More scans from the same side do not reduce it.
    pub(in crate::circles::map) fn unseen(&self, radius: f64, [x, y]: [f64; 2]) -> Matrix2<f64> {
        let longer = self.reported().map_or(0.0, |(_, state)| state.mean[5]);
        let half = radius.max(longer) * self.doubt();
        let (along, across) = (Vector2::new(x, y) * half, Vector2::new(-y, x) * half);
        along * along.transpose() * (DEPTH * DEPTH) + across * across.transpose() * (WIDTH * WIDTH)
    }

    /// Certainty, 0 to 1, that only one bent face of the body was seen in the direction `sight`: it
    /// looks like a flat ellipse seen from its flat side.
    pub(in crate::circles::map) fn is_bent(&self, sight: [f64; 2]) -> f64 {
        let ellipse = |&(kind, _): &(ShapeKind, _)| kind == ShapeKind::Ellipse;
        self.reported().filter(ellipse).map_or(0.0, |(_, state)| {
            let mean = state.mean;
            let flat = ((FLAT[1] - mean[6] / mean[5]) / (FLAT[1] - FLAT[0])).clamp(0.0, 1.0);
            let across = libm::cos(mean[4]) * sight[1] - libm::sin(mean[4]) * sight[0];
            let facing = (across.abs() - BROAD[0]) / (BROAD[1] - BROAD[0]);
            flat * facing.clamp(0.0, 1.0)
        })
    }

    /// Update the doubt that the body is round with a measurement.
    pub(in crate::circles::map) fn doubted(&mut self, is_unround: bool) {
        self.unround += LATEST * (f64::from(u8::from(is_unround)) - self.unround);
    }

    fn vote(&mut self, kind: ShapeKind, is_large: bool) {
        self.large += NEWEST * (f64::from(u8::from(is_large)) - self.large);
        self.doubted(kind != ShapeKind::Circle);
        self.shares = self.shares.map(|share| share * (1.0 - NEWEST));
        self.shares[number(kind)] += NEWEST;
        // A lead is needed to change: shapes between two kinds would alternate with every scan.
        let ahead = |&other: &usize| self.shares[other] > self.shares[self.kind] + AHEAD;
        self.kind = (0..KINDS.len()).find(ahead).unwrap_or(self.kind);
        if self.shares[0] > 1.0 - AHEAD {
            self.state = None; // a circle after all
        }
    }

    /// Kind and state of the outline, with the longer half length first; None for a circle. The
    /// state is centre and velocity, bearing of the longer half length [rad], and both half lengths
    /// [m].
    pub(in crate::circles::map) fn reported(&self) -> Option<(ShapeKind, Gaussian<7>)> {
        let Gaussian { mut mean, mut covariance } = self.state.as_ref()?.combined();
        if mean[6] > mean[5] {
            // Rows and columns of the covariance change places with the entries of the mean.
            mean.swap_rows(5, 6);
            covariance.swap_rows(5, 6);
            covariance.swap_columns(5, 6);
            mean[4] += FRAC_PI_2;
        }
        mean[4] -= PI * libm::round(mean[4] / PI);
        let is_shape = self.kind > 0 && mean[6] > 0.0;
        is_shape.then(|| (KINDS[self.kind], Gaussian { mean, covariance: symmetrised(covariance) }))
    }
}

fn number(kind: ShapeKind) -> usize {
    KINDS.iter().position(|&one| one == kind).unwrap_or(0)
}

fn started(seen: &OutlineMeasurement, rules: &Rules) -> ElementModes<7> {
    ElementModes::new(at_rest(seen.z, seen.R, seen.delay, rules.speed()), rules.motion())
}

/// The description of a measured outline that is nearest to a state, and its squared Mahalanobis
/// distance. An outline has several: half a turn, or a quarter turn with exchanged half lengths.
fn nearest(
    state: &Gaussian<7>,
    seen: &OutlineMeasurement,
) -> Result<(OutlineMeasurement, f64), Error> {
    // The filter is linear in heading and lengths, so the measurement takes the description in
    // which both are nearest.
    let mut ways = [*seen, seen.turned()].map(|way| (way.near(state.mean[4]), 0.0));
    for (way, squared) in &mut ways {
        let Linearised { y, H, R } = way.against(&state.mean);
        let S = symmetrised(H * state.covariance * H.transpose() + R);
        *squared = mahalanobis(&y, &S)?.squared;
    }
    let [usual, turned] = ways;
    Ok(if turned.1 < usual.1 { turned } else { usual })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(heading: f64, half: [f64; 2]) -> OutlineMeasurement {
        OutlineMeasurement {
            kind: ShapeKind::Rectangle,
            z: SVector::from([1.0, 2.0, heading, half[0], half[1]]),
            R: SMatrix::from_diagonal(&SVector::from([1e-4, 1e-4, 1e-3, 2e-4, 3e-4])),
            delay: 0.0,
            is_large: false,
        }
    }

    #[test]
    fn of_all_ways_to_state_an_outline_the_nearest_counts() -> Result<(), Error> {
        let here = seen(0.1, [0.5, 0.3]);
        let state = at_rest(here.z, here.R, 0.0, 1.0);
        let same = [
            seen(0.1 + PI, [0.5, 0.3]),
            seen(0.1 - PI, [0.5, 0.3]),
            seen(0.1 + FRAC_PI_2, [0.3, 0.5]),
            seen(0.1 - FRAC_PI_2, [0.3, 0.5]),
        ];
        for one in same {
            let (near, squared) = nearest(&state, &one)?;
            assert!(squared < 1e-20 && (near.z - here.z).abs().max() < 1e-12);
        }
        let (near, _) = nearest(&state, &seen(0.1 + FRAC_PI_2, [0.3, 0.5]))?;
        assert_eq!((near.R[(3, 3)], near.R[(4, 4)]), (3e-4, 2e-4));
        Ok(())
    }

    #[test]
    fn a_kind_changes_when_another_is_seen_more_often() {
        let mut outline = Outline::default();
        outline.shares[0] = 1.0;
        for _ in 0..7 {
            assert_eq!(outline.kind, 0);
            outline.vote(ShapeKind::Ellipse, true);
        }
        outline.vote(ShapeKind::Ellipse, true);
        assert_eq!(KINDS[outline.kind], ShapeKind::Ellipse);
        assert!(outline.is_large());
        outline.vote(ShapeKind::Circle, false);
        assert_eq!(KINDS[outline.kind], ShapeKind::Ellipse);
        outline.vote(ShapeKind::Circle, false);
        assert!(!outline.is_large());
    }
}
