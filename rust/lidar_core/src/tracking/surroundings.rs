//! Properties of a scanner, learnt from its scans: probability of detection, density of clutter,
//! and probability that an unexplained measurement belongs to a new target.

use super::existence::Presence;
use super::extent::{AXES, Recent};
use serde::{Deserialize, Serialize};

/// Weight of the configured density of clutter [measurements].
const CLUTTER_PRIOR: f64 = 1.0;
/// Weight of the configured probability of detection [scans of a target].
const DETECTION_PRIOR: f64 = 5.0;
/// Weight of the configured share of new targets [measurements].
const SHARE_PRIOR: f64 = 20.0;
/// Number of scans after which the weight of a scan is 1/e.
const MEMORY: f64 = 300.0;
/// Weight of the configured lifetime [ends of tracks].
const END_PRIOR: f64 = 0.5;
/// Weight of the configured time until something hides a target [times].
const HIDING_PRIOR: f64 = 0.1;
/// Number of targets after which the weight of the speed of a target is 1/e.
const SPEEDS: f64 = 50.0;
/// Least variance of the speed of new targets, as a share of the configured one.
const SLOWEST: f64 = 1.0 / 9.0;
/// Number of first scans in which targets are found that were there before: these do not count as
/// new targets.
const FIRST_SCANS: f64 = 5.0;
/// Smallest and largest estimated probability of detection.
const DETECTION: [f64; 2] = [0.05, 0.99];

/// Probability that no track explains a measurement, from which on the measurement is stored as
/// clutter.
const UNEXPLAINED: f64 = 0.5;

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
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Surroundings {
    /// The last measurements.
    all: Recent,
    /// The last measurements of clutter: with many targets, only few of all measurements are
    /// clutter.
    strays: Recent,
    /// Width of the space that the measurements take, by axis, in their units.
    widths: [f64; AXES],
    scans: f64,
    clutter: f64,
    /// Expected number of measurements in `clutter` that were the first one of a target.
    first: f64,
    looks: f64,
    hits: f64,
    arrivals: f64,
}

impl Surroundings {
    /// Add the measurements of a scan to the space that the scanner is known to see.
    pub fn see<'a>(&mut self, scan: impl Iterator<Item = &'a [f64]>) {
        self.all.take(&scan.map(padded).collect::<Vec<_>>());
        let boxes = [self.all.bounds(), self.strays.bounds()].into_iter().flatten();
        let joined = |a: [[f64; 2]; AXES], b: [[f64; 2]; AXES]| {
            std::array::from_fn(|k| [a[k][0].min(b[k][0]), a[k][1].max(b[k][1])])
        };
        self.widths = boxes.reduce(joined).map_or([0.0; AXES], |b| b.map(|[low, high]| high - low));
    }

    /// Count the measurements of a scan, each with the probability that no track explains it.
    pub fn count_scan(&mut self, scan: &[(&[f64], f64)]) {
        let strays = scan.iter().filter(|(_, unexplained)| *unexplained > UNEXPLAINED);
        self.strays.take(&strays.map(|(values, _)| padded(values)).collect::<Vec<_>>());
        let clutter: f64 = scan.iter().map(|(_, unexplained)| unexplained).sum();
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

    /// Count measurements of earlier scans that were clutter.
    pub fn count_false(&mut self, count: f64) {
        self.clutter += count;
    }

    /// Replace the expected number of unexplained measurements that were the first one of a target:
    /// `first` is the sum of the probabilities of existence of all tracks that began with them.
    pub fn count_first(&mut self, first: f64) {
        self.first = first;
    }

    /// Number of measurements that count as clutter, less those that were the first of a target.
    fn false_ones(&self) -> f64 {
        (self.clutter - self.first).max(0.0)
    }

    /// Count a scan of a target that is observable with probability `observable` and was measured
    /// with probability `hit`.
    pub fn count_look(&mut self, observable: f64, hit: f64) {
        self.looks += observable;
        self.hits += hit;
    }

    /// True once the scanner has had the time to find the targets that were there before it.
    #[must_use]
    pub fn is_settled(&self) -> bool {
        self.scans >= FIRST_SCANS
    }

    /// Count a track that has become certain and that began after the first scans.
    pub fn count_arrival(&mut self) {
        self.arrivals += 1.0;
    }

    /// Volume of the space that the scanner is known to see, in the units of its measurements; 0
    /// before it is known.
    #[must_use]
    pub fn volume(&self, axes: usize) -> f64 {
        self.widths.iter().take(axes).product()
    }

    /// Density of clutter in the units of a measurement with this number of axes: mean of its
    /// posterior, a gamma distribution.
    #[must_use]
    pub fn clutter(&self, prior: &ScannerPrior, axes: usize) -> f64 {
        let exposure = CLUTTER_PRIOR / prior.clutter;
        (CLUTTER_PRIOR + self.false_ones()) / (exposure + self.scans * self.volume(axes))
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
        (prior.share * SHARE_PRIOR + self.arrivals)
            / (SHARE_PRIOR + self.false_ones() + self.arrivals)
    }
}

