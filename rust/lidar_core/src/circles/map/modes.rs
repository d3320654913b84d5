//! Motion of one element: several modes at once, between which it switches.
//!
//! Source: Blom & Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian
//! switching coefficients", IEEE T-AC 33(8), 1988; here the chain runs in continuous time.

#![allow(non_snake_case)] // textbook letters

use super::parameters::{MAX_MODES, MotionMode, Standing};
use crate::Error;
use crate::estimation::kalman::{Gaussian, Linearised, mahalanobis, symmetrised, update};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use serde::{Deserialize, Serialize};

/// Largest number of modes, standing included, which comes first.
const SLOTS: usize = MAX_MODES + 1;
/// Longest step between two mixings [s].
const MAX_STEP: f64 = 0.1;
/// Most steps of one prediction; for longer times the steps become longer.
const MAX_STEPS: f64 = 600.0;
/// Largest product of rate and time for which the exponential series is summed.
const SERIES: f64 = 1e-3;
/// Least standard deviation of the velocity of what stands, per axis [m/s].
const STILL_SPEED: f64 = 1e-3;
/// Weight of a mode below which it is rare.
const RARE: f64 = 0.01;
/// Least probability of a mode.
const LEAST: f64 = 1e-30;
const LN_2_PI: f64 = 1.837_877_066_409_345_3;

pub(super) type Matrix5 = SMatrix<f64, 5, 5>;
type Square<const N: usize> = SMatrix<f64, N, N>;
/// Entry (i, j): probability of mode j after a time, if the mode was i before.
type Switching = SMatrix<f64, SLOTS, SLOTS>;

/// A measurement of M values of a state of N values: centre x and y, their velocities, then the
/// values of a random walk.
pub(super) trait Measures<const N: usize, const M: usize> {
    /// Linearised measurement at a state.
    fn against(&self, state: &SVector<f64, N>) -> Linearised<N, M>;
}

/// A circle in the world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct CircleMeasurement {
    /// Centre and radius [m].
    pub(super) z: Vector3<f64>,
    /// Their covariance.
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

/// State of eqs 18-20: a circle at rest, of unknown velocity.
pub(super) fn new_state(measurement: &CircleMeasurement, speed: f64) -> Gaussian<5> {
    at_rest(measurement.z, measurement.R, measurement.delay, speed)
}

/// State of an object measured for the first time: at rest, of unknown velocity.
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
    let back = transition(-delay); // to the stamp
    let covariance = symmetrised(back * covariance * back.transpose());
    Gaussian { mean: H.transpose() * z, covariance }
}

/// Transition matrix of eqs 13 and 15.
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

/// Motion of elements.
#[derive(Clone, Debug)]
pub(super) struct ElementMotion {
    modes: Vec<MotionMode>,
    standing: Option<Standing>,
    radius_density: f64,
    turn_density: f64,
    line_density: f64,
    /// Rates of the chain [1/s].
    rates: Switching,
}

/// Prediction of states of N values.
pub(super) struct Move<const N: usize> {
    count: usize,
    /// Variance of the velocity after standing; None without that mode [m^2/s^2].
    start: Option<f64>,
    F: Square<N>,
    Q: Vec<Square<N>>,
    switching: Switching,
}

/// Prediction over a given time, shared by all elements.
pub(super) struct ElementStep {
    /// Prediction of circles: centre, velocity, radius.
    pub(super) circles: Move<5>,
    /// Prediction of other outlines: centre, velocity, heading, half lengths.
    pub(super) outlines: Move<7>,
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
    /// lines. Standing, if it has a weight, is the first mode.
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

    /// Prediction over `dt` seconds in which nothing stops or starts: the mean moves at its
    /// velocity.
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

/// All modes except one, with their numbers.
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

/// Squared distance of a measurement from a mode, in variances and in squared units.
#[derive(Clone, Copy, Debug)]
pub(super) struct Distance {
    pub(super) squared: f64,
    pub(super) length: f64,
}

impl Distance {
    fn nearer(self, other: Self) -> Self {
        if other.squared < self.squared { other } else { self }
    }
}

/// Distances from the nearest mode, the nearest that is not rare, and the first one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Distances {
    pub(super) least: Distance,
    pub(super) calm: Distance,
    pub(super) first: Distance,
}

