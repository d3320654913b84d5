//! Plane and space: the forms of a state that all models of one of them share.

use crate::estimation::kalman::Gaussian;
use nalgebra::{SMatrix, SVector};
use std::fmt::Debug;

/// World in which targets move, plane or space: the forms of a state that its models share.
pub trait World: Clone + Copy + Debug + Send + Sync + 'static {
    /// Distribution of position and velocity.
    type Cv: Clone + Debug + Send + Sync + 'static;
    /// Distribution of position, velocity and acceleration: the form that models exchange.
    type Wide: Clone + Debug + Send + Sync + 'static;

    /// State of `cv` extended by an acceleration, which is zero.
    fn widened(cv: &Self::Cv) -> Self::Wide;
}

/// The plane, with the states [x, y, vx, vy] and [x, y, vx, vy, ax, ay].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plane;

/// Space, with the states [x, y, z, vx, vy, vz] and [x, y, z, vx, vy, vz, ax, ay, az].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Space;

impl World for Plane {
    type Cv = Gaussian<4>;
    type Wide = Gaussian<6>;

    fn widened(cv: &Gaussian<4>) -> Gaussian<6> {
        extended(cv, &[])
    }
}

impl World for Space {
    type Cv = Gaussian<6>;
    type Wide = Gaussian<9>;

    fn widened(cv: &Gaussian<6>) -> Gaussian<9> {
        extended(cv, &[])
    }
}

/// `start` extended by states with mean zero and the given variances; zero for those that are not
/// given.
pub(crate) fn extended<const S: usize, const N: usize>(
    start: &Gaussian<S>,
    variances: &[f64],
) -> Gaussian<N> {
    let (mut mean, mut covariance) = (SVector::<f64, N>::zeros(), SMatrix::<f64, N, N>::zeros());
    mean.fixed_rows_mut::<S>(0).copy_from(&start.mean);
    covariance.fixed_view_mut::<S, S>(0, 0).copy_from(&start.covariance);
    for (index, variance) in variances.iter().enumerate() {
        covariance[(S + index, S + index)] = *variance;
    }
    Gaussian { mean, covariance }
}
