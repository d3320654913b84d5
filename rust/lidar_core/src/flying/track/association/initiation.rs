//! Tracks that begin with two detections of a fast target. The speed follows from the distance
//! between them.

use super::super::belief::existence::Sight;
use super::super::motion::{Matrix9, position_block, seconds};
use super::super::state::PointTrack;
use nalgebra::Vector3;

/// Lowest and highest speed of a target whose track begins with two detections [m/s]. A slower
/// target stays in the gate of its first detection.
const SPEEDS: [f64; 2] = [8.0, 60.0];
/// Shortest and longest time between the two detections [s]. Detections that are closer in time may
/// be of the same sweep.
const TIMES: [f64; 2] = [0.02, 0.25];

/// Straight motion from one detection to the next: velocity [m/s] and time [s].
pub(super) struct Way {
    velocity: Vector3<f64>,
    time: f64,
}

impl Way {
    /// Distance between the two detections [m].
    pub(super) fn length(&self) -> f64 {
        self.velocity.norm() * self.time
    }
}

impl PointTrack {
    /// The motion from the only detection of track `other` to this new detection. None if no target can have flown this
    /// motion, if `other` has more than one detection, or if the newest scan still shows returns at `other`.
    pub(super) fn way_from(&self, other: &PointTrack) -> Option<Way> {
        let is_left = !matches!(other.sight, Sight::Followed | Sight::Few);
        if self.stamp_ns != self.born_ns || other.n_detections != 1 || !is_left {
            return None;
        }
        let time = seconds(other.born_ns, self.born_ns) + self.delay - other.delay;
        let velocity = (self.born_at - other.born_at) / time;
        let within = |value: f64, [low, high]: [f64; 2]| (low..=high).contains(&value);
        (within(time, TIMES) && within(velocity.norm(), SPEEDS)).then_some(Way { velocity, time })
    }

    /// A track of this new detection and the detection that began `other`. The acceleration between
    /// the two has the standard deviation `acceleration` [m/s^2]. Both positions have the
    /// uncertainty of the second.
    ///
    /// # Source
    /// Bar-Shalom, Li & Kirubarajan, "Estimation with applications to tracking and navigation", 2001,
    /// sec. 5.5.3: two-point differencing.
    pub(super) fn paired(&self, other: &PointTrack, way: &Way, acceleration: f64) -> Self {
        let Way { velocity, time } = *way;
        let mut fast = self.clone();
        let position = self.born_at - velocity * self.delay;
        fast.estimate.mean.fixed_rows_mut::<3>(0).copy_from(&position);
        fast.estimate.mean.fixed_rows_mut::<3>(3).copy_from(&velocity);
        // Of the place alone: what a fresh track adds for its unknown velocity is taken off.
        let unknown = self.estimate.covariance[(3, 3)] * self.delay * self.delay;
        let mut place = position_block(&self.estimate.covariance);
        (0..3).for_each(|axis| place[(axis, axis)] -= unknown);
        let [before, after] = [self.delay / time, 1.0 - self.delay / time];
        let blocks = [
            [before * before + after * after, (after - before) / time],
            [(after - before) / time, 2.0 / (time * time)],
        ];
        let mut covariance = Matrix9::zeros();
        for (row, shares) in blocks.iter().enumerate() {
            for (column, share) in shares.iter().enumerate() {
                let block = place * *share;
                covariance.fixed_view_mut::<3, 3>(3 * row, 3 * column).copy_from(&block);
            }
        }
        for axis in 0..3 {
            covariance[(3 + axis, 3 + axis)] += (acceleration * time).powi(2);
            covariance[(6 + axis, 6 + axis)] = acceleration * acceleration;
        }
        (fast.estimate.covariance, fast.aged) = (covariance, covariance);
        (fast.born_ns, fast.born_at, fast.seen_at) = (other.born_ns, other.born_at, position);
        (fast.seen_speed, fast.n_detections) = (velocity.norm(), 2);
        fast.before = Some(other.first);
        fast.made_of = vec![other.id];
        fast
    }
}
