//! Pose of a platform in space, and of the sensor that it carries.

#![allow(non_snake_case)] // textbook letters

use super::turn::direction;
use nalgebra::{Matrix3, Matrix6, Vector3};
use serde::{Deserialize, Serialize};

/// Rotation [rad] below which its axis does not matter.
const NO_TURN: f64 = 1e-12;
/// Trace of a rotation above which its angle is taken from its antisymmetric part alone.
const SMALL: f64 = 3.0 - 1e-6;

/// Place and motion of the platform in the world, at one time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpacePose {
    /// Time of the pose [ns].
    pub stamp_ns: i64,
    /// Position of the platform's origin in the world [m].
    pub position: Vector3<f64>,
    /// Roll, pitch and yaw [rad]: from the axes of the world turned about z by the yaw, then about
    /// the new y by the pitch, then about the new x by the roll.
    pub attitude: Vector3<f64>,
    /// Velocity of the platform's origin, axes of the world [m/s].
    pub velocity: Vector3<f64>,
    /// Turn rates of the platform about its own axes [rad/s].
    pub rates: Vector3<f64>,
    /// Covariance of x, y, z, roll, pitch and yaw; None for an exact pose.
    pub covariance: Option<Matrix6<f64>>,
}

/// Pose of a sensor in the world, with its velocities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpaceSensorPose {
    /// Position of the sensor in the world [m].
    pub position: Vector3<f64>,
    /// Rotation from the axes of the world into those of the sensor.
    pub into: Matrix3<f64>,
    /// Velocity, axes of the world [m/s].
    pub velocity: Vector3<f64>,
    /// Offset from the platform's origin, axes of the platform [m].
    pub lever: Vector3<f64>,
    /// Turn rates of the platform about its own axes [rad/s].
    pub rates: Vector3<f64>,
    /// Small rotation about the axes of the platform by roll, pitch and yaw of the pose.
    pub by_attitude: Matrix3<f64>,
    /// Covariance of x, y, z, roll, pitch and yaw of the pose; None for an exact pose.
    pub covariance: Option<Matrix6<f64>>,
}

impl SpacePose {
    /// A level platform in the plane z = 0, at rest.
    #[must_use]
    pub fn level(stamp_ns: i64, position: [f64; 2], yaw: f64) -> Self {
        Self {
            stamp_ns,
            position: Vector3::new(position[0], position[1], 0.0),
            attitude: Vector3::new(0.0, 0.0, yaw),
            velocity: Vector3::zeros(),
            rates: Vector3::zeros(),
            covariance: None,
        }
    }

    /// The pose with the velocities that lead to it from `last`, or with those of `last` if no time
    /// lies between.
    #[must_use]
    pub fn after(self, last: &Self) -> Self {
        let dt = self.stamp_ns.saturating_sub(last.stamp_ns) as f64 * 1e-9;
        if dt <= 0.0 {
            return Self { velocity: last.velocity, rates: last.rates, ..self };
        }
        let turned = rotation(&last.attitude).transpose() * rotation(&self.attitude);
        let velocity = (self.position - last.position) / dt;
        Self { velocity, rates: rotation_vector(&turned) / dt, ..self }
    }

    /// Pose of the sensor in the world at `stamp_ns` [ns]; `lever` is its position in the axes of the
    /// platform [m]. The pose of the platform is extrapolated with its velocity and turn rates; its
    /// covariance stays as it is.
    #[must_use]
    pub fn sensor_at(&self, stamp_ns: i64, lever: [f64; 3]) -> SpaceSensorPose {
        let dt = stamp_ns.saturating_sub(self.stamp_ns) as f64 * 1e-9;
        let since = turned_by(&(self.rates * dt));
        let R = rotation(&self.attitude) * since;
        let lever = Vector3::from(lever);
        SpaceSensorPose {
            position: self.position + self.velocity * dt + R * lever,
            into: R.transpose(),
            velocity: self.velocity + R * self.rates.cross(&lever),
            lever,
            rates: self.rates,
            by_attitude: since.transpose() * small_turns(&self.attitude),
            covariance: self.covariance,
        }
    }
}

/// Rotation from the axes of a platform into those of the world, Rz(yaw) Ry(pitch) Rx(roll), of the
/// `attitude` roll, pitch, yaw [rad].
#[must_use]
pub fn rotation(attitude: &Vector3<f64>) -> Matrix3<f64> {
    let [[cr, sr], [cp, sp], [cy, sy]] = attitude.data.0[0].map(direction);
    Matrix3::new(
        cy * cp,
        cy * sp * sr - sy * cr,
        cy * sp * cr + sy * sr,
        sy * cp,
        sy * sp * sr + cy * cr,
        sy * sp * cr - cy * sr,
        -sp,
        cp * sr,
        cp * cr,
    )
}

