//! Motion of one element: modes between which it switches, and prediction over a time.
//!
//! Source: Blom & Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian
//! switching coefficients", IEEE T-AC 33(8), 1988; here the chain runs in continuous time.

#![allow(non_snake_case)] // textbook letters

use super::parameters::{MAX_MODES, MotionMode, Standing};
use crate::estimation::kalman::symmetrised;
use nalgebra::SMatrix;

/// Largest number of modes, standing included, which comes first.
pub(super) const SLOTS: usize = MAX_MODES + 1;
/// Longest step between two mixings [s].
const MAX_STEP: f64 = 0.1;
/// Largest number of steps of one prediction; for longer times the steps become longer.
const MAX_STEPS: f64 = 600.0;
/// Density of the random walk of the half lengths of a box [m^2/s]: another height of the body is
/// seen.
const LENGTHS: f64 = 1e-5;
/// Largest product of rate and time for which the exponential series is summed.
const SERIES: f64 = 1e-3;

pub(super) type Matrix5 = SMatrix<f64, 5, 5>;
pub(super) type Square<const N: usize> = SMatrix<f64, N, N>;
/// Entry (i, j): probability of mode j after a time, if the mode was i before.
type Switching = SMatrix<f64, SLOTS, SLOTS>;

/// Transition matrix of eqs 13 and 15 over `dt` [s]: the centre moves with its velocity.
pub(super) fn transition<const N: usize>(dt: f64) -> Square<N> {
    let mut F = Square::<N>::identity();
    F[(0, 2)] = dt;
    F[(1, 3)] = dt;
    F
}

/// Covariance of white acceleration and of random walks over `dt` >= 0 seconds. Two short steps
/// give the same as one long step.
fn process_covariance<const N: usize>(dt: f64, density: f64, wander: &[f64]) -> Square<N> {
    let mut Q = Square::<N>::zeros();
    for axis in 0..2 {
        Q[(axis, axis)] = density * dt * dt * dt / 3.0;
        Q[(axis, axis + 2)] = density * dt * dt / 2.0;
        Q[(axis + 2, axis)] = Q[(axis, axis + 2)];
        Q[(axis + 2, axis + 2)] = density * dt;
    }
    for (row, density) in (4..N).zip(wander) {
        Q[(row, row)] = density * dt;
    }
    Q
}

/// Covariance of a random walk of the centre and of the other values over `dt` >= 0 seconds.
fn wandering<const N: usize>(dt: f64, density: f64, wander: &[f64]) -> Square<N> {
    let mut Q = process_covariance(dt, 0.0, wander);
    for axis in 0..2 {
        Q[(axis, axis)] = density * dt;
    }
    Q
}

/// Model of the motion of elements: modes, rates of switching between them, and random walks.
#[derive(Clone, Debug)]
pub(super) struct ElementMotion {
    pub(super) modes: Vec<MotionMode>,
    pub(super) standing: Option<Standing>,
    radius_density: f64,
    turn_density: f64,
    line_density: f64,
    /// Rates of switching from mode to mode [1/s].
    rates: Switching,
}

/// Prediction of states of N values, in `count` equal steps.
pub(super) struct Move<const N: usize> {
    pub(super) count: usize,
    /// Variance of the velocity after standing; None without that mode [m^2/s^2].
    pub(super) start: Option<f64>,
    pub(super) F: Square<N>,
    pub(super) Q: Vec<Square<N>>,
    pub(super) switching: Switching,
}

/// Prediction over a given time, shared by all elements.
pub(super) struct ElementStep {
    /// Prediction of circles: centre, velocity, radius.
    pub(super) circles: Move<5>,
    /// Prediction of other outlines: centre, velocity, heading, half lengths.
    pub(super) outlines: Move<7>,
    /// Prediction of boxes: centre, velocity, half lengths.
    pub(super) extents: Move<6>,
    /// Time of the whole step [s].
    pub(super) seconds: f64,
    line_variance: f64,
}

impl ElementStep {
    /// Variance of the random walk of lines over the whole step [m^2].
    pub(super) fn line_variance(&self) -> f64 {
        self.line_variance
    }
}

impl ElementMotion {
    /// Motion from modes and from the densities of radii and half lengths, of headings, and of
    /// lines. If `standing` has a weight, it is the first mode.
    pub(super) fn new(
        modes: &[MotionMode],
        standing: &Standing,
        [radius, turn, line]: [f64; 3],
    ) -> Self {
        let standing = Some(*standing).filter(|one| one.share > 0.0);
        let total: f64 = modes.iter().map(|mode| mode.weight).sum();
        let moving = 1.0 - standing.map_or(0.0, |one| one.share);
        let mut all: Vec<MotionMode> = standing.iter().map(still).collect();
        all.extend(
            modes.iter().map(|one| MotionMode { weight: one.weight / total * moving, ..*one }),
        );
        let modes = all;
        let mut rates = Switching::zeros();
        for (from, mode) in modes.iter().enumerate() {
            let stands = |number: usize| standing.filter(|_| number == 0);
            let elsewhere = others(&modes, from)
                .filter(|&(number, _)| stands(number).is_none())
                .map(|(_, other)| other.weight)
                .sum::<f64>();
            for (to, other) in others(&modes, from) {
                rates[(from, to)] = match stands(to) {
                    Some(standing) => 1.0 / standing.moving,
                    None => other.weight / elsewhere / mode.duration,
                };
                // Rows of rates sum to zero, so that probabilities keep summing to one.
                rates[(from, from)] -= rates[(from, to)];
            }
        }
        Self {
            modes,
            standing,
            radius_density: radius,
            turn_density: turn,
            line_density: line,
            rates,
        }
    }

