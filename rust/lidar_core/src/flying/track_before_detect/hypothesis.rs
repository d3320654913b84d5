//! One hypothesis: a target of nearly constant velocity that gives lone returns.

use super::lone_returns::LoneReturn;
use super::{Clutter, seconds};
use crate::flying::track::FoundTarget;
use crate::geometry::transform::{minus, norm};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Spectral density of the white acceleration noise [m^2/s^3].
const ACCELERATION: f64 = 4.0;
/// Standard deviation of the velocity along every axis before the second return [m/s].
const SPEED_STD: f64 = 8.0;
/// Probability that a scan has a return of the target.
const DETECTED: f64 = 0.5;
/// Largest squared Mahalanobis distance of a return of the target (99.8 % of them are nearer).
const GATE: f64 = 15.0;
/// Largest amount that one return adds to the score. It is limited because false returns are not
/// spread evenly.
const MOST: f64 = 3.4;
/// Score of a hypothesis before its first two returns. Only few pairs of returns come from one
/// target.
const START: f64 = -4.0;
/// Score below which a hypothesis ends; `LOST`: time without a return after which it ends [s].
const LEAST: f64 = -6.0;
/// Time without a return after which a hypothesis ends [s].
const LOST: f64 = 1.0;
/// Score from which on a target is certain; `FEWEST_RETURNS`: smallest number of its returns.
const CERTAIN: f64 = 10.0;
/// Smallest number of returns of a certain target.
const FEWEST_RETURNS: u32 = 5;
/// Largest score. Because of this limit, the score of a target that stops or disappears soon falls
/// below the bounds.
const HIGHEST: f64 = 20.0;
/// Distance [m], and number of standard deviations (`STDS`), by which a certain target must have
/// moved.
const MOVED: f64 = 1.0;
/// Number of standard deviations by which a certain target must have moved.
const STDS: f64 = 3.0;
/// Largest difference in elevation of returns of one row, as a multiple of the angle between rays.
/// At least `ROW_CHANGES` returns, and the share `CHANGES_SHARE` of them, must be of another row
/// than the return before.
const ONE_ROW: f64 = 0.3;
/// Smallest number of returns that are of another row than the return before.
const ROW_CHANGES: u32 = 3;
/// Smallest share of the returns that are of another row than the return before.
const CHANGES_SHARE: f64 = 0.25;
/// Differences in position [m] and velocity [m/s] below which two hypotheses follow the same
/// target.
const SAME: [f64; 2] = [0.5, 1.0];

/// A hypothesis with its estimate: a point that moves on every axis independently, with the same
/// covariance on all axes.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Hypothesis {
    pub(super) position: [f64; 3],
    velocity: [f64; 3],
    /// Variance of the position [m^2], covariance of position and velocity [m^2/s], and variance of
    /// the velocity [m^2/s^2], along each axis.
    covariance: [f64; 3],
    /// Logarithm of the likelihood ratio of the returns: caused by a target, or by chance.
    pub(super) score: f64,
    n_returns: u32,
    stamp_ns: i64,
    /// Position of the first return [m]; times of the first and of the last return [ns].
    first: [f64; 3],
    first_ns: i64,
    last_ns: i64,
    /// Position of the sensor at the first return [m].
    origin: [f64; 3],
    /// Angle of the last return above the level plane of the sensor [rad]; `row_changes`: number of
    /// returns that were not of the row of the return before.
    elevation: f64,
    row_changes: u32,
    /// Angle between neighbouring rays [rad].
    gap: f64,
}

/// The first return of a hypothesis.
pub(super) struct FirstReturn {
    pub(super) place: [f64; 3],
    /// Position of the sensor [m].
    pub(super) origin: [f64; 3],
    pub(super) stamp_ns: i64,
    /// Number of scans between the first two returns.
    pub(super) missed: usize,
}

impl Hypothesis {
    /// The hypothesis of two returns. None if they are far more likely by chance.
    pub(super) fn of_pair(
        first: &FirstReturn,
        second: &LoneReturn,
        stamp_ns: i64,
        clutter: &Clutter,
    ) -> Option<Self> {
        let time = seconds(first.stamp_ns, stamp_ns);
        let way = minus(second.place, first.place);
        let variance = second.std * second.std;
        let spread = 2.0 * variance + (SPEED_STD * time).powi(2);
        let density = gaussian(way.iter().map(|part| part * part).sum(), spread);
        let score = START
            + libm::log(DETECTED * density / clutter.without(2)).min(MOST)
            + first.missed as f64 * libm::log(1.0 - DETECTED);
        (score > LEAST).then(|| Self {
            position: second.place,
            velocity: way.map(|part| part / time),
            covariance: [variance, variance / time, 2.0 * variance / (time * time)],
            score,
            n_returns: 2,
            stamp_ns,
            first: first.place,
            first_ns: first.stamp_ns,
            last_ns: stamp_ns,
            origin: first.origin,
            elevation: second.elevation,
            row_changes: 0,
            gap: second.gap / norm(minus(second.place, first.origin)).max(1.0),
        })
    }

