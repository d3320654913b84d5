//! Sigma points in square-root form: covariances are kept as triangles and never factorised.

#![allow(non_snake_case)] // textbook letters

use nalgebra::{SMatrix, SVector};

/// Largest number of rows of a triangle: nine states and four measured values.
pub const MAX_ROWS: usize = 13;

/// A normal distribution whose covariance is stored as a lower triangle times its transpose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rooted<const N: usize> {
    /// Expected value.
    pub mean: SVector<f64, N>,
    /// Lower triangle L; the covariance is L L'.
    pub root: SMatrix<f64, N, N>,
}

impl<const N: usize> Rooted<N> {
    /// Distribution with this covariance; directions without positive variance count as exactly
    /// known.
    #[must_use]
    pub fn new(mean: SVector<f64, N>, covariance: &SMatrix<f64, N, N>) -> Self {
        Self { mean, root: semidefinite_root(covariance) }
    }

    /// The covariance.
    #[must_use]
    pub fn covariance(&self) -> SMatrix<f64, N, N> {
        let product = self.root * self.root.transpose();
        (product + product.transpose()) * 0.5
    }
}

/// Sigma-point rule: distance of the points and their weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SigmaRule {
    /// Square of the distance of the points from the mean, when the distance is in standard deviations.
    pub spread: f64,
    /// Weight of the central point; negative where `spread` is below the number of states.
    pub center: f64,
    /// Weight of every other point.
    pub around: f64,
}

impl SigmaRule {
    /// Rule for this number of states. The points lie sqrt(`spread`) standard deviations from the
    /// mean; `spread` > 0. With `spread` = `states` it is the cubature rule.
    #[must_use]
    pub fn new(states: usize, spread: f64) -> Self {
        Self { spread, center: 1.0 - states as f64 / spread, around: 0.5 / spread }
    }
}

/// Rows of a lower triangle L whose product L L' is the covariance of all absorbed columns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangle {
    size: usize,
    rows: [[f64; MAX_ROWS]; MAX_ROWS],
}

impl Triangle {
    /// Zero, with `size` rows, at most [`MAX_ROWS`].
    #[must_use]
    pub fn zero(size: usize) -> Self {
        Self { size: size.min(MAX_ROWS), rows: [[0.0; MAX_ROWS]; MAX_ROWS] }
    }

    /// The entry in `row` and `column`.
    #[must_use]
    pub fn at(&self, row: usize, column: usize) -> f64 {
        self.rows[row][column]
    }

    /// Add c c' to L L' by Givens rotations. They cannot fail: no difference is formed.
    pub fn absorb(&mut self, mut c: [f64; MAX_ROWS]) {
        for k in 0..self.size {
            // Nothing to rotate; and with a zero diagonal the angle would be 0 / 0.
            if c[k] == 0.0 {
                continue;
            }
            let length = libm::hypot(self.rows[k][k], c[k]);
            let (cosine, sine) = (self.rows[k][k] / length, c[k] / length);
            for (row, entry) in self.rows.iter_mut().zip(&mut c).take(self.size).skip(k) {
                let old = row[k];
                row[k] = cosine * old + sine * *entry;
                *entry = cosine * *entry - sine * old;
            }
        }
    }

    /// Triangle of L L' - c c'; None if that is not positive definite.
    #[must_use]
    pub fn without(&self, mut c: [f64; MAX_ROWS]) -> Option<Self> {
        let mut left = *self;
        for k in 0..self.size {
            let old = left.rows[k][k];
            let square = old * old - c[k] * c[k];
            // Below this share the difference consists of rounding: its root would be arbitrary.
            if square <= 1e-12 * old * old || square.is_nan() {
                return None;
            }
            let (cosine, sine) = (libm::sqrt(square) / old, c[k] / old);
            for (row, entry) in left.rows.iter_mut().zip(&mut c).take(self.size).skip(k) {
                row[k] = (row[k] - sine * *entry) / cosine;
                *entry = cosine * *entry - sine * row[k];
            }
        }
        Some(left)
    }

    /// Absorb a deviation with its weight; with a negative weight it is subtracted if possible.
    #[must_use]
    pub fn weighted(mut self, weight: f64, mut c: [f64; MAX_ROWS]) -> Self {
        let scale = libm::sqrt(weight.abs());
        c.iter_mut().for_each(|entry| *entry *= scale);
        if weight < 0.0 {
            return self.without(c).unwrap_or(self); // else the covariance stays the larger one
        }
        self.absorb(c);
        self
    }

    /// Rows and columns from `first` on.
    #[must_use]
    pub fn corner<const N: usize>(&self, first: usize) -> SMatrix<f64, N, N> {
        SMatrix::from_fn(|row, column| self.rows[first + row][first + column])
    }
}

/// A column for [`Triangle`]: `upper`, then `lower`, then zeros.
#[must_use]
pub fn stacked(upper: &[f64], lower: &[f64]) -> [f64; MAX_ROWS] {
    let mut column = [0.0; MAX_ROWS];
    for (entry, value) in column.iter_mut().zip(upper.iter().chain(lower)) {
        *entry = *value;
    }
    column
}

