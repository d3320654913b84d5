//! Pose of a scan: transforms from the level frame of its sensor to the world.

#![allow(non_snake_case)] // textbook letters

use super::line::LineMeasurement;
use super::modes::Measurement;
use super::outline::{OutlineEstimate, OutlineMeasurement};
use crate::circles::fit::circle::{Circle, CircleEstimate};
use crate::circles::preprocess::polar_scan::turn;
use crate::circles::shape::ShapeEstimate;
use crate::geometry::transform::Transform;
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// Vertical part of the scan's normal below which a scan plane is treated as upright.
const UPRIGHT: f64 = 0.05;

/// Pose of the level frame in the world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct LevelPose {
    origin: [f64; 2],
    cos: f64,
    sin: f64,
}

impl LevelPose {
    pub(super) fn of(pose: &Transform) -> Self {
        // Roll and pitch only shorten the projection of the x axis; its direction is the yaw.
        let [x, y] = [pose.rotation[0][0], pose.rotation[1][0]];
        let norm = (x * x + y * y).sqrt();
        let (cos, sin) = if norm > 0.0 { (x / norm, y / norm) } else { (1.0, 0.0) };
        Self { origin: [pose.translation[0], pose.translation[1]], cos, sin }
    }

    pub(super) fn rotation(&self) -> Matrix2<f64> {
        Matrix2::new(self.cos, -self.sin, self.sin, self.cos)
    }

    pub(super) fn origin(&self) -> [f64; 2] {
        self.origin
    }

    /// Transform a circle from the level frame to the world, eq. 18.
    pub(super) fn place(&self, estimate: &CircleEstimate) -> Measurement {
        let Circle { center: [x, y], radius } = estimate.circle;
        let mut turn = Matrix3::identity();
        turn.fixed_view_mut::<2, 2>(0, 0).copy_from(&self.rotation());
        let R = matrix_of(estimate);
        let R = turn * R * turn.transpose();
        let offset = Vector3::new(self.origin[0], self.origin[1], 0.0);
        let z = turn * Vector3::new(x, y, radius) + offset;
        Measurement { z, R: (R + R.transpose()) * 0.5, delay: 0.0 }
    }

    /// Transform a circle from the world to the level frame.
    pub(super) fn level(&self, center: [f64; 2], radius: f64) -> Circle {
        let [x, y] = [center[0] - self.origin[0], center[1] - self.origin[1]];
        Circle { center: [self.cos * x + self.sin * y, self.cos * y - self.sin * x], radius }
    }

    /// Transform a point from the level frame to the world.
    fn world_point(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [from_x, from_y] = self.origin;
        [from_x + self.cos * x - self.sin * y, from_y + self.sin * x + self.cos * y]
    }

    /// Transform a line from the level frame to the world; None for other shapes. An error of the
    /// pose moves its middle, an error of the yaw turns it.
    pub(super) fn place_line(
        &self,
        shape: &ShapeEstimate,
        pose: &Transform,
        R_pose: Option<SMatrix<f64, 6, 6>>,
    ) -> Option<LineMeasurement> {
        let ends = shape.ends()?;
        let [angle, _, start, end, _] = shape.parameters;
        let c = &shape.covariance;
        // From the angle and the distance to the angle and the place across the middle.
        let J = Matrix2::new(1.0, 0.0, -0.5 * (start + end), 1.0);
        let mut R = J * Matrix2::new(c[0][0], c[0][1], c[1][0], c[1][1]) * J.transpose();
        let middle = [0, 1].map(|axis| 0.5 * (ends[0][axis] + ends[1][axis]));
        let yaw = libm::atan2(self.sin, self.cos);
        let normal = Vector2::new(libm::cos(angle + yaw), libm::sin(angle + yaw));
        if let Some(R_pose) = R_pose {
            let mut J = SMatrix::<f64, 2, 6>::zeros();
            J[(0, 5)] = 1.0;
            J.set_row(1, &(normal.transpose() * self.by_pose(middle, pose)));
            R += J * R_pose * J.transpose();
        }
        Some(LineMeasurement {
            middle: self.world_point(middle),
            angle: turn(angle + yaw),
            half: 0.5 * (end - start),
            R: (R + R.transpose()) * 0.5,
        })
    }

    /// Transform a circle from the level frame to the world, with the covariance of the pose.
    pub(super) fn place_circle(
        &self,
        estimate: &CircleEstimate,
        world_from_lidar: &Transform,
        R_pose: Option<SMatrix<f64, 6, 6>>,
    ) -> Measurement {
        let mut measurement = self.place(estimate);
        if let Some(R_pose) = R_pose {
            let J = self.by_pose(estimate.circle.center, world_from_lidar);
            let common = J * R_pose * J.transpose();
            let mut block = measurement.R.fixed_view_mut::<2, 2>(0, 0);
            block += (common + common.transpose()) * 0.5;
        }
        measurement
    }

