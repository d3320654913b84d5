//! One target over time: start, prediction, gate, correction, loss.

use super::cartesian::ConstantVelocity;
use super::engine::{Engine, Innovation, Link, Output, Single};
use super::measurement::{Measurement, Sensor};
use super::platform::{Platform, Pose};
use super::sensors::first_sight;
use crate::Error;
use crate::estimation::chi2;
use crate::estimation::kalman::Gaussian;
use std::collections::VecDeque;

/// Measurements kept for late ones, at most.
const MOST_KEPT: usize = 10_000;

/// Rules over a target's life.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Life {
    /// Measurements that a constant-velocity filter takes before the model does.
    pub start_rows: u32,
    /// Largest NIS of 1 to 5 values that is believed; infinite for all.
    pub gate: [f64; 5],
    /// When a filter counts as lost; none for never.
    pub loss: Option<Loss>,
    /// Whether a radar that sees a target first gives its speed along the line of sight.
    pub radar_starts_speed: bool,
    /// How the turn rate of a gyro is used.
    pub gyro: GyroUse,
    /// How long measurements are kept for late ones to be put before them [ns].
    pub buffer_ns: i64,
}

/// A filter is lost when its NIS stays above what its covariances allow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loss {
    /// Measurements over which the NIS is averaged.
    pub window: f64,
    /// NIS per degree of freedom that is too much; 1 is expected.
    pub ratio: f64,
}

/// How the turn rate of a gyro is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GyroUse {
    /// As it is, until the next one.
    Input,
    /// As a measurement of a state.
    Measurement,
    /// Not at all.
    Ignored,
}

impl Life {
    /// Gates that a target passes with `probability`; all open without one.
    ///
    /// # Errors
    /// [`Error::Parameter`] unless 0 < `probability` < 1.
    pub fn gates(probability: Option<f64>) -> Result<[f64; 5], Error> {
        let mut gates = [f64::INFINITY; 5];
        if let Some(probability) = probability {
            for (degrees, gate) in (1..).zip(&mut gates) {
                *gate = chi2::quantile(probability, degrees)?;
            }
        }
        Ok(gates)
    }
}

/// What became of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// It corrected the state.
    Updated,
    /// It was the first one and made the state.
    Started,
    /// It told how the platform moves.
    Told,
    /// It was too far from what was expected; the state is predicted only.
    Gated,
    /// It found the filter lost, and started it anew.
    Restarted,
    /// Its values cannot be used; nothing changed.
    Invalid,
    /// It is older than what the filter can go back to; nothing changed.
    Late,
    /// It is there already: same stamp, sensor and values; nothing changed.
    Duplicate,
    /// The covariance of its innovation has no factor; nothing changed.
    Singular,
}

/// The filter after a measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// What became of the measurement.
    pub outcome: Outcome,
    /// Time of the state [ns].
    pub stamp_ns: i64,
    /// The state; none before the target has been seen.
    pub output: Option<Output>,
    /// How far the measurement was from what was expected.
    pub innovation: Option<Innovation>,
}

/// What is estimated at the moment.
#[derive(Clone, Debug)]
enum Phase<S> {
    Unseen,
    /// By a constant-velocity filter, after so many measurements.
    Starting(Gaussian<4>, u32),
    Running(S),
}

/// Everything that changes with measurements.
#[derive(Clone, Debug)]
struct Now<S> {
    stamp_ns: i64,
    phase: Phase<S>,
    platform: Platform,
    /// NIS per degree of freedom, averaged over the window of [`Loss`].
    ratio: f64,
}

/// A filter of one target.
#[derive(Clone, Debug)]
pub struct Target<E: Engine> {
    engine: E,
    starter: Single<4, ConstantVelocity>,
    life: Life,
    now: Now<E::State>,
    /// The last measurements, and what was known after each.
    history: VecDeque<(Measurement, Now<E::State>)>,
}

type Corrected<S> = Option<(Phase<S>, Innovation)>;

impl<E: Engine> Target<E> {
    /// A filter that has seen nothing; `starter` takes the first measurements.
    pub fn new(
        engine: E,
        starter: Single<4, ConstantVelocity>,
        life: Life,
        platform: Platform,
    ) -> Self {
        let now = Now { stamp_ns: i64::MIN, phase: Phase::Unseen, platform, ratio: 1.0 };
        Self { engine, starter, life, now, history: VecDeque::new() }
    }

