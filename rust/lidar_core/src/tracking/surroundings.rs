//! What a scanner does, learnt from its scans: how often it measures a target, how dense its clutter
//! is, and how often a measurement that no track explains is of a new target.

use super::existence::Presence;
use serde::{Deserialize, Serialize};

/// Weight of the configured density of clutter [measurements].
const CLUTTER_PRIOR: f64 = 1.0;
/// Weight of the configured probability of detection [looks].
const DETECTION_PRIOR: f64 = 5.0;
/// Weight of the configured share of new targets [measurements].
const SHARE_PRIOR: f64 = 20.0;
/// Number of scans after which one counts 1/e.
const MEMORY: f64 = 300.0;
/// Weight of the configured lifetime [ends of tracks].
const END_PRIOR: f64 = 0.5;
/// Weight of the configured time until something hides a target [times].
const HIDING_PRIOR: f64 = 0.1;
/// Number of targets after which the speed of one counts 1/e.
const SPEEDS: f64 = 50.0;
/// Least variance of the speed, over that before any target.
const SLOWEST: f64 = 1.0 / 9.0;
/// Scans within which a target is found that was there before: they say nothing about arrivals.
const FIRST_SCANS: f64 = 5.0;
/// Limits of the probability of detection.
const DETECTION: [f64; 2] = [0.05, 0.99];

/// Most dimensions of a measurement.
const AXES: usize = 3;

/// Configured values with which a scanner starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScannerPrior {
    /// Probability that a scan measures a target.
    pub detection: f64,
    /// Density of clutter, in the units of a measurement.
    pub clutter: f64,
    /// Probability that a measurement which no track explains is of a new target.
    pub share: f64,
}

/// Running sums over the scans of one scanner.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Surroundings {
    /// Least and largest value seen, by axis.
    low: [f64; AXES],
    high: [f64; AXES],
    scans: f64,
    clutter: f64,
    looks: f64,
    hits: f64,
    arrivals: f64,
}

impl Default for Surroundings {
    fn default() -> Self {
        let (low, high) = ([f64::INFINITY; AXES], [f64::NEG_INFINITY; AXES]);
        Self { low, high, scans: 0.0, clutter: 0.0, looks: 0.0, hits: 0.0, arrivals: 0.0 }
    }
}

impl Surroundings {
    /// Widen the space that the scanner is known to see by a measurement.
    pub fn widen(&mut self, values: &[f64]) {
        for (axis, value) in values.iter().take(AXES).enumerate() {
            self.low[axis] = self.low[axis].min(*value);
            self.high[axis] = self.high[axis].max(*value);
        }
    }

    /// Take in a scan: the sum of the probabilities that its measurements are clutter.
    pub fn count_scan(&mut self, clutter: f64) {
        let kept = 1.0 - 1.0 / MEMORY;
        for sum in [
            &mut self.scans,
            &mut self.clutter,
            &mut self.looks,
            &mut self.hits,
            &mut self.arrivals,
        ] {
            *sum *= kept;
        }
        self.scans += 1.0;
        self.clutter += clutter;
    }

    /// Take in a look at a target that is observable with probability `observable`, and was
    /// measured with probability `hit`.
    pub fn count_look(&mut self, observable: f64, hit: f64) {
        self.looks += observable;
        self.hits += hit;
    }

    /// True once the scanner has had the time to find the targets that were there before it.
    #[must_use]
    pub fn is_settled(&self) -> bool {
        self.scans >= FIRST_SCANS
    }

    /// Take in that a track has become certain that began after the first scans.
    pub fn count_arrival(&mut self) {
        self.arrivals += 1.0;
    }

    /// Volume of the space that the scanner is known to see, in the units of its measurements.
    fn volume(&self, axes: usize) -> f64 {
        let spans = self.low.iter().zip(&self.high).take(axes);
        spans.map(|(low, high)| (high - low).max(0.0)).product()
    }

    /// Density of clutter: mean of its posterior, which has a gamma distribution.
    #[must_use]
    pub fn clutter(&self, prior: &ScannerPrior, axes: usize) -> f64 {
        let exposure = CLUTTER_PRIOR / prior.clutter;
        (CLUTTER_PRIOR + self.clutter) / (exposure + self.scans * self.volume(axes))
    }

    /// Probability that a scan measures a target.
    #[must_use]
    pub fn detection(&self, prior: &ScannerPrior) -> f64 {
        let hits = prior.detection * DETECTION_PRIOR + self.hits;
        (hits / (DETECTION_PRIOR + self.looks)).clamp(DETECTION[0], DETECTION[1])
    }

    /// Probability that a measurement which no track explains is of a new target.
    #[must_use]
    pub fn share(&self, prior: &ScannerPrior) -> f64 {
        (prior.share * SHARE_PRIOR + self.arrivals) / (SHARE_PRIOR + self.clutter + self.arrivals)
    }
}

