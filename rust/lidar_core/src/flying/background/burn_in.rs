//! The burn-in: the first scans, in which the background is learnt and no detection is reported.
//!
//! Its length is a time and not a number of scans, so that a slow sensor is ready as early as a
//! fast one.

use super::parameters::SeedParameters;
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::parameters::FlyingParameters;
use crate::flying::reporting_gate::ReportingGate;
use serde::{Deserialize, Serialize};

/// Longest time that counts for a pause between two scans [s]; `LONGEST_TIMES`: also as a multiple
/// of the usual time. Nothing is seen in a pause.
const LONGEST_STEP: f64 = 0.5;
/// Longest time that counts for a pause, as a multiple of the usual time between scans.
const LONGEST_TIMES: f64 = 2.0;
/// Smallest number of scans. Fewer scans do not show which objects stand still.
const FEWEST_SCANS: u32 = 3;
/// Largest number of scans of the burn-in, as a multiple of `burn_in_scans`, also for very fast
/// sensors.
const MOST_TIMES: u32 = 10;

/// State of the burn-in: the scans so far.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct BurnIn {
    scans: u32,
    /// Number of sensors so far. The first scan of a sensor has no time step.
    sensors: u32,
    /// For all other scans, the time since the last scan of the same sensor [s].
    steps: Vec<f64>,
    is_over: bool,
}

impl BurnIn {
    /// The burn-in after one more scan. `step`: time since the last scan of the same sensor [s];
    /// None for its first scan.
    pub(crate) fn after(&self, step: Option<f64>, seed: &SeedParameters) -> Self {
        let mut next = self.clone();
        if next.is_over(seed) {
            return next;
        }
        next.scans = next.scans.saturating_add(1);
        match step {
            Some(step) => next.steps.push(step.max(0.0)),
            None => next.sensors = next.sensors.saturating_add(1),
        }
        next.is_over = next.scans >= next.length(seed);
        if next.is_over {
            next.steps = Vec::new();
        }
        next
    }

    /// Usual time between two scans of a sensor, with pauses shortened [s]. None before it is
    /// known.
    fn usual_step(&self) -> Option<f64> {
        let mut sorted = self.steps.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        // The upper quartile: neither a pause at the start nor scans that come in bursts move it.
        let quartile = *sorted.get(3 * sorted.len().checked_sub(1)? / 4)?;
        let longest = LONGEST_STEP.min(LONGEST_TIMES * quartile);
        Some(sorted.iter().map(|step| step.min(longest)).sum::<f64>() / sorted.len() as f64)
    }

    /// Whether the burn-in is over, so that the next scan does not belong to it.
    pub(crate) fn is_over(&self, seed: &SeedParameters) -> bool {
        self.is_over || seed.burn_in_scans == 0
    }

    /// Number of its scans so far.
    pub(crate) fn scans(&self) -> u32 {
        self.scans
    }

    /// Number of scans of the burn-in, estimated from the scans so far, and never less than these.
    pub(crate) fn length(&self, seed: &SeedParameters) -> u32 {
        if self.is_over {
            return self.scans;
        }
        let usual = seed.burn_in_scans;
        let (Some(period), Some(step)) = (seed.burn_in_period, self.usual_step()) else {
            return usual.max(self.scans);
        };
        let scans = (f64::from(usual) * period / step).round() as u32; // infinity gives the largest
        let most = usual.saturating_mul(MOST_TIMES);
        // Every sensor has to show a few scans of its own.
        let fewest = usual.min(FEWEST_SCANS).saturating_mul(self.sensors.max(1));
        scans.max(fewest).min(most).max(self.scans)
    }

    /// Diagonal beyond which clusters are background [m]: during the burn-in it is smaller than
    /// afterwards. None: no limit.
    pub(crate) fn background_extent(&self, parameters: &FlyingParameters) -> Option<f64> {
        let FlyingParameters { seed, classify, .. } = parameters;
        let otherwise = classify.background_extent;
        if self.is_over(seed) {
            return otherwise;
        }
        Some(otherwise.map_or(seed.burn_in_extent, |limit| limit.min(seed.burn_in_extent)))
    }

    /// Whether the detections of a scan are reported. `self`: the burn-in before the scan;
    /// `with_it`: after it. `needed`: number of confident voxels that a group of the background
    /// must have.
    pub(crate) fn gate(
        &self,
        with_it: &Self,
        seed: &SeedParameters,
        map: &VoxelMap,
        needed: usize,
    ) -> ReportingGate {
        if !self.is_over(seed) {
            ReportingGate::BurnIn { scans: with_it.scans(), of: with_it.length(seed) }
        } else if map.has_background() {
            ReportingGate::Open
        } else {
            ReportingGate::NoBackground { needed }
        }
    }

