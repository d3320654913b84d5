//! What a filter of one target does: predict, and correct with a measurement.

#![allow(non_snake_case)] // textbook letters

use super::measurement::{Measurement, Sensor};
use super::motion::{First, Motion, Prior, ProcessNoise};
use super::platform::Platform;
use super::sensors::{LineOfSight, Observation, Sensing, polar_difference};
use super::turn::wrapped;
use crate::Error;
use crate::estimation::kalman::{Gaussian, Linearised, Update, symmetrised, update};
use nalgebra::{Matrix1, Matrix6, SMatrix, Vector1, Vector6};

/// Most states that a model has.
pub const MAX_STATES: usize = 6;

/// How far a measurement was from what was expected.
#[derive(Clone, Copy, Debug, PartialEq)]
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

/// A filter without memory: the state is handed in and out.
pub trait Engine: Clone + Send + Sync + 'static {
    /// What it estimates.
    type State: Clone + Send + Sync + 'static;

    /// State of a target that has been seen once.
    fn first(&self, first: &First) -> Self::State;

    /// State of a target whose position and velocity are known, where the model can use them.
    fn after_velocity(&self, cv: &Gaussian<4>) -> Option<Self::State>;

    /// State after `dt` [s].
    fn predict(&self, state: &Self::State, dt: f64, platform: &Platform) -> Self::State;

    /// State corrected by a measurement; none where it corrects nothing of the state.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] if the covariance of the innovation cannot be factorised.
    fn update(
        &self,
        state: &Self::State,
        m: &Measurement,
        platform: &Platform,
    ) -> Result<Option<(Self::State, Innovation)>, Error>;

    /// Mean and covariance.
    fn output(&self, state: &Self::State) -> Output;

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
        state: &Gaussian<N>,
        model: &Linearised<N, K>,
    ) -> Result<Option<(Gaussian<N>, Innovation)>, Error> {
        let Update { posterior, nis, log_determinant } = update(state, model)?;
        let mut values = [0.0; 3];
        values[..K].copy_from_slice(model.y.as_slice());
        Ok(Some((posterior, Innovation { values, count: K, nis, log_determinant })))
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

    fn predict(&self, state: &Gaussian<N>, dt: f64, platform: &Platform) -> Gaussian<N> {
        let (mean, F) = self.motion.transition(&state.mean, dt, platform);
        let Q = self.noise.covariance(&self.motion, [&state.mean, &mean], dt, platform);
        Gaussian { mean, covariance: symmetrised(F * state.covariance * F.transpose() + Q) }
    }

    fn update(
        &self,
        state: &Gaussian<N>,
        m: &Measurement,
        platform: &Platform,
    ) -> Result<Option<(Gaussian<N>, Innovation)>, Error> {
        if m.sensor() == Sensor::Gyro && M::PLATFORM_RATE.is_none() {
            return Ok(None);
        }
        let sensor = platform.sensor_at(m.stamp_ns());
        let sight = LineOfSight::new(&self.motion, &state.mean, platform, sensor.as_ref());
        match self.sensing.observation(m, sight.range()) {
            Some(Observation::Position { z, R }) => {
                let (expected, H) = sight.place();
                Self::corrected(state, &Linearised { y: z - expected, H, R })
            }
            Some(Observation::Polar { z, R }) => {
                let y = polar_difference(&z, &sight.polar());
                Self::corrected(state, &Linearised { y, H: sight.polar_jacobian(), R })
            }
            Some(Observation::Rate { z, R }) => {
                let Some(index) = M::PLATFORM_RATE else { return Ok(None) };
                let mut H = SMatrix::<f64, 1, N>::zeros();
                H[index] = 1.0;
                let y = Vector1::new(z - state.mean[index]);
                Self::corrected(state, &Linearised { y, H, R: Matrix1::new(R) })
            }
            None => Ok(None),
        }
    }

    fn output(&self, state: &Gaussian<N>) -> Output {
        output(state, M::HEADING)
    }

    fn link(&self, state: &Gaussian<N>, dt: f64, platform: &Platform) -> Option<Link> {
        let (predicted, jacobian) = self.motion.transition(&state.mean, dt, platform);
        let ends = [&state.mean, &predicted];
        let noise = self.noise.covariance(&self.motion, ends, dt, platform);
        let (mut F, mut Q, mut mean) = (Matrix6::identity(), Matrix6::zeros(), Vector6::zeros());
        F.fixed_view_mut::<N, N>(0, 0).copy_from(&jacobian);
        Q.fixed_view_mut::<N, N>(0, 0).copy_from(&noise);
        mean.fixed_rows_mut::<N>(0).copy_from(&predicted);
        Some(Link { F, Q, mean, heading: M::HEADING })
    }
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
