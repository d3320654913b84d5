//! Bodies: round objects, ellipses and rectangles, which move.

#![allow(non_snake_case)] // textbook letters

mod body_box;
mod face;
pub(super) mod hull;
mod leg_shares;
mod legs;
pub(super) mod look;
mod measured;
pub(super) mod measurement;
mod meeting;
pub(super) mod outline;
mod person;
mod places;
mod shown;
mod sight;

use self::body_box::BodyBox;
use self::look::Looks;
use self::measurement::BodyMeasurement;
use self::outline::Outline;
use self::person::Person;
use self::places::{are_alike, is_one};
use super::arrivals::BirthPlace;
use super::circle_measurement::new_state;
use super::element::{State, exceeds};
use super::element_motion::{ElementMotion, ElementStep};
use super::modes::ElementModes;
use super::rules::Rules;
use super::view::viewpoint::Viewpoint;
use super::view::visibility::CircleVisibility;
use crate::Error;
use crate::estimation::assignment::{Pair, assign};
use crate::estimation::jitter::Jitter;
use crate::estimation::kalman::Gaussian;
use nalgebra::{SVector, Vector3};
use serde::{Deserialize, Serialize};

/// Distance from the predicted position of a body above which a measurement belongs to another body
/// [m].
const FARTHEST: f64 = 0.8;
/// Standard deviation of the position up to which a body may get a measurement that touches it [m].
const KNOWN: f64 = 0.5;
/// Weight of the expected noise of a centre, as a number of samples.
const TRUST: f64 = 4.0;

/// Squared velocity, normalised by its covariance, from which on a standing body counts as moving
/// (95 % of chi-square with 2 degrees of freedom).
const MOVES: f64 = 5.99;
/// Squared velocity, normalised by its covariance, from which on a known standing body at a place
/// that was free counts as moving (50 % of chi-square with 2 degrees of freedom).
const LEAVES: f64 = 1.39;
/// Squared velocity, normalised by its covariance, below which a moving body counts as standing.
const RESTS: f64 = 0.25;
/// Number of measurements in a row that must show motion before a standing body counts as moving: a
/// single one may show another part of it.
const DEPARTS: u32 = 2;

/// Probability above which a body is a person.
const PERSON: f64 = 0.5;
/// Time for which both of two people were measured before they met [s].
const MET: f64 = 1.0;
/// Distance from a person within which a new body may be a part of this person [m].
const BESIDE: f64 = 1.0;
/// Time of measurement after which a new body beside a person counts as a separate object [s].
const BESIDE_FOR: f64 = 2.0;

/// A body: its circle, or the circle that represents it, and its outline.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct RoundBody {
    circle: ElementModes<5>,
    pub(super) outline: Outline,
    /// Box around it, unless it is certainly round.
    extent: Option<BodyBox>,
    /// Noise of the centre beyond that of the fits: real objects are not exactly round, and the
    /// ranges of rays that graze their edges vary.
    jitter: Jitter,
    /// Variance of the measured radii beyond that of the fits [m^2]: the radius of an object that
    /// is not round differs from view to view.
    rough: f64,
    /// True if the body is reported as standing; the value after the last scan.
    stands: bool,
    /// Number of consecutive last measurements that showed motion.
    departs: u32,
    /// True if earlier scans saw surfaces wherever the last scan hit the body.
    has_stayed: bool,
    /// True if earlier scans saw free space at most points of the body in the last scan.
    is_in_free: bool,
    /// Direction in which it was seen last, of length one.
    sight: [f64; 2],
    looks: Looks,
    /// Scans since its last measurement, the next one included.
    waits: u32,
    /// Time since its last measurement [s].
    waiting: f64,
    /// Time for which it was measured [s].
    known: f64,
    /// True if the body was first seen beside a person and may be a part of this person.
    is_beside: bool,
    person: Person,
}

impl RoundBody {
    /// True if the parts of a restored state agree.
    pub(super) fn fits(&self, motion: &ElementMotion) -> bool {
        self.circle.fits(motion)
            && self.outline.fits(motion)
            && self.extent.iter().all(|extent| extent.fits(motion))
    }

    pub(super) fn circle(&self) -> Gaussian<5> {
        self.circle.combined()
    }

    /// Mean of [`Self::circle`], for tests of pairs of bodies that need no covariance.
    fn mean(&self) -> SVector<f64, 5> {
        self.circle.mean()
    }

    /// Centre and radius [m].
    fn place(&self) -> Vector3<f64> {
        let mean = self.mean();
        Vector3::new(mean[0], mean[1], mean[4])
    }

