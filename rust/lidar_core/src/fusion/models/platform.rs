//! Motion of the platform that carries the sensor, as far as it is known.

use super::space_pose::{SpacePose, SpaceSensorPose};
use super::turn::{direction, rotated};
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

/// Place and motion of the platform in the world, at one time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Time of the pose [ns].
    pub stamp_ns: i64,
    /// Position of the platform's origin in the world [m].
    pub position: [f64; 2],
    /// Heading, counter-clockwise from the world's x [rad].
    pub yaw: f64,
    /// Velocity of the platform's origin, axes of the world [m/s].
    pub velocity: [f64; 2],
    /// Turn rate [rad/s].
    pub rate: f64,
    /// Covariance of x and y [m^2] and yaw [rad^2]; None for an exact pose.
    pub covariance: Option<Matrix3<f64>>,
}

/// State of the platform. Without a pose, the frame of the target's state is the sensor's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Platform {
    /// The last pose; None before the first one. With a pose, states are in the world.
    pub pose: Option<Pose>,
    /// The last pose in space; filters in the plane have none.
    pub in_space: Option<Box<SpacePose>>,
    /// Turn rate measured by a gyro [rad/s]: the mean over the step that is predicted.
    pub rate: f64,
    /// Change of the measured turn rate [rad/s^2].
    pub slope: f64,
    /// The last reading of the gyro; None before the first one.
    pub gyro: Option<GyroReading>,
    /// Variance of the turn rate [rad^2/s^2].
    pub rate_variance: f64,
    /// Velocity of the platform's origin, axes of the platform [m/s].
    pub velocity: [f64; 2],
    /// Vector from the platform's origin to the sensor, axes of the platform [m].
    pub lever: [f64; 3],
}

/// Longest time between two readings of a gyro between which the turn rate is interpolated [s].
const GYRO_GAP: f64 = 0.5;
/// Time [s] over which the change of the turn rate is smoothed: differences of readings are noisy.
const SMOOTHED: f64 = 0.1;
/// Longest time [s] for which a turn rate is carried on by its change.
const CARRIED: f64 = 0.1;

/// Use of the turn rate of a gyro.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GyroUse {
    /// Input of the motion model; its bias and delay are estimated.
    Input,
    /// Input to the motion model as it is.
    Exact,
    /// Measurement of a state.
    Measurement,
    /// The gyro is ignored.
    Ignored,
}

/// Last reading of a gyro.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GyroReading {
    /// Time of the reading [ns].
    pub stamp_ns: i64,
    /// Turn rate [rad/s].
    pub rate: f64,
    /// Change of the rate since the previous reading [rad/s^2].
    pub slope: f64,
}

/// Time from one stamp to another [s].
fn seconds(from_ns: i64, to_ns: i64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 * 1e-9
}

/// Place and motion of the sensor in the world, at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorPose {
    /// Position of the sensor in the world [m].
    pub position: [f64; 2],
    /// Cosine and sine of its heading.
    pub heading: [f64; 2],
    /// Velocity, axes of the world [m/s].
    pub velocity: [f64; 2],
    /// Offset from the platform's origin, axes of the platform [m].
    pub lever: [f64; 2],
    /// Turn rate of the platform [rad/s].
    pub rate: f64,
    /// Covariance of the platform's x, y and yaw; None for an exact pose.
    pub covariance: Option<Matrix3<f64>>,
}

impl Platform {
    /// A platform at rest, with the sensor at its origin.
    #[must_use]
    pub fn still() -> Self {
        Self {
            pose: None,
            in_space: None,
            rate: 0.0,
            slope: 0.0,
            gyro: None,
            rate_variance: 0.0,
            velocity: [0.0; 2],
            lever: [0.0; 3],
        }
    }

    /// Store a reading of the gyro at `stamp_ns` [ns]: the turn rate about the vertical, positive
    /// counter-clockwise from above [rad/s], and its variance [rad^2/s^2].
    pub fn read_gyro(&mut self, stamp_ns: i64, rate: f64, variance: f64) {
        let last = self.gyro;
        let gap = last.map_or(0.0, |last| seconds(last.stamp_ns, stamp_ns));
        let step = last.map_or(0.0, |last| rate - last.rate);
        let is_in_turn = gap > 0.0 && gap <= GYRO_GAP;
        let slope = if is_in_turn { step / gap } else { 0.0 };
        let before = self.slope;
        self.slope =
            if is_in_turn { before + (slope - before) * gap / (gap + SMOOTHED) } else { 0.0 };
        (self.rate, self.rate_variance) = (rate, variance);
        self.gyro = Some(GyroReading { stamp_ns, rate, slope });
    }

