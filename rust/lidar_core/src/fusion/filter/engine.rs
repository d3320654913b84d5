//! Filter of one target: prediction, and correction by a measurement.

#![allow(non_snake_case)] // textbook letters

use crate::Error;
use crate::estimation::kalman::{Gaussian, Linearised, Mahalanobis, carry, correct, symmetrise};
use crate::fusion::models::motion::{First, Prior, ProcessNoise};
use crate::fusion::models::platform::Platform;
use crate::fusion::models::turn::wrapped;
use crate::fusion::models::world::World;
use crate::fusion::sensors::measurement::Measurement;
use crate::fusion::sensors::sensing::Sensing;
use crate::fusion::sensors::sight::{Observer, SeenIn, SeenMotion, SeenValues, Sights};
use nalgebra::{SMatrix, SVector};
use serde::{Deserialize, Serialize};

/// Largest number of states of a model.
pub const MAX_STATES: usize = 9;
/// Largest number of values of an innovation that are recorded.
pub const MAX_INNOVATION: usize = 4;
/// Number of recorded values of the paper's radar measurement, which has five values.
const OF_PAPER: usize = 3;

/// Difference of a measurement from its prediction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Innovation {
    /// Measured minus expected values: a position [m]; or the values of a radar (range [m], bearing
    /// and elevation [rad], range rate [m/s], as far as measured); or a turn rate [rad/s]; or the
    /// first three of the five values of the paper's radar.
    pub values: [f64; MAX_INNOVATION],
    /// Number of measured values. The paper's radar has five values, of which only three are
    /// stored.
    pub count: usize,
    /// Normalised innovation squared: chi-square with `count` degrees of freedom.
    pub nis: f64,
    /// Natural logarithm of the determinant of the innovation's covariance.
    pub log_determinant: f64,
    /// Variances of `values`.
    pub variances: [f64; MAX_INNOVATION],
}

impl Innovation {
    /// Innovation of the difference `y`, whose Mahalanobis distance from zero is `far`.
    #[must_use]
    pub fn new<const K: usize>(y: &[f64], far: &Mahalanobis<K>) -> Self {
        let (mut values, mut variances) = ([0.0; MAX_INNOVATION], [0.0; MAX_INNOVATION]);
        let recorded = if y.len() > MAX_INNOVATION { OF_PAPER } else { y.len() };
        let own = values.iter_mut().zip(&mut variances).take(recorded);
        for ((value, variance), (entry, spread)) in own.zip(y.iter().zip(&far.variances)) {
            (*value, *variance) = (*entry, *spread);
        }
        let Mahalanobis { squared: nis, log_determinant, .. } = *far;
        Self { values, count: y.len(), nis, log_determinant, variances }
    }

