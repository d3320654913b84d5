//! Rules over a target's life, and what becomes of its measurements.

use crate::Error;
use crate::estimation::chi2;
use crate::fusion::filter::engine::Innovation;

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

    /// Believe an innovation, or not, or that the filter is lost; `average` is the NIS per value.
    pub(crate) fn judged(&self, average: &mut f64, innovation: &Innovation) -> Outcome {
        if let Some(Loss { window, ratio }) = self.loss {
            let share = innovation.nis / innovation.count as f64;
            let share = share.min(ratio * window / 3.0); // one outlier alone is no loss
            *average += (share - *average) / window;
            if *average > ratio {
                return Outcome::Restarted;
            }
        }
        let is_believed = innovation.nis <= self.gate[innovation.count - 1];
        if is_believed { Outcome::Updated } else { Outcome::Gated }
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
