//! Rules for the life of a target, and outcomes of its measurements.

use crate::Error;
use crate::estimation::chi2;
use crate::fusion::filter::engine::Innovation;
use crate::fusion::models::platform::GyroUse;

/// Number of measurements over which the NIS is averaged for the test whether a filter is lost.
const LOSS_WINDOW: f64 = 10.0;

/// Rules for the life of a target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LifecycleRules {
    /// Number of measurements for the constant-velocity filter that starts a target.
    pub start_rows: u32,
    /// Gates on the NIS of 1 to 5 values; infinite for no gate.
    pub gate: [f64; 5],
    /// Number of measurements over which the noise of a sensor is estimated; None: the configured
    /// noise is used, and only the gate rejects measurements.
    pub memory: Option<f64>,
    /// The filter is lost when the NIS per degree of freedom, averaged over 10
    /// measurements, is above this; 1 is expected; None for never.
    pub loss_ratio: Option<f64>,
    /// Use the range rate of a first radar measurement as the speed along the line of sight.
    pub radar_starts_speed: bool,
    /// If true, a target starts with the covariance of its first measured position instead of the
    /// prior covariance.
    pub starts_as_measured: bool,
    /// Use of the turn rate of a gyro.
    pub gyro: GyroUse,
    /// Time for which measurements are kept, so that late ones can be inserted [ns].
    pub buffer_ns: i64,
}

/// Probability of the gate for a true measurement.
const GATE_PROBABILITY: f64 = 0.9999;

impl Default for LifecycleRules {
    fn default() -> Self {
        Self {
            start_rows: 6,
            gate: Self::gates(Some(GATE_PROBABILITY)).unwrap_or([f64::INFINITY; 5]),
            memory: Some(200.0),
            loss_ratio: Some(4.0),
            radar_starts_speed: true,
            starts_as_measured: false,
            gyro: GyroUse::Input,
            buffer_ns: 500_000_000,
        }
    }
}

impl LifecycleRules {
    /// Gates of the squared distance for 1 to 5 measured values, which a true measurement passes with
    /// `probability`; None: no gates.
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

    /// Outcome of an innovation: accepted, rejected, or filter lost; `average` is the NIS per
    /// value.
    pub(crate) fn check(&self, average: &mut f64, innovation: &Innovation) -> Outcome {
        if let Some(ratio) = self.loss_ratio {
            let share = innovation.nis / innovation.count as f64;
            let share = share.min(ratio * LOSS_WINDOW / 3.0); // one outlier alone is no loss
            *average += (share - *average) / LOSS_WINDOW;
            if *average > ratio {
                return Outcome::Restarted;
            }
        }
        let is_believed = innovation.nis <= self.gate[innovation.count - 1];
        if is_believed { Outcome::Updated } else { Outcome::Gated }
    }
}

/// Outcome of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The measurement corrected the state.
    Updated,
    /// The measurement was the first one and started the target.
    Started,
    /// The measurement describes the motion of the platform.
    PlatformMotion,
    /// The measurement was outside the gate; the state is only predicted.
    Gated,
    /// The filter was lost; the measurement started it again.
    Restarted,
    /// The values cannot be used; nothing changed.
    Invalid,
    /// The measurement is older than the buffer; nothing changed.
    Late,
    /// The measurement was processed before (same stamp, sensor and values); nothing changed.
    Duplicate,
    /// The covariance of its innovation cannot be factorised; nothing changed.
    Singular,
}
