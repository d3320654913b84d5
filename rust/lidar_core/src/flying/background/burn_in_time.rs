//! Length of the burn-in: in time rather than scans, so that a slow sensor is ready as soon as
//! a fast one.

use super::burn_in::SeedParameters;

/// A pause between two scans counts as this at most [s], and as so many times the usual step: nothing
/// is seen in it.
const LONGEST_STEP: f64 = 0.5;
const LONGEST_TIMES: f64 = 2.0;
/// Fewer scans do not tell what stands still.
const FEWEST_SCANS: u32 = 3;
/// So many times the scans of the usual sensor are enough, however fast they come.
const MOST_TIMES: u32 = 10;

/// The scans of the burn-in so far.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct BurnIn {
    scans: u32,
    /// Scans of sensors that had one before.
    steps: u32,
    /// Time from scan to scan of the same sensor, summed up without pauses [s].
    seconds: f64,
    is_over: bool,
}

impl BurnIn {
    /// The burn-in after one more scan; `step` [s] is the time since the last scan of the same
    /// sensor, None for its first one. Several sensors need no more scans than one of them alone.
    pub(crate) fn after(self, step: Option<f64>, seed: &SeedParameters) -> Self {
        if self.is_over(seed) {
            return self;
        }
        let next = Self {
            scans: self.scans.saturating_add(1),
            steps: self.steps + u32::from(step.is_some()),
            seconds: self.seconds + step.map_or(0.0, |step| step.clamp(0.0, self.longest())),
            is_over: false,
        };
        Self { is_over: next.scans >= next.length(seed), ..next }
    }

    /// The longest time between two scans that counts as such [s].
    fn longest(&self) -> f64 {
        let usual = self.seconds / f64::from(self.steps.max(1));
        if usual > 0.0 { LONGEST_STEP.min(LONGEST_TIMES * usual) } else { LONGEST_STEP }
    }

    /// True if the coming scan no longer belongs to the burn-in.
    pub(crate) fn is_over(&self, seed: &SeedParameters) -> bool {
        self.is_over || seed.burn_in_scans == 0
    }

    pub(crate) fn scans(&self) -> u32 {
        self.scans
    }

    /// Scans that it takes, judged by those so far.
    pub(crate) fn length(&self, seed: &SeedParameters) -> u32 {
        let usual = seed.burn_in_scans;
        let (Some(period), 1..) = (seed.burn_in_period, self.steps) else { return usual };
        let step = self.seconds / f64::from(self.steps);
        let scans = (f64::from(usual) * period / step).round() as u32; // infinity gives the largest
        scans.clamp(usual.min(FEWEST_SCANS), usual.saturating_mul(MOST_TIMES))
    }

    /// Of `standing_scans` the part that belongs to a burn-in of so many scans.
    pub(crate) fn standing(seed: &SeedParameters, length: u32) -> u32 {
        let share = f64::from(seed.standing_scans) / f64::from(seed.burn_in_scans.max(1));
        (share * f64::from(length) - 1e-9).ceil() as u32
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

    /// Scans until it is over, given the time between scans [s].
    fn length(seed: &SeedParameters, step: impl Fn(u32) -> f64) -> u32 {
        let (mut burn_in, mut before) = (BurnIn::default(), None);
        while !burn_in.is_over(seed) {
            burn_in = burn_in.after(before, seed);
            before = Some(step(burn_in.scans()));
        }
        burn_in.scans()
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
    fn without_a_period_scans_are_counted() {
        for step in [0.01, 0.1, 2.0] {
            assert_eq!(length(&seed(None), |_| step), 10);
        }
        let none = SeedParameters { burn_in_scans: 0, ..seed(Some(0.1)) };
        assert!(BurnIn::default().is_over(&none));
    }

    #[test]
    fn half_of_the_scans_tell_what_stands_still() {
        let seed = seed(Some(0.1));
        let standing = [3, 10, 20].map(|length| BurnIn::standing(&seed, length));
        assert_eq!(standing, [2, 5, 10]);
    }
}