    /// The platform with its mean turn rate from `start_ns` to `end_ns`. The rate is interpolated
    /// between the last two readings of the gyro, and constant after the last one. None without a
    /// reading.
    #[must_use]
    pub fn between(&self, start_ns: i64, end_ns: i64) -> Option<Self> {
        let gyro = self.gyro?;
        let middle = seconds(gyro.stamp_ns, start_ns) + 0.5 * seconds(start_ns, end_ns);
        // Readings may stop: a rate that changes is not carried on for long.
        let slope = if middle < 0.0 { gyro.slope } else { self.slope };
        let middle = middle.clamp(-GYRO_GAP, GYRO_GAP);
        let ahead = if middle < 0.0 { middle } else { middle.min(CARRIED) };
        Some(Self { rate: gyro.rate + slope * ahead, ..self.clone() })
    }

    /// Pose of the sensor at `stamp_ns`: the last pose, extrapolated at its velocity and with its
    /// covariance. None before the first pose.
    #[must_use]
    pub fn sensor_at(&self, stamp_ns: i64) -> Option<SensorPose> {
        let pose = self.pose?;
        // Poses and scans have stamps of their own. The extrapolation also goes backwards, to a
        // scan that is older than the last pose.
        let dt = stamp_ns.saturating_sub(pose.stamp_ns) as f64 * 1e-9;
        let heading = direction(pose.yaw + pose.rate * dt);
        let lever = [self.lever[0], self.lever[1]];
        let arm = rotated(heading, lever);
        let position = std::array::from_fn(|k| pose.position[k] + pose.velocity[k] * dt + arm[k]);
        let ([vx, vy], rate, covariance) = (pose.velocity, pose.rate, pose.covariance);
        // The sensor is off the turning point: a turning platform moves it sideways, and radar sees
        // that.
        let velocity = [vx - rate * arm[1], vy + rate * arm[0]];
        Some(SensorPose { position, heading, velocity, lever, rate, covariance })
    }

    /// Pose of the sensor in space at `stamp_ns`. None before the first pose.
    #[must_use]
    pub fn space_sensor_at(&self, stamp_ns: i64) -> Option<SpaceSensorPose> {
        self.in_space.as_ref().map(|pose| pose.sensor_at(stamp_ns, self.lever))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NONE: &str = "a pose was told";

    /// A rate that changes evenly is known between readings, and carried on after them for a while.
    #[test]
    fn readings_of_a_gyro_are_interpolated_and_carried_on() -> Result<(), &'static str> {
        let mut platform = Platform::still();
        assert_eq!(platform.between(0, 1), None);
        for k in 0..40_i64 {
            platform.read_gyro(50_000_000 * k, 0.1 + 0.02 * k as f64, 1e-4);
        }
        let last = 50_000_000 * 39;
        let mean = |from: i64, to: i64| platform.between(last + from, last + to).ok_or(NONE);
        let exact = |from: i64, to: i64| 0.1 + 0.02 * 39.0 + 0.4 * 0.5e-9 * (from + to) as f64;
        for (from, to) in [(-50_000_000, 0), (-20_000_000, 0), (0, 50_000_000)] {
            assert!((mean(from, to)?.rate - exact(from, to)).abs() < 1e-6, "{from} {to}");
        }
        let far = mean(10_000_000_000, 20_000_000_000)?;
        assert!(far.rate < exact(0, 200_000_001), "{}", far.rate);
        platform.read_gyro(last + 3_000_000_000, 5.0, 1e-4);
        assert_eq!((platform.slope, platform.rate), (0.0, 5.0), "a gap tells no slope");
        Ok(())
    }

    #[test]
    fn the_sensor_is_carried_on_with_its_lever() -> Result<(), &'static str> {
        let mut platform = Platform { lever: [1.0, 0.0, 0.0], ..Platform::still() };
        assert_eq!(platform.sensor_at(0), None);
        let (position, velocity) = ([1.0, 2.0], [3.0, 0.0]);
        let yaw = std::f64::consts::FRAC_PI_2;
        let pose = Pose { stamp_ns: 0, position, yaw, velocity, rate: 0.0, covariance: None };
        platform.pose = Some(pose);
        let sensor = platform.sensor_at(500_000_000).ok_or(NONE)?;
        assert!((sensor.position[0] - 2.5).abs() < 1e-12 && sensor.position[1] == 3.0);
        platform.pose = Some(Pose { rate: 2.0, ..pose });
        let sensor = platform.sensor_at(0).ok_or(NONE)?;
        assert!((sensor.velocity[0] - 1.0).abs() < 1e-12 && sensor.velocity[1].abs() < 1e-12);
        Ok(())
    }
}
