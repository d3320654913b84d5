//! Models whose velocity is a vector: constant velocity, constant acceleration, coordinated turn.

#![allow(non_snake_case)] // textbook letters

use super::motion::{First, INPUTS, Motion, Noise, PlaneMotion, Prior};
use super::platform::Platform;
use super::state_conversion::{ANY_RATE, StateConversion, capped, through, turn_rate};
use super::turn::{Turn, direction, rotated};
use super::world::{Plane, extended};
use crate::estimation::kalman::Gaussian;
use nalgebra::{Matrix2, Matrix6, SMatrix, SVector, Vector2, Vector4, Vector5, Vector6};

/// Constant velocity, driven by acceleration: [x, y, vx, vy].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConstantVelocity;

/// Constant acceleration, driven by jerk: [x, y, vx, vy, ax, ay].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConstantAcceleration;

/// Constant turn rate of the velocity vector, driven by acceleration and by angular
/// acceleration: [x, y, vx, vy, w].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CoordinatedTurn;

/// State of a target after its first measurement; the velocity across the line of sight is unknown.
fn first_cv(first: &First, prior: &Prior) -> Gaussian<4> {
    let [vx, vy] = direction(first.heading).map(|part| part * first.speed);
    let [x, y, _] = first.position;
    // The variance of the speed belongs to both axes: zero across the line of sight is only the
    // mean of what is not measured.
    let covariance = first.covariance::<4, 2>(prior, &[first.spread(prior); 2]);
    Gaussian { mean: Vector4::new(x, y, vx, vy), covariance }
}

/// Velocity (vx, vy) in states 2 and 3, and its Jacobian.
fn velocity_of<const N: usize>(s: &SVector<f64, N>) -> (Vector2<f64>, SMatrix<f64, 2, N>) {
    let mut J = SMatrix::<f64, 2, N>::zeros();
    (J[(0, 2)], J[(1, 3)]) = (1.0, 1.0);
    (Vector2::new(s[2], s[3]), J)
}

impl Motion<4> for ConstantVelocity {
    type World = Plane;
    const NOISES: [Noise; INPUTS] = [Noise::Acceleration, Noise::Acceleration, Noise::Absent];
    const HEADING: Option<usize> = None;

    fn propagate(&self, s: &Vector4<f64>, dt: f64, _: &Platform) -> Vector4<f64> {
        Vector4::new(s[0] + s[2] * dt, s[1] + s[3] * dt, s[2], s[3])
    }

    fn transition(
        &self,
        s: &Vector4<f64>,
        dt: f64,
        platform: &Platform,
    ) -> (Vector4<f64>, SMatrix<f64, 4, 4>) {
        let mut F = SMatrix::<f64, 4, 4>::identity();
        (F[(0, 2)], F[(1, 3)]) = (dt, dt);
        (self.propagate(s, dt, platform), F)
    }

    fn impulses(&self, _: &Vector4<f64>, dt: f64, _: &Platform) -> SMatrix<f64, 4, INPUTS> {
        let mut columns = SMatrix::<f64, 4, INPUTS>::zeros();
        columns.set_column(0, &Vector4::new(dt, 0.0, 1.0, 0.0));
        columns.set_column(1, &Vector4::new(0.0, dt, 0.0, 1.0));
        columns
    }

    fn step_response(&self, _: &Vector4<f64>, dt: f64) -> SMatrix<f64, 4, INPUTS> {
        let mut columns = SMatrix::<f64, 4, INPUTS>::zeros();
        columns.set_column(0, &Vector4::new(0.5 * dt * dt, 0.0, dt, 0.0));
        columns.set_column(1, &Vector4::new(0.0, 0.5 * dt * dt, 0.0, dt));
        columns
    }

    fn first(&self, first: &First, prior: &Prior) -> Gaussian<4> {
        first_cv(first, prior)
    }
}

impl PlaneMotion<4> for ConstantVelocity {
    fn velocity(&self, s: &Vector4<f64>, _: &Platform) -> (Vector2<f64>, SMatrix<f64, 2, 4>) {
        velocity_of(s)
    }
}

impl Motion<6> for ConstantAcceleration {
    type World = Plane;
    const NOISES: [Noise; INPUTS] = [Noise::Jerk, Noise::Jerk, Noise::Absent];
    const HEADING: Option<usize> = None;

    fn propagate(&self, s: &Vector6<f64>, dt: f64, platform: &Platform) -> Vector6<f64> {
        self.transition(s, dt, platform).0
    }

    fn transition(
        &self,
        s: &Vector6<f64>,
        dt: f64,
        _: &Platform,
    ) -> (Vector6<f64>, SMatrix<f64, 6, 6>) {
        let mut F = SMatrix::<f64, 6, 6>::identity();
        for axis in 0..2 {
            (F[(axis, axis + 2)], F[(axis + 2, axis + 4)]) = (dt, dt);
            F[(axis, axis + 4)] = 0.5 * dt * dt;
        }
        (F * s, F)
    }

    fn impulses(&self, _: &Vector6<f64>, dt: f64, _: &Platform) -> SMatrix<f64, 6, INPUTS> {
        let mut columns = SMatrix::<f64, 6, INPUTS>::zeros();
        for axis in 0..2 {
            columns[(axis, axis)] = 0.5 * dt * dt;
            columns[(axis + 2, axis)] = dt;
            columns[(axis + 4, axis)] = 1.0;
        }
        columns
    }

