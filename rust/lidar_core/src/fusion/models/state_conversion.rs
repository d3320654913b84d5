//! Conversion of states between models, through position, velocity and acceleration.

#![allow(non_snake_case)] // textbook letters

use super::motion::{Motion, Prior};
use super::turn::direction;
use super::world::World;
use crate::estimation::kalman::{Gaussian, symmetrised};
use nalgebra::{Matrix2, SMatrix, SVector, Vector2, Vector4, Vector6};

/// Least speed by which the derivatives are divided [m/s].
const SLOWEST: f64 = 0.1;
/// Variance of an unknown heading [rad^2].
pub(super) const ANY_HEADING: f64 = 4.0;
/// Variance of an unknown turn rate [rad^2/s^2].
pub(super) const ANY_RATE: f64 = 4.0;

/// Position, velocity and acceleration in the world of a motion.
pub type WideOf<M, const N: usize> = <<M as Motion<N>>::World as World>::Wide;

/// A model that can convert its state to and from position, velocity and acceleration.
pub trait StateConversion<const N: usize>: Motion<N> {
    /// Mean time for which a target follows this model [s]; None: the time of the filter.
    const SOJOURN: Option<f64> = None;
    /// How often a new target follows this model, relative to the others.
    const OF_NEW: f64 = 1.0;

    /// State in Cartesian form; states that the model does not have are taken from `other`.
    fn cartesian(&self, state: &Gaussian<N>, other: Option<&WideOf<Self, N>>) -> WideOf<Self, N>;

    /// How much a target in this state tends to this model when it leaves another one,
    /// relative to the others.
    fn tendency(&self, _at: &WideOf<Self, N>, _prior: &Prior) -> f64 {
        1.0
    }

    /// State of this model that corresponds to `cartesian`.
    fn adopted(&self, cartesian: &WideOf<Self, N>) -> Gaussian<N>;
}

/// Turn rate of a velocity under an acceleration, and its derivatives by the Cartesian state.
pub(super) fn turn_rate(s: &Vector6<f64>) -> (f64, Vector6<f64>) {
    let [_, _, vx, vy, ax, ay] = s.data.0[0];
    // At rest the turn rate is undefined; the limit keeps it and its derivatives finite.
    let square = (vx * vx + vy * vy).max(SLOWEST * SLOWEST);
    let rate = (vx * ay - vy * ax) / square;
    let by_speed = |part: f64| 2.0 * rate * part / square;
    let row = Vector6::new(
        0.0,
        0.0,
        ay / square - by_speed(vx),
        -ax / square - by_speed(vy),
        -vy / square,
        vx / square,
    );
    (rate, row)
}

/// Speed, heading, turn rate and acceleration along the heading, with their Jacobian.
pub(super) fn along(s: &Vector6<f64>) -> (Vector4<f64>, SMatrix<f64, 4, 6>) {
    let [_, _, vx, vy, ax, ay] = s.data.0[0];
    let speed = libm::hypot(vx, vy).max(1e-3);
    let heading = libm::atan2(vy, vx);
    let [c, sine] = direction(heading);
    let (rate, row) = turn_rate(s);
    // The speed itself may become smaller than what is divided by: only the derivatives need a
    // limit.
    let (pull, across, slow) = (ax * c + ay * sine, ay * c - ax * sine, speed.max(SLOWEST));
    let mut J = SMatrix::<f64, 4, 6>::zeros();
    (J[(0, 2)], J[(0, 3)]) = (c, sine);
    (J[(1, 2)], J[(1, 3)]) = (-sine / slow, c / slow);
    J.set_row(2, &row.transpose());
    let bend = across / slow;
    (J[(3, 2)], J[(3, 3)], J[(3, 4)], J[(3, 5)]) = (-bend * sine, bend * c, c, sine);
    (Vector4::new(speed, heading, rate, pull), J)
}

/// Cartesian form of speed, heading, turn rate and (with six states) acceleration.
pub(super) fn spread<const N: usize>(state: &Gaussian<N>) -> Gaussian<6> {
    let (mean, J) = spread_slopes(&state.mean);
    through(&state.covariance, &J, mean)
}