fn padded(values: &[f64]) -> [f64; AXES] {
    std::array::from_fn(|axis| values.get(axis).copied().unwrap_or(0.0))
}

/// Lifetimes and speeds of targets, learnt from certain tracks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Population {
    /// Sum of the times for which targets existed [s].
    stayed: f64,
    ends: f64,
    /// Sum of the times for which targets were observable [s].
    visible: f64,
    /// Number of times that targets were hidden and came back.
    returns: f64,
    /// Sum of the squared speeds of targets, per axis [m^2/s^2].
    squared: f64,
    /// Number of targets in this sum.
    speeds: f64,
}

impl Population {
    /// Count the existence of a target for `dt` [s].
    pub fn count_stay(&mut self, presence: &Presence, dt: f64) {
        self.stayed += presence.existence * dt;
        self.visible += presence.observable() * dt;
    }

    /// Count the return of a target that had been hidden with probability `returned`.
    pub fn count_return(&mut self, returned: f64) {
        self.returns += returned;
    }

    /// Count a certain track that has become doubtful, or the reverse.
    pub fn count_end(&mut self, is_doubtful: bool) {
        self.ends += if is_doubtful { 1.0 } else { -1.0 };
    }

    /// Count the velocity [vx, vy] of a target [m/s].
    pub fn count_speed(&mut self, [vx, vy]: [f64; 2]) {
        let kept = 1.0 - 1.0 / SPEEDS;
        self.squared = kept * self.squared + 0.5 * (vx * vx + vy * vy);
        self.speeds = kept * self.speeds + 1.0;
    }

    /// Variance of the speed of new targets per axis [m^2/s^2]. `variance`: initial value. The
    /// result is at least a ninth of it, so that a fast target among slow ones is found.
    #[must_use]
    pub fn speed(&self, variance: f64) -> f64 {
        let mean = (variance + self.squared) / (1.0 + self.speeds);
        mean.max(SLOWEST * variance)
    }

    /// Mean time for which a target exists [s]. `lifetime`: initial value, before any track has
    /// ended.
    #[must_use]
    pub fn lifetime(&self, lifetime: f64) -> f64 {
        (END_PRIOR * lifetime + self.stayed) / (END_PRIOR + self.ends)
    }

    /// Mean time until something hides a target [s]. `visible`: initial value.
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
            let place = |k: usize| [0.618_034, 0.414_214].map(|s| 40.0 * ((k as f64 * s) % 1.0));
            let places: Vec<[f64; 2]> = (0..1000).map(place).collect();
            for scan in places.chunks(10) {
                seen.see(scan.iter().map(<[f64; 2]>::as_slice));
                seen.count_scan(&scan.iter().map(|at| (at.as_slice(), 1.0)).collect::<Vec<_>>());
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
            seen.see([[1.0, 1.0].as_slice()].into_iter());
            seen.count_scan(&[(&[1.0, 1.0], 0.0)]);
        });
        assert_eq!(seen.clutter(&PRIOR, 2), 1e-3);
    }
}
