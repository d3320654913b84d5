//! Places in a scan: transforms from the level frame to the world, with the covariance of the pose.

#![allow(non_snake_case)] // textbook letters

use super::body::outline::{OutlineEstimate, OutlineMeasurement};
use super::circle_measurement::CircleMeasurement;
use super::line::LineMeasurement;
use super::view::level_pose::LevelPose;
use crate::circles::fit::circle::{Circle, CircleEstimate};
use crate::circles::preprocess::polar_scan::turn;
use crate::circles::shape::ShapeEstimate;
use crate::geometry::transform::Transform;
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};

impl LevelPose {
    /// Transform a circle from the level frame to the world, eq. 18.
    pub(super) fn place(&self, estimate: &CircleEstimate) -> CircleMeasurement {
        let Circle { center: [x, y], radius } = estimate.circle;
        let mut turn = Matrix3::identity();
        turn.fixed_view_mut::<2, 2>(0, 0).copy_from(&self.rotation());
        let R = matrix_of(estimate);
        let R = turn * R * turn.transpose();
        let [x0, y0] = self.origin();
        let offset = Vector3::new(x0, y0, 0.0);
        let z = turn * Vector3::new(x, y, radius) + offset;
        CircleMeasurement { z, R: (R + R.transpose()) * 0.5, delay: 0.0 }
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
        // An error of the angle shifts the visible part across the line, except at the foot of the normal.
        // The offset at the middle of the visible part hardly depends on the angle.
        let J = Matrix2::new(1.0, 0.0, -0.5 * (start + end), 1.0);
        let mut R = J * Matrix2::new(c[0][0], c[0][1], c[1][0], c[1][1]) * J.transpose();
        let middle = [0, 1].map(|axis| 0.5 * (ends[0][axis] + ends[1][axis]));
        let yaw = self.yaw();
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
    ) -> CircleMeasurement {
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
        let bearing = heading + self.yaw();
        Some(OutlineMeasurement {
            kind: shape.kind,
            z: SVector::from([x, y, bearing, scale * long, scale * short]),
            R: (R + R.transpose()) * 0.5,
            delay: 0.0,
            is_large,
        })
    }
}

/// Covariance of an estimated circle, as a matrix.
pub(super) fn matrix_of(estimate: &CircleEstimate) -> Matrix3<f64> {
    Matrix3::from_fn(|row, column| estimate.covariance[row][column])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_circle_goes_to_the_world_and_back() {
        let (sin, cos) = (libm::sin(2.0), libm::cos(2.0));
        let rotation = [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]];
        let pose = Transform { rotation, translation: [4.0, 5.0, 0.0] };
        let level = LevelPose::of(&pose);
        let circle = Circle { center: [1.0, 0.5], radius: 0.3 };
        let covariance = [[2e-4, 0.0, 0.0], [0.0, 1e-4, 1e-5], [0.0, 1e-5, 1e-4]];
        let placed =
            level.place(&CircleEstimate { circle, covariance, n_hits: 9, is_fallback: false });
        let back = level.level([placed.z[0], placed.z[1]], placed.z[2]);
        assert!((back.center[0] - 1.0).abs() + (back.center[1] - 0.5).abs() < 1e-12);
        assert!((placed.R.trace() - 4e-4).abs() < 1e-12);
    }
}