    /// Predict the estimate to the time of a scan.
    pub(super) fn predict(&mut self, stamp_ns: i64) {
        let time = seconds(self.stamp_ns, stamp_ns).max(0.0);
        let [position, both, velocity] = self.covariance;
        let noise = [time.powi(3) / 3.0, time.powi(2) / 2.0, time].map(|part| part * ACCELERATION);
        self.covariance = [
            position + 2.0 * time * both + time * time * velocity + noise[0],
            both + time * velocity + noise[1],
            velocity + noise[2],
        ];
        for axis in 0..3 {
            self.position[axis] += time * self.velocity[axis];
        }
        self.stamp_ns = stamp_ns;
    }

    /// Cost of assigning a return. None if it is outside the gate.
    pub(super) fn cost(&self, found: &LoneReturn) -> Option<f64> {
        let variance = self.covariance[0] + found.std * found.std;
        let squared = squared(minus(self.seen_from(found), self.position)) / variance;
        (squared <= GATE).then(|| squared + 3.0 * libm::log(variance))
    }

    /// Position of a return, moved to the stamp of its scan [m].
    fn seen_from(&self, found: &LoneReturn) -> [f64; 3] {
        std::array::from_fn(|axis| found.place[axis] - found.delay * self.velocity[axis])
    }

    /// Correct the estimate and the score with a return. `clutter`: other lone returns around it.
    pub(super) fn correct(&mut self, found: &LoneReturn, clutter: &Clutter) {
        let offset = minus(self.seen_from(found), self.position);
        let [position, both, velocity] = self.covariance;
        let variance = position + found.std * found.std;
        let likelihood = DETECTED * gaussian(squared(offset), variance);
        let evidence = libm::log(likelihood / clutter.without(self.n_returns));
        self.score = (self.score + evidence.min(MOST)).min(HIGHEST);
        let gain = [position / variance, both / variance];
        for (axis, offset) in offset.into_iter().enumerate() {
            self.position[axis] += gain[0] * offset;
            self.velocity[axis] += gain[1] * offset;
        }
        self.covariance =
            [position - gain[0] * position, both - gain[0] * both, velocity - gain[1] * both];
        if (found.elevation - self.elevation).abs() > ONE_ROW * self.gap {
            self.row_changes = self.row_changes.saturating_add(1);
        }
        self.elevation = found.elevation;
        self.n_returns = self.n_returns.saturating_add(1);
        self.last_ns = self.stamp_ns;
    }

    /// Update the score with a scan that shows nothing at the target's place.
    pub(super) fn miss(&mut self) {
        self.score += libm::log(1.0 - DETECTED);
    }

    /// Whether the hypothesis is continued at `now_ns`.
    pub(super) fn may_be(&self, now_ns: i64) -> bool {
        self.score > LEAST && seconds(self.last_ns, now_ns) <= LOST
    }

    /// Whether the target certainly exists and moves. `origin`: present position of the sensor [m].
    pub(super) fn is_certain(&self, origin: [f64; 3]) -> bool {
        let [position, _, velocity] = self.covariance.map(|value| value.max(0.0).sqrt());
        let way = minus(self.position, self.first);
        let is_seen_at_rest = norm(minus(origin, self.origin)) < MOVED;
        self.score >= CERTAIN
            && self.n_returns >= FEWEST_RETURNS
            && self.last_ns == self.stamp_ns
            && norm(way) > MOVED.max(STDS * position)
            && norm(self.velocity) > STDS * velocity
            && (is_seen_at_rest || !self.may_slide(way, position))
    }

    /// Whether the point may be where a row of rays of a moving sensor meets a pole or a cable: the
    /// point moves although the object is static. Such a point moves straight up or down, or is
    /// nearly always in the same row.
    fn may_slide(&self, way: [f64; 3], std: f64) -> bool {
        let fewest = ROW_CHANGES.max((CHANGES_SHARE * f64::from(self.n_returns)).ceil() as u32);
        let level = libm::hypot(way[0], way[1]);
        level <= MOVED.max(STDS * std) || self.row_changes < fewest
    }

    /// Whether both follow the same target.
    pub(super) fn is_same(&self, other: &Self) -> bool {
        let [position, _, velocity] = self.covariance.map(|value| 2.0 * value.max(0.0).sqrt());
        norm(minus(self.position, other.position)) <= SAME[0].max(position)
            && norm(minus(self.velocity, other.velocity)) <= SAME[1].max(velocity)
    }

    pub(super) fn target(&self) -> FoundTarget {
        let Self { position, velocity, covariance, first, first_ns, n_returns, .. } = *self;
        FoundTarget { position, velocity, covariance, first, first_ns, n_returns }
    }

