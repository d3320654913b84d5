//! Interacting multiple models: several models share one target.

#![allow(non_snake_case)] // textbook letters

use super::engine::{AcceptInnovation, Engine, Innovation, Output, Single, mixed, output};
use crate::Error;
use crate::estimation::kalman::Gaussian;
use crate::fusion::models::motion::First;
use crate::fusion::models::platform::Platform;
use crate::fusion::models::state_conversion::StateConversion;
use crate::fusion::models::world::World;
use crate::fusion::sensors::measurement::Measurement;
use crate::fusion::sensors::sight::{SeenMotion, Sights};
use nalgebra::{SMatrix, SVector};
use std::sync::Arc;

/// Least weight of a model, so that no model is ruled out for good.
const LEAST_WEIGHT: f64 = 1e-6;

/// Interacting multiple models of a plane or space W. The output is Cartesian and has S states:
/// [x, y, vx, vy, ax, ay], or [x, y, z, vx, vy, vz, ax, ay, az].
///
/// # Source
/// Blom & Bar-Shalom, "The interacting multiple model algorithm", 1988; states that a model does
/// not have are taken from the model into which it is mixed (Yuan, Lian & Han, 2011).
#[derive(Clone)]
pub struct Imm<W, const S: usize> {
    modes: Vec<Arc<dyn Mode<W>>>,
    /// Mean time for which a target follows a model that does not state a time itself [s].
    sojourn: f64,
}

/// Weight and state of every model.
pub type Modes<W> = Vec<(f64, Arc<dyn Mode<W>>)>;

type CorrectedModes<W> = Result<Option<(Arc<dyn Mode<W>>, Innovation)>, Error>;

/// One motion model together with its state.
pub trait Mode<W: World>: Send + Sync {
    /// Mean time for which a target follows this model [s]; None: the time of the filter.
    fn sojourn(&self) -> Option<f64>;
    /// How often a new target follows this model, relative to the others.
    fn of_new(&self) -> f64;
    /// How much a target in this state tends to this model when it leaves another one,
    /// relative to the others.
    fn tendency(&self, at: &W::Wide) -> f64;
    /// This model with the state of a target that was seen once.
    fn started(&self, first: &First) -> Arc<dyn Mode<W>>;
    /// This model with the state of a target whose position and velocity are known.
    fn after_velocity(&self, cv: &W::Cv) -> Arc<dyn Mode<W>>;
    /// This model with its state predicted `dt` [s] ahead.
    fn predicted(&self, dt: f64, platform: &Platform) -> Arc<dyn Mode<W>>;
    /// This model with its state corrected by a measurement.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] as of [`Engine::update`].
    fn updated(&self, m: &Measurement, platform: &Platform) -> CorrectedModes<W>;
    /// This model with the covariance of its state multiplied by `factor`.
    fn loosened(&self, factor: f64) -> Arc<dyn Mode<W>>;
    /// State in Cartesian form; states that the model does not have are taken from `other`.
    fn cartesian(&self, other: Option<&W::Wide>) -> W::Wide;
    /// This model with the state that corresponds to `cartesian`.
    fn adopted(&self, cartesian: &W::Wide) -> Arc<dyn Mode<W>>;
    /// The state as plain numbers, for saving.
    fn numbers(&self) -> Vec<f64>;
    /// This model with the state of `numbers`; None if they do not fit.
    fn restored(&self, numbers: &[f64]) -> Option<Arc<dyn Mode<W>>>;
}

#[derive(Clone)]
struct Member<const N: usize, M> {
    engine: Single<N, M>,
    state: Gaussian<N>,
}

/// The model of an extended Kalman filter as one of those that [`Imm`] mixes.
pub fn mode<const N: usize, M: StateConversion<N> + SeenMotion<N>>(
    engine: Single<N, M>,
) -> Arc<dyn Mode<M::World>> {
    let state = Gaussian { mean: SVector::zeros(), covariance: SMatrix::identity() };
    Arc::new(Member { engine, state })
}

impl<const N: usize, M: StateConversion<N> + SeenMotion<N>> Member<N, M> {
    fn with(&self, state: Gaussian<N>) -> Arc<dyn Mode<M::World>> {
        Arc::new(Self { engine: self.engine.clone(), state })
    }
}

impl<const N: usize, M: StateConversion<N> + SeenMotion<N>> Mode<M::World> for Member<N, M> {
    fn sojourn(&self) -> Option<f64> {
        M::SOJOURN
    }

    fn of_new(&self) -> f64 {
        M::OF_NEW
    }

    fn tendency(&self, at: &<M::World as World>::Wide) -> f64 {
        self.engine.motion.tendency(at, &self.engine.prior)
    }

