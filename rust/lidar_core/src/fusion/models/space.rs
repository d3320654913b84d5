//! Models in space: constant velocity, constant acceleration, and CTRV that climbs.

#![allow(non_snake_case)] // textbook letters

use super::heading::{Ctrv, polar_first, polar_velocity};
use super::motion::{First, INPUTS, Motion, Noise, Prior, SpaceMotion};
use super::platform::Platform;
use super::state_conversion::{
    ANY_HEADING, ANY_RATE, StateConversion, along, capped, spread_slopes, through,
};
use super::turn::direction;
use super::world::{Space, extended};
use crate::estimation::kalman::Gaussian;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3, Vector5, Vector6};

/// Constant velocity, driven by acceleration: [x, y, z, vx, vy, vz].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SpaceVelocity;

/// Constant acceleration, driven by jerk: [x, y, z, vx, vy, vz, ax, ay, az].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SpaceAcceleration;

/// Constant turn rate and speed in the horizontal, constant climb: [x, y, z, v, theta, w, vz], with
/// the horizontal speed v. Acceleration along the heading and upwards and angular acceleration drive
/// it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClimbingCtrv;

/// Indices of the states of [`ClimbingCtrv`] that [`Ctrv`] has too.
const LEVEL: [usize; 5] = [0, 1, 3, 4, 5];
/// Indices of the states height and climb.
const UP: [usize; 2] = [2, 6];
/// Indices of the entries of [x, y, z, vx, vy, vz, ax, ay, az] that exist in the plane too.
const LEVEL_WIDE: [usize; 6] = [0, 1, 3, 4, 6, 7];

/// Transition of positions, velocities and further derivatives, three of each, over `dt` [s].
fn integrated<const N: usize>(dt: f64) -> SMatrix<f64, N, N> {
    SMatrix::from_fn(|row, column| {
        if column < row || (column - row) % 3 != 0 {
            return 0.0;
        }
        (1..=(column - row) / 3).fold(1.0, |power, order| power * dt / order as f64)
    })
}

/// Integral of the last three columns of that transition from 0 to `dt`.
fn input_integral<const N: usize>(dt: f64) -> SMatrix<f64, N, INPUTS> {
    SMatrix::from_fn(|row, axis| {
        if row % 3 != axis {
            return 0.0;
        }
        (1..=(N - 1 - row) / 3 + 1).fold(1.0, |power, order| power * dt / order as f64)
    })
}

/// State of a target after its first measurement; the velocity across the line of sight is unknown.
fn first_velocity(first: &First, prior: &Prior) -> Gaussian<6> {
    let ([c, sine], [flat, up]) = (direction(first.heading), direction(first.elevation));
    let [x, y, z] = first.position;
    let mean =
        Vector6::new(x, y, z, first.speed * flat * c, first.speed * flat * sine, first.speed * up);
    Gaussian { mean, covariance: first.covariance::<6, 3>(prior, &[first.spread(prior); 3]) }
}

/// Velocity in states 3 to 5, and its Jacobian.
fn velocity_of<const N: usize>(s: &SVector<f64, N>) -> (Vector3<f64>, SMatrix<f64, 3, N>) {
    let mut J = SMatrix::<f64, 3, N>::zeros();
    J.fixed_view_mut::<3, 3>(0, 3).fill_with_identity();
    (Vector3::new(s[3], s[4], s[5]), J)
}

/// Level states of a climbing target.
fn level(s: &SVector<f64, 7>) -> Vector5<f64> {
    SVector::from_fn(|k, _| s[LEVEL[k]])
}

/// `part` in the rows and columns of `matrix` that are given.
fn set_block<const A: usize, const B: usize, const R: usize, const C: usize>(
    matrix: &mut SMatrix<f64, A, B>,
    part: &SMatrix<f64, R, C>,
    rows: &[usize; R],
    columns: &[usize; C],
) {
    for (row, column) in (0..R).flat_map(|row| (0..C).map(move |column| (row, column))) {
        matrix[(rows[row], columns[column])] = part[(row, column)];
    }
}

impl Motion<6> for SpaceVelocity {
    type World = Space;
    const NOISES: [Noise; INPUTS] = [Noise::Acceleration; INPUTS];
    const HEADING: Option<usize> = None;

    fn propagate(&self, s: &Vector6<f64>, dt: f64, _: &Platform) -> Vector6<f64> {
        integrated(dt) * s
    }

