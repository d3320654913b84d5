//! Offset in time between the scans of a scanner and their poses, estimated from static objects.
//!
//! If poses are late by `o`, a static object at `m` is measured at `m - o d`. Here `d` is the
//! velocity that the motion of the pose gives to the place. `d` changes over time, and `m` hardly
//! does. For every object, a Kalman filter for slow drift runs over the measured positions and,
//! with the same gains, over `d`. The innovations of the positions are `-o` times those of `d`,
//! plus noise. A scanner that turns at a constant rate gives no information, because `d` is then
//! constant, too.

use super::fit::circle::CircleEstimate;
use super::map::PoseCovariance;
use crate::circles::preprocess::polar_scan::turn;
use crate::geometry::transform::Transform;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Longest time over which the motion of the pose is computed [s].
const LONGEST: f64 = 0.5;
/// Time without a measurement after which the filter of an object starts again [s].
const MEMORY: f64 = 5.0;
/// Variance of the drift of places [m^2/s^2].
const DRIFT: f64 = 0.05 * 0.05;
/// Density of the random walk of places [m^2/s].
const WANDER: f64 = 0.002 * 0.002;
/// Density of the random walk of the drift of places [m^2/s^3].
const CHANGE: f64 = 0.002 * 0.002;
/// Number of measurements over which the regression averages.
const MOST: f64 = 20_000.0;
/// Variance of a place beyond that of its fit [m^2].
const ROUGH: f64 = 0.005 * 0.005;
/// Squared innovation, in variances, above which a measurement shows another object, or another
/// part of it.
const FAR: f64 = 16.0;
/// Standard deviation below which the offset counts as known [s].
const KNOWN: f64 = 0.005;
/// Number of measurements with as much information as one independent measurement: errors of
/// successive scans are correlated.
const ALIKE: f64 = 8.0;
/// Least size of an offset that is used, in standard deviations.
const SURE: f64 = 4.0;
/// Least size of an offset that is used [s].
const LEAST: f64 = 0.004;
/// Least standard deviation of a used offset [s]: clocks are not more exact.
const RESOLUTION: f64 = 0.001;
/// Largest offset that is used [s].
const LARGEST: f64 = 0.5;
/// Largest change of the used offset from scan to scan [s]: the map follows it.
const STEP: f64 = 0.002;
/// Number of objects above which old ones are removed.
const MANY: usize = 500;

/// Pose of the scanner as the caller gave it: stamp, place in the world [m] and yaw [rad].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct GivenPose {
    stamp_ns: i64,
    place: [f64; 3],
    yaw: f64,
}

impl GivenPose {
    fn new(stamp_ns: i64, pose: &Transform) -> Self {
        let yaw = libm::atan2(pose.rotation[1][0], pose.rotation[0][0]);
        Self { stamp_ns, place: pose.translation, yaw }
    }

    /// Velocity [m/s] and turn rate [rad/s] up to the pose `next`; None if it is not later, or much
    /// later.
    fn motion(&self, next: &Self) -> Option<([f64; 3], f64)> {
        let dt = (i128::from(next.stamp_ns) - i128::from(self.stamp_ns)) as f64 * 1e-9;
        let velocity = [0, 1, 2].map(|axis| (next.place[axis] - self.place[axis]) / dt);
        (dt > 0.0 && dt < LONGEST).then(|| (velocity, turn(next.yaw - self.yaw) / dt))
    }

    /// Place in the world of a point of the level frame.
    fn place(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = (libm::sin(self.yaw), libm::cos(self.yaw));
        [self.place[0] + cos * x - sin * y, self.place[1] + sin * x + cos * y]
    }
}

/// Measurement of a standing circle, in the level frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct StandingCircle {
    element: i64,
    center: [f64; 2],
    weight: f64,
}

