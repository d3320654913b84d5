//! Likelihood of a measurement under a body, and weight of the measurement.

#![allow(non_snake_case)] // textbook letters

use super::measurement::{FREE, Legs, STAYED};
use super::person::Gait;
use super::{FARTHEST, KNOWN, RoundBody};
use crate::Error;
use crate::circles::map::circle_measurement::{CircleMeasurement, Measures};
use crate::circles::map::element::exceeds;
use crate::circles::map::modes::{Distances, LN_2_PI, joined};
use crate::circles::map::rules::Rules;
use crate::circles::map::view::earlier::Trace;
use crate::estimation::kalman::{Gaussian, Linearised, mahalanobis, symmetrised};
use nalgebra::{Matrix3, Vector2};

/// Probability of standing above which a body counts as not moved, whatever its fit is.
const LIKELY: f64 = 0.2;
/// Probability of standing above which a body counts as standing before.
const STOOD: f64 = 0.8;
/// Upper bound of the squared Mahalanobis distance for a body that has not moved: the centre is
/// weaker evidence than the trace.
const STAYING: f64 = 1.0;
/// Largest squared Mahalanobis distance of a measurement with full weight, for a body that is not
/// certainly round or has not moved.
const NEAR: f64 = 9.0;
/// Probability that a measurement shows another part of a body.
const OTHER: f64 = 0.05;
/// Standard deviation of the circle of another part of a body: constant part [m].
const PART: f64 = 0.03;
/// Standard deviation of the circle of another part of a body: share of the radius.
const PART_SHARE: f64 = 0.5;
/// Probability that a measurement shows another part of a certainly round body, for the decision
/// whether it stands.
const OTHER_OF_ROUND: f64 = 0.001;
/// Speed above which a measurement belongs to another body [m/s]. It is the speed since the last
/// scan; if the place of the body is not known, it is the speed since its last measurement.
const FASTEST: f64 = 3.0;
/// Squared Mahalanobis distance up to which a measurement may be a body that comes back into sight:
/// 99.7 %, chi-square with 2 degrees of freedom.
const RETURN: f64 = 11.8;
/// Mean time for which a body is out of sight, if it comes back at all [s].
const HIDDEN: f64 = 5.0;

/// Time for which the centre of a walking person keeps the same error [s].
const LASTS: f64 = 0.15;
/// Lower bound of the time between measurements in these formulas [s].
const SHORTEST: f64 = 0.01;
/// Standard deviation of the error of the centre of a trunk, in radii.
const SWAY: f64 = 0.1;
/// Standard deviation of the error of the centre that a single leg gives [m].
const STRIDE: f64 = 0.2;
/// Weight of the newest radius in the variance of the measured radii.
const ROUGHNESS: f64 = 0.1;
/// Largest squared deviation of a radius that counts [m^2].
const ROUGHEST: f64 = 0.01;

impl RoundBody {
    /// Legs, speed, radius and shape of the body, which distinguish a person from other bodies.
    pub(super) fn gait(&self, legs: Legs) -> Gait {
        let mean = self.mean();
        Gait {
            legs,
            speed: if self.stands { 0.0 } else { libm::hypot(mean[2], mean[3]) },
            radius: mean[4],
            is_angular: self.outline.is_angular(),
        }
    }

    /// The measurement with a covariance that contains the additional noise of this body in centre
    /// and radius.
    pub(super) fn noisy(&self, seen: &CircleMeasurement) -> CircleMeasurement {
        let mut seen = *seen;
        for axis in 0..2 {
            seen.R[(axis, axis)] += self.jitter.variance();
        }
        // The variance that the fit states is chance; only what exceeds it is the shape of the body.
        seen.R[(2, 2)] += (self.rough - seen.R[(2, 2)]).max(0.0);
        seen
    }

    /// Additional variance of the centre of a walking person [m^2]. Arms swing, the trunk turns and
    /// one leg is seen before the other, so the same error lasts for a part of a step: two
    /// measurements `dt` [s] apart contain little more information than one. Zero for certainly
    /// round and for standing bodies.
    pub(super) fn sway(&self, legs: Legs, dt: f64) -> f64 {
        if !self.is_like_a_person() || self.stands {
            return 0.0;
        }
        let std = match legs {
            Legs::Two => return 0.0,
            Legs::One => STRIDE,
            Legs::None => SWAY * self.place()[2] * self.outline.doubt(),
        };
        // The filter knows only white noise: this variance has the effect of an error that lasts. The factor
        // is 3 at least, also after a gap, because only a part of a step was seen there.
        std * std * (1.0 + 2.0 * LASTS / dt.clamp(SHORTEST, LASTS))
    }