    fn started(&self, first: &First) -> Arc<dyn Mode<M::World>> {
        self.with(self.engine.first(first))
    }

    fn after_velocity(&self, cv: &<M::World as World>::Cv) -> Arc<dyn Mode<M::World>> {
        let own = self.engine.after_velocity(cv);
        own.map_or_else(
            || {
                let wide = M::World::widened(cv);
                self.with(self.engine.motion.adopted(&wide))
            },
            |state| self.with(state),
        )
    }

    fn predicted(&self, dt: f64, platform: &Platform) -> Arc<dyn Mode<M::World>> {
        let mut state = self.state.clone();
        self.engine.predict(&mut state, dt, platform);
        self.with(state)
    }

    fn updated(&self, m: &Measurement, platform: &Platform) -> CorrectedModes<M::World> {
        // Accepted here in any case: only the mixture of all models can decide about the
        // measurement.
        let mut state = self.state.clone();
        let update = self.engine.update(&mut state, m, platform, &mut |_| true)?;
        Ok(update.map(|innovation| (self.with(state), innovation)))
    }

    fn loosened(&self, factor: f64) -> Arc<dyn Mode<M::World>> {
        let Gaussian { mean, covariance } = self.state;
        self.with(Gaussian { mean, covariance: covariance * factor })
    }

    fn cartesian(&self, other: Option<&<M::World as World>::Wide>) -> <M::World as World>::Wide {
        self.engine.motion.cartesian(&self.state, other)
    }

    fn adopted(&self, cartesian: &<M::World as World>::Wide) -> Arc<dyn Mode<M::World>> {
        self.with(self.engine.motion.adopted(cartesian))
    }

    fn numbers(&self) -> Vec<f64> {
        self.state.numbers()
    }

    fn restored(&self, numbers: &[f64]) -> Option<Arc<dyn Mode<M::World>>> {
        Gaussian::from_numbers(numbers).map(|state| self.with(state))
    }
}

/// Moments of the mixture: see [`mixed`].
fn mixture<const S: usize>(parts: &[(f64, Gaussian<S>)]) -> Gaussian<S> {
    mixed(&parts.iter().map(|(weight, part)| (*weight, part)).collect::<Vec<_>>())
}

impl<const S: usize, W: Sights<Wide = Gaussian<S>>> Imm<W, S> {
    /// Engine for a target that follows each of `modes` for `sojourn` [s] on average.
    #[must_use]
    pub fn new(modes: Vec<Arc<dyn Mode<W>>>, sojourn: f64) -> Self {
        Self { modes, sojourn }
    }

    /// Every model with its weight before any measurement.
    fn begun(&self, make: impl Fn(&dyn Mode<W>) -> Arc<dyn Mode<W>>) -> Modes<W> {
        let all: f64 = self.modes.iter().map(|mode| mode.of_new()).sum();
        self.modes.iter().map(|mode| (mode.of_new() / all, make(&**mode))).collect()
    }

    /// Mixing step: probability of each model after a possible switch, and its mixed state.
    fn interacted(&self, modes: &Modes<W>, dt: f64) -> Modes<W> {
        let count = modes.len();
        let stays = modes.iter().map(|(_, mode)| mode.sojourn().unwrap_or(self.sojourn));
        let stays: Vec<f64> = stays.map(|sojourn| libm::exp(-dt / sojourn)).collect();
        // Without time there is no switch: two measurements at one stamp must not mix the models
        // twice.
        if count < 2 || stays.iter().all(|stay| *stay >= 1.0) {
            return modes.clone();
        }
        let chain: Vec<Vec<f64>> = (0..count)
            .map(|from| {
                let at = modes[from].1.cartesian(None);
                let tendency = |to: usize| modes[to].1.tendency(&at);
                let others: f64 = (0..count).filter(|to| *to != from).map(tendency).sum();
                let change = |to| (1.0 - stays[from]) * tendency(to) / others;
                (0..count).map(|to| if to == from { stays[from] } else { change(to) }).collect()
            })
            .collect();
        let into = |to: usize| {
            // A model without acceleration must not tell one with it that the acceleration is zero
            // and certain: its missing states come from the model that receives them.
            let own = modes[to].1.cartesian(None);
            let share = |from: usize| modes[from].0 * chain[from][to];
            let weight: f64 = (0..count).map(share).sum();
            let parts: Vec<(f64, Gaussian<S>)> = (0..count)
                .map(|from| (share(from) / weight, modes[from].1.cartesian(Some(&own))))
                .collect();
            (weight, modes[to].1.adopted(&mixture(&parts)))
        };
        (0..count).map(into).collect()
    }
}