    /// Number of scans with points in a voxel that make it background, for a burn-in of `length`
    /// scans: the proportion of `standing_scans`, but at least three, because a moving object may
    /// be at one place twice.
    pub(crate) fn standing(seed: &SeedParameters, length: u32) -> u32 {
        let share = f64::from(seed.standing_scans) / f64::from(seed.burn_in_scans.max(1));
        let part = (share * f64::from(length) - 1e-9).ceil() as u32;
        part.max(FEWEST_SCANS.min(seed.standing_scans).min(length))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seed(period: Option<f64>) -> SeedParameters {
        SeedParameters {
            burn_in_scans: 10,
            burn_in_period: period,
            burn_in_extent: 2.0,
            standing_scans: 5,
            standing_shift: 0.04,
            standing_track_distance: 0.5,
            ground_height: None,
            take_off_height: None,
        }
    }

    /// Length of a burn-in [scans]. `step`: time before each scan [s].
    fn length(seed: &SeedParameters, step: impl Fn(u32) -> f64) -> u32 {
        let (mut burn_in, mut before) = (BurnIn::default(), None);
        while !burn_in.is_over(seed) {
            burn_in = burn_in.after(before, seed);
            before = Some(step(burn_in.scans()));
        }
        burn_in.scans()
    }

    #[test]
    fn neither_pauses_nor_bursts_change_its_length() {
        let seed = seed(Some(0.1));
        for first in [60.0, 0.5, 0.01, 1e-3, 1e-6, 0.0] {
            let found = length(&seed, |scan| if scan == 1 { first } else { 0.1 });
            assert!((9..=11).contains(&found), "{first}: {found}");
        }
        // Two LiDARs under one name: twice as many scans in the same time.
        for short in [1e-3, 0.01, 0.05] {
            let pair =
                |odd: u32| move |scan: u32| if scan % 2 == odd { short } else { 0.1 - short };
            let found = [length(&seed, pair(0)), length(&seed, pair(1))];
            assert!(found.iter().all(|found| (19..=21).contains(found)), "{short}: {found:?}");
        }
    }

    #[test]
    fn every_sensor_shows_a_few_scans() {
        let seed = seed(Some(0.1));
        let mut burn_in = BurnIn::default();
        while !burn_in.is_over(&seed) {
            let step = (burn_in.scans() >= 3).then_some(0.3);
            burn_in = burn_in.after(step, &seed);
            let scans = burn_in.scans();
            assert!(burn_in.length(&seed) >= scans);
        }
        assert_eq!(burn_in.scans(), 9);
    }

    #[test]
    fn two_sensors_need_as_many_scans_as_one() {
        let seed = seed(Some(0.1));
        let mut burn_in = BurnIn::default();
        while !burn_in.is_over(&seed) {
            burn_in = burn_in.after((burn_in.scans() >= 2).then_some(0.1), &seed);
        }
        assert_eq!(burn_in.scans(), 10);
    }

    #[test]
    fn it_takes_a_second_at_any_rate() {
        let seed = seed(Some(0.1));
        for (step, expected) in [(0.1, 10), (0.05, 20), (0.2, 5), (0.5, 3), (3.0, 3), (1e-4, 100)] {
            assert_eq!(length(&seed, |_| step), expected, "{step}");
        }
        let jitter = |scan: u32| if scan.is_multiple_of(2) { 0.098 } else { 0.103 };
        assert_eq!(length(&seed, jitter), 10);
        assert_eq!(length(&seed, |scan| if scan == 2 { 60.0 } else { 0.1 }), 9); // a pause
    }

    #[test]
    fn the_last_scan_is_told_as_the_last() {
        let seed = seed(Some(0.1));
        for (step, expected) in [(0.5, 3), (0.2, 5), (0.1, 10), (0.05, 20)] {
            let mut burn_in = BurnIn::default();
            while !burn_in.is_over(&seed) {
                burn_in = burn_in.after((burn_in.scans() > 0).then_some(step), &seed);
            }
            assert_eq!([burn_in.scans(), burn_in.length(&seed)], [expected; 2]);
        }
    }

    #[test]
    fn without_a_period_scans_are_counted() {
        for step in [0.01, 0.1, 2.0] {
            assert_eq!(length(&seed(None), |_| step), 10);
        }
        let none = SeedParameters { burn_in_scans: 0, ..seed(Some(0.1)) };
        assert!(BurnIn::default().is_over(&none));
    }

    #[test]
    fn half_of_the_scans_but_at_least_three_tell_what_stands_still() {
        let seed = seed(Some(0.1));
        let standing = [2, 3, 5, 10, 20].map(|length| BurnIn::standing(&seed, length));
        assert_eq!(standing, [2, 3, 3, 5, 10]);
    }
}
