//! Kalman filter with sizes in types: predict, update (Joseph form), normalised innovation.

#![allow(non_snake_case)] // textbook letters

use crate::Error;
use nalgebra::{Cholesky, Const, SMatrix, SVector};

/// A normal distribution.
#[derive(Clone, Debug, PartialEq)]
pub struct Gaussian<const N: usize> {
    /// Expected value.
    pub mean: SVector<f64, N>,
    /// Covariance, exactly symmetric.
    pub covariance: SMatrix<f64, N, N>,
}

/// A measurement, its model linearised at the mean it is compared with.
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
pub struct Mahalanobis {
    /// y' S^-1 y.
    pub squared: f64,
    /// Natural logarithm of the determinant of S.
    pub log_determinant: f64,
}

/// `prior` after the linear motion `F` with process noise `Q`.
#[must_use]
pub fn predict<const N: usize>(
    prior: &Gaussian<N>,
    F: &SMatrix<f64, N, N>,
    Q: &SMatrix<f64, N, N>,
) -> Gaussian<N> {
    Gaussian {
        mean: F * prior.mean,
        covariance: symmetrised(F * prior.covariance * F.transpose() + Q),
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
    let (P, H, R) = (&prior.covariance, &model.H, &model.R);
    let PHt = P * H.transpose();
    let S_chol = factor(H * PHt + R)?;
    let K = S_chol.solve(&PHt.transpose()).transpose(); // S Kt = H P: solved, never inverted
    let IKH = SMatrix::<f64, N, N>::identity() - K * H;
    let joseph = IKH * P * IKH.transpose() + K * R * K.transpose();
    Ok(Update {
        posterior: Gaussian { mean: prior.mean + K * model.y, covariance: symmetrised(joseph) },
        nis: model.y.dot(&S_chol.solve(&model.y)),
        log_determinant: log_determinant(&S_chol),
    })
}

/// Distance of `y` from zero, whose covariance is `S`.
///
/// # Errors
/// [`Error::NotPositiveDefinite`] if `S` cannot be factorised.
pub fn mahalanobis<const M: usize>(
    y: &SVector<f64, M>,
    S: &SMatrix<f64, M, M>,
) -> Result<Mahalanobis, Error> {
    let S_chol = factor(*S)?;
    Ok(Mahalanobis { squared: y.dot(&S_chol.solve(y)), log_determinant: log_determinant(&S_chol) })
}

/// The mean of a matrix and its transpose: bit for bit symmetric.
#[must_use]
pub fn symmetrised<const N: usize>(matrix: SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    (matrix + matrix.transpose()) * 0.5
}

fn log_determinant<const M: usize>(S_chol: &Cholesky<f64, Const<M>>) -> f64 {
    let lower = S_chol.l_dirty(); // its diagonal is that of the factor
    2.0 * libm::log((0..M).map(|index| lower[(index, index)]).product())
}

fn factor<const M: usize>(S: SMatrix<f64, M, M>) -> Result<Cholesky<f64, Const<M>>, Error> {
    S.cholesky().ok_or(Error::NotPositiveDefinite { matrix: "S" })
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
