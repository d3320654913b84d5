//! Pose of a scan: transforms from the level frame of its sensor to the world.

#![allow(non_snake_case)] // textbook letters

use crate::circles::fit::circle::Circle;
use crate::geometry::transform::Transform;
use nalgebra::{Matrix2, SMatrix};
use serde::{Deserialize, Serialize};

/// Vertical part of the scan's normal below which a scan plane is treated as upright.
const UPRIGHT: f64 = 0.05;
/// Differences of poses that are rounding [m], [rad].
const SAME: f64 = 1e-6;

/// Pose of the level frame in the world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(in crate::circles::map) struct LevelPose {
    origin: [f64; 2],
    cos: f64,
    sin: f64,
}

impl LevelPose {
    pub(in crate::circles::map) fn of(pose: &Transform) -> Self {
        // Roll and pitch only shorten the projection of the x axis; its direction is the yaw.
        let [x, y] = [pose.rotation[0][0], pose.rotation[1][0]];
        let norm = (x * x + y * y).sqrt();
        let (cos, sin) = if norm > 0.0 { (x / norm, y / norm) } else { (1.0, 0.0) };
        Self { origin: [pose.translation[0], pose.translation[1]], cos, sin }
    }

    /// True if both poses are the same, up to rounding.
    pub(in crate::circles::map) fn is_same(&self, other: &Self) -> bool {
        let (one, two) = ([self.origin[0], self.origin[1], self.cos, self.sin], other);
        let two = [two.origin[0], two.origin[1], two.cos, two.sin];
        one.iter().zip(two).all(|(one, two)| (one - two).abs() < SAME)
    }

    pub(in crate::circles::map) fn rotation(&self) -> Matrix2<f64> {
        Matrix2::new(self.cos, -self.sin, self.sin, self.cos)
    }

    /// Bearing of the level frame's x axis in the world [rad].
    pub(in crate::circles::map) fn yaw(&self) -> f64 {
        libm::atan2(self.sin, self.cos)
    }

    pub(in crate::circles::map) fn origin(&self) -> [f64; 2] {
        self.origin
    }

    /// Transform a circle from the world to the level frame.
    pub(in crate::circles::map) fn level(&self, center: [f64; 2], radius: f64) -> Circle {
        let [x, y] = [center[0] - self.origin[0], center[1] - self.origin[1]];
        Circle { center: [self.cos * x + self.sin * y, self.cos * y - self.sin * x], radius }
    }

    /// Direction in the world in which a point of the level frame is seen, of length one.
    pub(in crate::circles::map) fn sight(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let length = libm::hypot(x, y).max(f64::MIN_POSITIVE);
        let [x, y] = [x / length, y / length];
        [self.cos * x - self.sin * y, self.sin * x + self.cos * y]
    }

    /// Transform a point from the level frame to the world.
    pub(in crate::circles::map) fn world_point(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [from_x, from_y] = self.origin;
        [from_x + self.cos * x - self.sin * y, from_y + self.sin * x + self.cos * y]
    }

    /// Derivative of a centre in the world by the pose of the sensor. An error of the tilt moves
    /// points above or below the sensor.
    pub(in crate::circles::map) fn by_pose(
        &self,
        [x, y]: [f64; 2],
        pose: &Transform,
    ) -> SMatrix<f64, 2, 6> {
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
}