/// Filter of the place of one standing object.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Thing {
    stamp_ns: i64,
    /// Filtered place x, y and velocity x, y by the pose's motion, each with its drift.
    values: [f64; 4],
    drifts: [f64; 4],
    /// Covariance of a value and its drift: the same for all, up to their unit.
    covariance: [f64; 3],
}

/// Estimate of the offset of one scanner's poses.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct PoseOffset {
    /// Pose of the scan before the last one.
    before: Option<GivenPose>,
    /// Pose of the last scan.
    last: Option<GivenPose>,
    /// Standing circles of the last scan; the motion at its time is known after the next one.
    waiting: Vec<StandingCircle>,
    things: BTreeMap<i64, Thing>,
    /// Sum of squared innovations of the rates over their variance.
    rates: f64,
    /// Sum of products of the innovations of places and rates over their variance.
    both: f64,
    /// Sum of squared innovations of the places over their variance.
    places: f64,
    /// Number of innovations in these sums.
    count: f64,
    /// Offset in use [s].
    used: f64,
}

impl PoseOffset {
    /// How late the poses are, once that is known to a few milliseconds [s]; None before.
    pub(super) fn known(&self) -> Option<f64> {
        let (offset, std) = self.estimate()?;
        (std < KNOWN).then_some(offset)
    }

    /// Estimate and its standard deviation [s].
    fn estimate(&self) -> Option<(f64, f64)> {
        let offset = -self.both / self.rates;
        let rest = (self.places - self.both * self.both / self.rates) / self.count;
        let std = (rest.max(1.0) * ALIKE / self.rates).sqrt();
        (offset.is_finite() && std.is_finite()).then_some((offset, std))
    }

    /// Velocity [m/s] and turn rate [rad/s] of the scanner during the offset, extrapolated from its
    /// last poses; None if poses are used as given.
    fn coming(&self, now: &GivenPose) -> Option<([f64; 3], f64)> {
        let last = self.last.filter(|_| self.used != 0.0)?;
        let (velocity, rate) = last.motion(now)?;
        let Some((earlier, slower)) = self.before.and_then(|before| before.motion(&last)) else {
            return Some((velocity, rate));
        };
        // The motion is that in the middle of its time, of which a half and a half of the offset
        // is to come.
        let ahead = (0.5 * (1.0 + self.used / age(last.stamp_ns, now.stamp_ns))).clamp(0.0, 1.0);
        let faster = |now: f64, before: f64| now + ahead * (now - before);
        let velocity = [0, 1, 2].map(|axis| faster(velocity[axis], earlier[axis]));
        Some((velocity, faster(rate, slower)))
    }

    /// Covariance of a pose and of the motion by which it is moved on; None for an exact pose that
    /// is used as given.
    pub(super) fn covariance(
        &self,
        stamp_ns: i64,
        given: &Transform,
        of_pose: Option<PoseCovariance>,
    ) -> Option<PoseCovariance> {
        let moved = self.coming(&GivenPose::new(stamp_ns, given)).zip(self.estimate());
        let Some(((velocity, rate), (_, std))) = moved else { return of_pose };
        let mut covariance = of_pose.unwrap_or_default();
        let rates = [velocity[0], velocity[1], velocity[2], 0.0, 0.0, rate];
        let std = std.max(RESOLUTION);
        for (axis, rate) in rates.into_iter().enumerate() {
            covariance[axis][axis] += (rate * std) * (rate * std);
        }
        Some(covariance)
    }

    /// Poses moved on by the offset that is in use; None if they are to be used as given.
    pub(super) fn shifted(
        &self,
        stamp_ns: i64,
        given: &Transform,
        poses: &[[f64; 16]],
    ) -> Option<Vec<[f64; 16]>> {
        let now = GivenPose::new(stamp_ns, given);
        let (velocity, rate) = self.coming(&now)?;
        let (sin, cos) = (libm::sin(rate * self.used), libm::cos(rate * self.used));
        let moved = |pose: &[f64; 16]| {
            let mut moved = *pose;
            for column in 0..4 {
                let from = if column == 3 { now.place } else { [0.0; 3] };
                let [x, y] = [pose[column] - from[0], pose[4 + column] - from[1]];
                moved[column] = from[0] + cos * x - sin * y;
                moved[4 + column] = from[1] + sin * x + cos * y;
            }
            for axis in 0..3 {
                moved[4 * axis + 3] += velocity[axis] * self.used;
            }
            moved
        };
        Some(poses.iter().map(moved).collect())
    }