/// State of an element in every mode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct ElementModes<const N: usize> {
    states: Vec<Gaussian<N>>,
    probabilities: [f64; SLOTS],
}

impl<const N: usize> ElementModes<N> {
    pub(super) fn new(state: Gaussian<N>, motion: &ElementMotion) -> Self {
        let mut probabilities = [0.0; SLOTS];
        for (probability, mode) in probabilities.iter_mut().zip(&motion.modes) {
            *probability = mode.weight;
        }
        let mut states = vec![state; motion.modes.len()];
        if let (Some(_), [first, ..]) = (motion.standing, states.as_mut_slice()) {
            set_speed(first, 0.0);
        }
        Self { states, probabilities }
    }

    /// True if a restored state has one part per mode of `motion`.
    pub(super) fn fits(&self, motion: &ElementMotion) -> bool {
        self.states.len() == motion.modes.len()
    }

    /// Predict by `step`.
    pub(super) fn predict(&mut self, step: &Move<N>) {
        for _ in 0..step.count {
            self.mix(step);
            for (state, Q) in self.states.iter_mut().zip(&step.Q) {
                state.mean = step.F * state.mean;
                let P = step.F * state.covariance * step.F.transpose();
                state.covariance = symmetrised(P + Q);
            }
        }
    }

    /// Mixing step: every mode becomes the mean of the modes that it may come from.
    fn mix(&mut self, step: &Move<N>) {
        if self.states.len() == 1 {
            return;
        }
        let before = self.clone();
        // What stops has no velocity, what starts has any: the velocity does not go over with the
        // position.
        let (mut stopped, mut started) = (before.states.clone(), before.states.clone());
        if let Some(start) = step.start {
            stopped.iter_mut().skip(1).for_each(|state| set_speed(state, 0.0));
            started.iter_mut().take(1).for_each(|state| set_speed(state, start));
        }
        for to in 0..self.states.len() {
            let weights: [f64; SLOTS] =
                std::array::from_fn(|from| before.probabilities[from] * step.switching[(from, to)]);
            let total: f64 = weights.iter().sum();
            let states = if to == 0 && step.start.is_some() { &stopped } else { &started };
            self.probabilities[to] = total;
            // A mode into which nothing leads, and which has no probability itself, stays as it is.
            if total > 0.0 {
                self.states[to] = mixture(states, &weights.map(|weight| weight / total));
            }
        }
    }

    /// Probability that the element stands; 0 without that mode.
    pub(super) fn standing(&self, motion: &ElementMotion) -> f64 {
        if motion.standing.is_some() { self.probabilities[0] } else { 0.0 }
    }

    /// How far a measurement is from the modes.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] if an innovation covariance cannot be factorised.
    pub(super) fn distances<const M: usize>(
        &self,
        seen: &impl Measures<N, M>,
        motion: &ElementMotion,
    ) -> Result<Distances, Error> {
        let far = Distance { squared: f64::INFINITY, length: f64::INFINITY };
        let (mut least, mut calm, mut first) = (far, far, None);
        for (state, mode) in self.states.iter().zip(&motion.modes) {
            let Linearised { y, H, R } = seen.against(&state.mean);
            let S = symmetrised(H * state.covariance * H.transpose() + R);
            let here = Distance { squared: mahalanobis(&y, &S)?.squared, length: y.dot(&y) };
            least = least.nearer(here);
            if mode.weight >= RARE {
                calm = calm.nearer(here);
            }
            first = first.or(Some(here));
        }
        Ok(Distances { least, calm, first: first.unwrap_or(least) })
    }

    /// Mean and covariance over all modes.
    pub(super) fn combined(&self) -> Gaussian<N> {
        mixture(&self.states, &self.probabilities)
    }

