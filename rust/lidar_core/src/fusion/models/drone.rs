//! CTRV relative to a moving platform: the state is in the levelled frame of the sensor.

#![allow(non_snake_case)] // textbook letters

use super::heading::{ArcLength, polar_first, velocity_of};
use super::motion::{First, INPUTS, Motion, Noise, PlaneMotion, Prior};
use super::platform::Platform;
use super::turn::{Turn, direction, rotated};
use super::world::{Plane, extended};
use crate::estimation::kalman::Gaussian;
use nalgebra::{SMatrix, SVector, Vector2, Vector5, Vector6};

/// Largest bias [rad/s] and largest delay [s] of a gyro that the filter assumes. Larger estimates
/// are limited to these.
const GYRO_LIMITS: [f64; 2] = [0.5, 0.2];
/// Variances of bias [rad^2/s^2] and delay [s^2] before a target has been seen: gyros without
/// calibration have errors of some degrees per second, and drivers use the arrival time of a packet
/// as stamp. With a wider prior, the filter may take the turn of a target for a bias of the gyro:
/// the estimate is then wrong, with a small covariance.
const GYRO_PRIOR: [f64; 2] = [0.05 * 0.05, 0.05 * 0.05];

/// CTRV relative to the moving sensor; a gyro without bias and delay gives the turn rate of the
/// platform: [x, y, v, theta, w], with v and w over ground.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CtrvDrone;

/// Like [`CtrvDrone`], with bias and delay of the gyro as states: [x, y, v, theta, w, bias, delay].
/// A reading of time t is the rate at t - delay, plus the bias.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CtrvDroneGyro;

/// Like [`CtrvDrone`], with the turn rate of the platform as a sixth state, which a gyro may
/// measure: [x, y, v, theta, w, w_d].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CtrvDroneRate;

/// State after a step of the sensor's frame, and its derivatives by all six states.
fn step(s: &Vector5<f64>, rate: f64, dt: f64, platform: &Platform) -> (Vector5<f64>, Columns) {
    let ([x, y, v, heading, w], lever) = (s.data.0[0], platform.lever);
    let arc = ArcLength::new(direction(heading), w, dt);
    let own = Turn::<2>::new(rate, dt);
    let d = own.turned(0, platform.velocity);
    let [along, aside] = own.turned(1, platform.velocity);
    let [c, minus_s] = direction(-rate * dt);
    let back = |vector: [f64; 2]| rotated([c, minus_s], vector);
    let [A, B] = arc.by_speed;
    // The platform turns about its origin, not about the sensor: the lever is added before the
    // rotation and subtracted after it.
    let moved = back([x + lever[0] + v * A - d[0], y + lever[1] + v * B - d[1]]);
    let after = [moved[0] - lever[0], moved[1] - lever[1]];
    let by_own = back([-aside, along]); // C d'
    let columns = Columns {
        position: [c, minus_s],
        by_speed: back(arc.by_speed),
        by_heading: back([-v * B, v * A]),
        by_rate: back(arc.by_rate.map(|part| part * v)),
        by_platform: [dt * moved[1] - by_own[0], -dt * moved[0] - by_own[1]],
    };
    // Angles count from the axes of the platform, which turn as well: only the difference of the
    // two rates is seen.
    (Vector5::new(after[0], after[1], v, heading + (w - rate) * dt, w), columns)
}

/// Derivatives of the position by the other states.
struct Columns {
    position: [f64; 2],
    by_speed: [f64; 2],
    by_heading: [f64; 2],
    by_rate: [f64; 2],
    by_platform: [f64; 2],
}

impl Columns {
    /// Jacobian of the first five states, in a matrix that may be larger.
    fn jacobian<const N: usize>(&self, dt: f64) -> SMatrix<f64, N, N> {
        let mut F = SMatrix::<f64, N, N>::identity();
        let [c, minus_s] = self.position;
        (F[(0, 0)], F[(0, 1)], F[(1, 0)], F[(1, 1)]) = (c, -minus_s, minus_s, c);
        for row in 0..2 {
            F[(row, 2)] = self.by_speed[row];
            F[(row, 3)] = self.by_heading[row];
            F[(row, 4)] = self.by_rate[row];
        }
        F[(3, 4)] = dt;
        F
    }
}

