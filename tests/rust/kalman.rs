//! Properties of the Kalman filter: symmetry, positivity, agreement with batch least squares.

#![allow(non_snake_case)] // textbook letters

use lidar_core::Error;
use lidar_core::estimation::kalman::{Gaussian, Linearised, predict, update};
use nalgebra::{DMatrix, DVector, Matrix3, RowVector3, SMatrix, Vector1, Vector3};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// Smallest eigenvalue allowed, relative to the largest: rounding of the Joseph form.
const EIGENVALUE_TOLERANCE: f64 = 1e-12;
/// Agreement with batch least squares, relative.
const BATCH_TOLERANCE: f64 = 1e-9;
/// Agreement of two orders of independent measurements.
const ORDER_TOLERANCE: f64 = 1e-10;

type Measurement = ([f64; 3], f64, f64); // row of H, measured value, variance

fn measurement() -> impl Strategy<Value = Measurement> {
    (prop::array::uniform3(-2.0..2.0_f64), -10.0..10.0_f64, 0.01..10.0_f64)
}

fn corrected(prior: &Gaussian<3>, (row, z, variance): Measurement) -> Result<Gaussian<3>, Error> {
    let H = RowVector3::from(row);
    let y = Vector1::new(z) - H * prior.mean;
    Ok(update(prior, &Linearised { y, H, R: SMatrix::from([[variance]]) })?.posterior)
}

fn start() -> Gaussian<3> {
    Gaussian { mean: Vector3::new(1.0, -2.0, 0.5), covariance: Matrix3::identity() * 25.0 }
}

/// Weighted least squares over the prior and all measurements at once, by its normal equations.
fn batch(measurements: &[Measurement]) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let prior = start();
    let mut information = DMatrix::identity(3, 3) / 25.0;
    let mut vector = &information * DVector::from_row_slice(prior.mean.as_slice());
    for (row, z, variance) in measurements {
        let h = DVector::from_row_slice(row);
        information += &h * h.transpose() / *variance;
        vector += h * (*z / variance);
    }
    let covariance = information.clone().try_inverse()?;
    Some((information.lu().solve(&vector)?, covariance))
}

/// The same cases on every run.
fn seeded() -> ProptestConfig {
    ProptestConfig {
        cases: 256,
        rng_seed: RngSeed::Fixed(0),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

proptest! {
    #![proptest_config(seeded())]

    #[test]
    fn a_linear_case_equals_batch_least_squares(
        measurements in prop::collection::vec(measurement(), 0..30)
    ) {
        let mut state = start();
        for &measurement in &measurements {
            state = corrected(&state, measurement).map_err(|e| TestCaseError::fail(e.to_string()))?;
        }
        let (mean, covariance) = batch(&measurements)
            .ok_or_else(|| TestCaseError::fail("singular information"))?;
        for row in 0..3 {
            let scale = mean.amax().max(1.0);
            prop_assert!((state.mean[row] - mean[row]).abs() <= BATCH_TOLERANCE * scale);
            for column in 0..3 {
                let difference = state.covariance[(row, column)] - covariance[(row, column)];
                prop_assert!(difference.abs() <= BATCH_TOLERANCE * covariance.amax());
            }
        }
    }

    #[test]
    fn independent_measurements_commute(a in measurement(), b in measurement()) {
        let both = |first, second| corrected(&corrected(&start(), first)?, second);
        let (ab, ba) = match (both(a, b), both(b, a)) {
            (Ok(ab), Ok(ba)) => (ab, ba),
            _ => return Err(TestCaseError::fail("an update was refused")),
        };
        prop_assert!((ab.mean - ba.mean).amax() <= ORDER_TOLERANCE * ab.mean.amax().max(1.0));
        prop_assert!((ab.covariance - ba.covariance).amax() <= ORDER_TOLERANCE * 25.0);
    }

    #[test]
    fn covariance_stays_symmetric_and_positive(
        measurements in prop::collection::vec((measurement(), 0.0..2.0_f64), 1..200),
        log_variance in -14.0..2.0_f64,
    ) {
        let mut state = start();
        for ((row, z, _), dt) in measurements {
            let F = Matrix3::new(1.0, dt, dt * dt / 2.0, 0.0, 1.0, dt, 0.0, 0.0, 1.0);
            state = predict(&state, &F, &(Matrix3::identity() * (1e-6 * dt)));
            state = corrected(&state, (row, z, libm::exp10(log_variance)))
                .map_err(|e| TestCaseError::fail(e.to_string()))?;
            let P = state.covariance;
            prop_assert_eq!(P, P.transpose());
            let eigenvalues = P.symmetric_eigenvalues();
            prop_assert!(eigenvalues.min() >= -EIGENVALUE_TOLERANCE * eigenvalues.max());
        }
    }
}
