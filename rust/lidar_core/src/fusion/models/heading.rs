//! Models with speed and heading: CTRV (constant turn rate and velocity) and CTRA (acceleration).

#![allow(non_snake_case)] // textbook letters

use super::motion::{First, INPUTS, Motion, Noise, PlaneMotion, Prior};
use super::platform::Platform;
use super::state_conversion::{
    ANY_HEADING, ANY_RATE, StateConversion, along, capped, spread, through,
};
use super::turn::{Turn, direction};
use super::world::{Plane, extended};
use crate::estimation::kalman::Gaussian;
use nalgebra::{Matrix2, Matrix6, SMatrix, SVector, Vector2, Vector4, Vector5, Vector6};

/// Speed below which a velocity has no heading [m/s].
const SLOWEST: f64 = 1e-3;

/// Constant turn rate and velocity, driven by acceleration along the heading and by angular
/// acceleration: [x, y, v, theta, w].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ctrv;

/// Constant turn rate and acceleration, driven by jerk along the heading and by angular
/// acceleration: [x, y, v, theta, w, a].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ctra;

/// Displacement (A, B) per unit of speed, and its derivatives by the turn rate.
pub(crate) struct ArcLength {
    pub(super) by_speed: [f64; 2],
    pub(super) by_rate: [f64; 2],
}

impl ArcLength {
    pub(crate) fn new(heading: [f64; 2], rate: f64, dt: f64) -> Self {
        let turn = Turn::<2>::new(rate, dt);
        let [along, aside] = turn.turned(1, heading);
        Self { by_speed: turn.turned(0, heading), by_rate: [-aside, along] }
    }
}

/// Speed and heading of a velocity, and their Jacobian.
pub(super) fn polar_velocity(vx: f64, vy: f64) -> ([f64; 2], Matrix2<f64>) {
    // A target at rest has no heading; the least speed keeps the Jacobian finite.
    let speed = libm::hypot(vx, vy).max(SLOWEST);
    let heading = libm::atan2(vy, vx);
    let [cosine, sine] = direction(heading);
    ([speed, heading], Matrix2::new(cosine, sine, -sine / speed, cosine / speed))
}

/// Position, speed and heading of a distribution of position and velocity.
pub(super) fn polar_from(cv: &Gaussian<4>) -> Gaussian<4> {
    let ([speed, heading], slopes) = polar_velocity(cv.mean[2], cv.mean[3]);
    let mut J = SMatrix::<f64, 4, 4>::identity();
    J.fixed_view_mut::<2, 2>(2, 2).copy_from(&slopes);
    let covariance = J * cv.covariance * J.transpose();
    let mean = Vector4::new(cv.mean[0], cv.mean[1], speed, heading);
    capped(Gaussian { mean, covariance }, 3, ANY_HEADING)
}

/// Position, speed and heading of a target after its first measurement.
pub(super) fn polar_first(first: &First, prior: &Prior) -> Gaussian<4> {
    let [x, y, _] = first.position;
    // Without a measured speed the line of sight does not show where the target is heading.
    let heading = if first.speed == 0.0 { 0.0 } else { first.heading };
    let covariance = first.covariance::<4, 2>(prior, &[first.spread(prior), prior.heading]);
    Gaussian { mean: Vector4::new(x, y, first.speed, heading), covariance }
}

/// Velocity of the speed and heading in states 2 and 3, and its Jacobian.
pub(super) fn velocity_of<const N: usize>(
    s: &SVector<f64, N>,
) -> (Vector2<f64>, SMatrix<f64, 2, N>) {
    let [cosine, sine] = direction(s[3]);
    let mut J = SMatrix::<f64, 2, N>::zeros();
    (J[(0, 2)], J[(1, 2)]) = (cosine, sine);
    (J[(0, 3)], J[(1, 3)]) = (-s[2] * sine, s[2] * cosine);
    (Vector2::new(s[2] * cosine, s[2] * sine), J)
}

impl Motion<5> for Ctrv {
    type World = Plane;
    const NOISES: [Noise; INPUTS] = [Noise::Acceleration, Noise::Turn, Noise::Absent];
    const HEADING: Option<usize> = Some(3);

    fn propagate(&self, s: &Vector5<f64>, dt: f64, _: &Platform) -> Vector5<f64> {
        let [A, B] = Turn::<1>::new(s[4], dt).turned(0, direction(s[3]));
        Vector5::new(s[0] + s[2] * A, s[1] + s[2] * B, s[2], s[3] + s[4] * dt, s[4])
    }

    fn transition(
        &self,
        s: &Vector5<f64>,
        dt: f64,
        _: &Platform,
    ) -> (Vector5<f64>, SMatrix<f64, 5, 5>) {
        let (v, w) = (s[2], s[4]);
        let arc = ArcLength::new(direction(s[3]), w, dt);
        let [A, B] = arc.by_speed;
        let mut F = SMatrix::<f64, 5, 5>::identity();
        (F[(0, 2)], F[(1, 2)]) = (A, B);
        (F[(0, 3)], F[(1, 3)]) = (-v * B, v * A);
        (F[(0, 4)], F[(1, 4)], F[(3, 4)]) = (v * arc.by_rate[0], v * arc.by_rate[1], dt);
        (Vector5::new(s[0] + v * A, s[1] + v * B, v, s[3] + w * dt, w), F)
    }

