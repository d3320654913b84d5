//! Uncertainty of measured points. Source: Vrba et al., sec. IV-A.

use crate::geometry::transform::{Transform, minus};

/// Derivative of a measured point by the pose: translation, then the angles alpha, beta, gamma of
/// `R = Rz(gamma) Ry(beta) Rx(alpha)` (the first five blocks of eq. 42). `point` is in the frame
/// that `pose` leads to.
pub(crate) fn pose_jacobian(pose: &Transform, point: [f64; 3]) -> [[f64; 6]; 3] {
    // Turning about an axis u of the rotated frame moves an arm r by u x r: Rx turns about the
    // body's x axis, Rz about the world's z axis, Ry about the y axis that Rz has turned.
    let arm = minus(point, pose.translation);
    let heading = libm::atan2(pose.rotation[1][0], pose.rotation[0][0]);
    let x_axis = std::array::from_fn(|row| pose.rotation[row][0]);
    let y_axis = [-libm::sin(heading), libm::cos(heading), 0.0];
    let turns = [cross(x_axis, arm), cross(y_axis, arm), cross([0.0, 0.0, 1.0], arm)];
    std::array::from_fn(|row| {
        std::array::from_fn(|column| match column {
            0..3 => f64::from(u8::from(row == column)),
            _ => turns[column - 3][row],
        })
    })
}

/// `J C J'` (eq. 41).
pub(crate) fn propagated(jacobian: &[[f64; 6]; 3], covariance: &[[f64; 6]; 6]) -> [[f64; 3]; 3] {
    let entry = |a: usize, b: usize| -> f64 {
        (0..6)
            .flat_map(|i| (0..6).map(move |j| (i, j)))
            .map(|(i, j)| jacobian[a][i] * covariance[i][j] * jacobian[b][j])
            .sum()
    };
    std::array::from_fn(|a| std::array::from_fn(|b| entry(a, b)))
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose([x, y, z, alpha, beta, gamma]: [f64; 6]) -> Transform {
        let (sa, ca) = (libm::sin(alpha), libm::cos(alpha));
        let (sb, cb) = (libm::sin(beta), libm::cos(beta));
        let (sc, cc) = (libm::sin(gamma), libm::cos(gamma));
        Transform {
            rotation: [
                [cc * cb, cc * sb * sa - sc * ca, cc * sb * ca + sc * sa],
                [sc * cb, sc * sb * sa + cc * ca, sc * sb * ca - cc * sa],
                [-sb, cb * sa, cb * ca],
            ],
            translation: [x, y, z],
        }
    }

    #[test]
    fn the_jacobian_is_that_of_finite_differences() {
        let at = [1.0, -2.0, 3.0, 0.4, -0.7, 2.1];
        let local = [5.0, 3.0, -1.0];
        let jacobian = pose_jacobian(&pose(at), pose(at).apply(local));
        for column in 0..6 {
            let shifted = |by: f64| {
                let mut moved = at;
                moved[column] += by;
                pose(moved).apply(local)
            };
            let difference = minus(shifted(1e-6), shifted(-1e-6));
            for row in 0..3 {
                assert!((difference[row] / 2e-6 - jacobian[row][column]).abs() < 1e-8);
            }
        }
    }
}
