//! Motion of a point mass with random acceleration: eqs 24-31.

#![allow(non_snake_case)] // textbook letters

use super::parameters::{Motion, NoiseForm, Radius, RadiusForm};
use crate::estimation::kalman::{Gaussian, symmetrised};
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Below this ratio of time to time constant, a series replaces a difference of nearly equal
/// numbers.
const SMALL: f64 = 1e-4;
/// Below this ratio of time to time constant, the closed form of the noise loses digits.
const CANCELS: f64 = 0.5;
/// Nodes and weights of the Gauss-Legendre quadrature on [-1, 1].
const GAUSS_LEGENDRE: [(f64, f64); 5] = [
    (-0.906_179_845_938_664, 0.236_926_885_056_189_08),
    (-0.538_469_310_105_683_1, 0.478_628_670_499_366_47),
    (0.0, 0.568_888_888_888_888_9),
    (0.538_469_310_105_683_1, 0.478_628_670_499_366_47),
    (0.906_179_845_938_664, 0.236_926_885_056_189_08),
];

pub(super) type Matrix9 = SMatrix<f64, 9, 9>;
pub(super) type Matrix3x9 = SMatrix<f64, 3, 9>;

/// State `prior` predicted by `dt` seconds. A negative `dt` predicts backwards, with the same
/// growth of uncertainty.
pub(super) fn predict(prior: &Gaussian<9>, dt: f64, motion: &Motion) -> Gaussian<9> {
    Gaussian {
        mean: transition(dt, motion) * prior.mean,
        covariance: predict_covariance(&prior.covariance, dt, motion),
    }
}

/// Covariance of the state that [`predict`] returns.
pub(super) fn predict_covariance(P: &Matrix9, dt: f64, motion: &Motion) -> Matrix9 {
    let (A, Q) = (transition(dt, motion), process_covariance(dt.abs(), motion));
    symmetrised(if dt < 0.0 { A * (P + Q) * A.transpose() } else { A * P * A.transpose() + Q })
}

/// Measurement matrix of a position `delay` seconds after the state's time: eq. 30 for none, else
/// the upper rows of eq. 27.
pub(super) fn position_matrix(delay: f64) -> Matrix3x9 {
    let mut H = Matrix3x9::identity();
    for axis in 0..3 {
        H[(axis, axis + 3)] = delay;
        H[(axis, axis + 6)] = 0.5 * delay * delay;
    }
    H
}

/// Position of a state [m].
pub(super) fn position(state: &Gaussian<9>) -> Vector3<f64> {
    state.mean.fixed_rows::<3>(0).into_owned()
}

/// Covariance of the position [m^2]: the upper left block of the state's covariance.
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

/// State transition matrix for `dt` seconds. If the acceleration fades, a prediction backwards
/// keeps it constant: the inverse of the decay would let it grow without bounds.
///
/// # Source
/// Vrba et al., eq. 27; with decay: Singer, "Estimating optimal tracking filter performance for
/// manned maneuvering targets", IEEE T-AES 6(4), 1970.
fn transition(dt: f64, motion: &Motion) -> Matrix9 {
    let [to_position, to_velocity, kept] = match motion.acceleration_time {
        Some(time) if dt > 0.0 => faded(dt, time),
        _ => [dt * dt / 2.0, dt, 1.0],
    };
    let mut A = Matrix9::identity();
    for axis in 0..3 {
        A[(axis, axis + 3)] = dt;
        A[(axis, axis + 6)] = to_position;
        A[(axis + 3, axis + 6)] = to_velocity;
        A[(axis + 6, axis + 6)] = kept;
    }
    A
}

/// Position, velocity and acceleration after `dt` seconds that a unit of acceleration causes. The
/// acceleration fades with time constant `time` [s].
fn faded(dt: f64, time: f64) -> [f64; 3] {
    let x = dt / time;
    let lost = -libm::expm1(-x); // 1 - exp(-x)
    let to_position = if x < SMALL {
        dt * dt / 2.0 * (1.0 - x / 3.0 + x * x / 12.0)
    } else {
        time * time * (x - lost)
    };
    [to_position, time * lost, 1.0 - lost]
}