    fn step_response(&self, _: &Vector6<f64>, dt: f64) -> SMatrix<f64, 6, INPUTS> {
        let mut columns = SMatrix::<f64, 6, INPUTS>::zeros();
        for axis in 0..2 {
            columns[(axis, axis)] = dt * dt * dt / 6.0;
            columns[(axis + 2, axis)] = 0.5 * dt * dt;
            columns[(axis + 4, axis)] = dt;
        }
        columns
    }

    fn first(&self, first: &First, prior: &Prior) -> Gaussian<6> {
        extended(&first_cv(first, prior), &[prior.acceleration; 2])
    }

    fn after_velocity(&self, cv: &Gaussian<4>, prior: &Prior) -> Option<Gaussian<6>> {
        Some(extended(cv, &[prior.acceleration; 2]))
    }
}

impl PlaneMotion<6> for ConstantAcceleration {
    fn velocity(&self, s: &Vector6<f64>, _: &Platform) -> (Vector2<f64>, SMatrix<f64, 2, 6>) {
        velocity_of(s)
    }
}

impl Motion<5> for CoordinatedTurn {
    type World = Plane;
    const NOISES: [Noise; INPUTS] = [Noise::Acceleration, Noise::Acceleration, Noise::Turn];
    const HEADING: Option<usize> = None;

    fn propagate(&self, s: &Vector5<f64>, dt: f64, _: &Platform) -> Vector5<f64> {
        let turn = Turn::<1>::new(s[4], dt);
        // Moments of the arc instead of division by w: they stay exact when the target flies
        // straight.
        let [x, y] = turn.turned(0, [s[2], s[3]]);
        let [vx, vy] = rotated(direction(s[4] * dt), [s[2], s[3]]);
        Vector5::new(s[0] + x, s[1] + y, vx, vy, s[4])
    }

    fn transition(
        &self,
        s: &Vector5<f64>,
        dt: f64,
        platform: &Platform,
    ) -> (Vector5<f64>, SMatrix<f64, 5, 5>) {
        let (turn, v) = (Turn::<2>::new(s[4], dt), [s[2], s[3]]);
        let [cosine, sine] = direction(s[4] * dt);
        let mut F = SMatrix::<f64, 5, 5>::identity();
        let displacement =
            Matrix2::new(turn.along[0], -turn.aside[0], turn.aside[0], turn.along[0]);
        F.fixed_view_mut::<2, 2>(0, 2).copy_from(&displacement);
        F.fixed_view_mut::<2, 2>(2, 2).copy_from(&Matrix2::new(cosine, -sine, sine, cosine));
        // A derivative by the turn rate is the vector of the next moment, turned by a quarter to
        // the left.
        let [along, aside] = turn.turned(1, v);
        let [vx, vy] = rotated([cosine, sine], v);
        F.set_column(4, &Vector5::new(-aside, along, -dt * vy, dt * vx, 1.0));
        (self.propagate(s, dt, platform), F)
    }

    fn impulses(&self, s: &Vector5<f64>, dt: f64, platform: &Platform) -> SMatrix<f64, 5, INPUTS> {
        // An impulse of acceleration is a jump of a state, so its response is a column of the
        // transition.
        self.transition(s, dt, platform).1.fixed_columns::<3>(2).into_owned()
    }

    fn step_response(&self, _: &Vector5<f64>, dt: f64) -> SMatrix<f64, 5, INPUTS> {
        let mut columns = SMatrix::<f64, 5, INPUTS>::zeros();
        columns.set_column(0, &Vector5::new(0.5 * dt * dt, 0.0, dt, 0.0, 0.0));
        columns.set_column(1, &Vector5::new(0.0, 0.5 * dt * dt, 0.0, dt, 0.0));
        columns[(4, 2)] = dt;
        columns
    }

    fn first(&self, first: &First, prior: &Prior) -> Gaussian<5> {
        extended(&first_cv(first, prior), &[prior.turn_rate])
    }

    fn after_velocity(&self, cv: &Gaussian<4>, prior: &Prior) -> Option<Gaussian<5>> {
        Some(extended(cv, &[prior.turn_rate]))
    }
}

impl PlaneMotion<5> for CoordinatedTurn {
    fn velocity(&self, s: &Vector5<f64>, _: &Platform) -> (Vector2<f64>, SMatrix<f64, 2, 5>) {
        velocity_of(s)
    }
}

impl StateConversion<4> for ConstantVelocity {
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

impl StateConversion<6> for ConstantAcceleration {
    fn cartesian(&self, state: &Gaussian<6>, _: Option<&Gaussian<6>>) -> Gaussian<6> {
        state.clone()
    }

    fn adopted(&self, cartesian: &Gaussian<6>) -> Gaussian<6> {
        cartesian.clone()
    }
}

impl StateConversion<5> for CoordinatedTurn {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::models::motion::tests::check_in_plane as check;

    #[test]
    fn models_agree_with_differences() {
        for dt in [0.02, 0.3] {
            let still = Platform::still();
            check(&ConstantVelocity, &Vector4::new(1.0, 2.0, -3.0, 0.5), dt, &still);
            check(&ConstantAcceleration, &Vector6::new(1.0, 2.0, -3.0, 0.5, 0.3, -1.0), dt, &still);
            for rate in [0.0, 1e-7, 0.4, -3.0] {
                check(&CoordinatedTurn, &Vector5::new(1.0, 2.0, -3.0, 0.5, rate), dt, &still);
            }
        }
    }
}
