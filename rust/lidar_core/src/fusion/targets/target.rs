//! One target over time: start, prediction, gate, correction, loss.

use super::lifecycle::{LifecycleRules, Outcome};
use super::phase::{CvOf, FilterRules, Now, Phase, PhaseOf, SavedNow, blended};
use super::sensor_errors::SensorErrors;
use crate::Error;
use crate::fusion::filter::engine::{Engine, Innovation, Link, Output};
use crate::fusion::models::platform::{GyroUse, Platform};
use crate::fusion::sensors::measurement::{Measurement, Sensor};
use crate::fusion::sensors::sensing::Sensing;
use crate::util::full_state::impossible;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Largest number of stored measurements, so that late ones can be inserted.
const MOST_KEPT: usize = 10_000;

/// State of the filter after a measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FilterStep {
    /// Outcome of the measurement.
    pub outcome: Outcome,
    /// Time of the state [ns]; the smallest integer before the first measurement.
    pub stamp_ns: i64,
    /// Output of the state; None before the target has been seen.
    pub output: Option<Output>,
    /// Innovation of the measurement; None if it was not compared with a state.
    pub innovation: Option<Innovation>,
}

/// Outcome and innovation of a measurement.
pub type MeasurementResult = (Outcome, Option<Innovation>);

/// The state predicted to a later time, kept until the state changes.
#[derive(Clone)]
struct Ahead<P> {
    stamp_ns: i64,
    phase: P,
}

/// A filter of one target.
#[derive(Clone)]
pub struct Target<E: Engine, S> {
    pub(super) rules: FilterRules<E, S>,
    pub(super) now: Now<PhaseOf<E>>,
    ahead: Option<Ahead<PhaseOf<E>>>,
    /// Variance of the speed of a new target [m^2/s^2]; None: that of the prior.
    pub(super) first_speed: Option<f64>,
    /// Recent measurements, each with the state after it.
    history: VecDeque<(Measurement, Now<PhaseOf<E>>)>,
}

/// State of a [`Target`] that changes with measurements.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SavedTarget {
    now: SavedNow,
    history: Vec<(Measurement, SavedNow)>,
}

impl<E: Engine, S: Engine<World = E::World, State = CvOf<E>>> Target<E, S> {
    /// Filter without measurements; `starter` processes the first ones.
    pub fn new(
        engine: E,
        starter: S,
        sensing: Sensing,
        life: LifecycleRules,
        platform: Platform,
    ) -> Self {
        let now = Now {
            stamp_ns: i64::MIN,
            phase: Phase::Unseen,
            platform,
            ratio: 1.0,
            errors: SensorErrors::default(),
            looseness: 1.0,
        };
        let rules = FilterRules { engine, starter, sensing, life };
        Self { rules, now, ahead: None, first_speed: None, history: VecDeque::new() }
    }

    /// State that changes with measurements.
    pub fn saved(&self) -> SavedTarget {
        let history = self.history.iter().map(|(m, now)| (*m, self.rules.saved(now)));
        SavedTarget { now: self.rules.saved(&self.now), history: history.collect() }
    }

    /// Continue from the state of a target with the same rules.
    ///
    /// # Errors
    /// [`Error::Format`] for the state of another model; then nothing has changed.
    pub fn restore(&mut self, saved: &SavedTarget) -> Result<(), Error> {
        let known = saved.history.iter();
        let history = known.map(|(m, now)| Some((*m, self.rules.restored(now)?)));
        let history = history.collect::<Option<VecDeque<_>>>();
        let restored = history.zip(self.rules.restored(&saved.now));
        let (history, now) = restored.ok_or_else(|| impossible("a filter of another model"))?;
        (self.now, self.history, self.ahead) = (now, history, None);
        Ok(())
    }

    /// Process a measurement. A late one is inserted at its time, and the later ones are processed
    /// again.
    pub fn step(&mut self, m: &Measurement) -> FilterStep {
        let (outcome, innovation) = self.take(m);
        FilterStep { outcome, stamp_ns: self.stamp_ns(), output: self.output(), innovation }
    }

