//! Whether a target or clutter explains the measurements of a track.

use serde::{Deserialize, Serialize};

/// Score of a new track: odds of 1:19 that it has a target.
const NEW_SCORE: f64 = -2.94;
/// Score from which on a track is credible, until the score falls below 0: odds of 19:1 that it has
/// a target.
const CREDIBLE: f64 = 2.94;
/// Largest score, so that old measurements do not outweigh new ones.
const LARGEST_SCORE: f64 = 6.9;

/// Score of a track: logarithm of the odds that a target, and not clutter, explains its
/// measurements.
///
/// # Source Sittler's track score: Blackman & Popoli, "Design and Analysis of Modern Tracking
/// Systems", 1999, sec. 6.2. Only measurements change the score; missed detections end a track by
/// counts and ages.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct TrackScore {
    /// Logarithm of the odds that the track has a target.
    log_odds: f64,
    /// False if clutter explains the measurements better than a target.
    pub(super) is_credible: bool,
}

impl Default for TrackScore {
    fn default() -> Self {
        Self { log_odds: NEW_SCORE, is_credible: true }
    }
}

impl TrackScore {
    /// Update the score with a scan that measured the track. `odds`: likelihood that the
    /// measurements come from the target, divided by the likelihood that the target was missed and
    /// they are clutter. `detection`: probability that a scan measures the target. Other tracks are
    /// ignored: two tracks of one target both have a target. If `decides` is true, `is_credible` is
    /// updated, too.
    pub(super) fn weigh(&mut self, odds: f64, detection: f64, decides: bool) {
        let log_ratio = libm::log((1.0 - detection) * (1.0 + odds));
        self.log_odds = (self.log_odds + log_ratio).min(LARGEST_SCORE);
        if decides {
            let least = if self.is_credible { 0.0 } else { CREDIBLE };
            self.is_credible = self.log_odds >= least;
        }
    }

    /// Probability that the measurements of the track are clutter.
    pub(super) fn clutter(&self) -> f64 {
        1.0 / (1.0 + libm::exp(self.log_odds))
    }
}