impl<const S: usize, W: Sights<Wide = Gaussian<S>>> Engine for Imm<W, S> {
    type State = Modes<W>;
    type World = W;

    fn first(&self, first: &First) -> Modes<W> {
        self.begun(|mode| mode.started(first))
    }

    fn after_velocity(&self, cv: &<W as World>::Cv) -> Option<Modes<W>> {
        Some(self.begun(|mode| mode.after_velocity(cv)))
    }

    fn predict(&self, state: &mut Modes<W>, dt: f64, platform: &Platform) {
        let modes = self.interacted(state, dt);
        let predicted = modes.iter().map(|(weight, mode)| (*weight, mode.predicted(dt, platform)));
        *state = predicted.collect();
    }

    fn update(
        &self,
        state: &mut Modes<W>,
        m: &Measurement,
        platform: &Platform,
        believe: AcceptInnovation<'_>,
    ) -> Result<Option<Innovation>, Error> {
        let mut updated = Vec::with_capacity(state.len());
        for (weight, mode) in &*state {
            let Some((mode, innovation)) = mode.updated(m, platform)? else { return Ok(None) };
            let likelihood = -0.5 * (innovation.nis + innovation.log_determinant);
            updated.push((libm::log(*weight) + likelihood, mode, innovation));
        }
        let Some(best) = updated.iter().max_by(|a, b| a.0.total_cmp(&b.0)) else {
            return Ok(None);
        };
        let (most, mut innovation) = (best.0, best.2);
        // Less the largest, so that the sum cannot underflow however unlikely the measurement is.
        let total: f64 = updated.iter().map(|(log, ..)| libm::exp(log - most)).sum();
        // Callers compute the likelihood from NIS and determinant. This determinant makes it the
        // likelihood under all models together.
        innovation.log_determinant = -2.0 * (most + libm::log(total)) - innovation.nis;
        if believe(&innovation) {
            let weight = |log: f64| (libm::exp(log - most) / total).max(LEAST_WEIGHT);
            let sum: f64 = updated.iter().map(|(log, ..)| weight(*log)).sum();
            let one = |(log, mode, _)| (weight(log) / sum, mode);
            *state = updated.into_iter().map(one).collect();
        }
        Ok(Some(innovation))
    }

    /// Every model is a part: the most likely model depends on the measurement.
    fn innovations(
        &self,
        state: &mut Modes<W>,
        m: &Measurement,
        platform: &Platform,
        visit: &mut dyn FnMut(f64, &Innovation),
    ) -> Result<(), Error> {
        for (weight, mode) in &*state {
            if let Some((_, innovation)) = mode.updated(m, platform)? {
                visit(*weight, &innovation);
            }
        }
        Ok(())
    }

    /// Blend the states of each model, through the Cartesian form.
    fn blended(&self, parts: &[(f64, &Modes<W>)]) -> Modes<W> {
        let models = 0..self.modes.len();
        let blended = models.map(|model| {
            let share = |(weight, modes): &(f64, &Modes<W>)| weight * modes[model].0;
            let total: f64 = parts.iter().map(share).sum();
            let wide: Vec<(f64, Gaussian<S>)> = parts
                .iter()
                .map(|part| (share(part) / total, part.1[model].1.cartesian(None)))
                .collect();
            (total, self.modes[model].adopted(&mixture(&wide)))
        });
        blended.collect()
    }

    /// Weight and state of every model, one after the other.
    fn numbers(&self, state: &Modes<W>) -> Vec<f64> {
        let of =
            |(weight, mode): &(f64, Arc<dyn Mode<W>>)| [vec![*weight], mode.numbers()].concat();
        state.iter().flat_map(of).collect()
    }

    fn state_of_numbers(&self, numbers: &[f64]) -> Option<Modes<W>> {
        let mut rest = numbers;
        let mut modes = Vec::with_capacity(self.modes.len());
        for mode in &self.modes {
            let (weight, after) = rest.split_first()?;
            let (state, after) = after.split_at_checked(mode.numbers().len())?;
            modes.push((*weight, mode.restored(state)?));
            rest = after;
        }
        rest.is_empty().then_some(modes)
    }

    fn loosen(&self, state: &mut Modes<W>, factor: f64) {
        state.iter_mut().for_each(|(_, mode)| *mode = mode.loosened(factor));
    }

    fn output(&self, state: &Modes<W>) -> Output {
        let wide = |mode: &Arc<dyn Mode<W>>| mode.cartesian(None);
        let parts: Vec<_> = state.iter().map(|(weight, mode)| (*weight, wide(mode))).collect();
        output(&mixture(&parts), None)
    }
}
