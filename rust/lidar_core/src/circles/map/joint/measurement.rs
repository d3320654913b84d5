//! Expected measurement of an element, and place of a measured one, with the Jacobians of both.

#![allow(non_snake_case)] // textbook letters

use super::covariance::{Covariance, ELEMENT, place};
use crate::circles::map::element_motion::Matrix5;
use crate::circles::map::view::level_pose::LevelPose;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

type Matrix3x5 = SMatrix<f64, 3, 5>;
pub(super) type Matrix5x3 = SMatrix<f64, 5, 3>;

/// Measurement model of one element, eqs 16-17, and its Jacobians.
pub(super) struct MeasurementModel {
    pub(super) z: Vector3<f64>,
    pub(super) H_robot: Matrix3<f64>,
    pub(super) H_element: Matrix3x5,
}

impl MeasurementModel {
    pub(super) fn of(pose: &LevelPose, x: &SVector<f64, ELEMENT>) -> Self {
        let [px, py] = pose.level([x[0], x[1]], x[4]).center;
        let back = pose.rotation().transpose();
        let mut H_robot = Matrix3::zeros();
        H_robot.fixed_view_mut::<2, 2>(0, 0).copy_from(&-back);
        H_robot[(0, 2)] = py; // an error of the angle turns what is seen the other way
        H_robot[(1, 2)] = -px;
        let mut H_element = Matrix3x5::zeros();
        H_element.fixed_view_mut::<2, 2>(0, 0).copy_from(&back);
        H_element[(2, 4)] = 1.0;
        Self { z: Vector3::new(px, py, x[4]), H_robot, H_element }
    }

    /// P H', one row per error.
    pub(super) fn cross_covariance(&self, P: &Covariance, index: usize) -> Vec<Vector3<f64>> {
        (0..P.size())
            .map(|row| {
                let robot = Vector3::from_fn(|column, _| P.at(row, column));
                let element =
                    SVector::<f64, ELEMENT>::from_fn(|column, _| P.at(row, place(index) + column));
                self.H_robot * robot + self.H_element * element
            })
            .collect()
    }

    /// H P H' of eq. 25.
    pub(super) fn innovation_covariance(&self, P: &Covariance, index: usize) -> Matrix3<f64> {
        let robot: Matrix3<f64> = P.block(0, 0);
        let shared: Matrix3x5 = P.block(0, place(index));
        let element: Matrix5 = P.block(place(index), place(index));
        let mixed = self.H_robot * shared * self.H_element.transpose();
        self.H_robot * robot * self.H_robot.transpose()
            + mixed
            + mixed.transpose()
            + self.H_element * element * self.H_element.transpose()
    }

    /// H dx: change of the expected measurement by the corrections so far.
    pub(super) fn expected(&self, dx: &[f64], index: usize) -> Vector3<f64> {
        let element =
            SVector::<f64, ELEMENT>::from_column_slice(&dx[place(index)..place(index) + ELEMENT]);
        self.H_robot * Vector3::new(dx[0], dx[1], dx[2]) + self.H_element * element
    }
}

/// Place a measured circle in the world by eqs 18-20, with the Jacobians by the robot's error and
/// by the measurement.
pub(super) fn mapped(
    pose: &LevelPose,
    z: &Vector3<f64>,
) -> (SVector<f64, ELEMENT>, Matrix5x3, Matrix5x3) {
    let turn = pose.rotation();
    let at = turn * z.xy();
    let [x, y] = pose.origin();
    let mut G_robot = Matrix5x3::zeros();
    G_robot[(0, 0)] = 1.0;
    G_robot[(1, 1)] = 1.0;
    G_robot[(0, 2)] = -at[1];
    G_robot[(1, 2)] = at[0];
    let mut G_z = Matrix5x3::zeros();
    G_z.fixed_view_mut::<2, 2>(0, 0).copy_from(&turn);
    G_z[(4, 2)] = 1.0;
    (SVector::from([x + at[0], y + at[1], 0.0, 0.0, z[2]]), G_robot, G_z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::transform::Transform;

    fn pose([x, y, angle]: [f64; 3]) -> LevelPose {
        let (sin, cos) = (libm::sin(angle), libm::cos(angle));
        LevelPose::of(&Transform {
            rotation: [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]],
            translation: [x, y, 0.0],
        })
    }

    /// Central differences of `value` by each of `at`.
    fn differences<const N: usize, const M: usize>(
        at: [f64; M],
        value: impl Fn([f64; M]) -> SVector<f64, N>,
    ) -> SMatrix<f64, N, M> {
        let columns: [SVector<f64, N>; M] = std::array::from_fn(|index| {
            let moved = |by: f64| {
                let mut near = at;
                near[index] += by;
                value(near)
            };
            (moved(1e-6) - moved(-1e-6)) / 2e-6
        });
        SMatrix::from_columns(&columns)
    }

    #[test]
    fn jacobians_agree_with_differences() {
        let (robot, x, z) = ([1.0, -2.0, 0.8], [4.0, 1.0, 0.3, -0.2, 0.25], [2.0, -1.0, 0.3]);
        let model = MeasurementModel::of(&pose(robot), &SVector::from(x));
        let by_robot =
            differences(robot, |robot| MeasurementModel::of(&pose(robot), &SVector::from(x)).z);
        assert!((model.H_robot - by_robot).abs().max() < 1e-8);
        let by_element =
            differences(x, |x| MeasurementModel::of(&pose(robot), &SVector::from(x)).z);
        assert!((model.H_element - by_element).abs().max() < 1e-8);
        let (_, G_robot, G_z) = mapped(&pose(robot), &Vector3::from(z));
        let by_robot = differences(robot, |robot| mapped(&pose(robot), &Vector3::from(z)).0);
        assert!((G_robot - by_robot).abs().max() < 1e-8);
        let by_z = differences(z, |z| mapped(&pose(robot), &Vector3::from(z)).0);
        assert!((G_z - by_z).abs().max() < 1e-8);
    }
}
