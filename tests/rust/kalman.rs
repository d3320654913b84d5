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

/// Steps of the long runs, and steps between two looks at the eigenvalues.
const LONG: u32 = 1_000_000;
const LOOK_EVERY: u32 = 997;

/// A target of constant velocity in space, whose position is measured with this variance [m^2], where
/// `step` says how much time passes [s] and whether it is measured.
fn long_run(
    [start, noise]: [f64; 2],
    step: impl Fn(u32) -> (f64, bool),
) -> Result<Gaussian<6>, Box<dyn std::error::Error>> {
    let covariance = SMatrix::identity() * start;
    let mut state = Gaussian { mean: SMatrix::zeros(), covariance };
    let mut H = SMatrix::<f64, 3, 6>::zeros();
    (0..3).for_each(|axis| H[(axis, axis)] = 1.0);
    let R = SMatrix::identity() * noise;
    for number in 0..LONG {
        let (dt, is_measured) = step(number);
        let (mut F, mut Q) = (SMatrix::<f64, 6, 6>::identity(), SMatrix::<f64, 6, 6>::zeros());
        for axis in 0..3 {
            F[(axis, axis + 3)] = dt;
            Q[(axis, axis)] = dt * dt * dt / 3.0;
            Q[(axis, axis + 3)] = dt * dt / 2.0;
            Q[(axis + 3, axis)] = dt * dt / 2.0;
            Q[(axis + 3, axis + 3)] = dt;
        }
        state = predict(&state, &F, &Q);
        if is_measured {
            let z = Vector3::new(1.0, -2.0, 0.5) * f64::from(number % 13);
            let y = z - H * state.mean;
            state = update(&state, &Linearised { y, H, R })?.posterior;
        }
        let P = &state.covariance;
        if *P != P.transpose() || !state.numbers().iter().all(|value| value.is_finite()) {
            return Err(format!("step {number}: {state:?}").into());
        }
        if number % LOOK_EVERY == 0 || number + 1 == LONG {
            let values = P.symmetric_eigenvalues();
            if values.min() < -EIGENVALUE_TOLERANCE * values.max() {
                return Err(format!("step {number}: eigenvalues {values:?}").into());
            }
        }
    }
    Ok(state)
}

/// Goal G8 of the reliability notes: 1e6 steps, whatever the noise, the pauses and the times are.
#[test]
fn a_million_steps_keep_the_covariance_whole() -> Result<(), Box<dyn std::error::Error>> {
    let usual = long_run([25.0, 1e-2], |_| (0.1, true))?;
    assert!(usual.covariance[(0, 0)] < 1e-2, "it knows more than one measurement tells");
    long_run([1e6, 1e-8], |_| (0.1, true))?;
    long_run([25.0, 1e-2], |number| (0.1, number % 1000 < 10))?;
    long_run([25.0, 1e-2], |number| ([0.0, 1e-6, 10.0][(number % 3) as usize], true))?;
    Ok(())
}