    fn impulses(&self, s: &Vector5<f64>, dt: f64, _: &Platform) -> SMatrix<f64, 5, INPUTS> {
        let arc = ArcLength::new(direction(s[3]), s[4], dt);
        let [A, B] = arc.by_speed;
        let [A1, B1] = arc.by_rate.map(|part| part * s[2]);
        let mut columns = SMatrix::<f64, 5, INPUTS>::zeros();
        columns.set_column(0, &Vector5::new(A, B, 1.0, 0.0, 0.0));
        columns.set_column(1, &Vector5::new(A1, B1, 0.0, dt, 1.0));
        columns
    }

    /// Responses from the end state, whose heading all impulses share.
    fn responses(
        &self,
        end: &Vector5<f64>,
        rests: [f64; 3],
        _: &Platform,
        mut visit: impl FnMut(&SMatrix<f64, 5, INPUTS>),
    ) {
        // The arc is followed backwards from the end: one sine and cosine serve all three impulses,
        // where the general form would compute a new state for each.
        let (heading, v) = (direction(end[3]), end[2]);
        for rest in rests {
            let back = Turn::<2>::new(-end[4], rest);
            let ([A, B], [C, D]) = (back.turned(0, heading), back.turned(1, heading));
            let mut columns = SMatrix::<f64, 5, INPUTS>::zeros();
            columns.set_column(0, &Vector5::new(A, B, 1.0, 0.0, 0.0));
            let bent = [v * (D - rest * B), v * (rest * A - C)];
            columns.set_column(1, &Vector5::new(bent[0], bent[1], 0.0, rest, 1.0));
            visit(&columns);
        }
    }

    fn step_response(&self, s: &Vector5<f64>, dt: f64) -> SMatrix<f64, 5, INPUTS> {
        let [cosine, sine] = direction(s[3]);
        // The path that the noise adds within a step is short, so its bend is neglected.
        let half = 0.5 * dt * dt;
        let mut columns = SMatrix::<f64, 5, INPUTS>::zeros();
        columns.set_column(0, &Vector5::new(half * cosine, half * sine, dt, 0.0, 0.0));
        columns.set_column(1, &Vector5::new(0.0, 0.0, 0.0, half, dt));
        columns
    }

    fn first(&self, first: &First, prior: &Prior) -> Gaussian<5> {
        extended(&polar_first(first, prior), &[prior.turn_rate])
    }

    fn after_velocity(&self, cv: &Gaussian<4>, prior: &Prior) -> Option<Gaussian<5>> {
        Some(extended(&polar_from(cv), &[prior.turn_rate]))
    }
}

impl PlaneMotion<5> for Ctrv {
    fn velocity(&self, s: &Vector5<f64>, _: &Platform) -> (Vector2<f64>, SMatrix<f64, 2, 5>) {
        velocity_of(s)
    }
}

impl Motion<6> for Ctra {
    type World = Plane;
    const NOISES: [Noise; INPUTS] = [Noise::Jerk, Noise::Turn, Noise::Absent];
    const HEADING: Option<usize> = Some(3);

    fn propagate(&self, s: &Vector6<f64>, dt: f64, _: &Platform) -> Vector6<f64> {
        let (v, w, a) = (s[2], s[4], s[5]);
        let (turn, heading) = (Turn::<2>::new(w, dt), direction(s[3]));
        let ([A, B], [C, D]) = (turn.turned(0, heading), turn.turned(1, heading));
        let (x, y) = (s[0] + v * A + a * C, s[1] + v * B + a * D);
        Vector6::new(x, y, v + a * dt, s[3] + w * dt, w, a)
    }

    fn transition(
        &self,
        s: &Vector6<f64>,
        dt: f64,
        _: &Platform,
    ) -> (Vector6<f64>, SMatrix<f64, 6, 6>) {
        let (v, w, a) = (s[2], s[4], s[5]);
        let (turn, heading) = (Turn::<3>::new(w, dt), direction(s[3]));
        let ([A, B], [C, D]) = (turn.turned(0, heading), turn.turned(1, heading));
        let [G, H] = turn.turned(2, heading);
        let mut F = SMatrix::<f64, 6, 6>::identity();
        (F[(0, 2)], F[(1, 2)]) = (A, B);
        (F[(0, 3)], F[(1, 3)]) = (-v * B - a * D, v * A + a * C);
        (F[(0, 4)], F[(1, 4)], F[(3, 4)]) = (-v * D - a * H, v * C + a * G, dt);
        (F[(0, 5)], F[(1, 5)], F[(2, 5)]) = (C, D, dt);
        let (x, y) = (s[0] + v * A + a * C, s[1] + v * B + a * D);
        (Vector6::new(x, y, v + a * dt, s[3] + w * dt, w, a), F)
    }