    /// Update the estimate with a scan: its pose as given, and the circles of standing elements in
    /// the level frame.
    pub(super) fn add<'a>(
        &mut self,
        stamp_ns: i64,
        given: &Transform,
        standing: impl Iterator<Item = (i64, &'a CircleEstimate)>,
    ) {
        let now = GivenPose::new(stamp_ns, given);
        if self.last.is_some_and(|last| last.stamp_ns >= stamp_ns) {
            return; // a late scan
        }
        if let (Some(before), Some(last)) = (self.before, self.last)
            && let Some((velocity, rate)) = before.motion(&now)
        {
            for seen_circle in std::mem::take(&mut self.waiting) {
                let place = last.place(seen_circle.center);
                let [x, y] = [place[0] - last.place[0], place[1] - last.place[1]];
                let rate = [velocity[0] - rate * y, velocity[1] + rate * x];
                self.learn(&seen_circle, last.stamp_ns, place, rate);
            }
        }
        let seen_circle = |(element, circle): (i64, &CircleEstimate)| StandingCircle {
            element,
            center: circle.circle.center,
            weight: 1.0 / (0.5 * (circle.covariance[0][0] + circle.covariance[1][1]) + ROUGH),
        };
        self.waiting = standing.map(seen_circle).collect();
        (self.before, self.last) = (self.last, Some(now));
        if self.things.len() > MANY {
            self.things.retain(|_, thing| age(thing.stamp_ns, stamp_ns) < MEMORY);
        }
        let wanted = self
            .estimate()
            .filter(|&(offset, std)| {
                std < KNOWN && offset.abs() > LEAST.max(SURE * std) && offset.abs() < LARGEST
            })
            .map_or(0.0, |(offset, _)| offset);
        self.used += (wanted - self.used).clamp(-STEP, STEP);
    }

    /// Update the estimate with the measured position of an object [m] and its velocity due to the
    /// motion of the pose [m/s].
    fn learn(&mut self, seen: &StandingCircle, stamp_ns: i64, place: [f64; 2], rate: [f64; 2]) {
        let offset = self.known().unwrap_or(0.0);
        let values = [place[0], place[1], rate[0], rate[1]];
        let noise = 1.0 / seen.weight;
        let fresh = Thing { stamp_ns, values, drifts: [0.0; 4], covariance: [noise, 0.0, DRIFT] };
        let thing = self.things.entry(seen.element).or_insert(fresh);
        let dt = age(thing.stamp_ns, stamp_ns);
        if dt <= 0.0 || dt > MEMORY {
            *thing = fresh;
            return;
        }
        let [p, c, v] = thing.covariance;
        let [p, c, v] = [p + dt * (2.0 * c + dt * v) + WANDER * dt, c + dt * v, v + CHANGE * dt];
        let variance = p + noise;
        let gains = [p / variance, c / variance];
        let mut off = [0.0; 4];
        for (axis, off) in off.iter_mut().enumerate() {
            let expected = thing.values[axis] + dt * thing.drifts[axis];
            *off = values[axis] - expected;
            thing.values[axis] = expected + gains[0] * *off;
            thing.drifts[axis] += gains[1] * *off;
        }
        let rest = [0, 1].map(|axis| off[axis] + offset * off[axis + 2]);
        if rest.iter().any(|rest| rest * rest > FAR * variance) {
            *thing = fresh; // another object, or another part of it
            return;
        }
        thing.covariance = [p * (1.0 - gains[0]), c * (1.0 - gains[0]), v - gains[1] * c];
        thing.stamp_ns = stamp_ns;
        let faded = 1.0 - 1.0 / MOST;
        let sum = |before: f64, now: f64| before * faded + now / variance;
        self.rates = sum(self.rates, off[2] * off[2] + off[3] * off[3]);
        self.both = sum(self.both, off[0] * off[2] + off[1] * off[3]);
        self.places = sum(self.places, off[0] * off[0] + off[1] * off[1]);
        self.count = self.count * faded + 2.0;
    }
}