    /// The measurement by which the circle is corrected. A measurement outside all gates gets a
    /// larger covariance, so that it is inside. The same holds for a measurement that shows motion
    /// although earlier scans saw the same surface, and for one that shows a sudden turn of a body
    /// that is not round: another part of the body is then visible.
    pub(super) fn weighted(
        &self,
        seen: &CircleMeasurement,
        trace: Option<Trace>,
        rules: &Rules,
    ) -> Result<CircleMeasurement, Error> {
        let mut seen = self.noisy(seen);
        let motion = rules.motion();
        let Distances { least, calm, first } = self.circle.distances(&seen, motion)?;
        let has_stayed =
            trace.is_some_and(|trace| trace >= STAYED) && self.circle.standing(motion) > LIKELY;
        // A round object leaves its place before its trace shows that it moves.
        let is_round = self.outline.is_surely_round();
        let (from, most, left) = match (has_stayed, is_round) {
            (true, false) => (first, NEAR, STAYING),
            (true, true) => (first, NEAR, NEAR),
            (false, true) => (least, rules.gate(), rules.gate()),
            (false, false) => (calm, NEAR, NEAR),
        };
        if from.squared <= most {
            return Ok(seen);
        }
        let Gaussian { mean, covariance } = self.circle();
        let growth = seen.z[2] - mean[4];
        if growth * growth > NEAR * (covariance[(4, 4)] + seen.R[(2, 2)]) {
            // A very different radius means that the fit is of another part of the body. The fit's
            // covariance does not contain this error, so it is added.
            seen.R += Matrix3::identity() * (from.length / left);
        } else {
            seen.R *= from.squared / left;
        }
        Ok(seen)
    }

    /// True if the body cannot have reached the measurement since it was last measured.
    fn is_out_of_reach(&self, seen: &CircleMeasurement, rules: &Rules) -> bool {
        // Most pairs are too far apart, whatever their covariances.
        let apart = self.apart(&seen.z);
        if apart > FARTHEST.max(FASTEST * self.waiting) {
            return true;
        }
        let place = self.circle().covariance.fixed_view::<2, 2>(0, 0).into_owned();
        let has_stood = self.circle.standing(rules.motion()) > STOOD;
        let time = if exceeds(&place, KNOWN * KNOWN) && !has_stood {
            self.waiting
        } else {
            self.waiting / f64::from(self.waits.max(1))
        };
        apart > FARTHEST.max(FASTEST * time)
    }

    /// -2 ln of the likelihood of a measurement; None if it belongs to another body.
    ///
    /// Sometimes another part of a body is visible, and its circle is shifted by a part of its
    /// size. The probability that a body comes back decreases with the time that it was out of
    /// sight. A measurement far from the predicted position belongs to another body.
    pub(super) fn cost(
        &self,
        seen: &CircleMeasurement,
        trace: Option<Trace>,
        rules: &Rules,
    ) -> Result<Option<f64>, Error> {
        let noisy = self.noisy(seen);
        if !rules.has_standing() {
            return self.circle.cost(&noisy, rules.gate());
        }
        if self.is_out_of_reach(seen, rules) {
            return Ok(None);
        }
        let state = self.circle();
        let wide = self.of_part(&noisy);
        let Linearised { y, H, R } = wide.against(&state.mean);
        let S = symmetrised(H * state.covariance * H.transpose() + R);
        let is_back = self.waits > 1;
        let place = Vector2::new(y[0], y[1]);
        if is_back
            && mahalanobis(&place, &S.fixed_view::<2, 2>(0, 0).into_owned())?.squared > RETURN
        {
            return Ok(None);
        }
        let part = mahalanobis(&y, &S)?;
        // Another part of what stands is where a surface was, not where space was free.
        let is_other =
            trace.is_some_and(|trace| trace < FREE) && self.circle.standing(rules.motion()) > STOOD;
        let part = (part.squared <= rules.gate() && !is_other)
            .then(|| part.squared + part.log_determinant + 3.0 * LN_2_PI - 2.0 * libm::log(OTHER));
        let whole = self.circle.cost(&noisy, rules.gate())?;
        let gone = if is_back { 2.0 * self.waiting / HIDDEN } else { 0.0 };
        Ok(match (whole, part) {
            (Some(whole), Some(part)) => Some(joined(whole, part) + gone),
            (whole, part) => whole.or(part).map(|cost| cost + gone),
        })
    }

    /// Probability that a measurement shows another part of this body, for the decision whether it
    /// stands.
    pub(super) fn share_of_parts(&self) -> f64 {
        if self.outline.is_surely_round() { OTHER_OF_ROUND } else { OTHER }
    }

    /// The measurement with the covariance that it has if it shows another part of this body.
    pub(super) fn of_part(&self, seen: &CircleMeasurement) -> CircleMeasurement {
        let spread = PART + PART_SHARE * self.place()[2].max(seen.z[2]);
        CircleMeasurement { R: seen.R + Matrix3::identity() * (spread * spread), ..*seen }
    }

    /// Update the estimated noise of the centre and of the radius with a measurement.
    pub(super) fn listen(&mut self, seen: &CircleMeasurement, time_ns: i64) {
        let variance = 0.5 * (seen.R[(0, 0)] + seen.R[(1, 1)]);
        self.jitter.add(time_ns, [seen.z[0], seen.z[1]], variance);
        let Gaussian { mean, covariance } = self.circle();
        let off = seen.z[2] - mean[4];
        let excess = off * off - seen.R[(2, 2)] - covariance[(4, 4)];
        self.rough += ROUGHNESS * (excess.min(ROUGHEST) - self.rough);
    }
}
