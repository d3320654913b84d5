//! State of one element in every mode of its motion: prediction, distances, correction, mixture.

#![allow(non_snake_case)] // textbook letters

use super::circle_measurement::Measures;
use super::element_motion::{ElementMotion, Move, SLOTS, Square};
use crate::Error;
use crate::estimation::kalman::{Gaussian, Linearised, mahalanobis, symmetrised, update};
use nalgebra::SVector;
use serde::{Deserialize, Serialize};

/// Least standard deviation of the velocity of a standing element, per axis [m/s].
const STILL_SPEED: f64 = 1e-3;
/// Weight of a mode below which it is rare.
const RARE: f64 = 0.01;
/// Least probability of a mode.
const LEAST: f64 = 1e-30;
pub(super) const LN_2_PI: f64 = 1.837_877_066_409_345_3;

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
        // A switch changes the velocity: it is zero after a stop and unknown after a start. Only the
        // position is carried over.
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

    /// Set the velocity to zero in every mode and keep its uncertainty.
    pub(super) fn halt(&mut self) {
        for state in &mut self.states {
            let variance = 0.5 * (state.covariance[(2, 2)] + state.covariance[(3, 3)]);
            set_speed(state, variance);
        }
    }

    /// Exchange two values of the state.
    pub(super) fn swap(&mut self, one: usize, other: usize) {
        for state in &mut self.states {
            state.mean.swap_rows(one, other);
            state.covariance.swap_rows(one, other);
            state.covariance.swap_columns(one, other);
        }
    }

    /// Probability that the element stands; 0 without that mode.
    pub(super) fn standing(&self, motion: &ElementMotion) -> f64 {
        if motion.standing.is_some() { self.probabilities[0] } else { 0.0 }
    }

    /// Distances of a measurement from the modes.
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

    /// Mean over all modes.
    pub(super) fn mean(&self) -> SVector<f64, N> {
        mean_of(&self.states, &self.probabilities)
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

    /// Correct with a measurement. A scan may show another part of a standing object: `standing`
    /// holds the measurement for this case, its probability, and other evidence for the first mode
    /// (logarithm of the Bayes factor against the other modes).
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] if an innovation covariance cannot be factorised; the state
    /// is then unchanged.
    pub(super) fn correct<const M: usize, S: Measures<N, M>>(
        &mut self,
        seen: &S,
        standing: Option<(&S, f64, f64)>,
    ) -> Result<(), Error> {
        let mut costs = [f64::INFINITY; SLOTS];
        let mut states = Vec::with_capacity(self.states.len());
        for (index, state) in self.states.iter().enumerate() {
            let mut corrected = update(state, &seen.against(&state.mean))?;
            costs[index] = corrected.nis + corrected.log_determinant;
            if let Some((part, share, evidence)) = standing.filter(|_| index == 0) {
                let of_part = update(state, &part.against(&state.mean))?;
                let cost = of_part.nis + of_part.log_determinant - 2.0 * libm::log(share);
                if cost < costs[0] {
                    corrected = of_part;
                }
                costs[0] = joined(costs[0], cost) - 2.0 * evidence;
            }
            costs[index] -= 2.0 * libm::log(self.probabilities[index]);
            states.push(corrected.posterior);
        }
        let total = log_sum(&costs);
        for (probability, cost) in self.probabilities.iter_mut().zip(costs).take(states.len()) {
            // No mode is given up for good: zero would stay zero.
            *probability = libm::exp(-0.5 * cost - total).max(LEAST);
        }
        self.states = states;
        Ok(())
    }

    /// Correct with a rough measurement whose error may be the same in every scan. It changes the probabilities of the
    /// modes and the states of all modes but the first.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] if an innovation covariance cannot be factorised; the state
    /// is then unchanged.
    pub(super) fn weigh<const M: usize>(
        &mut self,
        seen: &impl Measures<N, M>,
    ) -> Result<(), Error> {
        let first = self.states.first().cloned();
        self.correct(seen, None)?;
        for (state, first) in self.states.iter_mut().zip(first) {
            *state = first;
        }
        Ok(())
    }
}

/// The state with velocity zero. The old velocity is added to the covariance, so that the
/// probability of motion does not change.
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

/// Cost of two exclusive explanations with a cost each: -2 ln of the sum of their likelihoods.
pub(super) fn joined(one: f64, other: f64) -> f64 {
    -2.0 * log_sum(&[one, other])
}

/// Logarithm of the sum of e^(-cost / 2).
fn log_sum(costs: &[f64]) -> f64 {
    // Relative to the least cost: the terms of a far measurement would all underflow.
    let least = costs.iter().copied().fold(f64::INFINITY, f64::min);
    let sum: f64 = costs.iter().map(|cost| libm::exp(-0.5 * (cost - least))).sum();
    libm::log(sum) - 0.5 * least
}

/// Mean and covariance of a mixture of modes; the weights sum to one.
fn mixture<const N: usize>(states: &[Gaussian<N>], weights: &[f64; SLOTS]) -> Gaussian<N> {
    if let [state] = states { state.clone() } else { mixture_of(states, weights) }
}

/// Mean of a mixture of states; the weights sum to one.
fn mean_of<const N: usize>(states: &[Gaussian<N>], weights: &[f64]) -> SVector<f64, N> {
    if let [state] = states {
        return state.mean;
    }
    let mut mean = SVector::<f64, N>::zeros();
    for (state, &weight) in states.iter().zip(weights) {
        mean += state.mean * weight;
    }
    mean
}

/// Mean and covariance of a mixture of any states; the weights sum to one.
pub(super) fn mixture_of<const N: usize>(states: &[Gaussian<N>], weights: &[f64]) -> Gaussian<N> {
    let mean = mean_of(states, weights);
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
    use crate::circles::map::circle_measurement::{CircleMeasurement, new_state};
    use crate::circles::map::element_motion::tests::{motion, standing};
    use crate::circles::map::element_motion::transition;
    use crate::circles::map::parameters::{MotionMode, Standing};
    use nalgebra::{Matrix3, Vector3};

    fn measurement(x: f64) -> CircleMeasurement {
        CircleMeasurement {
            z: Vector3::new(x, 1.0, 0.3),
            R: Matrix3::identity() * 1e-4,
            delay: 0.0,
        }
    }

    #[test]
    fn the_mixture_keeps_its_mean_when_nothing_is_measured() -> Result<(), Error> {
        let motion = motion();
        let mut modes = ElementModes::new(new_state(&measurement(0.0), 1.5), &motion);
        for step in 1..5 {
            modes.predict(&motion.step(0.05).circles);
            modes.correct(&measurement(0.05 * f64::from(step)), None)?;
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
            modes.correct(&measurement(0.0), None)?;
        }
        modes.predict(&motion.step(0.05).circles);
        assert!(modes.cost(&measurement(0.1), 11.3)?.is_some());
        assert!(modes.cost(&measurement(5.0), 11.3)?.is_none());
        modes.correct(&measurement(0.1), None)?;
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
            modes.correct(&measurement(x), None)?;
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