    fn impulses(&self, s: &Vector6<f64>, dt: f64, platform: &Platform) -> SMatrix<f64, 6, INPUTS> {
        let F = self.transition(s, dt, platform).1;
        let mut columns = SMatrix::<f64, 6, INPUTS>::zeros();
        columns.set_column(0, &F.column(5));
        columns.set_column(1, &F.column(4));
        columns
    }

    /// Responses from the end state, whose heading all impulses share.
    fn responses(
        &self,
        end: &Vector6<f64>,
        rests: [f64; 3],
        _: &Platform,
        mut visit: impl FnMut(&SMatrix<f64, 6, INPUTS>),
    ) {
        let (heading, v, a) = (direction(end[3]), end[2], end[5]);
        for rest in rests {
            let back = Turn::<3>::new(-end[4], rest);
            let ([A, B], [C, D]) = (back.turned(0, heading), back.turned(1, heading));
            let [G, H] = back.turned(2, heading);
            let mut columns = SMatrix::<f64, 6, INPUTS>::zeros();
            let (x, y) = (rest * A - C, rest * B - D);
            columns.set_column(0, &Vector6::new(x, y, rest, 0.0, 0.0, 1.0));
            // speed at t before the end is v - a t, turned aside by (rest - t)
            let along = v * x - a * (rest * C - G);
            let aside = v * y - a * (rest * D - H);
            columns.set_column(1, &Vector6::new(-aside, along, 0.0, rest, 1.0, 0.0));
            visit(&columns);
        }
    }

    fn step_response(&self, s: &Vector6<f64>, dt: f64) -> SMatrix<f64, 6, INPUTS> {
        let [cosine, sine] = direction(s[3]);
        let (half, sixth) = (0.5 * dt * dt, dt * dt * dt / 6.0);
        let mut columns = SMatrix::<f64, 6, INPUTS>::zeros();
        columns.set_column(0, &Vector6::new(sixth * cosine, sixth * sine, half, 0.0, 0.0, dt));
        columns.set_column(1, &Vector6::new(0.0, 0.0, 0.0, half, dt, 0.0));
        columns
    }

    fn first(&self, first: &First, prior: &Prior) -> Gaussian<6> {
        extended(&polar_first(first, prior), &[prior.turn_rate, prior.acceleration])
    }

    fn after_velocity(&self, cv: &Gaussian<4>, prior: &Prior) -> Option<Gaussian<6>> {
        Some(extended(&polar_from(cv), &[prior.turn_rate, prior.acceleration]))
    }
}

impl PlaneMotion<6> for Ctra {
    fn velocity(&self, s: &Vector6<f64>, _: &Platform) -> (Vector2<f64>, SMatrix<f64, 2, 6>) {
        velocity_of(s)
    }
}

impl StateConversion<5> for Ctrv {
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

impl StateConversion<6> for Ctra {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::models::motion::tests::{check_in_plane as check, difference};

    #[test]
    fn models_agree_with_differences() {
        let still = Platform::still();
        for dt in [0.02, 0.3] {
            for rate in [0.0, 1e-7, 0.4, -3.0] {
                check(&Ctrv, &Vector5::new(1.0, 2.0, 4.0, 2.5, rate), dt, &still);
                check(&Ctra, &Vector6::new(1.0, 2.0, 4.0, -2.5, rate, 0.7), dt, &still);
            }
        }
    }

    /// Sec. 3.1: at w = 0 the column of w is not zero, as eq. 19 of the paper has it.
    #[test]
    fn the_column_of_the_turn_rate_has_its_limit() {
        let (_, F) =
            Ctrv.transition(&Vector5::new(0.0, 0.0, 2.0, 0.0, 0.0), 0.1, &Platform::still());
        assert_eq!((F[(0, 4)], F[(3, 4)]), (0.0, 0.1));
        assert!((F[(1, 4)] - 2.0 * 0.005).abs() < 1e-17);
    }

    #[test]
    fn speed_and_heading_come_from_the_velocity() {
        let covariance = SMatrix::<f64, 4, 4>::from_fn(|row, column| {
            if row == column { 2.0 } else { 0.3 / (1.0 + (row + column) as f64) }
        });
        let cv = Gaussian { mean: Vector4::new(1.0, 2.0, 3.0, -4.0), covariance };
        let polar = polar_from(&cv);
        assert!((polar.mean[2] - 5.0).abs() < 1e-12);
        let J = difference(&cv.mean, |s| {
            Vector4::new(s[0], s[1], libm::hypot(s[2], s[3]), libm::atan2(s[3], s[2]))
        });
        assert!((polar.covariance - J * covariance * J.transpose()).abs().max() < 1e-8);
        let slow = Gaussian { mean: Vector4::new(1.0, 2.0, 0.0, 0.0), covariance };
        assert!((polar_from(&slow).covariance[(3, 3)] - ANY_HEADING).abs() < 1e-12);
    }
}
