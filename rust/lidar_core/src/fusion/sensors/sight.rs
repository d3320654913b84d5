//! Interface of measurements for filters: expected values of a state, and their deviation.

#![allow(non_snake_case)] // textbook letters

use super::measurement::Measurement;
use super::sensing::Sensing;
use super::told_pose::TellPose;
use crate::fusion::models::motion::{First, Motion};
use crate::fusion::models::platform::Platform;
use crate::fusion::models::world::World;
use nalgebra::{SMatrix, SVector};

/// K measured values, and their model near the state for which it was made.
pub trait SeenValues<const N: usize, const K: usize> {
    /// Measured values.
    fn measured(&self) -> SVector<f64, K>;
    /// Values that the sensor is expected to measure of `s`.
    fn expected(&self, s: &SVector<f64, N>) -> SVector<f64, K>;
    /// Values that are expected for the state for which the model was made, and their Jacobian.
    fn linear(&self) -> (SVector<f64, K>, SMatrix<f64, K, N>);
    /// Difference of two measurements, angles wrapped.
    fn minus(&self, a: &SVector<f64, K>, b: &SVector<f64, K>) -> SVector<f64, K>;
    /// Covariance of the errors, those of the platform's pose included.
    fn noise(&self) -> SMatrix<f64, K, K>;
}

/// Computation with the values of a measurement, for any number of values.
pub trait Observer<const N: usize> {
    /// Result of the computation.
    type Output;
    /// Compute with the values `seen`.
    fn observe<const K: usize, V: SeenValues<N, K>>(self, seen: &V) -> Self::Output;
}

/// Plane or space, as sensors see it.
pub trait Sights: World + TellPose {
    /// First position of a target from a measurement, in the world if the pose of the platform is
    /// known; None for a measurement without a position. With `with_noise` its covariance is that
    /// of the measurement.
    fn first_sight(
        m: &Measurement,
        sensing: &Sensing,
        platform: &Platform,
        with_noise: bool,
    ) -> Option<First>;
}

/// Plane or space, in which sensors see a target that moves by M.
pub trait SeenIn<const N: usize, M>: Sights {
    /// Let `observer` process a measurement near the state `s`; None if it contains no information
    /// about the state.
    fn see<T: Observer<N>>(
        motion: &M,
        s: &SVector<f64, N>,
        m: &Measurement,
        sensing: &Sensing,
        platform: &Platform,
        observer: T,
    ) -> Option<T::Output>;
}

/// A motion that sensors see.
pub trait SeenMotion<const N: usize>: Motion<N, World: SeenIn<N, Self>> {}

impl<const N: usize, M: Motion<N, World: SeenIn<N, M>>> SeenMotion<N> for M {}

/// K chosen values of a measurement of P values.
struct ChosenValues<'a, const P: usize, const K: usize, V> {
    whole: &'a V,
    rows: [usize; K],
}

impl<const P: usize, const K: usize, V> ChosenValues<'_, P, K, V> {
    fn chosen(&self, all: &SVector<f64, P>) -> SVector<f64, K> {
        SVector::from_fn(|k, _| all[self.rows[k]])
    }

    fn filled(&self, part: &SVector<f64, K>) -> SVector<f64, P> {
        let mut all = SVector::zeros();
        self.rows.iter().zip(part.iter()).for_each(|(row, value)| all[*row] = *value);
        all
    }
}

impl<const N: usize, const P: usize, const K: usize, V: SeenValues<N, P>> SeenValues<N, K>
    for ChosenValues<'_, P, K, V>
{
    fn measured(&self) -> SVector<f64, K> {
        self.chosen(&self.whole.measured())
    }

    fn expected(&self, s: &SVector<f64, N>) -> SVector<f64, K> {
        self.chosen(&self.whole.expected(s))
    }

    fn linear(&self) -> (SVector<f64, K>, SMatrix<f64, K, N>) {
        let (expected, J) = self.whole.linear();
        (self.chosen(&expected), SMatrix::from_fn(|k, column| J[(self.rows[k], column)]))
    }

    fn minus(&self, a: &SVector<f64, K>, b: &SVector<f64, K>) -> SVector<f64, K> {
        self.chosen(&self.whole.minus(&self.filled(a), &self.filled(b)))
    }

    fn noise(&self) -> SMatrix<f64, K, K> {
        let R = self.whole.noise();
        SMatrix::from_fn(|row, column| R[(self.rows[row], self.rows[column])])
    }
}

/// Let `observer` compute with the values of `whole` in `rows`, one to three of them; None for
/// another number.
pub(super) fn observe_part<const N: usize, const P: usize, V: SeenValues<N, P>, T: Observer<N>>(
    whole: &V,
    rows: &[usize],
    observer: T,
) -> Option<T::Output> {
    match *rows {
        [a] => Some(observer.observe(&ChosenValues::<P, 1, V> { whole, rows: [a] })),
        [a, b] => Some(observer.observe(&ChosenValues::<P, 2, V> { whole, rows: [a, b] })),
        [a, b, c] => Some(observer.observe(&ChosenValues::<P, 3, V> { whole, rows: [a, b, c] })),
        _ => None,
    }
}