    /// Transform an ellipse or rectangle from the level frame to the world; None for other shapes.
    pub(super) fn place_outline(
        &self,
        outline: &OutlineEstimate,
        pose: &Transform,
        R_pose: Option<SMatrix<f64, 6, 6>>,
    ) -> Option<OutlineMeasurement> {
        let OutlineEstimate { shape, is_large, .. } = *outline;
        let scale = shape.kind.half_length()?;
        let [x, y, long, short, heading] = shape.parameters;
        // From centre, lengths and heading to centre, heading and half lengths.
        let mut J = SMatrix::<f64, 5, 5>::zeros();
        J.fixed_view_mut::<2, 2>(0, 0).copy_from(&self.rotation());
        (J[(2, 4)], J[(3, 2)], J[(4, 3)]) = (1.0, scale, scale);
        let C = SMatrix::<f64, 5, 5>::from_fn(|row, column| shape.covariance[row][column]);
        let mut R = J * C * J.transpose();
        if let Some(R_pose) = R_pose {
            let mut J = SMatrix::<f64, 5, 6>::zeros();
            J.fixed_view_mut::<2, 6>(0, 0).copy_from(&self.by_pose([x, y], pose));
            J[(2, 5)] = 1.0;
            R += J * R_pose * J.transpose();
        }
        let [x, y] = self.world_point([x, y]);
        let bearing = heading + libm::atan2(self.sin, self.cos);
        Some(OutlineMeasurement {
            kind: shape.kind,
            z: SVector::from([x, y, bearing, scale * long, scale * short]),
            R: (R + R.transpose()) * 0.5,
            delay: 0.0,
            is_large,
        })
    }

    /// Derivative of a centre in the world by the pose of the sensor. An error of the tilt moves
    /// points above or below the sensor.
    fn by_pose(&self, [x, y]: [f64; 2], pose: &Transform) -> SMatrix<f64, 2, 6> {
        let r = &pose.rotation;
        let normal = [
            self.cos * r[0][2] + self.sin * r[1][2],
            self.cos * r[1][2] - self.sin * r[0][2],
            r[2][2],
        ];
        let is_upright = normal[2].abs() < UPRIGHT;
        // Height of the scan plane at the centre. In an upright plane the centre does not determine
        // it.
        let z = if is_upright { 0.0 } else { -(normal[0] * x + normal[1] * y) / normal[2] };
        let (sin_beta, cos_beta) = (-r[2][0], (r[0][0] * r[0][0] + r[1][0] * r[1][0]).sqrt());
        let turned = SMatrix::<f64, 2, 3>::from_columns(&[
            [sin_beta * y, -sin_beta * x - cos_beta * z].into(),
            [z, 0.0].into(),
            [-y, x].into(),
        ]);
        let mut J = SMatrix::<f64, 2, 6>::zeros();
        J[(0, 0)] = 1.0;
        J[(1, 1)] = 1.0;
        J.fixed_view_mut::<2, 3>(0, 3).copy_from(&(self.rotation() * turned));
        J
    }
}

/// Covariance of an estimated circle, as a matrix.
pub(super) fn matrix_of(estimate: &CircleEstimate) -> Matrix3<f64> {
    Matrix3::from_fn(|row, column| estimate.covariance[row][column])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose([x, y, z, alpha, beta, gamma]: [f64; 6]) -> Transform {
        let (sa, ca) = (libm::sin(alpha), libm::cos(alpha));
        let (sb, cb) = (libm::sin(beta), libm::cos(beta));
        let (sc, cc) = (libm::sin(gamma), libm::cos(gamma));
        let rotation = [
            [cc * cb, cc * sb * sa - sc * ca, cc * sb * ca + sc * sa],
            [sc * cb, sc * sb * sa + cc * ca, sc * sb * ca - cc * sa],
            [-sb, cb * sa, cb * ca],
        ];
        Transform { rotation, translation: [x, y, z] }
    }

    /// A point of the scan's plane in the world, from above.
    fn seen(pose: &Transform, point: [f64; 2]) -> [f64; 2] {
        let [x, y, _] = pose.apply([point[0], point[1], 0.0]);
        [x, y]
    }

    #[test]
    fn the_derivative_by_the_pose_agrees_with_differences() {
        let at = [1.0, -2.0, 1.5, 0.2, -0.3, 0.7];
        let here = pose(at);
        let level = LevelPose::of(&here);
        let point = [3.0, 2.0];
        let world = seen(&here, point);
        let J = level.by_pose(level.level(world, 0.1).center, &here);
        for parameter in 0..6 {
            let moved = |by: f64| {
                let mut near = at;
                near[parameter] += by;
                seen(&pose(near), point)
            };
            let (ahead, behind) = (moved(1e-6), moved(-1e-6));
            for axis in 0..2 {
                let expected = (ahead[axis] - behind[axis]) / 2e-6;
                assert!((J[(axis, parameter)] - expected).abs() < 1e-8, "{axis} {parameter}");
            }
        }
    }

    #[test]
    fn a_circle_goes_to_the_world_and_back() {
        let level = LevelPose::of(&pose([4.0, 5.0, 0.0, 0.1, 0.2, 2.0]));
        let circle = Circle { center: [1.0, 0.5], radius: 0.3 };
        let covariance = [[2e-4, 0.0, 0.0], [0.0, 1e-4, 1e-5], [0.0, 1e-5, 1e-4]];
        let placed =
            level.place(&CircleEstimate { circle, covariance, n_hits: 9, is_fallback: false });
        let back = level.level([placed.z[0], placed.z[1]], placed.z[2]);
        assert!((back.center[0] - 1.0).abs() + (back.center[1] - 0.5).abs() < 1e-12);
        assert!((placed.R.trace() - 4e-4).abs() < 1e-12);
    }
}
