//! A point mass whose acceleration wanders: eqs 24-31.

#![allow(non_snake_case)] // textbook letters

use super::parameters::{NoiseForm, ProcessNoise, Radius, RadiusForm};
use crate::estimation::kalman::{Gaussian, symmetrised};
use nalgebra::{Matrix3, SMatrix};

pub(super) type Matrix9 = SMatrix<f64, 9, 9>;
pub(super) type Matrix3x9 = SMatrix<f64, 3, 9>;

/// `prior` after `dt` seconds; a negative `dt` looks back, with the same growth of uncertainty.
pub(super) fn predict(prior: &Gaussian<9>, dt: f64, noise: &ProcessNoise) -> Gaussian<9> {
    Gaussian {
        mean: transition(dt) * prior.mean,
        covariance: predict_covariance(&prior.covariance, dt, noise),
    }
}

/// Covariance of [`predict`].
pub(super) fn predict_covariance(P: &Matrix9, dt: f64, noise: &ProcessNoise) -> Matrix9 {
    let (A, Q) = (transition(dt), process_covariance(dt.abs(), noise));
    symmetrised(if dt < 0.0 { A * (P + Q) * A.transpose() } else { A * P * A.transpose() + Q })
}

/// Measurement matrix. Source: Vrba et al., eq. 30.
pub(super) fn position_matrix() -> Matrix3x9 {
    Matrix3x9::identity()
}

/// Block of the position.
pub(super) fn position_block(P: &Matrix9) -> Matrix3<f64> {
    P.fixed_view::<3, 3>(0, 0).into_owned()
}

/// Uncertainty radius of a track [m], before it is bounded from above.
///
/// # Source
/// Vrba et al., eq. 26; the sixth root makes a length of the determinant [m^6].
pub(super) fn radius(P: &Matrix9, parameters: &Radius) -> f64 {
    let cube_root = libm::cbrt(position_block(P).determinant().max(0.0));
    let spread = match parameters.form {
        RadiusForm::Paper => cube_root,
        RadiusForm::SixthRoot => cube_root.sqrt(),
    };
    parameters.min.max(parameters.scale * spread)
}

/// Source: Vrba et al., eq. 27.
fn transition(dt: f64) -> Matrix9 {
    let mut A = Matrix9::identity();
    for axis in 0..3 {
        A[(axis, axis + 3)] = dt;
        A[(axis, axis + 6)] = dt * dt / 2.0;
        A[(axis + 3, axis + 6)] = dt;
    }
    A
}

/// Process noise of a step of `dt` >= 0 seconds.
///
/// # Source
/// Vrba et al., eq. 31, or the integral of A(t) diag(q) A(t)' over the step.
fn process_covariance(dt: f64, noise: &ProcessNoise) -> Matrix9 {
    let [r, v, a] = noise.std.map(|std| std * std);
    let blocks = match noise.form {
        NoiseForm::Paper if dt == 0.0 => [0.0; 6],
        NoiseForm::Paper => [r, 0.0, 0.0, v, 0.0, a],
        NoiseForm::Continuous => {
            let (t2, t3) = (dt * dt, dt * dt * dt);
            [
                r * dt + v * t3 / 3.0 + a * t3 * t2 / 20.0,
                v * t2 / 2.0 + a * t2 * t2 / 8.0,
                a * t3 / 6.0,
                v * dt + a * t3 / 3.0,
                a * t2 / 2.0,
                a * dt,
            ]
        }
    };
    let mut Q = Matrix9::zeros();
    for axis in 0..3 {
        let places = [(0, 0), (0, 3), (0, 6), (3, 3), (3, 6), (6, 6)];
        for ((row, column), value) in places.into_iter().zip(blocks) {
            Q[(row + axis, column + axis)] = value;
            Q[(column + axis, row + axis)] = value;
        }
    }
    Q
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::SVector;

    fn state() -> Gaussian<9> {
        Gaussian {
            mean: SVector::from_fn(|row, _| row as f64 - 3.5),
            covariance: Matrix9::from_diagonal(&SVector::from_fn(|row, _| 1.0 + row as f64)),
        }
    }

    const CONTINUOUS: ProcessNoise =
        ProcessNoise { form: NoiseForm::Continuous, std: [0.5, 0.7, 2.0] };
    const PAPER: ProcessNoise = ProcessNoise { form: NoiseForm::Paper, std: [0.5, 0.5, 0.1] };
    /// Rounding of eleven matrix products.
    const TOLERANCE: f64 = 1e-12;

    #[test]
    fn one_step_equals_ten_steps_of_a_tenth() {
        let once = predict(&state(), 0.1, &CONTINUOUS);
        let ten = (0..10).fold(state(), |state, _| predict(&state, 0.01, &CONTINUOUS));
        assert!((once.mean - ten.mean).amax() < TOLERANCE);
        assert!((once.covariance - ten.covariance).amax() < TOLERANCE);
        assert_eq!(ten.covariance, ten.covariance.transpose());
    }

    #[test]
    fn continuous_noise_matches_table_ii_at_ten_hertz() {
        let root = 0.1_f64.sqrt(); // q = Xi^2 / 0.1 s
        let noise =
            ProcessNoise { form: NoiseForm::Continuous, std: PAPER.std.map(|std| std / root) };
        let (got, paper) = (process_covariance(0.1, &noise), process_covariance(0.1, &PAPER));
        for index in 0..9 {
            assert!((got[(index, index)] / paper[(index, index)] - 1.0).abs() < 0.1);
        }
    }

    #[test]
    fn looking_back_undoes_the_mean_and_adds_uncertainty() {
        let back = predict(&predict(&state(), 0.5, &CONTINUOUS), -0.5, &CONTINUOUS);
        assert!((back.mean - state().mean).amax() < TOLERANCE);
        assert!((back.covariance - state().covariance).diagonal().min() > 0.0);
        assert!(back.covariance.cholesky().is_some());
    }

    #[test]
    fn the_paper_adds_its_noise_once_per_step_but_none_without_time() {
        let after = predict(&state(), 1e-9, &PAPER);
        assert!((after.covariance[(0, 0)] - 1.25).abs() < 1e-6);
        assert_eq!(predict(&state(), 0.0, &PAPER), state());
    }

    #[test]
    fn radius_of_an_isotropic_covariance() {
        let P = Matrix9::identity() * 16.0;
        let radius_of = |form| radius(&P, &Radius { form, scale: 0.5, min: 1.5, max: 3.0 });
        assert!((radius_of(RadiusForm::Paper) - 8.0).abs() < TOLERANCE);
        assert!((radius_of(RadiusForm::SixthRoot) - 2.0).abs() < TOLERANCE);
        let small = radius(
            &Matrix9::identity(),
            &Radius { form: RadiusForm::Paper, scale: 0.5, min: 1.5, max: 3.0 },
        );
        assert_eq!(small, 1.5);
    }
}