    fn transition(
        &self,
        s: &Vector6<f64>,
        dt: f64,
        _: &Platform,
    ) -> (Vector6<f64>, SMatrix<f64, 6, 6>) {
        let F = integrated(dt);
        (F * s, F)
    }

    fn impulses(&self, _: &Vector6<f64>, dt: f64, _: &Platform) -> SMatrix<f64, 6, INPUTS> {
        integrated::<6>(dt).fixed_columns::<INPUTS>(3).into_owned()
    }

    fn step_response(&self, _: &Vector6<f64>, dt: f64) -> SMatrix<f64, 6, INPUTS> {
        input_integral(dt)
    }

    fn first(&self, first: &First, prior: &Prior) -> Gaussian<6> {
        first_velocity(first, prior)
    }
}

impl SpaceMotion<6> for SpaceVelocity {
    fn velocity(&self, s: &Vector6<f64>) -> (Vector3<f64>, SMatrix<f64, 3, 6>) {
        velocity_of(s)
    }
}

impl Motion<9> for SpaceAcceleration {
    type World = Space;
    const NOISES: [Noise; INPUTS] = [Noise::Jerk; INPUTS];
    const HEADING: Option<usize> = None;

    fn propagate(&self, s: &SVector<f64, 9>, dt: f64, _: &Platform) -> SVector<f64, 9> {
        integrated(dt) * s
    }

    fn transition(
        &self,
        s: &SVector<f64, 9>,
        dt: f64,
        _: &Platform,
    ) -> (SVector<f64, 9>, SMatrix<f64, 9, 9>) {
        let F = integrated(dt);
        (F * s, F)
    }

    fn impulses(&self, _: &SVector<f64, 9>, dt: f64, _: &Platform) -> SMatrix<f64, 9, INPUTS> {
        integrated::<9>(dt).fixed_columns::<INPUTS>(6).into_owned()
    }

    fn step_response(&self, _: &SVector<f64, 9>, dt: f64) -> SMatrix<f64, 9, INPUTS> {
        input_integral(dt)
    }

    fn first(&self, first: &First, prior: &Prior) -> Gaussian<9> {
        extended(&first_velocity(first, prior), &[prior.acceleration; 3])
    }

    fn after_velocity(&self, cv: &Gaussian<6>, prior: &Prior) -> Option<Gaussian<9>> {
        Some(extended(cv, &[prior.acceleration; 3]))
    }
}

impl SpaceMotion<9> for SpaceAcceleration {
    fn velocity(&self, s: &SVector<f64, 9>) -> (Vector3<f64>, SMatrix<f64, 3, 9>) {
        velocity_of(s)
    }
}

impl Motion<7> for ClimbingCtrv {
    type World = Space;
    const NOISES: [Noise; INPUTS] = [Noise::Acceleration, Noise::Turn, Noise::Acceleration];
    const HEADING: Option<usize> = Some(4);

    fn propagate(&self, s: &SVector<f64, 7>, dt: f64, platform: &Platform) -> SVector<f64, 7> {
        let mut after = *s;
        let flat = Ctrv.propagate(&level(s), dt, platform);
        set_block(&mut after, &flat, &LEVEL, &[0]);
        after[2] += s[6] * dt;
        after
    }

    fn transition(
        &self,
        s: &SVector<f64, 7>,
        dt: f64,
        platform: &Platform,
    ) -> (SVector<f64, 7>, SMatrix<f64, 7, 7>) {
        let (flat, part) = Ctrv.transition(&level(s), dt, platform);
        let (mut after, mut F) = (*s, SMatrix::<f64, 7, 7>::identity());
        set_block(&mut after, &flat, &LEVEL, &[0]);
        set_block(&mut F, &part, &LEVEL, &LEVEL);
        after[2] += s[6] * dt;
        F[(2, 6)] = dt;
        (after, F)
    }

    fn impulses(
        &self,
        s: &SVector<f64, 7>,
        dt: f64,
        platform: &Platform,
    ) -> SMatrix<f64, 7, INPUTS> {
        let mut columns = SMatrix::zeros();
        set_block(&mut columns, &Ctrv.impulses(&level(s), dt, platform), &LEVEL, &[0, 1, 2]);
        set_block(&mut columns, &SMatrix::<f64, 2, 1>::new(dt, 1.0), &UP, &[2]);
        columns
    }