    /// -2 ln of the likelihood of `seen`; with one mode d^2 + ln det S + M ln(2 pi). None if it is
    /// outside the gate of every mode.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] if an innovation covariance cannot be factorised.
    pub(super) fn cost<const M: usize>(
        &self,
        seen: &impl Measures<N, M>,
        gate: f64,
    ) -> Result<Option<f64>, Error> {
        let mut best = f64::INFINITY;
        let mut costs = [f64::INFINITY; SLOTS];
        for (index, state) in self.states.iter().enumerate() {
            let Linearised { y, H, R } = seen.against(&state.mean);
            let S = symmetrised(H * state.covariance * H.transpose() + R);
            if y.dot(&y) > gate * S.trace() {
                continue; // no eigenvalue of S is larger than its trace
            }
            let distance = mahalanobis(&y, &S)?;
            best = best.min(distance.squared);
            costs[index] = distance.squared + distance.log_determinant + M as f64 * LN_2_PI
                - 2.0 * libm::log(self.probabilities[index]);
        }
        Ok((best <= gate).then(|| -2.0 * log_sum(&costs)))
    }

    /// Correct with a measurement, and with other `evidence` for the first mode: the logarithm of
    /// its Bayes factor against the other modes.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] if an innovation covariance cannot be factorised; the state
    /// is then unchanged.
    pub(super) fn correct<const M: usize>(
        &mut self,
        seen: &impl Measures<N, M>,
        evidence: f64,
    ) -> Result<(), Error> {
        let mut costs = [f64::INFINITY; SLOTS];
        let mut states = Vec::with_capacity(self.states.len());
        for (index, state) in self.states.iter().enumerate() {
            let corrected = update(state, &seen.against(&state.mean))?;
            costs[index] = corrected.nis + corrected.log_determinant
                - 2.0 * libm::log(self.probabilities[index]);
            states.push(corrected.posterior);
        }
        costs[0] -= 2.0 * evidence;
        let total = log_sum(&costs);
        for (probability, cost) in self.probabilities.iter_mut().zip(costs).take(states.len()) {
            // No mode is given up for good: zero would stay zero.
            *probability = libm::exp(-0.5 * cost - total).max(LEAST);
        }
        self.states = states;
        Ok(())
    }
}

/// The state with velocity zero, and with the covariance of its error then: that it moves after all
/// stays as probable as it is.
pub(super) fn halted<const N: usize>(mut state: Gaussian<N>) -> Gaussian<N> {
    let speed = [state.mean[2], state.mean[3]];
    for row in 0..2 {
        for column in 0..2 {
            state.covariance[(row + 2, column + 2)] += speed[row] * speed[column];
        }
        state.covariance[(row + 2, row + 2)] += STILL_SPEED * STILL_SPEED;
        state.mean[row + 2] = 0.0;
    }
    state
}

/// Make the velocity of a state zero, independent of the position, with a variance per axis.
pub(super) fn set_speed<const N: usize>(state: &mut Gaussian<N>, variance: f64) {
    for axis in 2..4 {
        state.mean[axis] = 0.0;
        state.covariance.row_mut(axis).fill(0.0);
        state.covariance.column_mut(axis).fill(0.0);
        state.covariance[(axis, axis)] = variance;
    }
}

/// Logarithm of the sum of e^(-cost / 2).
fn log_sum(costs: &[f64; SLOTS]) -> f64 {
    // Relative to the least cost: the terms of a far measurement would all underflow.
    let least = costs.iter().copied().fold(f64::INFINITY, f64::min);
    let sum: f64 = costs.iter().map(|cost| libm::exp(-0.5 * (cost - least))).sum();
    libm::log(sum) - 0.5 * least
}