    /// The values that results store: all values, or the first three of a measurement with more
    /// than [`MAX_INNOVATION`] values (the radar of the published model).
    #[must_use]
    pub fn recorded(&self) -> &[f64] {
        let count = if self.count > MAX_INNOVATION { OF_PAPER } else { self.count };
        &self.values[..count]
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

/// Function that decides by the innovation of a measurement whether the measurement may correct a
/// state.
pub type AcceptInnovation<'a> = &'a mut dyn FnMut(&Innovation) -> bool;

/// A filter without memory: the caller holds the state.
pub trait Engine: Clone + Send + Sync + 'static {
    /// State that is estimated.
    type State: Clone + Send + Sync + 'static;
    /// World in which the target moves: plane or space.
    type World: Sights;

    /// State of a target that has been seen once.
    fn first(&self, first: &First) -> Self::State;

    /// State of a target with known position and velocity; None if the model cannot start from
    /// them.
    fn after_velocity(&self, cv: &<Self::World as World>::Cv) -> Option<Self::State>;

    /// Predict the state `dt` [s] ahead.
    fn predict(&self, state: &mut Self::State, dt: f64, platform: &Platform);

    /// Correct the state by a measurement if `believe` accepts its innovation. None if the
    /// measurement does not depend on the state.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] if the covariance of the innovation cannot be factorised;
    /// nothing has changed then.
    fn update(
        &self,
        state: &mut Self::State,
        m: &Measurement,
        platform: &Platform,
        believe: AcceptInnovation<'_>,
    ) -> Result<Option<Innovation>, Error>;

    /// Call `visit` with the weight and the innovation of a measurement for each part of the state.
    /// Every model of interacting models is a part. Any other state counts as one part of weight 1.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] as of [`Engine::update`].
    fn innovations(
        &self,
        state: &mut Self::State,
        m: &Measurement,
        platform: &Platform,
        visit: &mut dyn FnMut(f64, &Innovation),
    ) -> Result<(), Error> {
        let visited = self.update(state, m, platform, &mut |innovation| {
            visit(1.0, innovation);
            false
        });
        visited.map(|_| ())
    }

    /// Multiply the covariance of the state by `factor`.
    fn loosen(&self, state: &mut Self::State, factor: f64);

    /// Mean and covariance of the state.
    fn output(&self, state: &Self::State) -> Output;

    /// Weighted mean of states with a common past; the weights sum to 1.
    fn blended(&self, parts: &[(f64, &Self::State)]) -> Self::State;

    /// The state as plain numbers, for saving.
    fn numbers(&self, state: &Self::State) -> Vec<f64>;

    /// Inverse of [`Self::numbers`]; None if the numbers do not fit the state.
    fn state_of_numbers(&self, numbers: &[f64]) -> Option<Self::State>;

    /// Linearised transition of the state over `dt` [s], for the smoother; None if the engine
    /// cannot be smoothed.
    fn link(&self, _state: &Self::State, _dt: f64, _platform: &Platform) -> Option<Link> {
        None
    }
}

/// Linearised prediction for the smoother: x' = F x + noise of covariance Q. States outside of the
/// model do not change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link {
    /// Jacobian of the prediction.
    pub F: SMatrix<f64, MAX_STATES, MAX_STATES>,
    /// Covariance of the added noise.
    pub Q: SMatrix<f64, MAX_STATES, MAX_STATES>,
    /// Predicted mean, the heading not wrapped.
    pub mean: SVector<f64, MAX_STATES>,
    /// Index of the state that is a heading; None if there is none.
    pub heading: Option<usize>,
}

impl Link {
    /// Transition from `state` after which the covariance is `factor` times as large.
    #[must_use]
    pub fn loosened(&self, state: &Output, factor: f64) -> Self {
        if factor <= 1.0 {
            return *self;
        }
        let P = SMatrix::from_fn(|row, column| state.covariance[row][column]);
        let carried = self.F * P * self.F.transpose();
        Self { Q: carried * (factor - 1.0) + self.Q * factor, ..*self }
    }

    /// Transition over no time: the state stays as it is.
    #[must_use]
    pub fn standing(&self, state: &Output) -> Self {
        let (F, Q) = (SMatrix::identity(), SMatrix::zeros());
        Self { F, Q, mean: SVector::from(state.mean), heading: self.heading }
    }
}

/// One motion model with an extended Kalman filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Single<const N: usize, M> {
    /// Motion model.
    pub motion: M,
    /// Process noise.
    pub noise: ProcessNoise,
    /// Variances before the second measurement.
    pub prior: Prior,
    /// Sensor models.
    pub sensing: Sensing,
}

/// Corrects `state` by a linearised measurement if `believe` accepts its innovation.
struct Corrected<'a, 'b, const N: usize> {
    state: &'a mut Gaussian<N>,
    believe: AcceptInnovation<'b>,
}

impl<const N: usize> Observer<N> for Corrected<'_, '_, N> {
    type Output = Result<Innovation, Error>;

    fn observe<const K: usize, V: SeenValues<N, K>>(self, seen: &V) -> Self::Output {
        let (expected, H) = seen.linear();
        let y = seen.minus(&seen.measured(), &expected);
        let model = Linearised { y, H, R: seen.noise() };
        let of = |far: &Mahalanobis<K>| Innovation::new(model.y.as_slice(), far);
        let far = correct(self.state, &model, |far| (self.believe)(&of(far)))?;
        Ok(of(&far))
    }
}

