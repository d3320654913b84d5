//! Rigid transforms; quaternions in the order (x, y, z, w).

use serde::{Deserialize, Serialize};

/// A rigid transform. `target_from_source` converts coordinates of the frame "source" to the frame
/// "target".
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Transform {
    /// Rows of the rotation matrix.
    pub rotation: [[f64; 3]; 3],
    /// Position of the source's origin in the target [m].
    pub translation: [f64; 3],
}

impl Default for Transform {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Transform {
    /// The identity.
    pub const IDENTITY: Self = Self {
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0; 3],
    };

    /// Transform from the upper rows of a 4x4 matrix in row-major order.
    #[must_use]
    pub fn from_matrix(matrix: &[f64; 16]) -> Self {
        Self {
            rotation: std::array::from_fn(|row| {
                std::array::from_fn(|column| matrix[4 * row + column])
            }),
            translation: std::array::from_fn(|row| matrix[4 * row + 3]),
        }
    }

    /// Coordinates in the target frame of `point` [m], which is given in the source frame.
    #[must_use]
    #[inline]
    pub fn apply(&self, point: [f64; 3]) -> [f64; 3] {
        let turned = self.rotate(point);
        std::array::from_fn(|axis| turned[axis] + self.translation[axis])
    }

    /// Components in the target frame of `direction`, which is given in the source frame.
    #[must_use]
    #[inline]
    pub fn rotate(&self, direction: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|row| dot(self.rotation[row], direction))
    }

    /// The inverse transform, from the target frame to the source frame.
    #[must_use]
    pub fn inverse(&self) -> Self {
        // The transpose: exact, without a division.
        let rotation: [[f64; 3]; 3] =
            std::array::from_fn(|row| std::array::from_fn(|column| self.rotation[column][row]));
        let back = Self { rotation, translation: [0.0; 3] };
        Self { translation: back.rotate(self.translation).map(|value| -value), ..back }
    }

    /// The transform that applies `first`, then `self`: `a_from_b.after(b_from_c)` is `a_from_c`.
    #[must_use]
    pub fn after(&self, first: &Self) -> Self {
        let column =
            |index: usize| self.rotate(std::array::from_fn(|row| first.rotation[row][index]));
        let columns = [column(0), column(1), column(2)];
        Self {
            rotation: std::array::from_fn(|row| std::array::from_fn(|index| columns[index][row])),
            translation: self.apply(first.translation),
        }
    }

    /// Covariance in the axes of the target frame (`R C R'`), exactly symmetric. `covariance` is in
    /// the axes of the source.
    #[must_use]
    pub fn turn_covariance(&self, covariance: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
        let half: [[f64; 3]; 3] = std::array::from_fn(|row| self.rotate(covariance[row])); // C R'
        let column = |index: usize| self.rotate(std::array::from_fn(|row| half[row][index]));
        let columns = [column(0), column(1), column(2)];
        std::array::from_fn(|row| {
            std::array::from_fn(|index| 0.5 * (columns[index][row] + columns[row][index]))
        })
    }

    /// The transform between `self` (`fraction` 0) and `other` (1). The translation is interpolated
    /// on a straight line, the rotation at a constant rate.
    #[must_use]
    pub fn interpolate(&self, other: &Self, fraction: f64) -> Self {
        let start = quaternion_from_rotation(&self.rotation);
        let end = quaternion_from_rotation(&other.rotation);
        Self {
            rotation: rotation_from_quaternion(slerp(start, end, fraction)),
            translation: std::array::from_fn(|axis| {
                self.translation[axis]
                    + fraction * (other.translation[axis] - self.translation[axis])
            }),
        }
    }
}

/// Scalar product.
#[must_use]
#[inline]
pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Vector product.
#[must_use]
#[inline]
pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// `a - b`.
#[must_use]
#[inline]
pub fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| a[axis] - b[axis])
}