    pub(super) fn is_possible(&self) -> bool {
        let places = self.position.iter().chain(&self.velocity).chain(&self.first);
        let values = places.chain(&self.covariance).chain(&self.origin);
        values.chain([&self.score, &self.gap, &self.elevation]).all(|value| value.is_finite())
            && self.covariance[0] >= 0.0
            && self.covariance[2] >= 0.0
    }
}

fn squared(offset: [f64; 3]) -> f64 {
    offset.iter().map(|part| part * part).sum()
}

/// Density of a Gaussian on three axes with equal variance, at a squared distance [1/m^3].
fn gaussian(squared: f64, variance: f64) -> f64 {
    libm::exp(-0.5 * squared / variance) / libm::pow(TAU * variance, 1.5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::estimation::kalman::{Gaussian, Linearised, update};
    use nalgebra::{SMatrix, SVector};

    /// The same correction with full matrices, as a reference.
    fn reference(
        prior: &Gaussian<6>,
        time: f64,
        found: &LoneReturn,
    ) -> Result<(Gaussian<6>, f64), Error> {
        let (mut step, mut noise) =
            (SMatrix::<f64, 6, 6>::identity(), SMatrix::<f64, 6, 6>::zeros());
        for axis in 0..3 {
            step[(axis, axis + 3)] = time;
            noise[(axis, axis)] = ACCELERATION * time.powi(3) / 3.0;
            noise[(axis, axis + 3)] = ACCELERATION * time.powi(2) / 2.0;
            noise[(axis + 3, axis)] = ACCELERATION * time.powi(2) / 2.0;
            noise[(axis + 3, axis + 3)] = ACCELERATION * time;
        }
        let mean = step * prior.mean;
        let covariance = step * prior.covariance * step.transpose() + noise;
        let observed = SMatrix::<f64, 3, 6>::identity();
        let error = SMatrix::<f64, 3, 3>::identity() * (found.std * found.std);
        let offset = SVector::<f64, 3>::from(found.place) - observed * mean;
        let spread = observed * covariance * observed.transpose() + error;
        let model = Linearised { y: offset, H: observed, R: error };
        let updated = update(&Gaussian { mean, covariance }, &model)?;
        let density = libm::exp(-0.5 * updated.nis) / ((TAU * spread).determinant()).sqrt();
        Ok((updated.posterior, density))
    }

    #[test]
    fn it_is_a_kalman_filter_and_its_score_a_likelihood_ratio() -> Result<(), Error> {
        let lone = |place| LoneReturn { place, delay: 0.0, std: 0.2, gap: 0.5, elevation: 0.1 };
        let first =
            FirstReturn { place: [20.0, 1.0, 5.0], origin: [0.0; 3], stamp_ns: 0, missed: 0 };
        let clutter = Clutter { count: 3, volume: 8.0 };
        let second = lone([20.1, 1.4, 5.0]);
        let begun = Hypothesis::of_pair(&first, &second, 100_000_000, &clutter);
        assert!(begun.is_some());
        let Some(mut hypothesis) = begun else { return Ok(()) };
        let mut covariance = SMatrix::<f64, 6, 6>::zeros();
        for axis in 0..3 {
            let [position, both, velocity] = hypothesis.covariance;
            covariance[(axis, axis)] = position;
            covariance[(axis, axis + 3)] = both;
            covariance[(axis + 3, axis)] = both;
            covariance[(axis + 3, axis + 3)] = velocity;
        }
        let values = hypothesis.position.into_iter().chain(hypothesis.velocity);
        let mut state = Gaussian { mean: SVector::from_iterator(values), covariance };
        for (scan, place) in
            [[20.1, 1.8, 5.1], [20.3, 2.5, 5.0], [20.2, 2.6, 4.9]].into_iter().enumerate()
        {
            let found = lone(place);
            let before = hypothesis.score;
            let own = hypothesis.n_returns;
            hypothesis.predict((scan as i64 + 2) * 100_000_000);
            hypothesis.correct(&found, &clutter);
            let (next, density) = reference(&state, 0.1, &found)?;
            state = next;
            let evidence = libm::log(DETECTED * density / clutter.without(own)).min(MOST);
            assert!((hypothesis.score - (before + evidence)).abs() < 1e-9);
            for axis in 0..3 {
                assert!((hypothesis.position[axis] - state.mean[axis]).abs() < 1e-12);
                assert!((hypothesis.velocity[axis] - state.mean[axis + 3]).abs() < 1e-11);
            }
            let of_axis = [(0, 0), (0, 3), (3, 3)].map(|place| state.covariance[place]);
            for (own, other) in hypothesis.covariance.into_iter().zip(of_axis) {
                assert!((own - other).abs() < 1e-12, "{own} {other}");
            }
        }
        Ok(())
    }
}