    /// Take in a measurement; a late one is put where it belongs, and what came after it is
    /// filtered again.
    pub fn step(&mut self, m: &Measurement) -> Step {
        if !m.is_usable() {
            return self.report(Outcome::Invalid, None);
        }
        let newer = |(known, _): &&(Measurement, _)| known.stamp_ns() >= m.stamp_ns();
        if self.history.iter().rev().take_while(newer).any(|(known, _)| known == m) {
            return self.report(Outcome::Duplicate, None);
        }
        if m.stamp_ns() < self.now.stamp_ns {
            return self.step_late(m);
        }
        let step = self.advance(m);
        self.remember(m);
        step
    }

    fn remember(&mut self, m: &Measurement) {
        if self.life.buffer_ns == 0 {
            return;
        }
        self.history.push_back((*m, self.now.clone()));
        let oldest = self.now.stamp_ns.saturating_sub(self.life.buffer_ns);
        while self.history.len() > MOST_KEPT
            || self.history.front().is_some_and(|(_, now)| now.stamp_ns < oldest)
        {
            self.history.pop_front();
        }
    }

    /// Go back to the state before `m`, take it in, and everything after it again.
    fn step_late(&mut self, m: &Measurement) -> Step {
        let before = self.history.partition_point(|(known, _)| known.stamp_ns() <= m.stamp_ns());
        let Some((_, now)) = before.checked_sub(1).and_then(|index| self.history.get(index)) else {
            return self.report(Outcome::Late, None);
        };
        self.now = now.clone();
        let after: Vec<Measurement> = self.history.drain(before..).map(|(m, _)| m).collect();
        let Step { outcome, innovation, .. } = self.advance(m);
        self.remember(m);
        for later in &after {
            self.advance(later);
            self.remember(later);
        }
        self.report(outcome, innovation)
    }

    /// Take in a usable measurement that is not older than the state.
    fn advance(&mut self, m: &Measurement) -> Step {
        let dt = m.stamp_ns().saturating_sub(self.now.stamp_ns) as f64 * 1e-9;
        let predicted = self.predicted(dt);
        if matches!(m.sensor(), Sensor::Pose | Sensor::Gyro) {
            return self.told(predicted, m);
        }
        match self.corrected(&predicted, m) {
            Err(_) => self.report(Outcome::Singular, None),
            Ok(None) => self.start(m, Outcome::Started, None),
            Ok(Some((phase, innovation))) => self.judged(predicted, phase, innovation, m),
        }
    }

    /// How the state at `stamp_ns` hangs on the present one; none while the target starts.
    pub fn link(&self, stamp_ns: i64) -> Option<Link> {
        let Phase::Running(state) = &self.now.phase else { return None };
        let dt = stamp_ns.saturating_sub(self.now.stamp_ns).max(0) as f64 * 1e-9;
        self.engine.link(state, dt, &self.now.platform)
    }

    fn predicted(&self, dt: f64) -> Phase<E::State> {
        let platform = &self.now.platform;
        match &self.now.phase {
            Phase::Unseen => Phase::Unseen,
            Phase::Starting(cv, rows) => {
                Phase::Starting(self.starter.predict(cv, dt, platform), *rows)
            }
            Phase::Running(state) => Phase::Running(self.engine.predict(state, dt, platform)),
        }
    }

    fn corrected(
        &self,
        predicted: &Phase<E::State>,
        m: &Measurement,
    ) -> Result<Corrected<E::State>, Error> {
        let platform = &self.now.platform;
        Ok(match predicted {
            Phase::Unseen => None,
            Phase::Starting(cv, rows) => {
                let update = self.starter.update(cv, m, platform)?;
                update.map(|(cv, innovation)| (self.started(cv, rows + 1), innovation))
            }
            Phase::Running(state) => {
                let update = self.engine.update(state, m, platform)?;
                update.map(|(state, innovation)| (Phase::Running(state), innovation))
            }
        })
    }

    /// The model takes over after enough measurements.
    fn started(&self, cv: Gaussian<4>, rows: u32) -> Phase<E::State> {
        if rows < self.life.start_rows {
            return Phase::Starting(cv, rows);
        }
        match self.engine.after_velocity(&cv) {
            Some(state) => Phase::Running(state),
            None => Phase::Starting(cv, rows),
        }
    }