/// Time from one stamp to a later one [s].
fn age(from_ns: i64, to_ns: i64) -> f64 {
    ((i128::from(to_ns) - i128::from(from_ns)) as f64 * 1e-9).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::circles::fit::circle::Circle;

    fn pose(yaw: f64) -> Transform {
        let (sin, cos) = (libm::sin(yaw), libm::cos(yaw));
        let rotation = [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]];
        Transform { rotation, translation: [0.0; 3] }
    }

    /// Estimate after 20 s with two posts, seen with a jitter of 5 mm from a scanner of this yaw at
    /// a time, with poses that are late.
    fn found(yaw: impl Fn(f64) -> f64, late: f64) -> PoseOffset {
        let mut offset = PoseOffset::default();
        for scan in 0..400_i32 {
            let time = 0.05 * f64::from(scan);
            let error = 0.005 * if scan % 2 == 0 { 1.0 } else { -1.0 };
            let (truth, given) = (pose(yaw(time)), pose(yaw(time - late)));
            let seen = [[4.0, 0.0, 0.0], [-1.0, 3.0, 0.0]].map(|post| {
                let [x, y, _] = truth.inverse().apply(post);
                let covariance = [[2.5e-5, 0.0, 0.0], [0.0, 2.5e-5, 0.0], [0.0, 0.0, 2.5e-5]];
                let circle = Circle { center: [x + error, y - error], radius: 0.1 };
                CircleEstimate { circle, covariance, n_hits: 20, is_fallback: false }
            });
            let standing = seen.iter().enumerate().map(|(id, circle)| (id as i64, circle));
            offset.add(i64::from(scan) * 50_000_000, &given, standing);
        }
        offset
    }

    #[test]
    fn late_and_early_poses_are_found_and_right_ones_stay_as_they_are() {
        for late in [0.05, -0.03] {
            let offset = found(|time| 1.2 * libm::sin(0.5 * time), late);
            assert!(offset.known().is_some_and(|known| (known - late).abs() < 0.002), "{late}");
            assert!((offset.used - late).abs() < 0.003);
        }
        let right = found(|time| 1.2 * libm::sin(0.5 * time), 0.0);
        assert!(right.known().is_some_and(|known| known.abs() < 0.002) && right.used == 0.0);
    }

    #[test]
    fn a_steady_turn_and_a_scanner_at_rest_tell_nothing() {
        for rate in [0.4, 0.0] {
            let offset = found(|time| rate * time, 0.05);
            assert!(offset.used == 0.0 && offset.known().is_none(), "{rate}: {offset:?}");
        }
    }

    #[test]
    fn poses_move_on_by_the_offset_in_use() {
        let yaw = |time: f64| 1.2 * libm::sin(0.5 * time);
        let offset = found(yaw, 0.05);
        let given = pose(yaw(20.0 - 0.05));
        let matrix = |pose: &Transform| {
            let [a, b, c] = pose.rotation;
            [a[0], a[1], a[2], 0., b[0], b[1], b[2], 0., c[0], c[1], c[2], 0., 0., 0., 0., 1.]
        };
        let moved = offset.shifted(400 * 50_000_000, &given, &[matrix(&given)]);
        let right = matrix(&pose(yaw(20.0)));
        let apart = |moved: Vec<[f64; 16]>| {
            moved[0].iter().zip(right).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
        };
        assert!(moved.is_some_and(|moved| apart(moved) < 0.003));
    }
}