/// Mean and covariance of a mixture; the weights sum to one.
fn mixture<const N: usize>(states: &[Gaussian<N>], weights: &[f64; SLOTS]) -> Gaussian<N> {
    if let [state] = states {
        return state.clone();
    }
    let mut mean = SVector::<f64, N>::zeros();
    for (state, &weight) in states.iter().zip(weights) {
        mean += state.mean * weight;
    }
    let mut covariance = Square::<N>::zeros();
    for (state, &weight) in states.iter().zip(weights) {
        let apart = state.mean - mean;
        covariance += (state.covariance + apart * apart.transpose()) * weight;
    }
    Gaussian { mean, covariance: symmetrised(covariance) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn motion() -> ElementMotion {
        let mode = |density, weight, duration| MotionMode { density, weight, duration };
        ElementMotion::new(
            &[mode(0.01, 0.5, 2.0), mode(1.0, 0.45, 1.0), mode(50.0, 0.05, 0.1)],
            &Standing { share: 0.0, ..standing() },
            [1e-6, 0.0, 0.0],
        )
    }

    fn standing() -> Standing {
        Standing {
            share: 0.5,
            duration: 10.0,
            moving: 20.0,
            density: 1e-4,
            start_speed: 1.0,
            hysteresis: [0.8, 0.2],
        }
    }

    fn measurement(x: f64) -> CircleMeasurement {
        CircleMeasurement {
            z: Vector3::new(x, 1.0, 0.3),
            R: Matrix3::identity() * 1e-4,
            delay: 0.0,
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

    #[test]
    fn the_mixture_keeps_its_mean_when_nothing_is_measured() -> Result<(), Error> {
        let motion = motion();
        let mut modes = ElementModes::new(new_state(&measurement(0.0), 1.5), &motion);
        for step in 1..5 {
            modes.predict(&motion.step(0.05).circles);
            modes.correct(&measurement(0.05 * f64::from(step)), 0.0)?;
        }
        let before = modes.combined();
        modes.predict(&motion.step(0.4).circles);
        let after = modes.combined();
        assert!((after.mean - transition(0.4) * before.mean).abs().max() < 1e-12);
        assert!((modes.probabilities.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert!(after.covariance.cholesky().is_some());
        Ok(())
    }

    #[test]
    fn a_jump_is_within_the_gate_and_followed() -> Result<(), Error> {
        let motion = motion();
        let mut modes = ElementModes::new(new_state(&measurement(0.0), 1.5), &motion);
        for _ in 0..40 {
            modes.predict(&motion.step(0.05).circles);
            modes.correct(&measurement(0.0), 0.0)?;
        }
        modes.predict(&motion.step(0.05).circles);
        assert!(modes.cost(&measurement(0.1), 11.3)?.is_some());
        assert!(modes.cost(&measurement(5.0), 11.3)?.is_none());
        modes.correct(&measurement(0.1), 0.0)?;
        assert!((modes.combined().mean[0] - 0.1).abs() < 0.01);
        Ok(())
    }

    #[test]
    fn what_stands_is_known_to_stand_and_what_leaves_is_noticed() -> Result<(), Error> {
        let mode = MotionMode { density: 0.5, weight: 1.0, duration: 2.0 };
        let motion = ElementMotion::new(&[mode], &standing(), [1e-6, 0.0, 0.0]);
        let mut modes = ElementModes::new(new_state(&measurement(0.0), 1.5), &motion);
        let mut see = |x: f64| -> Result<f64, Error> {
            modes.predict(&motion.step(0.05).circles);
            modes.correct(&measurement(x), 0.0)?;
            Ok(modes.standing(&motion))
        };
        for step in 0..40 {
            see(0.01 * f64::from(step % 2))?;
        }
        assert!(see(0.0)? > 0.95);
        let mut after = 1.0;
        for step in 1..=10 {
            after = see(0.5 * 0.05 * f64::from(step))?; // 0.5 m/s for 0.5 s
        }
        assert!(after < 0.05, "{after}");
        for step in 1..=20 {
            after = see(0.25 + 0.025 * f64::from(step))?;
        }
        assert!(after < 0.01, "{after}");
        Ok(())
    }

    #[test]
    fn one_mode_costs_what_the_textbook_says() -> Result<(), Error> {
        let mode = MotionMode { density: 1.0, weight: 3.0, duration: 1.0 };
        let motion = ElementMotion::new(&[mode], &Standing { share: 0.0, ..standing() }, [0.0; 3]);
        let modes = ElementModes::new(new_state(&measurement(0.0), 1.0), &motion);
        let got = modes.cost(&measurement(0.01), 11.3)?;
        let expected = 0.5 + 3.0 * libm::log(2e-4) + 3.0 * LN_2_PI;
        assert!(got.is_some_and(|cost| (cost - expected).abs() < 1e-9));
        Ok(())
    }
}
