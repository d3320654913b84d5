//! Conversion of states between models, through position, velocity and acceleration.

#![allow(non_snake_case)] // textbook letters

use super::cartesian::{ConstantAcceleration, ConstantVelocity, CoordinatedTurn};
use super::heading::{Ctra, Ctrv};
use super::motion::Motion;
use super::turn::direction;
use crate::estimation::kalman::{Gaussian, symmetrised};
use nalgebra::{Matrix2, Matrix6, SMatrix, SVector, Vector2, Vector4, Vector5, Vector6};

/// Least speed that is divided by [m/s].
const SLOWEST: f64 = 0.1;
/// Variance of an unknown heading [rad^2].
const ANY_HEADING: f64 = 4.0;
/// Variance of an unknown turn rate [rad^2/s^2].
const ANY_RATE: f64 = 4.0;

/// A model that can convert its state to and from the form [x, y, vx, vy, ax, ay].
pub trait Exchange<const N: usize>: Motion<N> {
    /// State in Cartesian form; states that the model does not have are taken from `other`.
    fn cartesian(&self, state: &Gaussian<N>, other: Option<&Gaussian<6>>) -> Gaussian<6>;

    /// State of this model that corresponds to `cartesian`.
    fn adopted(&self, cartesian: &Gaussian<6>) -> Gaussian<N>;
}

impl Exchange<4> for ConstantVelocity {
    fn cartesian(&self, state: &Gaussian<4>, other: Option<&Gaussian<6>>) -> Gaussian<6> {
        let (mut mean, mut covariance) = (Vector6::zeros(), Matrix6::zeros());
        mean.fixed_rows_mut::<4>(0).copy_from(&state.mean);
        covariance.fixed_view_mut::<4, 4>(0, 0).copy_from(&state.covariance);
        if let Some(other) = other {
            // Only the block on the diagonal is copied: correlations of two different models would
            // not fit together, and the matrix could become indefinite.
            mean.fixed_rows_mut::<2>(4).copy_from(&other.mean.fixed_rows::<2>(4));
            let known = other.covariance.fixed_view::<2, 2>(4, 4);
            covariance.fixed_view_mut::<2, 2>(4, 4).copy_from(&known);
        }
        Gaussian { mean, covariance }
    }

    fn adopted(&self, cartesian: &Gaussian<6>) -> Gaussian<4> {
        Gaussian {
            mean: cartesian.mean.fixed_rows::<4>(0).into(),
            covariance: cartesian.covariance.fixed_view::<4, 4>(0, 0).into(),
        }
    }
}

impl Exchange<6> for ConstantAcceleration {
    fn cartesian(&self, state: &Gaussian<6>, _: Option<&Gaussian<6>>) -> Gaussian<6> {
        state.clone()
    }

    fn adopted(&self, cartesian: &Gaussian<6>) -> Gaussian<6> {
        cartesian.clone()
    }
}

impl Exchange<5> for CoordinatedTurn {
    fn cartesian(&self, state: &Gaussian<5>, _: Option<&Gaussian<6>>) -> Gaussian<6> {
        let [x, y, vx, vy, w] = state.mean.data.0[0];
        let mut J = SMatrix::<f64, 6, 5>::zeros();
        J.fixed_view_mut::<4, 4>(0, 0).fill_with_identity();
        (J[(4, 3)], J[(5, 2)]) = (-w, w);
        (J[(4, 4)], J[(5, 4)]) = (-vy, vx);
        through(&state.covariance, &J, Vector6::new(x, y, vx, vy, -w * vy, w * vx))
    }

    fn adopted(&self, cartesian: &Gaussian<6>) -> Gaussian<5> {
        let [x, y, vx, vy, _, _] = cartesian.mean.data.0[0];
        let (rate, row) = turn_rate(&cartesian.mean);
        let mut J = SMatrix::<f64, 5, 6>::zeros();
        J.fixed_view_mut::<4, 4>(0, 0).fill_with_identity();
        J.set_row(4, &row.transpose());
        let mean = Vector5::new(x, y, vx, vy, rate);
        capped(through(&cartesian.covariance, &J, mean), 4, ANY_RATE)
    }
}

/// Turn rate of a velocity under an acceleration, and its derivatives by the Cartesian state.
fn turn_rate(s: &Vector6<f64>) -> (f64, Vector6<f64>) {
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
fn along(s: &Vector6<f64>) -> (Vector4<f64>, SMatrix<f64, 4, 6>) {
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
fn spread<const N: usize>(state: &Gaussian<N>) -> Gaussian<6> {
    let s = &state.mean;
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
    let mean = Vector6::new(s[0], s[1], velocity.x, velocity.y, force.x, force.y);
    through(&state.covariance, &J, mean)
}

impl Exchange<5> for Ctrv {
    fn cartesian(&self, state: &Gaussian<5>, _: Option<&Gaussian<6>>) -> Gaussian<6> {
        spread(state)
    }

    fn adopted(&self, cartesian: &Gaussian<6>) -> Gaussian<5> {
        let (values, part) = along(&cartesian.mean);
        let m = &cartesian.mean;
        let mut J = SMatrix::<f64, 5, 6>::zeros();
        (J[(0, 0)], J[(1, 1)]) = (1.0, 1.0);
        J.fixed_view_mut::<3, 6>(2, 0).copy_from(&part.fixed_rows::<3>(0));
        let mean = Vector5::new(m[0], m[1], values[0], values[1], values[2]);
        let state = through(&cartesian.covariance, &J, mean);
        capped(capped(state, 3, ANY_HEADING), 4, ANY_RATE)
    }
}

impl Exchange<6> for Ctra {
    fn cartesian(&self, state: &Gaussian<6>, _: Option<&Gaussian<6>>) -> Gaussian<6> {
        spread(state)
    }

    fn adopted(&self, cartesian: &Gaussian<6>) -> Gaussian<6> {
        let (values, part) = along(&cartesian.mean);
        let m = &cartesian.mean;
        let mut J = Matrix6::zeros();
        (J[(0, 0)], J[(1, 1)]) = (1.0, 1.0);
        J.fixed_view_mut::<4, 6>(2, 0).copy_from(&part);
        let mean = Vector6::new(m[0], m[1], values[0], values[1], values[2], values[3]);
        let state = through(&cartesian.covariance, &J, mean);
        capped(capped(state, 3, ANY_HEADING), 4, ANY_RATE)
    }
}

fn through<const A: usize, const B: usize>(
    P: &SMatrix<f64, A, A>,
    J: &SMatrix<f64, B, A>,
    mean: SVector<f64, B>,
) -> Gaussian<B> {
    Gaussian { mean, covariance: symmetrised(J * P * J.transpose()) }
}

/// Limit the variance of state `index` to `most`. Scaling row and column alike keeps the matrix
/// positive semidefinite.
fn capped<const N: usize>(mut state: Gaussian<N>, index: usize, most: f64) -> Gaussian<N> {
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
    use crate::fusion::models::motion::tests::difference;

    fn there_and_back<const N: usize, M: Exchange<N>>(motion: &M, mean: SVector<f64, N>) {
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
