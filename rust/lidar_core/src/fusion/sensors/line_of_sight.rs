//! A state of the plane relative to a sensor: expected measurements, with their Jacobians.

#![allow(non_snake_case)] // textbook letters

use crate::fusion::models::motion::PlaneMotion;
use crate::fusion::models::platform::{Platform, SensorPose};
use nalgebra::{Matrix2, Matrix2x3, Matrix3, Matrix3x2, SMatrix, SVector, Vector2, Vector3};

/// Ranges below this have no bearing [m].
pub(super) const NEAREST: f64 = 1e-9;

/// A state relative to the sensor.
pub struct LineOfSight<'a, const N: usize, M> {
    motion: &'a M,
    state: &'a SVector<f64, N>,
    platform: &'a Platform,
    sensor: Option<&'a SensorPose>,
    /// Position of the target in the frame of the sensor [m].
    pub(super) position: Vector2<f64>,
}

impl<'a, const N: usize, M: PlaneMotion<N>> LineOfSight<'a, N, M> {
    /// State `s` relative to a sensor in the world, or in the sensor's own frame without one.
    pub fn new(
        motion: &'a M,
        state: &'a SVector<f64, N>,
        platform: &'a Platform,
        sensor: Option<&'a SensorPose>,
    ) -> Self {
        let position = Vector2::new(state[0], state[1]);
        let position = sensor.map_or(position, |sensor| {
            into_sensor(sensor) * (position - Vector2::from(sensor.position))
        });
        Self { motion, state, platform, sensor, position }
    }

    /// The line of sight to another state.
    pub(super) fn of(&self, state: &'a SVector<f64, N>) -> Self {
        Self::new(self.motion, state, self.platform, self.sensor)
    }

    /// Expected position and its Jacobian.
    #[inline]
    #[must_use]
    pub fn place(&self) -> (Vector2<f64>, SMatrix<f64, 2, N>) {
        let mut by_position = SMatrix::<f64, 2, N>::zeros();
        let back = self.sensor.map_or_else(Matrix2::identity, into_sensor);
        by_position.fixed_view_mut::<2, 2>(0, 0).copy_from(&back);
        (self.position, by_position)
    }

    /// Velocity relative to the sensor in its frame, and its Jacobian.
    #[inline]
    fn velocity(&self) -> (Vector2<f64>, SMatrix<f64, 2, N>) {
        let (velocity, by_state) = self.motion.velocity(self.state, self.platform);
        let Some(sensor) = self.sensor else { return (velocity, by_state) };
        let back = into_sensor(sensor);
        (back * (velocity - Vector2::from(sensor.velocity)), back * by_state)
    }

    /// Expected range, bearing and range rate.
    #[inline]
    #[must_use]
    pub fn polar(&self) -> Vector3<f64> {
        polar_of(self.position, self.velocity().0)
    }

    /// Expected range, bearing and range rate, and their Jacobian; the range must not be zero.
    #[inline]
    #[must_use]
    pub fn polar_jacobian(&self) -> (Vector3<f64>, SMatrix<f64, 3, N>) {
        let (p, (v, by_velocity)) = (self.position, self.velocity());
        let (mut by_position, ahead) = polar_slopes(p, v);
        if let Some(sensor) = self.sensor {
            by_position *= into_sensor(sensor);
        }
        let mut J = SMatrix::<f64, 3, N>::zeros();
        J.fixed_view_mut::<3, 2>(0, 0).copy_from(&by_position);
        for (column, by) in J.data.0.iter_mut().zip(&by_velocity.data.0) {
            column[2] += ahead[0] * by[0] + ahead[1] * by[1];
        }
        (polar_of(p, v), J)
    }

    /// Covariance of a measured position: `R` plus the contribution of the platform's pose.
    #[inline]
    #[must_use]
    pub fn place_noise(&self, R: Matrix2<f64>) -> Matrix2<f64> {
        let Some((by_pose, _, P)) = self.by_pose() else { return R };
        R + by_pose * P * by_pose.transpose()
    }

    /// Covariance of range, bearing and range rate: `R` plus the contribution of the platform's
    /// pose. The range must not be zero.
    #[inline]
    #[must_use]
    pub fn polar_noise(&self, R: Matrix3<f64>) -> Matrix3<f64> {
        let Some((position_by, velocity_by, P)) = self.by_pose() else { return R };
        let (by_position, ahead) = polar_slopes(self.position, self.velocity().0);
        let mut by_pose = by_position * position_by;
        let rate = by_pose.row(2) + Vector2::from(ahead).transpose() * velocity_by;
        by_pose.set_row(2, &rate);
        R + by_pose * P * by_pose.transpose()
    }

    /// Jacobians of position and velocity in the frame of the sensor with respect to x, y and yaw
    /// of the platform, and the covariance of these. None for an exact pose.
    #[inline]
    fn by_pose(&self) -> Option<(Matrix2x3<f64>, Matrix2x3<f64>, Matrix3<f64>)> {
        let sensor = self.sensor?;
        let covariance = sensor.covariance?;
        let (back, [lx, ly]) = (into_sensor(sensor), sensor.lever);
        let away = self.position + Vector2::new(lx, ly); // of the platform's origin
        let passing = self.velocity().0 + Vector2::new(-ly, lx) * sensor.rate;
        let mut position_by = Matrix2x3::zeros();
        position_by.fixed_view_mut::<2, 2>(0, 0).copy_from(&-back);
        position_by.set_column(2, &Vector2::new(away.y, -away.x));
        let mut velocity_by = Matrix2x3::zeros();
        velocity_by.set_column(2, &Vector2::new(passing.y, -passing.x));
        Some((position_by, velocity_by, covariance))
    }

    /// Distance from the sensor [m].
    #[must_use]
    pub fn range(&self) -> f64 {
        self.position.norm()
    }
}

/// Jacobian of range, bearing and range rate by the position, and of the range rate by the
/// velocity.
#[inline]
fn polar_slopes(p: Vector2<f64>, v: Vector2<f64>) -> (Matrix3x2<f64>, [f64; 2]) {
    let square = p.x * p.x + p.y * p.y;
    let range = libm::sqrt(square);
    let across = (p.x * v.y - p.y * v.x) / (square * range);
    let ahead = [p.x / range, p.y / range];
    // Derivative of the range rate: the velocity across the line of sight becomes velocity along it
    // as the line turns.
    let by_position = Matrix3x2::new(
        ahead[0],
        ahead[1], //
        -p.y / square,
        p.x / square, //
        -p.y * across,
        p.x * across,
    );
    (by_position, ahead)
}

/// Rotation from the world's axes into those of the sensor.
pub(super) fn into_sensor(sensor: &SensorPose) -> Matrix2<f64> {
    let [c, sine] = sensor.heading;
    Matrix2::new(c, sine, -sine, c)
}

/// Range, bearing and range rate of a position and a velocity.
fn polar_of(p: Vector2<f64>, v: Vector2<f64>) -> Vector3<f64> {
    let range = libm::sqrt(p.x * p.x + p.y * p.y).max(NEAREST);
    Vector3::new(range, libm::atan2(p.y, p.x), (p.x * v.x + p.y * v.y) / range)
}