/// Process noise of a step of `dt` >= 0 seconds.
///
/// # Source
/// Vrba et al., eq. 31, or the integral of A(t) diag(q) A(t)' over the step.
fn process_covariance(dt: f64, motion: &Motion) -> Matrix9 {
    let [r, v, a] = motion.std.map(|std| std * std);
    let blocks = match motion.form {
        NoiseForm::Paper if dt == 0.0 => [0.0; 6],
        NoiseForm::Paper => [r, 0.0, 0.0, v, 0.0, a],
        NoiseForm::Continuous | NoiseForm::Adaptive => {
            let of_acceleration = match motion.acceleration_time {
                Some(time) => faded_noise(dt, time),
                None => wandering_noise(dt),
            };
            let mut blocks = of_acceleration.map(|value| a * value);
            blocks[0] += r * dt + v * dt * dt * dt / 3.0;
            blocks[1] += v * dt * dt / 2.0;
            blocks[3] += v * dt;
            blocks
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

/// Blocks rr, rv, ra, vv, va, aa of the process noise after `dt` seconds, for white noise of unit
/// density on the derivative of the acceleration.
fn wandering_noise(dt: f64) -> [f64; 6] {
    let (t2, t3) = (dt * dt, dt * dt * dt);
    [t3 * t2 / 20.0, t2 * t2 / 8.0, t3 / 6.0, t3 / 3.0, t2 / 2.0, dt]
}

/// Like [`wandering_noise`], but the acceleration fades with time constant `time` [s]: Singer's
/// closed form, or the integral by five Gauss-Legendre nodes where the closed form loses digits.
fn faded_noise(dt: f64, time: f64) -> [f64; 6] {
    let x = dt / time;
    if x < CANCELS {
        let mut blocks = [0.0; 6];
        for (node, weight) in GAUSS_LEGENDRE {
            let [r, v, a] = faded(dt * (1.0 + node) / 2.0, time);
            let products = [r * r, r * v, r * a, v * v, v * a, a * a];
            for (block, product) in blocks.iter_mut().zip(products) {
                *block += weight * dt / 2.0 * product;
            }
        }
        return blocks;
    }
    let (once, twice) = (libm::exp(-x), libm::exp(-2.0 * x));
    let half = [time / 2.0, time * time / 2.0, time * time * time / 2.0];
    [
        half[2]
            * time
            * time
            * (1.0 - twice + 2.0 * x + 2.0 * x * x * x / 3.0 - 2.0 * x * x - 4.0 * x * once),
        half[2] * time * (twice + 1.0 - 2.0 * once + 2.0 * x * once - 2.0 * x + x * x),
        half[2] * (1.0 - twice - 2.0 * x * once),
        half[2] * (4.0 * once - 3.0 - twice + 2.0 * x),
        half[1] * (twice + 1.0 - 2.0 * once),
        half[0] * (1.0 - twice),
    ]
}

/// Seconds from `start_ns` to `end_ns`.
pub(super) fn seconds(start_ns: i64, end_ns: i64) -> f64 {
    (i128::from(end_ns) - i128::from(start_ns)) as f64 * 1e-9
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

    const CONTINUOUS: Motion = Motion {
        form: NoiseForm::Continuous,
        std: [0.5, 0.7, 2.0],
        acceleration_time: None,
        unseen_time: None,
    };
    const FADING: Motion = Motion { acceleration_time: Some(0.8), ..CONTINUOUS };
    const PAPER: Motion = Motion {
        form: NoiseForm::Paper,
        std: [0.5, 0.5, 0.1],
        acceleration_time: None,
        unseen_time: None,
    };
    /// Rounding of eleven matrix products.
    const TOLERANCE: f64 = 1e-12;

    #[test]
    fn one_step_equals_ten_steps_of_a_tenth() {
        for (motion, dt) in [(CONTINUOUS, 0.1), (FADING, 0.1), (FADING, 1e-4), (FADING, 7.0)] {
            let once = predict(&state(), dt, &motion);
            let ten = (0..10).fold(state(), |state, _| predict(&state, dt / 10.0, &motion));
            assert!((once.mean - ten.mean).amax() < TOLERANCE * once.mean.amax());
            let difference = (once.covariance - ten.covariance).amax();
            assert!(difference < TOLERANCE * once.covariance.amax(), "{dt}: {difference}");
            assert_eq!(ten.covariance, ten.covariance.transpose());
        }
    }

    #[test]
    fn a_slow_decay_is_almost_none() {
        let slow = Motion { acceleration_time: Some(1e7), ..CONTINUOUS };
        let (got, expected) = (predict(&state(), 2.0, &slow), predict(&state(), 2.0, &CONTINUOUS));
        assert!((got.mean - expected.mean).amax() < 1e-5);
        assert!((got.covariance - expected.covariance).amax() < 1e-4);
    }

    #[test]
    fn continuous_noise_matches_table_ii_at_ten_hertz() {
        let root = 0.1_f64.sqrt(); // q = Xi^2 / 0.1 s
        let noise = Motion { std: PAPER.std.map(|std| std / root), ..CONTINUOUS };
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