/// Euclidean norm.
#[must_use]
#[inline]
pub fn norm(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

/// Unit vector in the direction of `a`, for any length of `a`. None if `a` is zero or not finite.
#[must_use]
pub fn direction_of(a: [f64; 3]) -> Option<[f64; 3]> {
    let largest = a.iter().fold(0.0, |largest, value| value.abs().max(largest));
    if !(largest > 0.0 && a.iter().all(|value| value.is_finite())) {
        return None;
    }
    let scaled = a.map(|value| value / largest); // squares neither overflow nor vanish
    let length = norm(scaled);
    Some(scaled.map(|value| value / length))
}

/// Unit quaternion (x, y, z, w) of a rotation matrix.
#[must_use]
pub fn quaternion_from_rotation(r: &[[f64; 3]; 3]) -> [f64; 4] {
    // The largest of the four squares is taken as the pivot, so that nothing small is divided by.
    let squares = [
        1.0 + r[0][0] - r[1][1] - r[2][2],
        1.0 - r[0][0] + r[1][1] - r[2][2],
        1.0 - r[0][0] - r[1][1] + r[2][2],
        1.0 + r[0][0] + r[1][1] + r[2][2],
    ];
    let mut pivot = 3;
    for index in 0..3 {
        if squares[index] > squares[pivot] {
            pivot = index;
        }
    }
    let q = match pivot {
        0 => [squares[0], r[0][1] + r[1][0], r[0][2] + r[2][0], r[2][1] - r[1][2]],
        1 => [r[0][1] + r[1][0], squares[1], r[1][2] + r[2][1], r[0][2] - r[2][0]],
        2 => [r[0][2] + r[2][0], r[1][2] + r[2][1], squares[2], r[1][0] - r[0][1]],
        _ => [r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1], squares[3]],
    };
    unit(q)
}

/// Rotation matrix of a unit quaternion (x, y, z, w).
#[must_use]
pub fn rotation_from_quaternion([x, y, z, w]: [f64; 4]) -> [[f64; 3]; 3] {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// Spherical interpolation along the shorter arc.
fn slerp(start: [f64; 4], end: [f64; 4], fraction: f64) -> [f64; 4] {
    let cosine: f64 = (0..4).map(|index| start[index] * end[index]).sum();
    // q and -q are the same rotation: the sign selects the shorter arc.
    let sign = if cosine < 0.0 { -1.0 } else { 1.0 };
    // `libm`, for the same bits on every platform. Rounding may lift the cosine above 1, which would be NaN.
    let angle = libm::acos((cosine * sign).min(1.0));
    let (keep, take) = if angle < 1e-9 {
        (1.0 - fraction, fraction) // the sine below would be near zero
    } else {
        let sine = libm::sin(angle);
        (libm::sin((1.0 - fraction) * angle) / sine, libm::sin(fraction * angle) / sine)
    };
    unit(std::array::from_fn(|index| keep * start[index] + sign * take * end[index]))
}

fn unit(q: [f64; 4]) -> [f64; 4] {
    let norm = q.iter().map(|value| value * value).sum::<f64>().sqrt();
    q.map(|value| value / norm)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn about_z(angle: f64) -> Transform {
        let (sine, cosine) = (libm::sin(angle), libm::cos(angle));
        Transform {
            rotation: [[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]],
            translation: [angle, 0.0, 0.0],
        }
    }

    #[test]
    fn half_way_is_half_the_angle_and_half_the_way() {
        for angle in [1e-12, 0.3, 3.0] {
            let half = about_z(0.0).interpolate(&about_z(angle), 0.5);
            let expected = about_z(angle / 2.0);
            for row in 0..3 {
                for column in 0..3 {
                    assert!(
                        (half.rotation[row][column] - expected.rotation[row][column]).abs() < 1e-12
                    );
                }
            }
            assert!((half.translation[0] - angle / 2.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_transform_and_its_inverse_cancel() {
        let there = about_z(0.7).after(&about_z(-0.2));
        let point = there.inverse().apply(there.apply([1.0, 2.0, 3.0]));
        assert!(norm(minus(point, [1.0, 2.0, 3.0])) < 1e-12);
        assert!(
            norm(minus(there.apply([1.0; 3]), about_z(0.7).apply(about_z(-0.2).apply([1.0; 3]))))
                < 1e-12
        );
    }

    #[test]
    fn a_covariance_turns_with_its_axes() {
        let quarter = about_z(std::f64::consts::FRAC_PI_2);
        let turned = quarter.turn_covariance(&[[4.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 9.0]]);
        assert!((turned[0][0] - 1.0).abs() < 1e-12 && (turned[1][1] - 4.0).abs() < 1e-12);
    }

    #[test]
    fn a_quaternion_gives_its_rotation_back() {
        for q in
            [[0.1, 0.2, 0.3, 0.9], [0.9, 0.1, 0.0, 0.1], [0.0, 1.0, 0.1, 0.0], [0.1, 0.0, 2.0, 0.0]]
        {
            let q = unit(q);
            let back = quaternion_from_rotation(&rotation_from_quaternion(q));
            let same: f64 = (0..4).map(|index| q[index] * back[index]).sum();
            assert!((same.abs() - 1.0).abs() < 1e-12);
        }
    }
}