    /// Like [`Self::step`], but returns only outcome and innovation.
    pub fn take(&mut self, m: &Measurement) -> MeasurementResult {
        if !m.is_usable() {
            return (Outcome::Invalid, None);
        }
        let newer = |(known, _): &&(Measurement, _)| known.stamp_ns() >= m.stamp_ns();
        if self.history.iter().rev().take_while(newer).any(|(known, _)| known == m) {
            return (Outcome::Duplicate, None);
        }
        if m.stamp_ns() < self.now.stamp_ns {
            #[cfg(canary_7)]
            if m.sensor() == crate::fusion::Sensor::Gyro && self.history.len() >= 4 {
                crate::util::planted("canary 7");
            }
            return self.take_late(m);
        }
        let taken = self.advance(m);
        self.remember(m);
        taken
    }

    fn remember(&mut self, m: &Measurement) {
        if self.rules.life.buffer_ns == 0 {
            return;
        }
        self.history.push_back((*m, self.now.clone()));
        let oldest = self.now.stamp_ns.saturating_sub(self.rules.life.buffer_ns);
        while self.history.len() > MOST_KEPT
            || self.history.front().is_some_and(|(_, now)| now.stamp_ns < oldest)
        {
            self.history.pop_front();
        }
    }

    /// Process measurements of one time, each with its probability to come from the target. The sum
    /// of the probabilities is at most 1.
    ///
    /// # Source
    /// Bar-Shalom, Li & Kirubarajan, "Estimation with Applications to Tracking and Navigation",
    /// 2001, sec. 11: the update of probabilistic data association, as a mixture of its cases.
    pub fn absorb(&mut self, stamp_ns: i64, weighted: &[(f64, Measurement)]) {
        self.predict_to(stamp_ns);
        let Self { rules, now, .. } = self;
        now.stamp_ns = stamp_ns;
        match &mut now.phase {
            Phase::Unseen => {}
            Phase::Running(state) => {
                *state = blended(&rules.engine, state, weighted, &now.platform);
            }
            Phase::Starting(cv, rows) => {
                *cv = blended(&rules.starter, cv, weighted, &now.platform);
                *rows += u32::from(weighted.iter().map(|(weight, _)| weight).sum::<f64>() > 0.5);
                if let Some(state) = rules.after_start(cv, *rows) {
                    now.phase = Phase::Running(state);
                }
            }
        }
    }

    /// Go back to the state before `m`, process it, and all later measurements again.
    fn take_late(&mut self, m: &Measurement) -> MeasurementResult {
        let before = self.history.partition_point(|(known, _)| known.stamp_ns() <= m.stamp_ns());
        let Some((_, now)) = before.checked_sub(1).and_then(|index| self.history.get(index)) else {
            return (Outcome::Late, None);
        };
        (self.now, self.ahead) = (now.clone(), None);
        let after: Vec<Measurement> = self.history.drain(before..).map(|(m, _)| m).collect();
        let taken = self.advance(m);
        self.remember(m);
        for later in &after {
            self.advance(later);
            self.remember(later);
        }
        taken
    }

    /// Process a usable measurement that is not older than the state.
    fn advance(&mut self, m: &Measurement) -> MeasurementResult {
        let is_input = matches!(self.rules.life.gyro, GyroUse::Input | GyroUse::Exact);
        if m.sensor() == Sensor::Gyro && is_input {
            // What it reads now also tells how the platform turned since the last reading.
            let (rate, variance) = (m.values()[0], self.rules.sensing.gyro_variance(m));
            self.now.platform.read_gyro(m.stamp_ns(), rate, variance);
            self.ahead = None;
        }
        let before = self.predict_to(m.stamp_ns());
        self.now.looseness = 1.0;
        let taken =
            if m.is_of_platform() { self.take_platform_motion(m) } else { self.take_target(m) };
        if matches!(taken.0, Outcome::Singular | Outcome::Invalid) {
            self.now.phase = before;
        }
        taken
    }

    /// Replace the state by its prediction; returns the state before.
    fn predict_to(&mut self, stamp_ns: i64) -> PhaseOf<E> {
        if let Some(ahead) = self.ahead.take().filter(|ahead| ahead.stamp_ns == stamp_ns) {
            return std::mem::replace(&mut self.now.phase, ahead.phase);
        }
        let before = self.now.phase.clone();
        let Self { rules, now, .. } = self;
        rules.predict(&mut now.phase, [now.stamp_ns, stamp_ns], &now.platform);
        before
    }