/// Mean and covariance triangle of f(x) for x with distribution `prior`, without the central point.
///
/// The third value is the shift of the mean from f at the prior mean. The caller absorbs it with
/// the central weight after all positive terms, since that weight may be negative.
pub fn transformed<const N: usize>(
    prior: &Rooted<N>,
    rule: &SigmaRule,
    f: impl Fn(&SVector<f64, N>) -> SVector<f64, N>,
) -> (SVector<f64, N>, Triangle, SVector<f64, N>) {
    // Deviations from the image of the mean are summed, not the images: coordinates far from the
    // origin would lose the digits of the covariance.
    let center = f(&prior.mean);
    let (reach, mut around) = (libm::sqrt(rule.spread), [[SVector::zeros(); 2]; N]);
    let mut sum = SVector::<f64, N>::zeros();
    for (pair, axis) in around.iter_mut().zip(prior.root.column_iter()) {
        let step = axis * reach;
        *pair = [f(&(prior.mean + step)) - center, f(&(prior.mean - step)) - center];
        sum += pair[0] + pair[1];
    }
    let shift = sum * rule.around;
    let mut triangle = Triangle::zero(N);
    for deviation in around.iter().flatten() {
        triangle = triangle.weighted(rule.around, stacked((deviation - shift).as_slice(), &[]));
    }
    (center + shift, triangle, shift)
}

/// Cholesky factor of a semidefinite covariance; columns whose pivot is not positive are zero.
fn semidefinite_root<const N: usize>(P: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    let mut root = SMatrix::<f64, N, N>::zeros();
    for column in 0..N {
        let pivot = P[(column, column)]
            - (0..column).map(|k| root[(column, k)] * root[(column, k)]).sum::<f64>();
        // A state without variance (exactly known, or a copy of others) has no Cholesky column.
        // Zero puts its sigma points on the mean, where an error would stop the filter.
        if pivot <= 1e-14 * P[(column, column)] || pivot.is_nan() {
            continue;
        }
        let diagonal = libm::sqrt(pivot);
        root[(column, column)] = diagonal;
        for row in column + 1..N {
            let product: f64 = (0..column).map(|k| root[(row, k)] * root[(column, k)]).sum();
            root[(row, column)] = (P[(row, column)] - product) / diagonal;
        }
    }
    root
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector3};

    fn covariance() -> Matrix3<f64> {
        Matrix3::new(4.0, 1.0, 0.5, 1.0, 3.0, -0.2, 0.5, -0.2, 2.0)
    }

    #[test]
    fn a_triangle_holds_what_it_absorbed_and_gives_it_back() {
        let columns = [[1.0, 2.0, 3.0], [0.0, -1.0, 2.0], [0.5, 0.0, 0.0], [2.0, 2.0, -1.0]];
        let mut triangle = Triangle::zero(3);
        let mut expected = Matrix3::zeros();
        for column in columns {
            triangle.absorb(stacked(&column, &[]));
            let column = Vector3::from(column);
            expected += column * column.transpose();
        }
        let root = triangle.corner::<3>(0);
        assert!((root * root.transpose() - expected).abs().max() < 1e-13);
        let fewer = triangle.without(stacked(&columns[0], &[])).map(|left| left.corner::<3>(0));
        let column = Vector3::from(columns[0]);
        let difference = fewer.map(|root| root * root.transpose() + column * column.transpose());
        assert!(difference.is_some_and(|sum| (sum - expected).abs().max() < 1e-12));
        assert_eq!(triangle.without([9.0; MAX_ROWS]), None);
    }

    #[test]
    fn a_linear_function_keeps_mean_and_covariance() {
        let F = Matrix3::new(1.0, 0.5, 0.0, 0.0, 1.0, 0.5, 0.2, 0.0, 1.0);
        let prior = Rooted::new(Vector3::new(1.0, -2.0, 0.5), &covariance());
        for spread in [3.0, 5.0, 1.0] {
            let rule = SigmaRule::new(3, spread);
            let (mean, triangle, shift) = transformed(&prior, &rule, |s| F * s);
            let triangle = triangle.weighted(rule.center, stacked(shift.as_slice(), &[]));
            let root = triangle.corner::<3>(0);
            assert!((mean - F * prior.mean).abs().max() < 1e-12);
            let expected = F * covariance() * F.transpose();
            assert!((root * root.transpose() - expected).abs().max() < 1e-12);
        }
    }

    #[test]
    fn a_singular_covariance_has_a_root() {
        let column = Vector3::new(1.0, 2.0, 3.0);
        let singular = column * column.transpose();
        assert!((Rooted::new(column, &singular).covariance() - singular).abs().max() < 1e-12);
        assert_eq!(Rooted::new(column, &-singular).root, Matrix3::zeros());
    }
}
