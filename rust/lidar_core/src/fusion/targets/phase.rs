//! Phases of the estimation of one target, and the transitions between them.

use super::lifecycle::LifecycleRules;
use super::sensor_errors::SensorErrors;
use crate::Error;
use crate::fusion::filter::engine::{AcceptInnovation, Engine, Innovation};
use crate::fusion::models::platform::Platform;
use crate::fusion::models::world::World;
use crate::fusion::sensors::measurement::Measurement;
use crate::fusion::sensors::sensing::Sensing;
use serde::{Deserialize, Serialize};

/// Position and velocity in the world of an engine.
pub(super) type CvOf<E> = <<E as Engine>::World as World>::Cv;

/// Phase of the estimation: a state of the model, and one of position and velocity.
#[derive(Clone)]
pub(super) enum Phase<T, C> {
    Unseen,
    /// Estimated by a constant-velocity filter, after this many measurements.
    Starting(C, u32),
    Running(T),
}

/// Phase of an engine.
pub(super) type PhaseOf<E> = Phase<<E as Engine>::State, CvOf<E>>;

/// State of a filter that changes with measurements.
#[derive(Clone)]
pub(super) struct Now<P> {
    pub(super) stamp_ns: i64,
    pub(super) phase: P,
    pub(super) platform: Platform,
    /// NIS per degree of freedom, averaged over `LOSS_WINDOW` measurements.
    pub(super) ratio: f64,
    pub(super) errors: SensorErrors,
    /// Factor by which the covariance of the last prediction was enlarged beyond that of the model.
    pub(super) looseness: f64,
}

/// Parts of a filter that measurements do not change.
#[derive(Clone)]
pub(super) struct FilterRules<E, S> {
    pub(super) engine: E,
    pub(super) starter: S,
    pub(super) sensing: Sensing,
    pub(super) life: LifecycleRules,
}

/// [`Phase`] as plain numbers.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) enum SavedPhase {
    Unseen,
    Starting(Vec<f64>, u32),
    Running(Vec<f64>),
}

/// [`Now`] as plain numbers.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct SavedNow {
    pub(super) stamp_ns: i64,
    pub(super) phase: SavedPhase,
    pub(super) platform: Platform,
    pub(super) ratio: f64,
    pub(super) errors: SensorErrors,
}

impl<E: Engine, S: Engine<World = E::World, State = CvOf<E>>> FilterRules<E, S> {
    pub(super) fn saved(&self, now: &Now<PhaseOf<E>>) -> SavedNow {
        let phase = match &now.phase {
            Phase::Unseen => SavedPhase::Unseen,
            Phase::Starting(cv, rows) => SavedPhase::Starting(self.starter.numbers(cv), *rows),
            Phase::Running(state) => SavedPhase::Running(self.engine.numbers(state)),
        };
        let Now { stamp_ns, ratio, errors, .. } = *now;
        SavedNow { stamp_ns, phase, platform: now.platform.clone(), ratio, errors }
    }

    pub(super) fn restored(&self, saved: &SavedNow) -> Option<Now<PhaseOf<E>>> {
        let phase = match &saved.phase {
            SavedPhase::Unseen => Phase::Unseen,
            SavedPhase::Starting(cv, rows) => {
                Phase::Starting(self.starter.state_of_numbers(cv)?, *rows)
            }
            SavedPhase::Running(state) => Phase::Running(self.engine.state_of_numbers(state)?),
        };
        let SavedNow { stamp_ns, ratio, errors, .. } = *saved;
        let platform = saved.platform.clone();
        Some(Now { stamp_ns, phase, platform, ratio, errors, looseness: 1.0 })
    }

    pub(super) fn predict(
        &self,
        phase: &mut PhaseOf<E>,
        [from_ns, to_ns]: [i64; 2],
        platform: &Platform,
    ) {
        let dt = to_ns.saturating_sub(from_ns) as f64 * 1e-9;
        let turning = platform.between(from_ns, to_ns);
        let platform = turning.as_ref().unwrap_or(platform);
        match phase {
            Phase::Unseen => {}
            Phase::Starting(cv, _) => self.starter.predict(cv, dt, platform),
            Phase::Running(state) => self.engine.predict(state, dt, platform),
        }
    }

    pub(super) fn loosen(&self, phase: &mut PhaseOf<E>, factor: f64) {
        match phase {
            Phase::Unseen => {}
            Phase::Starting(cv, _) => self.starter.loosen(cv, factor),
            Phase::Running(state) => self.engine.loosen(state, factor),
        }
    }

    /// Correct a state if `believe` accepts the innovation. After enough measurements, the filter
    /// of the model replaces the starting filter.
    pub(super) fn correct(
        &self,
        phase: &mut PhaseOf<E>,
        m: &Measurement,
        platform: &Platform,
        believe: AcceptInnovation<'_>,
    ) -> Result<Option<Innovation>, Error> {
        match phase {
            Phase::Unseen => Ok(None),
            Phase::Running(state) => self.engine.update(state, m, platform, believe),
            Phase::Starting(cv, rows) => {
                let mut is_believed = false;
                let update = self.starter.update(cv, m, platform, &mut |innovation| {
                    is_believed = believe(innovation);
                    is_believed
                })?;
                *rows += u32::from(is_believed);
                if let Some(state) = self.after_start(cv, *rows) {
                    *phase = Phase::Running(state);
                }
                Ok(update)
            }
        }
    }

    /// State of the model, once the starting filter has processed enough measurements.
    pub(super) fn after_start(&self, cv: &CvOf<E>, rows: u32) -> Option<E::State> {
        let is_enough = rows >= self.life.start_rows;
        is_enough.then(|| self.engine.after_velocity(cv)).flatten()
    }
}

/// Mixture of the prediction corrected by each measurement and by none, with their probabilities.
pub(super) fn blended<E: Engine>(
    engine: &E,
    predicted: &E::State,
    weighted: &[(f64, Measurement)],
    platform: &Platform,
) -> E::State {
    let (mut left, mut corrected) = (1.0, Vec::with_capacity(weighted.len()));
    for (weight, m) in weighted {
        let mut state = predicted.clone();
        if let Ok(Some(_)) = engine.update(&mut state, m, platform, &mut |_| true) {
            left -= weight;
            corrected.push((*weight, state));
        }
    }
    let parts = corrected.iter().map(|(weight, state)| (*weight, state));
    let parts: Vec<_> = std::iter::once((left.max(0.0), predicted)).chain(parts).collect();
    engine.blended(&parts)
}