/// Responses to acceleration and angular acceleration on a straight line, as in CTRV.
fn step_response<const N: usize>(s: &SVector<f64, N>, dt: f64) -> SMatrix<f64, N, INPUTS> {
    let [cosine, sine] = direction(s[3]);
    let half = 0.5 * dt * dt;
    let mut columns = SMatrix::<f64, N, INPUTS>::zeros();
    (columns[(0, 0)], columns[(1, 0)], columns[(2, 0)]) = (half * cosine, half * sine, dt);
    (columns[(3, 1)], columns[(4, 1)]) = (half, dt);
    columns
}

/// Velocity relative to the sensor, which moves and turns with the platform, and its Jacobian.
fn relative<const N: usize>(
    s: &SVector<f64, N>,
    rate: f64,
    platform: &Platform,
) -> (Vector2<f64>, SMatrix<f64, 2, N>) {
    let (ground, J) = velocity_of(s);
    let (u, lever) = (platform.velocity, platform.lever);
    (ground - Vector2::new(u[0] - rate * lever[1], u[1] + rate * lever[0]), J)
}

impl Motion<5> for CtrvDrone {
    type World = Plane;
    const NOISES: [Noise; INPUTS] = [Noise::Acceleration, Noise::Turn, Noise::Absent];
    const HEADING: Option<usize> = Some(3);

    fn propagate(&self, s: &Vector5<f64>, dt: f64, platform: &Platform) -> Vector5<f64> {
        step(s, platform.rate, dt, platform).0
    }

    fn transition(
        &self,
        s: &Vector5<f64>,
        dt: f64,
        platform: &Platform,
    ) -> (Vector5<f64>, SMatrix<f64, 5, 5>) {
        let (after, columns) = step(s, platform.rate, dt, platform);
        (after, columns.jacobian(dt))
    }

    fn impulses(&self, s: &Vector5<f64>, dt: f64, platform: &Platform) -> SMatrix<f64, 5, INPUTS> {
        let F = self.transition(s, dt, platform).1;
        let mut columns = SMatrix::<f64, 5, INPUTS>::zeros();
        columns.set_column(0, &F.column(2));
        columns.set_column(1, &F.column(4));
        columns
    }

    fn step_response(&self, s: &Vector5<f64>, dt: f64) -> SMatrix<f64, 5, INPUTS> {
        step_response(s, dt)
    }

    /// Response to the error of the gyro, which turns the frame.
    fn input_response(
        &self,
        s: &Vector5<f64>,
        dt: f64,
        platform: &Platform,
    ) -> Option<Vector5<f64>> {
        // The error is constant over the step: one column, which correlates position and heading.
        let [x, y] = step(s, platform.rate, dt, platform).1.by_platform;
        Some(Vector5::new(x, y, 0.0, -dt, 0.0) * libm::sqrt(platform.rate_variance))
    }

    fn first(&self, first: &First, prior: &Prior) -> Gaussian<5> {
        extended(&polar_first(first, prior), &[prior.turn_rate])
    }
}

impl PlaneMotion<5> for CtrvDrone {
    fn velocity(
        &self,
        s: &Vector5<f64>,
        platform: &Platform,
    ) -> (Vector2<f64>, SMatrix<f64, 2, 5>) {
        relative(s, platform.rate, platform)
    }
}

impl CtrvDroneGyro {
    /// Turn rate of the platform, and its derivatives by bias and delay.
    fn rate(s: &SVector<f64, 7>, platform: &Platform) -> (f64, [f64; 2]) {
        let [bias, delay] = GYRO_LIMITS;
        let (bias, delay) = (s[5].clamp(-bias, bias), s[6].clamp(-delay, delay));
        (platform.rate + platform.slope * delay - bias, [-1.0, platform.slope])
    }
}

