//! Whether a target or clutter explains the measurements of a track.

use serde::{Deserialize, Serialize};

/// Score of a new track: one of twenty is of a target.
const NEW_SCORE: f64 = -2.94;
/// Score from which on a track is credible, until it falls below 0: twenty times as likely as none.
const CREDIBLE: f64 = 2.94;
/// Largest score: a long past does not outweigh what is measured now.
const LARGEST_SCORE: f64 = 6.9;

/// How much better a target explains the measurements of a track than clutter at their places does.
///
/// # Source
/// Sittler's track score: Blackman & Popoli, "Design and Analysis of Modern Tracking Systems",
/// 1999, sec. 6.2; of measurements alone, since counts and ages say what misses mean.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct TrackScore {
    /// Logarithm of the odds of a target.
    log_odds: f64,
    /// False once clutter explains the measurements as well.
    pub(super) is_credible: bool,
}

impl Default for TrackScore {
    fn default() -> Self {
        Self { log_odds: NEW_SCORE, is_credible: true }
    }
}

impl TrackScore {
    /// Take in a scan that measured the track. `odds` are how much likelier its measurements are of a
    /// target than that the target was missed and they are clutter; it is measured with probability
    /// `detection`. Other tracks do not count: two on one target are both of a target. With `decides` the
    /// score says whether the track is credible.
    pub(super) fn weigh(&mut self, odds: f64, detection: f64, decides: bool) {
        let log_ratio = libm::log((1.0 - detection) * (1.0 + odds));
        self.log_odds = (self.log_odds + log_ratio).min(LARGEST_SCORE);
        if decides {
            let least = if self.is_credible { 0.0 } else { CREDIBLE };
            self.is_credible = self.log_odds >= least;
        }
    }

    /// Probability that the measurements are clutter.
    pub(super) fn clutter(&self) -> f64 {
        1.0 / (1.0 + libm::exp(self.log_odds))
    }
}
