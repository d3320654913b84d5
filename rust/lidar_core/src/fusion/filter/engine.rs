//! What a filter of one target does: predict, and correct with a measurement.

#![allow(non_snake_case)] // textbook letters

use crate::Error;
use crate::estimation::kalman::{Gaussian, Linearised, Mahalanobis, carry, correct, symmetrise};
use crate::fusion::models::motion::{First, Motion, Prior, ProcessNoise};
use crate::fusion::models::platform::Platform;
use crate::fusion::models::turn::wrapped;
use crate::fusion::sensors::measurement::{Measurement, Sensor};
use crate::fusion::sensors::observation::{LineOfSight, Observation, Sensing, polar_difference};
use nalgebra::{Matrix1, Matrix6, SMatrix, SVector, Vector1, Vector6};
use serde::{Deserialize, Serialize};

/// Most states that a model has.
pub const MAX_STATES: usize = 6;

/// How far a measurement was from what was expected.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Innovation {
    /// Measured minus expected: position [m]; or range, bearing and range rate; or turn rate; or
    /// the first three states of the paper's five.
    pub values: [f64; 3],
    /// How many of them there are.
    pub count: usize,
    /// Normalised innovation squared: chi-square with `count` degrees of freedom.
    pub nis: f64,
    /// Natural logarithm of the determinant of its covariance.
    pub log_determinant: f64,
}

impl Innovation {
    /// The difference `y`, `far` from zero.
    #[must_use]
    pub fn new(y: &[f64], far: &Mahalanobis) -> Self {
        let mut values = [0.0; 3];
        values.iter_mut().zip(y).for_each(|(value, entry)| *value = *entry);
        let Mahalanobis { squared: nis, log_determinant } = *far;
        Self { values, count: y.len(), nis, log_determinant }
    }
}

/// Mean and covariance of a state, with room for the largest model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Output {
    /// Number of states.
    pub count: usize,
    /// Mean; the heading within -pi to pi.
    pub mean: [f64; MAX_STATES],
    /// Covariance, symmetric.
    pub covariance: [[f64; MAX_STATES]; MAX_STATES],
}

/// Whether a measurement may correct a state.
pub type Believe<'a> = &'a mut dyn FnMut(&Innovation) -> bool;

/// A filter without memory: the state is handed in.
pub trait Engine: Clone + Send + Sync + 'static {
    /// What it estimates.
    type State: Clone + Send + Sync + 'static;

    /// State of a target that has been seen once.
    fn first(&self, first: &First) -> Self::State;

    /// State of a target whose position and velocity are known, where the model can use them.
    fn after_velocity(&self, cv: &Gaussian<4>) -> Option<Self::State>;

    /// Carry the state on by `dt` [s].
    fn predict(&self, state: &mut Self::State, dt: f64, platform: &Platform);

    /// Correct the state by a measurement, if `believe` says so of its innovation; none where it
    /// says nothing about the state.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] if the covariance of the innovation cannot be factorised;
    /// nothing has changed then.
    fn update(
        &self,
        state: &mut Self::State,
        m: &Measurement,
        platform: &Platform,
        believe: Believe<'_>,
    ) -> Result<Option<Innovation>, Error>;

    /// Mean and covariance.
    fn output(&self, state: &Self::State) -> Output;

    /// One state for weighted ones that have the same past; weights sum to 1.
    fn blended(&self, parts: &[(f64, &Self::State)]) -> Self::State;

    /// The state as plain numbers, for saving.
    fn numbers(&self, state: &Self::State) -> Vec<f64>;

    /// The reverse of [`Self::numbers`]; none for numbers that no state has.
    fn state_of_numbers(&self, numbers: &[f64]) -> Option<Self::State>;

    /// How the state after `dt` [s] hangs on the state before it; none for engines whose past
    /// cannot be smoothed.
    fn link(&self, _state: &Self::State, _dt: f64, _platform: &Platform) -> Option<Link> {
        None
    }
}

/// A prediction to be gone back over: x' = F x + noise of covariance Q. States that a model does
/// not have keep to themselves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link {
    /// Jacobian of the prediction.
    pub F: Matrix6<f64>,
    /// Covariance of what is added.
    pub Q: Matrix6<f64>,
    /// Mean that was predicted, the heading not wrapped.
    pub mean: Vector6<f64>,
    /// Which state is a heading.
    pub heading: Option<usize>,
}

impl Link {
    /// The same where nothing happened: the state stays what it was.
    #[must_use]
    pub fn standing(&self, state: &Output) -> Self {
        let (F, Q) = (Matrix6::identity(), Matrix6::zeros());
        Self { F, Q, mean: Vector6::from(state.mean), heading: self.heading }
    }
}

/// One motion model and how it is estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Single<const N: usize, M> {
    /// How targets move.
    pub motion: M,
    /// What disturbs that.
    pub noise: ProcessNoise,
    /// What is known before.
    pub prior: Prior,
    /// Sensor models.
    pub sensing: Sensing,
}