    fn step_response(&self, s: &SVector<f64, 7>, dt: f64) -> SMatrix<f64, 7, INPUTS> {
        let mut columns = SMatrix::zeros();
        set_block(&mut columns, &Ctrv.step_response(&level(s), dt), &LEVEL, &[0, 1, 2]);
        set_block(&mut columns, &SMatrix::<f64, 2, 1>::new(0.5 * dt * dt, dt), &UP, &[2]);
        columns
    }

    fn first(&self, first: &First, prior: &Prior) -> Gaussian<7> {
        let [flat, up] = direction(first.elevation);
        let across = polar_first(&First { speed: first.speed * flat, ..*first }, prior).mean;
        let spread = first.spread(prior);
        let variances = [spread, prior.heading, prior.turn_rate, spread];
        let mean = SVector::from([
            first.position[0],
            first.position[1],
            first.position[2],
            across[2],
            across[3],
            0.0,
            first.speed * up,
        ]);
        Gaussian { mean, covariance: first.covariance::<7, 3>(prior, &variances) }
    }

    fn after_velocity(&self, cv: &Gaussian<6>, prior: &Prior) -> Option<Gaussian<7>> {
        let ([speed, heading], slopes) = polar_velocity(cv.mean[3], cv.mean[4]);
        let mut J = SMatrix::<f64, 7, 6>::zeros();
        set_block(&mut J, &Matrix3::identity(), &[0, 1, 2], &[0, 1, 2]);
        set_block(&mut J, &slopes, &[3, 4], &[3, 4]);
        J[(6, 5)] = 1.0;
        let m = &cv.mean;
        let mean = SVector::from([m[0], m[1], m[2], speed, heading, 0.0, m[5]]);
        let mut state = capped(through(&cv.covariance, &J, mean), 4, ANY_HEADING);
        state.covariance[(5, 5)] = prior.turn_rate;
        Some(state)
    }
}

impl SpaceMotion<7> for ClimbingCtrv {
    fn velocity(&self, s: &SVector<f64, 7>) -> (Vector3<f64>, SMatrix<f64, 3, 7>) {
        let [cosine, sine] = direction(s[4]);
        let mut J = SMatrix::<f64, 3, 7>::zeros();
        (J[(0, 3)], J[(1, 3)]) = (cosine, sine);
        (J[(0, 4)], J[(1, 4)]) = (-s[3] * sine, s[3] * cosine);
        J[(2, 6)] = 1.0;
        (Vector3::new(s[3] * cosine, s[3] * sine, s[6]), J)
    }
}

/// `state` with the accelerations of `other` in the last `COUNT` rows. Only the block on the
/// diagonal is copied: correlations of two different models would not fit together.
fn completed<const COUNT: usize>(
    mut state: Gaussian<9>,
    other: Option<&Gaussian<9>>,
) -> Gaussian<9> {
    if let Some(other) = other {
        let first = 9 - COUNT;
        let mean = other.mean.fixed_rows::<COUNT>(first);
        state.mean.fixed_rows_mut::<COUNT>(first).copy_from(&mean);
        let known = other.covariance.fixed_view::<COUNT, COUNT>(first, first);
        state.covariance.fixed_view_mut::<COUNT, COUNT>(first, first).copy_from(&known);
    }
    state
}

impl StateConversion<6> for SpaceVelocity {
    fn cartesian(&self, state: &Gaussian<6>, other: Option<&Gaussian<9>>) -> Gaussian<9> {
        completed::<3>(extended(state, &[]), other)
    }

    fn adopted(&self, cartesian: &Gaussian<9>) -> Gaussian<6> {
        Gaussian {
            mean: cartesian.mean.fixed_rows::<6>(0).into(),
            covariance: cartesian.covariance.fixed_view::<6, 6>(0, 0).into(),
        }
    }
}

impl StateConversion<9> for SpaceAcceleration {
    fn cartesian(&self, state: &Gaussian<9>, _: Option<&Gaussian<9>>) -> Gaussian<9> {
        state.clone()
    }

    fn adopted(&self, cartesian: &Gaussian<9>) -> Gaussian<9> {
        cartesian.clone()
    }
}

impl StateConversion<7> for ClimbingCtrv {
    fn cartesian(&self, state: &Gaussian<7>, other: Option<&Gaussian<9>>) -> Gaussian<9> {
        let (flat, part) = spread_slopes(&level(&state.mean));
        let (mut mean, mut J) = (SVector::<f64, 9>::zeros(), SMatrix::<f64, 9, 7>::zeros());
        set_block(&mut mean, &flat, &LEVEL_WIDE, &[0]);
        set_block(&mut J, &part, &LEVEL_WIDE, &LEVEL);
        (mean[2], mean[5]) = (state.mean[2], state.mean[6]);
        (J[(2, 2)], J[(5, 6)]) = (1.0, 1.0);
        completed::<1>(through(&state.covariance, &J, mean), other)
    }