impl Motion<7> for CtrvDroneGyro {
    type World = Plane;
    const NOISES: [Noise; INPUTS] = [Noise::Acceleration, Noise::Turn, Noise::Gyro];
    const HEADING: Option<usize> = Some(3);

    fn propagate(&self, s: &SVector<f64, 7>, dt: f64, platform: &Platform) -> SVector<f64, 7> {
        let rate = Self::rate(s, platform).0;
        let after = step(&s.fixed_rows::<5>(0).into(), rate, dt, platform).0;
        after.push(s[5]).push(s[6])
    }

    fn transition(
        &self,
        s: &SVector<f64, 7>,
        dt: f64,
        platform: &Platform,
    ) -> (SVector<f64, 7>, SMatrix<f64, 7, 7>) {
        let (rate, by_gyro) = Self::rate(s, platform);
        let (after, columns) = step(&s.fixed_rows::<5>(0).into(), rate, dt, platform);
        let mut F = columns.jacobian::<7>(dt);
        for (column, by) in (5..).zip(by_gyro) {
            (F[(0, column)], F[(1, column)]) =
                (columns.by_platform[0] * by, columns.by_platform[1] * by);
            F[(3, column)] = -dt * by;
        }
        (after.push(s[5]).push(s[6]), F)
    }

    fn impulses(
        &self,
        s: &SVector<f64, 7>,
        dt: f64,
        platform: &Platform,
    ) -> SMatrix<f64, 7, INPUTS> {
        let F = self.transition(s, dt, platform).1;
        SMatrix::from_columns(&[F.column(2), F.column(4), F.column(5)])
    }

    fn step_response(&self, s: &SVector<f64, 7>, dt: f64) -> SMatrix<f64, 7, INPUTS> {
        let mut columns = step_response(s, dt);
        columns[(5, 2)] = dt;
        columns
    }

    fn input_response(
        &self,
        s: &SVector<f64, 7>,
        dt: f64,
        platform: &Platform,
    ) -> Option<SVector<f64, 7>> {
        let rate = Self::rate(s, platform).0;
        let [x, y] = step(&s.fixed_rows::<5>(0).into(), rate, dt, platform).1.by_platform;
        let column = SVector::from([x, y, 0.0, -dt, 0.0, 0.0, 0.0]);
        Some(column * libm::sqrt(platform.rate_variance))
    }

    fn first(&self, first: &First, prior: &Prior) -> Gaussian<7> {
        let [bias, delay] = GYRO_PRIOR;
        extended(&polar_first(first, prior), &[prior.turn_rate, bias, delay])
    }
}

impl PlaneMotion<7> for CtrvDroneGyro {
    fn velocity(
        &self,
        s: &SVector<f64, 7>,
        platform: &Platform,
    ) -> (Vector2<f64>, SMatrix<f64, 2, 7>) {
        let (rate, by_gyro) = Self::rate(s, platform);
        let (velocity, mut J) = relative(s, rate, platform);
        for (column, by) in (5..).zip(by_gyro) {
            (J[(0, column)], J[(1, column)]) = (platform.lever[1] * by, -platform.lever[0] * by);
        }
        (velocity, J)
    }
}

impl Motion<6> for CtrvDroneRate {
    type World = Plane;
    const NOISES: [Noise; INPUTS] = [Noise::Acceleration, Noise::Turn, Noise::Platform];
    const HEADING: Option<usize> = Some(3);
    const PLATFORM_RATE: Option<usize> = Some(5);

    fn propagate(&self, s: &Vector6<f64>, dt: f64, platform: &Platform) -> Vector6<f64> {
        step(&s.fixed_rows::<5>(0).into(), s[5], dt, platform).0.push(s[5])
    }

    fn transition(
        &self,
        s: &Vector6<f64>,
        dt: f64,
        platform: &Platform,
    ) -> (Vector6<f64>, SMatrix<f64, 6, 6>) {
        let (after, columns) = step(&s.fixed_rows::<5>(0).into(), s[5], dt, platform);
        let mut F = columns.jacobian::<6>(dt);
        (F[(0, 5)], F[(1, 5)], F[(3, 5)]) = (columns.by_platform[0], columns.by_platform[1], -dt);
        (after.push(s[5]), F)
    }