/// Position, velocity and acceleration of a state with speed and heading, and their Jacobian.
pub(super) fn spread_slopes<const N: usize>(
    s: &SVector<f64, N>,
) -> (Vector6<f64>, SMatrix<f64, 6, N>) {
    let (v, w) = (s[2], s[4]);
    let pull = if N > 5 { s[5] } else { 0.0 };
    let [c, sine] = direction(s[3]);
    let turn = Matrix2::new(c, -sine, sine, c);
    // A turn at constant speed is an acceleration of v w to the left.
    let (velocity, force) = (turn * Vector2::new(v, 0.0), turn * Vector2::new(pull, v * w));
    let mut J = SMatrix::<f64, 6, N>::zeros();
    (J[(0, 0)], J[(1, 1)]) = (1.0, 1.0);
    let mut place = |row: usize, column: usize, vector: Vector2<f64>| {
        J.fixed_view_mut::<2, 1>(row, column).copy_from(&vector);
    };
    place(2, 2, turn.column(0).into());
    place(2, 3, turn * Vector2::new(0.0, v));
    place(4, 2, turn * Vector2::new(0.0, w));
    place(4, 3, turn * Vector2::new(-v * w, pull));
    place(4, 4, turn * Vector2::new(0.0, v));
    if N > 5 {
        place(4, 5, turn.column(0).into());
    }
    (Vector6::new(s[0], s[1], velocity.x, velocity.y, force.x, force.y), J)
}

pub(super) fn through<const A: usize, const B: usize>(
    P: &SMatrix<f64, A, A>,
    J: &SMatrix<f64, B, A>,
    mean: SVector<f64, B>,
) -> Gaussian<B> {
    Gaussian { mean, covariance: symmetrised(J * P * J.transpose()) }
}

/// Limit the variance of state `index` to `most`. Scaling row and column alike keeps the matrix
/// positive semidefinite.
pub(super) fn capped<const N: usize>(
    mut state: Gaussian<N>,
    index: usize,
    most: f64,
) -> Gaussian<N> {
    let variance = state.covariance[(index, index)];
    if variance > most {
        let scale = libm::sqrt(most / variance);
        state.covariance.row_mut(index).scale_mut(scale);
        state.covariance.column_mut(index).scale_mut(scale);
    }
    state
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::models::cartesian::{
        ConstantAcceleration, ConstantVelocity, CoordinatedTurn,
    };
    use crate::fusion::models::heading::{Ctra, Ctrv};
    use crate::fusion::models::motion::tests::difference;
    use nalgebra::{Matrix6, Vector5};

    fn there_and_back<const N: usize, const W: usize, M>(motion: &M, mean: SVector<f64, N>)
    where
        M: StateConversion<N>,
        M::World: World<Wide = Gaussian<W>>,
    {
        let covariance = SMatrix::<f64, N, N>::from_fn(|row, column| {
            if row == column { 0.04 } else { 0.002 * (row + column) as f64 }
        });
        let state = Gaussian { mean, covariance };
        let cartesian = motion.cartesian(&state, None);
        let value = |mean: &SVector<f64, N>| {
            motion.cartesian(&Gaussian { mean: *mean, covariance }, None).mean
        };
        let J = difference(&mean, value);
        assert!((cartesian.covariance - J * covariance * J.transpose()).abs().max() < 1e-8);
        let back = motion.adopted(&cartesian);
        assert!((back.mean - mean).abs().max() < 1e-12);
        assert!((back.covariance - covariance).abs().max() < 1e-10, "{}", back.covariance);
    }

    #[test]
    fn states_survive_the_way_there_and_back() {
        there_and_back(&ConstantVelocity, Vector4::new(1.0, 2.0, -3.0, 0.5));
        there_and_back(&ConstantAcceleration, Vector6::new(1.0, 2.0, -3.0, 0.5, 0.2, 0.3));
        there_and_back(&CoordinatedTurn, Vector5::new(1.0, 2.0, -3.0, 0.5, 0.3));
        there_and_back(&Ctrv, Vector5::new(1.0, 2.0, 3.0, 0.5, 0.3));
        there_and_back(&Ctra, Vector6::new(1.0, 2.0, 3.0, 0.5, 0.3, -0.4));
    }

    #[test]
    fn a_target_at_rest_has_any_heading() {
        let cartesian = Gaussian { mean: Vector6::zeros(), covariance: Matrix6::identity() };
        let state = Ctrv.adopted(&cartesian);
        assert!(state.covariance[(3, 3)] <= ANY_HEADING && state.covariance[(4, 4)] <= ANY_RATE);
    }
}