/// How long targets stay and how fast they are, learnt from tracks that were certain.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Population {
    /// Sum of the times for which targets existed [s].
    stayed: f64,
    ends: f64,
    /// Sum of the times for which they were observable [s], and how often they were hidden and came
    /// back.
    visible: f64,
    returns: f64,
    /// Sum of the squared speeds of targets, per axis [m^2/s^2], and their number.
    squared: f64,
    speeds: f64,
}

impl Population {
    /// Take in what a target did for `dt` [s].
    pub fn count_stay(&mut self, presence: &Presence, dt: f64) {
        self.stayed += presence.existence * dt;
        self.visible += presence.observable() * dt;
    }

    /// Take in that a target was measured that had been hidden with probability `returned`.
    pub fn count_return(&mut self, returned: f64) {
        self.returns += returned;
    }

    /// Take in that a track which was certain has become doubtful, or the reverse.
    pub fn count_end(&mut self, is_doubtful: bool) {
        self.ends += if is_doubtful { 1.0 } else { -1.0 };
    }

    /// Take in that a target has moved with the velocity [vx, vy] [m/s].
    pub fn count_speed(&mut self, [vx, vy]: [f64; 2]) {
        let kept = 1.0 - 1.0 / SPEEDS;
        self.squared = kept * self.squared + 0.5 * (vx * vx + vy * vy);
        self.speeds = kept * self.speeds + 1.0;
    }

    /// Variance of the speed of new targets per axis [m^2/s^2]; `variance` is that before any
    /// target. Among slow ones a ninth of it stays, so that a fast one is still found.
    #[must_use]
    pub fn speed(&self, variance: f64) -> f64 {
        let mean = (variance + self.squared) / (1.0 + self.speeds);
        mean.max(SLOWEST * variance)
    }

    /// Mean time for which a target stays [s]; `lifetime` is that before any track has ended.
    #[must_use]
    pub fn lifetime(&self, lifetime: f64) -> f64 {
        (END_PRIOR * lifetime + self.stayed) / (END_PRIOR + self.ends)
    }

    /// Mean time until something hides a target [s]; `visible` is that before any target.
    #[must_use]
    pub fn visible(&self, visible: f64) -> f64 {
        (HIDING_PRIOR * visible + self.visible) / (HIDING_PRIOR + self.returns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PRIOR: ScannerPrior = ScannerPrior { detection: 0.9, clutter: 1e-3, share: 0.05 };

    #[test]
    fn a_scanner_without_scans_is_as_configured() {
        let unknown = Surroundings::default();
        assert_eq!(unknown.clutter(&PRIOR, 2), 1e-3);
        assert!((unknown.detection(&PRIOR) - 0.9).abs() < 1e-15);
        assert!((unknown.share(&PRIOR) - 0.05).abs() < 1e-15);
    }

    #[test]
    fn what_scans_show_outweighs_what_was_told() {
        for told in [0.5, 1.0, 2.0] {
            let prior = ScannerPrior { detection: 0.45 * told, clutter: 5e-3 * told, share: 0.05 };
            let mut seen = Surroundings::default();
            seen.widen(&[-20.0, -20.0]);
            seen.widen(&[20.0, 20.0]);
            for _ in 0..100 {
                seen.count_scan(10.0);
                (0..8).for_each(|_| seen.count_look(1.0, 0.7));
            }
            assert!((seen.clutter(&prior, 2) / (10.0 / 1600.0) - 1.0).abs() < 0.05);
            assert!((seen.detection(&prior) - 0.7).abs() < 0.02);
            assert!(seen.share(&prior) < 0.01);
        }
    }

    #[test]
    fn lifetimes_are_learnt_from_ends() {
        let mut population = Population::default();
        assert_eq!(population.lifetime(60.0), 60.0);
        (0..100).for_each(|_| {
            population.count_stay(&Presence::measured(1.0), 20.0);
            population.count_end(true);
        });
        assert!((population.lifetime(60.0) - 20.2).abs() < 0.1);
    }

    /// What never was hidden is hardly expected to be; what is every 5 s, is.
    #[test]
    fn hiding_is_learnt_from_returns() {
        let (mut open, mut crowded) = (Population::default(), Population::default());
        assert!((open.visible(20.0) - 20.0).abs() < 1e-12);
        for _ in 0..100 {
            open.count_stay(&Presence::measured(1.0), 5.0);
            crowded.count_stay(&Presence::measured(1.0), 5.0);
            crowded.count_return(1.0);
        }
        assert!(open.visible(20.0) > 1000.0);
        assert!((crowded.visible(20.0) - 5.0).abs() < 0.2);
    }

    /// Everything was seen at one place: no density can be derived, and the configured one stays.
    #[test]
    fn a_space_without_volume_says_nothing() {
        let mut seen = Surroundings::default();
        (0..20).for_each(|_| {
            seen.widen(&[1.0, 1.0]);
            seen.count_scan(0.0);
        });
        assert_eq!(seen.clutter(&PRIOR, 2), 1e-3);
    }
}
