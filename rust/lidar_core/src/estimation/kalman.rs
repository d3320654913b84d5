//! Kalman filter with sizes in types: predict, update (Joseph form), normalised innovation.

#![allow(non_snake_case)] // textbook letters
#![allow(clippy::needless_range_loop)] // plain loops are inlined and unrolled

use crate::Error;
use nalgebra::{SMatrix, SVector};
use serde::{Deserialize, Serialize};

/// A normal distribution.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gaussian<const N: usize> {
    /// Expected value.
    pub mean: SVector<f64, N>,
    /// Covariance, exactly symmetric.
    pub covariance: SMatrix<f64, N, N>,
}

impl<const N: usize> Gaussian<N> {
    /// Mean, then covariance column by column: for saving.
    #[must_use]
    pub fn numbers(&self) -> Vec<f64> {
        self.mean.iter().chain(&self.covariance).copied().collect()
    }

    /// Inverse of [`Self::numbers`]; None if the number of values does not fit.
    #[must_use]
    pub fn from_numbers(numbers: &[f64]) -> Option<Self> {
        let (mean, covariance) = numbers.split_at_checked(N)?;
        (covariance.len() == N * N).then(|| Self {
            mean: SVector::from_column_slice(mean),
            covariance: SMatrix::from_column_slice(covariance),
        })
    }
}

/// A measurement whose model is linearised at the mean of the state.
#[derive(Clone, Debug, PartialEq)]
pub struct Linearised<const N: usize, const M: usize> {
    /// Innovation: measured minus expected.
    pub y: SVector<f64, M>,
    /// Jacobian of the measurement with respect to the state.
    pub H: SMatrix<f64, M, N>,
    /// Covariance of the measurement noise.
    pub R: SMatrix<f64, M, M>,
}

/// A corrected state, and how well the measurement agreed with the prediction.
#[derive(Clone, Debug, PartialEq)]
pub struct Update<const N: usize> {
    /// State after the measurement.
    pub posterior: Gaussian<N>,
    /// Normalised innovation squared: chi-square with M degrees of freedom.
    pub nis: f64,
    /// Natural logarithm of the determinant of the innovation covariance S.
    pub log_determinant: f64,
}

/// Distance of a vector from zero in terms of a covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mahalanobis<const M: usize> {
    /// Squared distance of the vector y, y' S^-1 y with its covariance S.
    pub squared: f64,
    /// Natural logarithm of the determinant of S.
    pub log_determinant: f64,
    /// Diagonal of S.
    pub variances: [f64; M],
}

/// `prior` after the linear motion `F` with process noise `Q`.
#[must_use]
pub fn predict<const N: usize>(
    prior: &Gaussian<N>,
    F: &SMatrix<f64, N, N>,
    Q: &SMatrix<f64, N, N>,
) -> Gaussian<N> {
    let mut covariance = prior.covariance;
    carry(&mut covariance, F);
    Gaussian { mean: F * prior.mean, covariance: symmetrised(covariance + Q) }
}

/// Replace P by F P F'. `P` has to be symmetric; zeros of `F` cost nothing.
pub fn carry<const N: usize>(P: &mut SMatrix<f64, N, N>, F: &SMatrix<f64, N, N>) {
    let (P, F) = (&mut P.data.0, &F.data.0);
    // F P by columns, as P is stored: both products then run along memory.
    let mut half = [[0.0; N]; N];
    for row in 0..N {
        let mut sum = [0.0; N];
        for k in 0..N {
            add_scaled(&mut sum, F[k][row], &P[k]);
        }
        for k in 0..N {
            half[k][row] = sum[k];
        }
    }
    for row in 0..N {
        let mut sum = [0.0; N];
        for k in 0..N {
            add_scaled(&mut sum, F[k][row], &half[k]);
        }
        P[row] = sum;
    }
}

/// `sum` += `factor` * `vector`, skipped for zero.
#[inline(always)]
pub(crate) fn add_scaled<const N: usize>(sum: &mut [f64; N], factor: f64, vector: &[f64; N]) {
    if factor != 0.0 {
        for k in 0..N {
            sum[k] += factor * vector[k];
        }
    }
}

/// Correct `prior` with a measurement whose model is linearised at `prior.mean`.
///
/// # Errors
/// [`Error::NotPositiveDefinite`] if the innovation covariance S cannot be factorised.
///
/// # Source
/// Bar-Shalom, Li & Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001.
pub fn update<const N: usize, const M: usize>(
    prior: &Gaussian<N>,
    model: &Linearised<N, M>,
) -> Result<Update<N>, Error> {
    let mut posterior = prior.clone();
    let far = correct(&mut posterior, model, |_| true)?;
    Ok(Update { posterior, nis: far.squared, log_determinant: far.log_determinant })
}