    /// Prediction over `dt` seconds without changes of the mode: the mean moves at its velocity.
    pub(super) fn coast(&self, dt: f64) -> ElementStep {
        let mut motion = self.clone();
        if motion.standing.is_some() {
            for mode in 1..SLOTS {
                motion.rates[(mode, mode)] += motion.rates[(mode, 0)];
                (motion.rates[(mode, 0)], motion.rates[(0, mode)]) = (0.0, 0.0);
            }
            motion.rates[(0, 0)] = 0.0;
        }
        motion.step(dt)
    }

    /// Prediction over `dt` seconds.
    pub(super) fn step(&self, dt: f64) -> ElementStep {
        let size = self.radius_density;
        ElementStep {
            circles: self.movement(dt, &[size]),
            outlines: self.movement(dt, &[self.turn_density, size, size]),
            extents: self.movement(dt, &[LENGTHS; 2]),
            seconds: dt,
            line_variance: self.line_density * dt.abs(),
        }
    }

    fn movement<const N: usize>(&self, dt: f64, wander: &[f64]) -> Move<N> {
        // Long times are split: modes that last shorter than a step would be mixed only once, and
        // the mixture would depend on the rate of the scans.
        let count = (dt.abs() / MAX_STEP).ceil().clamp(1.0, MAX_STEPS);
        let part = dt / count;
        // Backwards in time the noise acts before the transition.
        let back: Square<N> = transition(part.min(0.0));
        let Q = self.modes.iter().enumerate().map(|(number, mode)| {
            if number == 0 && self.standing.is_some() {
                return wandering(part.abs(), mode.density, wander);
            }
            let Q = process_covariance(part.abs(), mode.density, wander);
            symmetrised(back * Q * back.transpose())
        });
        Move {
            count: count as usize,
            start: self.standing.map(|one| one.start_speed * one.start_speed),
            F: transition(part),
            Q: Q.collect(),
            switching: exponential(&self.rates, part.abs()),
        }
    }
}

/// Standing as a mode.
fn still(one: &Standing) -> MotionMode {
    MotionMode { density: one.density, weight: one.share, duration: one.duration }
}

/// All modes except one, with their indices.
fn others(modes: &[MotionMode], but: usize) -> impl Iterator<Item = (usize, &MotionMode)> {
    modes.iter().enumerate().filter(move |&(index, _)| index != but)
}

/// Matrix exponential e^(rates * time) by scaling and squaring.
fn exponential(rates: &Switching, time: f64) -> Switching {
    let mut squarings = 0;
    let mut part = time;
    // Powers of two are exact, so that the scaling itself adds no error.
    while part * rates.abs().max() > SERIES && squarings < 64 {
        part *= 0.5;
        squarings += 1;
    }
    let A = rates * part;
    let mut sum = Switching::identity();
    let mut term = Switching::identity();
    for order in 1..5 {
        term = term * A / f64::from(order);
        sum += term;
    }
    for _ in 0..squarings {
        sum = sum * sum;
    }
    sum
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in crate::circles::map) fn motion() -> ElementMotion {
        let mode = |density, weight, duration| MotionMode { density, weight, duration };
        ElementMotion::new(
            &[mode(0.01, 0.5, 2.0), mode(1.0, 0.45, 1.0), mode(50.0, 0.05, 0.1)],
            &Standing { share: 0.0, ..standing() },
            [1e-6, 0.0, 0.0],
        )
    }

    pub(in crate::circles::map) fn standing() -> Standing {
        Standing {
            share: 0.5,
            duration: 10.0,
            moving: 20.0,
            density: 1e-4,
            start_speed: 1.0,
            hysteresis: [0.8, 0.2],
        }
    }

    #[test]
    fn chances_of_switching_sum_to_one_and_compose() {
        let rates = motion().rates;
        let (half, whole) = (exponential(&rates, 0.35), exponential(&rates, 0.7));
        assert!((half * half - whole).abs().max() < 1e-12);
        for row in 0..3 {
            assert!((whole.row(row).sum() - 1.0).abs() < 1e-12);
        }
        assert!(
            (exponential(&rates, 100.0).row(0) - exponential(&rates, 100.0).row(2)).abs().max()
                < 1e-9
        );
    }

    #[test]
    fn noise_does_not_depend_on_how_a_step_is_split() {
        let [short, long] = [0.3, 0.6].map(|dt| process_covariance::<5>(dt, 2.0, &[0.1]));
        let F = transition::<5>(0.3);
        assert!((F * short * F.transpose() + short - long).abs().max() < 1e-15);
    }
}