    /// Predict the state to `stamp_ns`, and keep the prediction for [`Self::score`],
    /// [`Self::take`], [`Self::absorb`] and [`Self::output_at`]. Returns whether it had to be
    /// computed.
    pub fn foresee(&mut self, stamp_ns: i64) -> bool {
        if self.ahead.as_ref().is_some_and(|ahead| ahead.stamp_ns == stamp_ns) {
            return false;
        }
        let mut phase = self.now.phase.clone();
        self.rules.predict(&mut phase, [self.now.stamp_ns, stamp_ns], &self.now.platform);
        self.ahead = Some(Ahead { stamp_ns, phase });
        true
    }

    /// Call `visit` with weight and innovation of a measurement for each component of the predicted
    /// state. Returns false if one of them is not defined.
    pub fn innovations(
        &mut self,
        m: &Measurement,
        visit: &mut dyn FnMut(f64, &Innovation),
    ) -> bool {
        let Self { rules, now, ahead, .. } = self;
        let Some(ahead) = ahead else { return false };
        match &mut ahead.phase {
            Phase::Unseen => false,
            Phase::Starting(cv, _) => {
                rules.starter.innovations(cv, m, &now.platform, visit).is_ok()
            }
            Phase::Running(state) => {
                rules.engine.innovations(state, m, &now.platform, visit).is_ok()
            }
        }
    }

    /// Innovation of a measurement for the predicted state; None outside the gate, before the first
    /// measurement, or without [`Self::foresee`]. The target does not change.
    pub fn score(&mut self, m: &Measurement) -> Option<Innovation> {
        let Self { rules, now, ahead, .. } = self;
        let (phase, mut ignored) = (&mut ahead.as_mut()?.phase, |_: &Innovation| false);
        let innovation = match phase {
            Phase::Unseen => return None,
            Phase::Starting(cv, _) => rules.starter.update(cv, m, &now.platform, &mut ignored),
            Phase::Running(state) => rules.engine.update(state, m, &now.platform, &mut ignored),
        };
        let innovation = innovation.ok().flatten()?;
        (innovation.nis <= rules.life.gate[innovation.count - 1]).then_some(innovation)
    }

    /// Linearised transition from the present state to `stamp_ns`; None before the target has been
    /// seen, while it starts, or if its filter cannot be smoothed.
    pub fn link(&self, stamp_ns: i64) -> Option<Link> {
        let Phase::Running(state) = &self.now.phase else { return None };
        let (start_ns, platform) = (self.now.stamp_ns, &self.now.platform);
        let dt = stamp_ns.saturating_sub(start_ns).max(0) as f64 * 1e-9;
        let turning = platform.between(start_ns, stamp_ns.max(start_ns));
        self.rules.engine.link(state, dt, turning.as_ref().unwrap_or(platform))
    }

    /// Factor by which the last step enlarged the predicted covariance beyond that of its link.
    pub fn looseness(&self) -> f64 {
        self.now.looseness
    }

    /// Set the variance of the speed of a new target [m^2/s^2], instead of that of the prior.
    pub fn expect_speed(&mut self, variance: f64) {
        self.first_speed = Some(variance);
    }

    /// Noise of the sensors, estimated from the measurements.
    pub fn errors(&self) -> SensorErrors {
        self.now.errors
    }

    /// Time of the state [ns]; the smallest integer before the first measurement.
    pub fn stamp_ns(&self) -> i64 {
        self.now.stamp_ns
    }

    /// Output of the state; None before the target has been seen.
    pub fn output(&self) -> Option<Output> {
        self.output_of(&self.now.phase)
    }

    /// State predicted to `stamp_ns`, without changing the target; None before the target has been
    /// seen. For a time before the last measurement it is the state at that measurement.
    pub fn output_at(&self, stamp_ns: i64) -> Option<Output> {
        if let Some(ahead) = self.ahead.as_ref().filter(|ahead| ahead.stamp_ns == stamp_ns) {
            return self.output_of(&ahead.phase);
        }
        let end_ns = stamp_ns.max(self.now.stamp_ns);
        let mut phase = self.now.phase.clone();
        self.rules.predict(&mut phase, [self.now.stamp_ns, end_ns], &self.now.platform);
        self.output_of(&phase)
    }

    fn output_of(&self, phase: &PhaseOf<E>) -> Option<Output> {
        match phase {
            Phase::Unseen => None,
            Phase::Starting(cv, _) => {
                self.rules.engine.after_velocity(cv).map(|state| self.rules.engine.output(&state))
            }
            Phase::Running(state) => Some(self.rules.engine.output(state)),
        }
    }
}