/// Like [`update`], but in place, and only if `believe` accepts the distance of the innovation.
///
/// # Errors
/// [`Error::NotPositiveDefinite`] as of [`update`]; the state is then unchanged.
pub fn correct<const N: usize, const M: usize>(
    state: &mut Gaussian<N>,
    model: &Linearised<N, M>,
    believe: impl FnOnce(&Mahalanobis<M>) -> bool,
) -> Result<Mahalanobis<M>, Error> {
    // Longer than other functions: loops over rows that the compiler makes vector code of, and that
    // share A, S and their factor.
    let (P, H) = (&state.covariance.data.0, &model.H.data.0);
    let mut A = [[0.0; N]; M]; // H P by rows: sums of whole rows become vector code
    for k in 0..N {
        for m in 0..M {
            add_scaled(&mut A[m], H[k][m], &P[k]);
        }
    }
    let mut S = model.R.data.0;
    for k in 0..N {
        for m in 0..M {
            add_scaled(&mut S[m], A[m][k], &H[k]);
        }
    }
    let root = Root::new(&S)?;
    let mut y = [[0.0; 1]; M];
    let mut squared = 0.0;
    for m in 0..M {
        y[m] = [model.y[m]];
    }
    root.solve_lower(&mut y);
    for [entry] in &y {
        squared += entry * entry;
    }
    let variances = std::array::from_fn(|m| S[m][m]);
    let far = Mahalanobis { squared, log_determinant: root.log_determinant(), variances };
    if !believe(&far) {
        return Ok(far);
    }
    // y becomes S^-1 y by the other half of the factorisation: S is never inverted.
    root.solve_upper(&mut y);
    for m in 0..M {
        add_scaled(&mut state.mean.data.0[0], y[m][0], &A[m]);
    }
    let mut gain = A; // rows of K': S Kt = H P is solved, nothing inverted
    root.solve_lower(&mut gain);
    root.solve_upper(&mut gain);
    joseph(&mut state.covariance, &A, &gain, model);
    Ok(far)
}

/// Joseph form (I - K H) P (I - K H)' + K R K' with H P in `A` and K' in `gain`.
///
/// Unlike P - K H P it is a sum of squares: rounding in the gain cannot make it indefinite.
#[inline(always)]
fn joseph<const N: usize, const M: usize>(
    P: &mut SMatrix<f64, N, N>,
    A: &[[f64; N]; M],
    gain: &[[f64; N]; M],
    model: &Linearised<N, M>,
) {
    // Longer than other functions: the terms of one sum, which share G and the gain.
    // Columns of (I - K H) P, as P - K (H P): A holds H P already, which saves a product of N x N.
    let mut G = [[0.0; N]; N];
    for k in 0..N {
        let mut sum = P.data.0[k];
        for m in 0..M {
            add_scaled(&mut sum, -A[m][k], &gain[m]);
        }
        G[k] = sum;
    }
    let mut noisy = [[0.0; N]; M]; // R K' by rows, as A
    for m in 0..M {
        for l in 0..M {
            add_scaled(&mut noisy[m], model.R.data.0[m][l], &gain[l]);
        }
    }
    // Columns of I - K H: matrices are stored by columns, so that sums run along memory.
    let mut left = [[0.0; N]; N];
    for k in 0..N {
        left[k][k] = 1.0;
        for m in 0..M {
            add_scaled(&mut left[k], -model.H.data.0[k][m], &gain[m]);
        }
    }
    for row in 0..N {
        let mut sum = [0.0; N];
        for k in 0..N {
            add_scaled(&mut sum, left[k][row], &G[k]);
        }
        for m in 0..M {
            add_scaled(&mut sum, gain[m][row], &noisy[m]);
        }
        P.data.0[row] = sum;
    }
    symmetrise(P);
}

/// Cholesky factor of a covariance of M values: lower triangle and the inverses of its diagonal.
struct Root<const M: usize> {
    lower: [[f64; M]; M],
    inverse: [f64; M],
}

impl<const M: usize> Root<M> {
    #[inline(always)]
    fn new(S: &[[f64; M]; M]) -> Result<Self, Error> {
        let (mut lower, mut inverse) = ([[0.0; M]; M], [0.0; M]);
        for row in 0..M {
            for column in 0..=row {
                let mut left = S[row][column];
                for k in 0..column {
                    left -= lower[row][k] * lower[column][k];
                }
                if column < row {
                    lower[row][column] = left * inverse[column];
                } else if left > 0.0 {
                    lower[row][row] = libm::sqrt(left);
                    inverse[row] = 1.0 / lower[row][row];
                } else {
                    // also for NaN, which fails every comparison
                    return Err(Error::NotPositiveDefinite { matrix: "S" });
                }
            }
        }
        Ok(Self { lower, inverse })
    }

    fn log_determinant(&self) -> f64 {
        let mut product = 1.0;
        for index in 0..M {
            product *= self.lower[index][index];
        }
        2.0 * libm::log(product)
    }