    /// Probability that the body is a person.
    pub(super) fn person(&self) -> f64 {
        self.person.probability()
    }

    /// True if the body is reported as standing.
    pub(super) fn stands(&self) -> bool {
        self.stands
    }
}

impl State for RoundBody {
    type Measurement = BodyMeasurement;

    fn new<'a>(
        seen: &BodyMeasurement,
        others: impl Iterator<Item = &'a Self>,
        rules: &Rules,
    ) -> Self {
        // Longer than other functions: the first values of all fields.
        // The noise of the others tells what to expect of a new one: they are seen by the same
        // scanner from the same poses.
        let known = rules.parameters().center_noise * rules.parameters().center_noise;
        let mut is_beside = false;
        let (sum, weight) = others.fold((known * TRUST, TRUST), |(sum, weight), other| {
            is_beside |= other.is_like_a_person() && other.apart(&seen.circle.z) < BESIDE;
            let (mean, more) = other.jitter.mean();
            (sum + mean * (more - TRUST).max(0.0), weight + (more - TRUST).max(0.0))
        });
        let mut body = Self {
            circle: ElementModes::new(new_state(&seen.circle, rules.speed()), rules.motion()),
            outline: Outline::new(seen.outline.as_ref(), seen.is_face, rules),
            extent: None,
            jitter: Jitter::new((sum / weight).max(known), TRUST),
            rough: 0.0,
            stands: rules.has_standing(),
            departs: 0,
            has_stayed: seen.has_stayed(),
            is_in_free: false,
            sight: seen.sight,
            looks: Looks::default(),
            waits: 0,
            waiting: 0.0,
            known: 0.0,
            is_beside,
            person: Person::default(),
        };
        body.circle =
            ElementModes::new(new_state(&body.noisy(&seen.circle), rules.speed()), rules.motion());
        if body.outline.doubt() > 0.0 {
            let known = seen.hull.as_ref().zip(seen.look.as_ref());
            let known = known.filter(|(hull, _)| !hull.is_covered());
            body.extent =
                known.map(|(hull, look)| BodyBox::new(hull, (look, seen.circle.delay), rules));
        }
        body.listen(&seen.circle, seen.time_ns);
        body
    }

    /// A measurement that nearly touches a larger one is a part of it, as an arm is of a person. Two
    /// legs are one person.
    fn wholes<'a>(
        all: impl Iterator<Item = &'a Self>,
        seen: &[BodyMeasurement],
        rules: &Rules,
    ) -> (Vec<BodyMeasurement>, Vec<usize>) {
        let mut measurements = seen.to_vec();
        let mut wholes = places::wholes(seen, rules);
        let bodies: Vec<&Self> = all.collect();
        if rules.has_standing() {
            Self::keep_apart(&bodies, seen, &mut wholes);
        }
        for (part, &whole) in wholes.iter().enumerate().filter(|&(part, &whole)| part != whole) {
            let hull = measurements[whole].hull.zip(seen[part].hull);
            measurements[whole].hull = hull.map(|(whole, part)| whole.joined(&part));
        }
        if rules.has_standing() {
            legs::put_together(&bodies, &mut measurements, &mut wholes);
            Self::share(&bodies, &mut measurements, &wholes);
        }
        (measurements, wholes)
    }

    fn predict(&mut self, step: &ElementStep) {
        self.circle.predict(&step.circles);
        self.outline.predict(step);
        if let Some(extent) = &mut self.extent {
            if self.stands && self.waits > 0 {
                extent.halt(); // what stands stays where it was seen
            }
            extent.predict(step);
        }
        self.waits = self.waits.saturating_add(1);
        self.waiting += step.seconds;
    }

    fn correct(&mut self, seen: &BodyMeasurement, rules: &Rules) -> Result<(), Error> {
        let face = self.outline.behind(seen).filter(|_| rules.has_standing());
        if seen.is_face || face.is_some() {
            self.outline.doubted(true);
        } else {
            self.outline.correct(seen.outline.as_ref(), rules)?;
        }
        self.surround(seen, rules)?;
        // A single scan may classify a circle as another shape, whose centre it hardly determines.
        let mut used = face.unwrap_or(seen.circle);
        if let Some(round) = seen.round.filter(|_| self.outline.is_round())
            && self.circle.cost(&self.noisy(&round), rules.gate())?.is_some()
        {
            used = round;
        }
        self.listen(&used, seen.time_ns);
        self.sight = seen.sight;
        self.has_stayed = seen.has_stayed();
        self.is_in_free = seen.is_in_free();
        self.person.hear(&self.gait(seen.legs), self.waiting);
        self.known += self.waiting;
        let sway = self.sway(seen.legs, self.waiting);
        (self.waits, self.waiting) = (0, 0.0);
        if let Some(look) = seen.look {
            self.looks.add(look, &self.place(), &used.R);
        }
        let mut weighted = self.weighted(&used, seen.trace, rules)?;
        if !rules.has_standing() {
            return self.circle.correct(&weighted, None);
        }
        let mut part = self.of_part(&self.noisy(&used));
        for axis in 0..2 {
            weighted.R[(axis, axis)] += sway;
            part.R[(axis, axis)] += sway;
        }
        self.circle.correct(&weighted, Some((&part, self.share_of_parts(), seen.evidence())))
    }

    /// At most one measurement per body: the assignment that explains all of them best.
    fn associate<'a>(
        all: impl ExactSizeIterator<Item = &'a Self> + Clone,
        seen: &[BodyMeasurement],
        wholes: &[usize],
        from: &Viewpoint,
        rules: &Rules,
    ) -> Result<Vec<Option<usize>>, Error> {
        let whole = wholes.iter().enumerate().filter(|&(one, &whole)| one == whole).count();
        // Costs are -2 log likelihoods, so that of a new body is that of the density of births.
        let unassigned = -2.0 * libm::log(rules.density(whole, from.view.as_ref()));
        let count = all.len();
        let mut pairs = Vec::new();
        for (row, body) in all.clone().enumerate() {
            for (column, measurement) in seen.iter().enumerate() {
                if wholes[column] == column
                    && body.is_alike(measurement)
                    && let Some(cost) = body.cost(&measurement.circle, measurement.trace, rules)?
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
        if rules.has_standing() {
            Self::adopt(all, seen, wholes, &mut owners, rules);
        }
        Ok(owners)
    }

    fn look(&self, from: &Viewpoint, rules: &Rules) -> CircleVisibility {
        self.visibility(from, rules)
    }

    fn glimpse(&mut self, from: &Viewpoint, rules: &Rules) -> Result<bool, Error> {
        self.take_glimpse(from, rules)
    }

    fn doubt(&self, visibility: CircleVisibility) -> f64 {
        self.share_beyond(visibility)
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

    fn is_lost(&self, rules: &Rules) -> bool {
        // The circle of what is large is not reported.
        let state = if self.outline.is_large() { self.circle() } else { self.reported() };
        let mut limit = rules.parameters().limits.position;
        if self.waits > 0 && rules.has_standing() {
            limit = limit.min(KNOWN);
        }
        exceeds(&state.covariance.fixed_view::<2, 2>(0, 0).into_owned(), limit * limit)
    }

    /// The decision between standing and moving has a hysteresis. An element stands unless motion
    /// is certain: the velocity of a new element, and of one that shows another part of itself, is
    /// hardly known. An element at a place where earlier scans saw its surface does not move,
    /// whatever its fits are.
    fn settle(&mut self, rules: &Rules) -> bool {
        let [begin, end] = rules.parameters().standing.hysteresis;
        let (probability, moves_by) = self.motion(rules);
        // An element that is known well and entered free space needs no second measurement.
        let is_leaving = self.is_in_free && self.known >= MET;
        let least = match (self.stands, is_leaving) {
            (true, false) => MOVES,
            (true, true) => LEAVES,
            (false, _) => RESTS,
        };
        let stands = probability > begin
            || self.has_stayed
            || self.stands && probability >= end
            || moves_by < least;
        if self.waits == 0 {
            self.departs = if stands { 0 } else { self.departs.saturating_add(1) };
        }
        let is_sure = !self.stands || is_leaving || self.departs >= DEPARTS;
        self.stands = rules.has_standing() && (stands || !is_sure);
        self.stands
    }

    /// True if the centre of one body lies inside the other, or the gap between them is small.
    /// Large bodies have corners, between which there may be others: they are never twins.
    fn is_twin(&self, other: &Self, rules: &Rules) -> bool {
        if self.outline.is_large() || other.outline.is_large() || self.passes(other) {
            return false;
        }
        let [one, two] = [self, other].map(Self::place);
        are_alike(one[2], two[2])
            && libm::hypot(one[0] - two[0], one[1] - two[1]) <= FARTHEST
            && is_one(&one, &two, rules)
    }

    fn absorb(&mut self, twin: Self, is_newer: bool) {
        if is_newer {
            *self = twin;
        }
    }

    fn birth_place(seen: &BodyMeasurement) -> BirthPlace {
        BirthPlace::of(seen.trace, seen.circle.R[(2, 2)])
    }

    fn coast(rules: &Rules) -> Option<f64> {
        rules.parameters().coast
    }
}