impl<const N: usize, M: Motion<N>> Single<N, M> {
    fn corrected<const K: usize>(
        state: &mut Gaussian<N>,
        model: &Linearised<N, K>,
        believe: Believe<'_>,
    ) -> Result<Option<Innovation>, Error> {
        let of = |far: &Mahalanobis| Innovation::new(model.y.as_slice(), far);
        let far = correct(state, model, |far| believe(&of(far)))?;
        Ok(Some(of(&far)))
    }
}

impl<const N: usize, M: Motion<N>> Engine for Single<N, M> {
    type State = Gaussian<N>;

    fn first(&self, first: &First) -> Gaussian<N> {
        self.motion.first(first, &self.prior)
    }

    fn after_velocity(&self, cv: &Gaussian<4>) -> Option<Gaussian<N>> {
        self.motion.after_velocity(cv, &self.prior)
    }

    fn predict(&self, state: &mut Gaussian<N>, dt: f64, platform: &Platform) {
        let (mean, F) = self.motion.transition(&state.mean, dt, platform);
        carry(&mut state.covariance, &F);
        let ends = [&state.mean, &mean];
        self.noise.add(&self.motion, ends, dt, platform, &mut state.covariance);
        symmetrise(&mut state.covariance);
        state.mean = mean;
    }

    fn update(
        &self,
        state: &mut Gaussian<N>,
        m: &Measurement,
        platform: &Platform,
        believe: Believe<'_>,
    ) -> Result<Option<Innovation>, Error> {
        if m.sensor() == Sensor::Gyro && M::PLATFORM_RATE.is_none() {
            return Ok(None);
        }
        let sensor = platform.sensor_at(m.stamp_ns());
        let sight = LineOfSight::new(&self.motion, &state.mean, platform, sensor.as_ref());
        match self.sensing.observation(m, sight.range()) {
            Some(Observation::Position { z, R }) => {
                let (expected, H) = sight.place();
                let R = sight.place_noise(R);
                Self::corrected(state, &Linearised { y: z - expected, H, R }, believe)
            }
            Some(Observation::Polar { z, R }) => {
                let (expected, H) = sight.polar_jacobian();
                let (y, R) = (polar_difference(&z, &expected), sight.polar_noise(R));
                Self::corrected(state, &Linearised { y, H, R }, believe)
            }
            Some(Observation::Rate { z, R }) => {
                let Some(index) = M::PLATFORM_RATE else { return Ok(None) };
                let mut H = SMatrix::<f64, 1, N>::zeros();
                H[index] = 1.0;
                let y = Vector1::new(z - state.mean[index]);
                Self::corrected(state, &Linearised { y, H, R: Matrix1::new(R) }, believe)
            }
            None => Ok(None),
        }
    }

    fn output(&self, state: &Gaussian<N>) -> Output {
        output(state, M::HEADING)
    }

    fn blended(&self, parts: &[(f64, &Gaussian<N>)]) -> Gaussian<N> {
        mixed(parts)
    }

    fn numbers(&self, state: &Gaussian<N>) -> Vec<f64> {
        state.numbers()
    }

    fn state_of_numbers(&self, numbers: &[f64]) -> Option<Gaussian<N>> {
        Gaussian::from_numbers(numbers)
    }

    fn link(&self, state: &Gaussian<N>, dt: f64, platform: &Platform) -> Option<Link> {
        let (predicted, jacobian) = self.motion.transition(&state.mean, dt, platform);
        let ends = [&state.mean, &predicted];
        let mut noise = SMatrix::<f64, N, N>::zeros();
        self.noise.add(&self.motion, ends, dt, platform, &mut noise);
        let (mut F, mut Q, mut mean) = (Matrix6::identity(), Matrix6::zeros(), Vector6::zeros());
        F.fixed_view_mut::<N, N>(0, 0).copy_from(&jacobian);
        Q.fixed_view_mut::<N, N>(0, 0).copy_from(&noise);
        mean.fixed_rows_mut::<N>(0).copy_from(&predicted);
        Some(Link { F, Q, mean, heading: M::HEADING })
    }
}

/// Mean and covariance of weighted normal distributions, whose weights sum to 1.
#[must_use]
pub fn mixed<const N: usize>(parts: &[(f64, &Gaussian<N>)]) -> Gaussian<N> {
    let mut mean = SVector::zeros();
    parts.iter().for_each(|(weight, part)| mean += part.mean * *weight);
    let mut covariance = SMatrix::zeros();
    for (weight, part) in parts {
        let apart = part.mean - mean;
        covariance += (part.covariance + apart * apart.transpose()) * *weight;
    }
    symmetrise(&mut covariance);
    Gaussian { mean, covariance }
}

/// `state` with its heading wrapped.
#[must_use]
pub fn output<const N: usize>(state: &Gaussian<N>, heading: Option<usize>) -> Output {
    let (mut mean, mut covariance) = ([0.0; MAX_STATES], [[0.0; MAX_STATES]; MAX_STATES]);
    mean[..N].copy_from_slice(state.mean.as_slice());
    if let Some(index) = heading {
        mean[index] = wrapped(mean[index]);
    }
    for (row, column) in covariance.iter_mut().zip(state.covariance.column_iter()) {
        row[..N].copy_from_slice(column.as_slice()); // symmetric
    }
    Output { count: N, mean, covariance }
}