    fn start(&mut self, m: &Measurement, outcome: Outcome, lost: Option<Innovation>) -> Step {
        let sensor = self.now.platform.sensor_at(m.stamp_ns());
        let Some(mut first) = first_sight(m, sensor.as_ref()) else {
            return self.report(Outcome::Invalid, None);
        };
        if !self.life.radar_starts_speed {
            (first.speed, first.heading) = (0.0, 0.0);
        }
        let state = self.engine.first(&first);
        let cv = self.starter.first(&first);
        self.now.phase = if self.life.start_rows > 1 && self.engine.after_velocity(&cv).is_some() {
            Phase::Starting(cv, 1)
        } else {
            Phase::Running(state)
        };
        (self.now.stamp_ns, self.now.ratio) = (m.stamp_ns(), 1.0);
        self.report(outcome, lost)
    }

    /// Believe an innovation, or not, or that the filter is lost.
    fn judged(
        &mut self,
        predicted: Phase<E::State>,
        corrected: Phase<E::State>,
        innovation: Innovation,
        m: &Measurement,
    ) -> Step {
        if let Some(Loss { window, ratio }) = self.life.loss {
            let share = innovation.nis / innovation.count as f64;
            let share = share.min(ratio * window / 3.0); // one outlier alone is no loss
            self.now.ratio += (share - self.now.ratio) / window;
            if self.now.ratio > ratio {
                return self.start(m, Outcome::Restarted, Some(innovation));
            }
        }
        let believed = innovation.nis <= self.life.gate[innovation.count - 1];
        self.now.stamp_ns = m.stamp_ns();
        self.now.phase = if believed { corrected } else { predicted };
        self.report(if believed { Outcome::Updated } else { Outcome::Gated }, Some(innovation))
    }

    /// Note how the platform moves from here on.
    fn told(&mut self, predicted: Phase<E::State>, m: &Measurement) -> Step {
        let values = m.values();
        let mut platform = self.now.platform;
        if m.sensor() == Sensor::Pose {
            platform.pose = Some(pose_of(m, self.now.platform.pose));
        } else if let [_, vx, vy] = *values {
            platform.velocity = [vx, vy];
        }
        let mut innovation = None;
        let mut phase = predicted;
        if m.sensor() == Sensor::Gyro && self.life.gyro == GyroUse::Input {
            platform.rate = values[0];
            platform.rate_variance = self.starter.sensing.gyro_variance(m);
        }
        if m.sensor() == Sensor::Gyro && self.life.gyro == GyroUse::Measurement {
            match self.corrected(&phase, m) {
                Err(_) => return self.report(Outcome::Singular, None),
                Ok(None) => {}
                Ok(Some((corrected, of_rate))) => {
                    phase = corrected;
                    innovation = Some(of_rate);
                }
            }
        }
        self.now = Now { stamp_ns: m.stamp_ns(), phase, platform, ratio: self.now.ratio };
        self.report(Outcome::Told, innovation)
    }

    fn report(&self, outcome: Outcome, innovation: Option<Innovation>) -> Step {
        Step { outcome, stamp_ns: self.now.stamp_ns, output: self.output(), innovation }
    }

    fn output(&self) -> Option<Output> {
        self.output_of(&self.now.phase)
    }

    /// State carried on to `stamp_ns`; nothing changes. A time before the last measurement gives
    /// the state at that measurement.
    pub fn output_at(&self, stamp_ns: i64) -> Option<Output> {
        let dt = stamp_ns.saturating_sub(self.now.stamp_ns).max(0) as f64 * 1e-9;
        self.output_of(&self.predicted(dt))
    }

    fn output_of(&self, phase: &Phase<E::State>) -> Option<Output> {
        match phase {
            Phase::Unseen => None,
            Phase::Starting(cv, _) => {
                self.engine.after_velocity(cv).map(|state| self.engine.output(&state))
            }
            Phase::Running(state) => Some(self.engine.output(state)),
        }
    }
}

/// The pose in a measurement; without a velocity, that since the last pose.
fn pose_of(m: &Measurement, last: Option<Pose>) -> Pose {
    let v = m.values();
    let (stamp_ns, position, yaw) = (m.stamp_ns(), [v[0], v[1]], v[2]);
    if let [_, _, _, vx, vy, rate] = *v {
        return Pose { stamp_ns, position, yaw, velocity: [vx, vy], rate };
    }
    let standing = Pose { stamp_ns, position, yaw, velocity: [0.0; 2], rate: 0.0 };
    let Some(last) = last else { return standing };
    let dt = stamp_ns.saturating_sub(last.stamp_ns) as f64 * 1e-9;
    if dt <= 0.0 {
        return Pose { velocity: last.velocity, rate: last.rate, ..standing };
    }
    let velocity = std::array::from_fn(|k| (position[k] - last.position[k]) / dt);
    Pose { velocity, rate: super::turn::wrapped(yaw - last.yaw) / dt, ..standing }
}
