//! Measurements of elements, and first states of new elements.

#![allow(non_snake_case)] // textbook letters

use super::element_motion::{Square, transition};
use crate::estimation::kalman::{Gaussian, Linearised, symmetrised};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use serde::{Deserialize, Serialize};

/// A measurement of M values of a state of N values: centre x and y, their velocities, then the
/// values of a random walk.
pub(super) trait Measures<const N: usize, const M: usize> {
    /// Linearised measurement at a state.
    fn against(&self, state: &SVector<f64, N>) -> Linearised<N, M>;
}

/// A measured circle in the world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct CircleMeasurement {
    /// Centre and radius [m].
    pub(super) z: Vector3<f64>,
    /// Covariance of the measured values.
    pub(super) R: Matrix3<f64>,
    /// Time of the measurement after the stamp of the scan [s].
    pub(super) delay: f64,
}

impl Measures<5, 3> for CircleMeasurement {
    fn against(&self, state: &SVector<f64, 5>) -> Linearised<5, 3> {
        let H = centre_matrix(self.delay);
        Linearised { y: self.z - H * state, H, R: self.R }
    }
}

/// Measurement matrix of the centre and of all random walks: eqs 16-17 in the world, for a centre
/// that moves for `delay` seconds between the stamp and the measurement.
pub(super) fn centre_matrix<const N: usize, const M: usize>(delay: f64) -> SMatrix<f64, M, N> {
    let mut H = SMatrix::<f64, M, N>::zeros();
    for axis in 0..2 {
        H[(axis, axis)] = 1.0;
        H[(axis, axis + 2)] = delay;
    }
    for (row, column) in (2..M).zip(4..N) {
        H[(row, column)] = 1.0;
    }
    H
}

/// State of eqs 18-20: a circle at rest; `speed` is the standard deviation of its velocity [m/s].
pub(super) fn new_state(measurement: &CircleMeasurement, speed: f64) -> Gaussian<5> {
    at_rest(measurement.z, measurement.R, measurement.delay, speed)
}

/// State of an object measured for the first time: at rest; `speed` is the standard deviation of
/// its velocity [m/s].
pub(super) fn at_rest<const N: usize, const M: usize>(
    z: SVector<f64, M>,
    R: Square<M>,
    delay: f64,
    speed: f64,
) -> Gaussian<N> {
    let H = centre_matrix::<N, M>(0.0);
    let mut covariance = H.transpose() * R * H;
    covariance[(2, 2)] = speed * speed;
    covariance[(3, 3)] = speed * speed;
    let back = transition(-delay); // the measurement is later than the stamp of the scan
    let covariance = symmetrised(back * covariance * back.transpose());
    Gaussian { mean: H.transpose() * z, covariance }
}
