//! Correction of the predicted state by a measurement; start of the target; motion of the platform.

use super::target::{MeasurementResult, Target};
use crate::Error;
use crate::fusion::filter::engine::{Engine, Innovation};
use crate::fusion::models::platform::GyroUse;
use crate::fusion::sensors::measurement::{Measurement, Sensor};
use crate::fusion::sensors::sight::Sights;
use crate::fusion::sensors::told_pose::TellPose;
use crate::fusion::targets::lifecycle::Outcome;
use crate::fusion::targets::phase::{CvOf, Phase, PhaseOf};
use crate::fusion::targets::sensor_errors::as_outlier;

/// Factor on the covariance of a state whose target moved in a way that no model describes.
const MANOEUVRE: f64 = 25.0;

impl<E: Engine, S: Engine<World = E::World, State = CvOf<E>>> Target<E, S> {
    /// Correct the predicted state by a measurement of the target.
    pub(super) fn take_target(&mut self, m: &Measurement) -> MeasurementResult {
        let adapted = match self.rules.life.memory {
            Some(memory) => self.adapted(m, memory),
            None => Ok(*m),
        };
        let Ok(adapted) = adapted else { return (Outcome::Singular, None) };
        let Self { rules, now, .. } = self;
        let (mut outcome, mut ratio) = (Outcome::Updated, now.ratio);
        let m = &adapted;
        let update = rules.correct(&mut now.phase, m, &now.platform, &mut |innovation| {
            outcome = rules.life.check(&mut ratio, innovation);
            outcome == Outcome::Updated
        });
        match update {
            Err(_) => (Outcome::Singular, None),
            Ok(None) if matches!(now.phase, Phase::Unseen) => self.start(m, Outcome::Started, None),
            Ok(None) => (Outcome::Invalid, None),
            Ok(lost) if outcome == Outcome::Restarted => self.start(m, outcome, lost),
            Ok(innovation) => {
                (now.stamp_ns, now.ratio) = (m.stamp_ns(), ratio);
                (outcome, innovation)
            }
        }
    }

    /// The measurement with the estimated noise of its sensor. If it is far from the prediction,
    /// and an unmodelled motion of the target is more likely than an outlier, the covariance of the
    /// state is enlarged.
    fn adapted(&mut self, m: &Measurement, memory: f64) -> Result<Measurement, Error> {
        let Self { rules, now, .. } = self;
        let sensing = rules.sensing;
        let before = now.errors;
        let look = |phase: &mut PhaseOf<E>, m: &Measurement| {
            rules.correct(phase, m, &now.platform, &mut |_| false)
        };
        let Some(first) = look(&mut now.phase, &now.errors.seen_by(m, &sensing))? else {
            return Ok(*m);
        };
        now.errors.learn(m, &sensing, &first, memory);
        let adapted = now.errors.seen_by(m, &sensing);
        let Some(second) = look(&mut now.phase, &adapted)? else { return Ok(adapted) };
        if second.nis <= rules.life.gate[second.count - 1] {
            return Ok(adapted);
        }
        let Some(outlier) = as_outlier(&adapted) else { return Ok(adapted) };
        let mut loose = now.phase.clone();
        rules.loosen(&mut loose, MANOEUVRE);
        let likelihood = |seen: Option<Innovation>| {
            seen.map_or(f64::NEG_INFINITY, |seen| -0.5 * (seen.nis + seen.log_determinant))
        };
        let moved = likelihood(look(&mut loose, &adapted)?);
        if moved > likelihood(look(&mut now.phase, &outlier)?) {
            (now.phase, now.looseness) = (loose, MANOEUVRE);
            if before.is_known(m) {
                // What is blamed on the state says nothing about a sensor that is known.
                now.errors = before;
                return Ok(before.seen_by(m, &sensing));
            }
        }
        Ok(adapted)
    }

    /// Position from a measurement alone, and the variances along its axes, in the frame of the
    /// state; None for a measurement without a position.
    pub fn sight(&self, m: &Measurement) -> Option<[[f64; 3]; 2]> {
        let first = E::World::first_sight(m, &self.rules.sensing, &self.now.platform, true)?;
        let variance = first.noise.map_or([0.0; 3], |of| [of[(0, 0)], of[(1, 1)], of[(2, 2)]]);
        Some([first.position, variance])
    }

    /// Start the target with a measurement. `lost`: innovation of the measurement that ended the
    /// estimate before.
    fn start(
        &mut self,
        m: &Measurement,
        outcome: Outcome,
        lost: Option<Innovation>,
    ) -> MeasurementResult {
        let (life, sensing) = (&self.rules.life, &self.rules.sensing);
        let as_measured = life.starts_as_measured;
        let sight = E::World::first_sight(m, sensing, &self.now.platform, as_measured);
        let Some(mut first) = sight else { return (Outcome::Invalid, lost) };
        if !life.radar_starts_speed {
            (first.speed, first.heading, first.elevation) = (0.0, 0.0, 0.0);
        }
        first.speed_variance = self.first_speed;
        let state = self.rules.engine.first(&first);
        let cv = self.rules.starter.first(&first);
        self.now.phase =
            if self.rules.life.start_rows > 1 && self.rules.engine.after_velocity(&cv).is_some() {
                Phase::Starting(cv, 1)
            } else {
                Phase::Running(state)
            };
        (self.now.stamp_ns, self.now.ratio) = (m.stamp_ns(), 1.0);
        (outcome, lost)
    }

    /// Store the motion of the platform from here on.
    pub(super) fn take_platform_motion(&mut self, m: &Measurement) -> MeasurementResult {
        let values = m.values();
        let mut platform = self.now.platform.clone();
        let sensing = self.rules.sensing;
        if m.sensor() == Sensor::Gyro {
            if let [_, vx, vy] = *values {
                platform.velocity = [vx, vy];
            }
        } else {
            E::World::tell_pose(&mut platform, m, &sensing);
        }
        let mut innovation = None;
        if m.sensor() == Sensor::Gyro && self.rules.life.gyro == GyroUse::Measurement {
            let Self { rules, now, .. } = self;
            match rules.correct(&mut now.phase, m, &now.platform, &mut |_| true) {
                Err(_) => return (Outcome::Singular, None),
                Ok(of_rate) => innovation = of_rate,
            }
        }
        (self.now.stamp_ns, self.now.platform) = (m.stamp_ns(), platform);
        (Outcome::PlatformMotion, innovation)
    }
}