/// Small rotation about the axes of the platform by small changes of roll, pitch and yaw.
fn small_turns(attitude: &Vector3<f64>) -> Matrix3<f64> {
    let [[cr, sr], [cp, sp], _] = attitude.data.0[0].map(direction);
    Matrix3::new(1.0, 0.0, -sp, 0.0, cr, cp * sr, 0.0, -sr, cp * cr)
}

/// Matrix whose product with a vector is the cross product of `v` with it.
#[must_use]
pub fn crossed(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// Rotation about the direction of `turn` by its length [rad] (Rodrigues).
fn turned_by(turn: &Vector3<f64>) -> Matrix3<f64> {
    let angle = libm::sqrt(turn.norm_squared());
    if angle < NO_TURN {
        return Matrix3::identity() + crossed(turn);
    }
    let K = crossed(&(turn / angle));
    let half = libm::sin(0.5 * angle);
    // 1 - cos(angle) as a square of the half angle: the difference would cancel.
    Matrix3::identity() + K * libm::sin(angle) + K * K * (2.0 * half * half)
}

/// Axis times angle of a rotation by less than half a turn.
fn rotation_vector(R: &Matrix3<f64>) -> Vector3<f64> {
    let twice_sine =
        Vector3::new(R[(2, 1)] - R[(1, 2)], R[(0, 2)] - R[(2, 0)], R[(1, 0)] - R[(0, 1)]);
    if R.trace() > SMALL {
        return twice_sine * 0.5; // the angle is its sine to 1e-9 of it
    }
    let length = libm::sqrt(twice_sine.norm_squared());
    twice_sine * (libm::atan2(length, R.trace() - 1.0) / length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::models::motion::tests::difference;

    fn pose() -> SpacePose {
        SpacePose {
            stamp_ns: 0,
            position: Vector3::new(5.0, 1.0, 8.0),
            attitude: Vector3::new(0.3, -0.4, 1.9),
            velocity: Vector3::new(1.0, -2.0, 0.5),
            rates: Vector3::new(0.4, 0.1, -0.7),
            covariance: None,
        }
    }

    #[test]
    fn roll_pitch_and_yaw_turn_about_their_axes() {
        let quarter = std::f64::consts::FRAC_PI_2;
        let at = |roll, pitch, yaw| rotation(&Vector3::new(roll, pitch, yaw));
        assert!((at(0.0, 0.0, quarter) * Vector3::x() - Vector3::y()).abs().max() < 1e-15);
        assert!((at(0.0, quarter, 0.0) * Vector3::x() + Vector3::z()).abs().max() < 1e-15);
        assert!((at(quarter, 0.0, 0.0) * Vector3::y() - Vector3::z()).abs().max() < 1e-15);
        let R = at(0.3, -0.4, 1.9);
        assert!((R * R.transpose() - Matrix3::identity()).abs().max() < 1e-15);
        assert!(
            (at(0.0, 0.0, 1.9) * at(0.0, -0.4, 0.0) * at(0.3, 0.0, 0.0) - R).abs().max() < 1e-15
        );
    }

    /// The velocity of the sensor is how its position changes, lever and turn rates included.
    #[test]
    fn the_sensor_moves_as_its_velocity_says() {
        let at = |ns| pose().sensor_at(ns, [0.3, -0.2, 0.5]);
        let change = (at(100_010_000).position - at(99_990_000).position) / 2e-5;
        assert!((at(100_000_000).velocity - change).abs().max() < 1e-6);
    }

    /// A pose without velocities gets those that lead to it.
    #[test]
    fn velocities_come_from_two_poses() {
        let still = SpacePose { velocity: Vector3::zeros(), rates: Vector3::zeros(), ..pose() };
        let later = pose().sensor_at(200_000_000, [0.0; 3]);
        let R = later.into.transpose();
        let attitude = Vector3::new(
            libm::atan2(R[(2, 1)], R[(2, 2)]),
            libm::asin(-R[(2, 0)]),
            libm::atan2(R[(1, 0)], R[(0, 0)]),
        );
        let next = SpacePose { stamp_ns: 200_000_000, position: later.position, attitude, ..still };
        let told = next.after(&still);
        assert!((told.velocity - pose().velocity).abs().max() < 1e-9);
        assert!((told.rates - pose().rates).abs().max() < 1e-9);
        let again = SpacePose { stamp_ns: 0, ..next }.after(&pose());
        assert_eq!((again.velocity, again.rates), (pose().velocity, pose().rates));
    }

    #[test]
    fn small_turns_are_those_of_the_attitude() {
        let sensor = pose().sensor_at(100_000_000, [0.0; 3]);
        let vector = |attitude: &Vector3<f64>| {
            let turned = SpacePose { attitude: *attitude, ..pose() };
            let now = turned.sensor_at(100_000_000, [0.0; 3]).into.transpose();
            rotation_vector(&(sensor.into * now))
        };
        let expected = difference(&pose().attitude, vector);
        assert!((sensor.by_attitude - expected).abs().max() < 1e-8);
    }
}