    /// L^-1 X, in place.
    #[inline(always)]
    fn solve_lower<const N: usize>(&self, X: &mut [[f64; N]; M]) {
        for row in 0..M {
            for k in 0..row {
                let known = X[k];
                add_scaled(&mut X[row], -self.lower[row][k], &known);
            }
            for k in 0..N {
                X[row][k] *= self.inverse[row];
            }
        }
    }

    /// L'^-1 X, in place.
    #[inline(always)]
    fn solve_upper<const N: usize>(&self, X: &mut [[f64; N]; M]) {
        for row in (0..M).rev() {
            for k in row + 1..M {
                let known = X[k];
                add_scaled(&mut X[row], -self.lower[k][row], &known);
            }
            for k in 0..N {
                X[row][k] *= self.inverse[row];
            }
        }
    }
}

/// Squared Mahalanobis distance of `y` from zero, given its covariance `S`.
///
/// # Errors
/// [`Error::NotPositiveDefinite`] if `S` cannot be factorised.
pub fn mahalanobis<const M: usize>(
    y: &SVector<f64, M>,
    S: &SMatrix<f64, M, M>,
) -> Result<Mahalanobis<M>, Error> {
    let root = Root::new(&S.data.0)?;
    let mut white: [[f64; 1]; M] = std::array::from_fn(|m| [y[m]]);
    root.solve_lower(&mut white);
    let squared = white.iter().map(|[entry]| entry * entry).sum();
    let variances = std::array::from_fn(|m| S[(m, m)]);
    Ok(Mahalanobis { squared, log_determinant: root.log_determinant(), variances })
}

/// The mean of a matrix and its transpose: bit for bit symmetric.
#[must_use]
pub fn symmetrised<const N: usize>(matrix: SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    let mut mean = matrix;
    symmetrise(&mut mean);
    mean
}

/// Make a matrix exactly symmetric in place: see [`symmetrised`].
#[inline]
pub fn symmetrise<const N: usize>(matrix: &mut SMatrix<f64, N, N>) {
    let entries = &mut matrix.data.0;
    for row in 0..N {
        // Rounding differs between the triangles; without the mean of both the difference would
        // grow from step to step, and the factorisations, which read one triangle, would not see
        // it.
        for column in 0..row {
            let value = (entries[row][column] + entries[column][row]) * 0.5;
            (entries[row][column], entries[column][row]) = (value, value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix1, Matrix1x2, Matrix2, Vector1, Vector2};

    fn prior() -> Gaussian<2> {
        Gaussian { mean: Vector2::new(1.0, 2.0), covariance: Matrix2::new(2.0, 1.0, 1.0, 3.0) }
    }

    #[test]
    fn predict_agrees_with_a_calculation_by_hand() {
        let F = Matrix2::new(1.0, 0.5, 0.0, 1.0);
        let Q = Matrix2::new(0.1, 0.0, 0.0, 0.2);
        let after = predict(&prior(), &F, &Q);
        assert_eq!(after.mean, Vector2::new(2.0, 2.0));
        // [2 + 2*0.5*1 + 0.25*3 + 0.1, 1 + 0.5*3; ., 3 + 0.2]
        let expected = Matrix2::new(3.85, 2.5, 2.5, 3.2);
        assert!((after.covariance - expected).abs().max() < 1e-15);
    }

    #[test]
    fn update_agrees_with_a_calculation_by_hand() -> Result<(), Error> {
        let model =
            Linearised { y: Vector1::new(3.0), H: Matrix1x2::new(1.0, 0.0), R: Matrix1::new(2.0) };
        let update = update(&prior(), &model)?; // S = 4, K = [1/2, 1/4]
        assert_eq!(update.posterior.mean, Vector2::new(2.5, 2.75));
        assert_eq!(update.posterior.covariance, Matrix2::new(1.0, 0.5, 0.5, 2.75));
        assert_eq!(update.nis, 2.25);
        assert!((update.log_determinant - libm::log(4.0)).abs() < 1e-15);
        Ok(())
    }

    #[test]
    fn a_singular_innovation_covariance_is_refused() {
        for S in [0.0, -1.0, f64::NAN] {
            let model = Linearised {
                y: Vector1::new(1.0),
                H: Matrix1x2::new(0.0, 0.0),
                R: Matrix1::new(S),
            };
            assert!(matches!(
                update(&prior(), &model),
                Err(Error::NotPositiveDefinite { matrix: "S" })
            ));
        }
    }

    #[test]
    fn mahalanobis_agrees_with_a_calculation_by_hand() -> Result<(), Error> {
        let distance = mahalanobis(&Vector2::new(2.0, 3.0), &Matrix2::new(4.0, 0.0, 0.0, 9.0))?;
        assert!((distance.squared - 2.0).abs() < 1e-15);
        assert!((distance.log_determinant - libm::log(36.0)).abs() < 1e-15);
        Ok(())
    }
}