impl<const N: usize, M: SeenMotion<N>> Engine for Single<N, M> {
    type State = Gaussian<N>;
    type World = M::World;

    fn first(&self, first: &First) -> Gaussian<N> {
        self.motion.first(first, &self.prior)
    }

    fn after_velocity(&self, cv: &<M::World as World>::Cv) -> Option<Gaussian<N>> {
        self.motion.after_velocity(cv, &self.prior)
    }

    fn predict(&self, state: &mut Gaussian<N>, dt: f64, platform: &Platform) {
        let (mean, F) = self.motion.transition(&state.mean, dt, platform);
        carry(&mut state.covariance, &F);
        let ends = [&state.mean, &mean];
        self.noise.add(&self.motion, ends, dt, platform, &mut state.covariance);
        // Products and noise round differently in the two triangles.
        symmetrise(&mut state.covariance);
        state.mean = mean;
    }

    fn update(
        &self,
        state: &mut Gaussian<N>,
        m: &Measurement,
        platform: &Platform,
        believe: AcceptInnovation<'_>,
    ) -> Result<Option<Innovation>, Error> {
        let mean = state.mean;
        let corrected = Corrected { state, believe };
        M::World::see(&self.motion, &mean, m, &self.sensing, platform, corrected).transpose()
    }

    fn loosen(&self, state: &mut Gaussian<N>, factor: f64) {
        state.covariance *= factor;
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
        // The smoother runs over filters of several sizes: smaller models are padded, which identity
        // and zero noise leave alone.
        let (predicted, jacobian) = self.motion.transition(&state.mean, dt, platform);
        let ends = [&state.mean, &predicted];
        let mut noise = SMatrix::<f64, N, N>::zeros();
        self.noise.add(&self.motion, ends, dt, platform, &mut noise);
        type Wide = SMatrix<f64, MAX_STATES, MAX_STATES>;
        let (mut F, mut Q) = (Wide::identity(), Wide::zeros());
        let mut mean = SVector::<f64, MAX_STATES>::zeros();
        F.fixed_view_mut::<N, N>(0, 0).copy_from(&jacobian);
        Q.fixed_view_mut::<N, N>(0, 0).copy_from(&noise);
        mean.fixed_rows_mut::<N>(0).copy_from(&predicted);
        Some(Link { F, Q, mean, heading: M::HEADING })
    }
}

/// Mean and covariance of a mixture of normal distributions whose weights sum to 1.
#[must_use]
pub fn mixed<const N: usize>(parts: &[(f64, &Gaussian<N>)]) -> Gaussian<N> {
    let mut mean = SVector::zeros();
    parts.iter().for_each(|(weight, part)| mean += part.mean * *weight);
    let mut covariance = SMatrix::zeros();
    for (weight, part) in parts {
        // The distance between the means is part of the uncertainty.
        let apart = part.mean - mean;
        covariance += (part.covariance + apart * apart.transpose()) * *weight;
    }
    symmetrise(&mut covariance);
    Gaussian { mean, covariance }
}

/// Output of `state`; the heading, if it has one, is wrapped.
#[must_use]
pub fn output<const N: usize>(state: &Gaussian<N>, heading: Option<usize>) -> Output {
    let (mut mean, mut covariance) = ([0.0; MAX_STATES], [[0.0; MAX_STATES]; MAX_STATES]);
    mean[..N].copy_from_slice(state.mean.as_slice());
    if let Some(index) = heading {
        // Unwrapped inside the filter, so that differences of means stay small.
        mean[index] = wrapped(mean[index]);
    }
    for (row, entries) in covariance.iter_mut().zip(state.covariance.row_iter()) {
        // The covariance of model paper is not symmetric: rows are not columns.
        row.iter_mut().zip(entries.iter()).for_each(|(entry, &value)| *entry = value);
    }
    Output { count: N, mean, covariance }
}