    fn adopted(&self, cartesian: &Gaussian<9>) -> Gaussian<7> {
        let m = &cartesian.mean;
        let flat = Vector6::from_fn(|k, _| m[LEVEL_WIDE[k]]);
        let (values, part) = along(&flat);
        let mut J = SMatrix::<f64, 7, 9>::zeros();
        set_block(&mut J, &Matrix3::identity(), &[0, 1, 2], &[0, 1, 2]);
        set_block(&mut J, &part.fixed_rows::<3>(0).into_owned(), &[3, 4, 5], &LEVEL_WIDE);
        J[(6, 5)] = 1.0;
        let mean = SVector::from([m[0], m[1], m[2], values[0], values[1], values[2], m[5]]);
        let state = through(&cartesian.covariance, &J, mean);
        capped(capped(state, 4, ANY_HEADING), 5, ANY_RATE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::models::motion::tests::{check, difference};

    fn check_in_space<const N: usize, M: SpaceMotion<N>>(motion: &M, s: &SVector<f64, N>) {
        for dt in [0.02, 0.3] {
            check(motion, s, dt, &Platform::still());
        }
        let (_, J) = motion.velocity(s);
        let expected = difference(s, |s| motion.velocity(s).0);
        assert!((J - expected).abs().max() < 1e-8, "velocity: {J} {expected}");
        // The velocity is how the position changes.
        let position = |dt| {
            let after = motion.propagate(s, dt, &Platform::still());
            Vector3::new(after[0], after[1], after[2])
        };
        let change = (position(1e-5) - position(-1e-5)) / 2e-5;
        assert!((motion.velocity(s).0 - change).abs().max() < 1e-8);
    }

    #[test]
    fn models_agree_with_differences() {
        check_in_space(&SpaceVelocity, &Vector6::new(1.0, 2.0, 4.0, -3.0, 0.5, 0.7));
        let nine = [1.0, 2.0, 4.0, -3.0, 0.5, 0.7, 0.3, -1.0, 0.4];
        check_in_space(&SpaceAcceleration, &SVector::from(nine));
        for rate in [0.0, 1e-7, 0.4, -3.0] {
            check_in_space(&ClimbingCtrv, &SVector::from([1.0, 2.0, 4.0, 3.0, 2.5, rate, -0.8]));
        }
    }

    /// Constant noise over a step is what impulses spread over it sum to, on a straight line.
    #[test]
    fn what_holds_is_the_integral_of_impulses() {
        fn check<const N: usize, M: Motion<N>>(motion: &M, s: SVector<f64, N>) {
            let (dt, still, steps) = (0.3, Platform::still(), 2000);
            let h = dt / f64::from(steps);
            let impulses =
                (0..steps).map(|k| motion.impulses(&s, (f64::from(k) + 0.5) * h, &still) * h);
            let sum: SMatrix<f64, N, INPUTS> = impulses.sum();
            // The way that angular acceleration adds is neglected, as in the plane.
            let mut difference = sum - motion.step_response(&s, dt);
            if motion.step_response(&s, dt)[(0, 1)] == 0.0 {
                (difference[(0, 1)], difference[(1, 1)]) = (0.0, 0.0);
            }
            assert!(difference.abs().max() < 1e-6, "{difference}");
        }
        check(&SpaceVelocity, Vector6::new(1.0, 2.0, 4.0, -3.0, 0.5, 0.7));
        check(&SpaceAcceleration, SVector::from([1.0; 9]));
        check(&ClimbingCtrv, SVector::from([1.0, 2.0, 4.0, 3.0, 2.5, 0.0, -0.8]));
    }

    #[test]
    fn a_target_that_does_not_climb_is_one_in_the_plane() {
        let flat = Vector5::new(1.0, 2.0, 3.0, 2.5, 0.4);
        let s = SVector::from([1.0, 2.0, 7.0, 3.0, 2.5, 0.4, 0.0]);
        let still = Platform::still();
        let after = ClimbingCtrv.propagate(&s, 0.3, &still);
        assert_eq!(level(&after), Ctrv.propagate(&flat, 0.3, &still));
        assert_eq!((after[2], after[6]), (7.0, 0.0));
    }
}
