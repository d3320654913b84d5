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
    /// Position of its origin [m].
    pub position: [f64; 2],
    /// Heading, counter-clockwise from the world's x [rad].
    pub yaw: f64,
    /// Velocity of its origin, axes of the world [m/s].
    pub velocity: [f64; 2],
    /// Turn rate [rad/s].
    pub rate: f64,
    /// Covariance of x, y and yaw; None for an exact pose.
    pub covariance: Option<Matrix3<f64>>,
}

/// State of the platform. Without a pose, the frame of the target's state is the sensor's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Platform {
    /// The last pose; states are in the world where there is one.
    pub pose: Option<Pose>,
    /// The last pose in space, of which filters in the plane have none.
    pub in_space: Option<Box<SpacePose>>,
    /// Turn rate measured by a gyro [rad/s].
    pub rate: f64,
    /// Variance of that rate [rad^2/s^2].
    pub rate_variance: f64,
    /// Velocity of the platform's origin, axes of the platform [m/s].
    pub velocity: [f64; 2],
    /// From the platform's origin to the sensor, axes of the platform [m].
    pub lever: [f64; 3],
}

/// The sensor in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorPose {
    /// Position [m].
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
    /// A platform that stands still, with the sensor at its origin.
    #[must_use]
    pub fn still() -> Self {
        Self {
            pose: None,
            in_space: None,
            rate: 0.0,
            rate_variance: 0.0,
            velocity: [0.0; 2],
            lever: [0.0; 3],
        }
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