    fn impulses(&self, s: &Vector6<f64>, dt: f64, platform: &Platform) -> SMatrix<f64, 6, INPUTS> {
        let F = self.transition(s, dt, platform).1;
        SMatrix::from_columns(&[F.column(2), F.column(4), F.column(5)])
    }

    fn step_response(&self, s: &Vector6<f64>, dt: f64) -> SMatrix<f64, 6, INPUTS> {
        let mut columns = step_response(s, dt);
        columns[(5, 2)] = dt;
        columns
    }

    fn first(&self, first: &First, prior: &Prior) -> Gaussian<6> {
        extended(&polar_first(first, prior), &[prior.turn_rate, prior.platform_rate])
    }
}

impl PlaneMotion<6> for CtrvDroneRate {
    fn velocity(
        &self,
        s: &Vector6<f64>,
        platform: &Platform,
    ) -> (Vector2<f64>, SMatrix<f64, 2, 6>) {
        let (velocity, mut J) = relative(s, s[5], platform);
        (J[(0, 5)], J[(1, 5)]) = (platform.lever[1], -platform.lever[0]);
        (velocity, J)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::models::motion::tests::check_in_plane as check;

    #[test]
    fn models_agree_with_differences() {
        for rate in [0.0, 1e-7, 0.5, -2.0] {
            let platform = Platform {
                rate,
                rate_variance: 0.01,
                slope: 0.6,
                velocity: [3.0, -0.5],
                lever: [0.3, -0.2, 0.0],
                ..Platform::still()
            };
            for w in [0.0, 0.7] {
                check(&CtrvDrone, &Vector5::new(4.0, -2.0, 2.0, 2.5, w), 0.1, &platform);
                check(&CtrvDroneRate, &Vector6::new(4.0, -2.0, 2.0, 2.5, w, rate), 0.1, &platform);
                let with_gyro = SVector::from([4.0, -2.0, 2.0, 2.5, w, 0.1, 0.05]);
                check(&CtrvDroneGyro, &with_gyro, 0.1, &platform);
            }
        }
    }

    /// A gyro without error makes the two models the same; one that is wrong and late is corrected.
    #[test]
    fn bias_and_delay_correct_the_rate() {
        let platform = Platform { rate: 1.0, slope: 0.4, ..Platform::still() };
        let s = Vector5::new(2.0, 0.5, 1.0, 0.3, 0.2);
        let exact = CtrvDrone.propagate(&s, 0.5, &platform);
        let same = CtrvDroneGyro.propagate(&s.push(0.0).push(0.0), 0.5, &platform);
        assert_eq!(same.fixed_rows::<5>(0), exact);
        let biased = Platform { rate: 1.0 + 0.1 - 0.4 * 0.05, ..platform.clone() };
        let corrected = CtrvDroneGyro.propagate(&s.push(0.1).push(0.05), 0.5, &biased);
        assert!((corrected.fixed_rows::<5>(0) - exact).abs().max() < 1e-12);
        let far = CtrvDroneGyro.propagate(&s.push(9.0).push(9.0), 0.5, &platform);
        let limit = CtrvDroneGyro.propagate(&s.push(0.5).push(0.2), 0.5, &platform);
        assert_eq!(far.fixed_rows::<5>(0), limit.fixed_rows::<5>(0), "both are bounded");
    }

    /// A target at rest seems to circle a sensor that turns, at the opposite rate.
    #[test]
    fn a_target_at_rest_goes_round_a_turning_sensor() {
        let platform = Platform { rate: 1.0, ..Platform::still() };
        let after = CtrvDrone.propagate(&Vector5::new(2.0, 0.0, 0.0, 0.0, 0.0), 0.5, &platform);
        assert!((after[0] - 2.0 * 0.5_f64.cos()).abs() < 1e-12);
        assert!((after[1] + 2.0 * 0.5_f64.sin()).abs() < 1e-12);
    }
}
