//! Rays without return, and how drivers of 2D scanners mark them.

use serde::{Deserialize, Serialize};

/// Least share of invalid rays in a scan if invalid values mark misses. Dark or slanting surfaces
/// give fewer invalid rays.
const MANY: f64 = 0.05;
/// A value marks misses only if the values of a kind with more certain meaning are rarer than this
/// share of it.
const RARE: f64 = 0.05;
/// Number of scans over which the counts are averaged.
const MEMORY: f64 = 200.0;
/// Number of scans before NaN can be recognised as the mark of misses.
const FIRST: f64 = 20.0;

/// Distance above the smallest measurable range, in standard deviations: the neighbours of a hit
/// within it may be too near to be measured.
pub(in crate::circles) const NEAR: f64 = 10.0;

/// Value that marks a ray without return.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum NoReturn {
    /// +inf, as REP-117 defines it, or a range at or beyond the limit of the scanner.
    #[default]
    Infinite,
    /// A range of zero.
    Zero,
    /// A range of NaN.
    Nan,
}

/// Statistics of the scans of one scanner that show how its rays without return are marked.
///
/// REP-117 defines +inf for a ray without return within range, and NaN for an erroneous
/// measurement. Many drivers write zero or NaN for both: a scan then has no +inf, but many zeros or
/// NaN. NaN on rays that never had a range may be a mask, for example for parts of the robot. It
/// stays "no information".
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Misses {
    no_return: NoReturn,
    scans: f64,
    rays: f64,
    infinite: f64,
    zero: f64,
    /// NaN on rays that worked before.
    nan: f64,
    /// Rays that had a range at least once.
    worked: Vec<bool>,
}

impl Misses {
    /// The value that marks a ray without return, learnt from the scans so far.
    #[must_use]
    pub fn no_return(&self) -> NoReturn {
        self.no_return
    }

    /// Count the ranges of one more scan [m]. A scan without any range is ignored: scanners send
    /// such scans while they start.
    pub fn add(&mut self, ranges: &[f32], [range_min, range_max]: [f64; 2]) {
        let (least, limit) = (range_min as f32, range_max as f32);
        let is_hit = |range: f32| range.is_finite() && range > 0.0 && range >= least;
        if !ranges.iter().any(|&range| is_hit(range)) {
            return;
        }
        self.worked.resize(ranges.len(), false);
        let [mut infinite, mut zero, mut nan] = [0_u32; 3];
        for (worked, &range) in self.worked.iter_mut().zip(ranges) {
            infinite += u32::from(range == f32::INFINITY || range == limit);
            zero += u32::from(range == 0.0);
            nan += u32::from(range.is_nan() && *worked);
            *worked |= is_hit(range);
        }
        let kept = 1.0 - 1.0 / MEMORY;
        let sums =
            [&mut self.scans, &mut self.rays, &mut self.infinite, &mut self.zero, &mut self.nan];
        let news = [1.0, ranges.len() as f64, f64::from(infinite), f64::from(zero), f64::from(nan)];
        for (sum, new) in sums.into_iter().zip(news) {
            *sum = kept * *sum + new;
        }
        self.no_return = self.meaning();
    }

    /// The value that marks a ray without return, from the counts; the last result if the counts do
    /// not decide.
    fn meaning(&self) -> NoReturn {
        let is_many = |count: f64| count > 0.0 && count >= MANY * self.rays;
        let can_be_zero = self.infinite.max(RARE * RARE * self.nan) <= RARE * self.zero;
        let can_be_nan = self.infinite + self.zero <= RARE * self.nan;
        if can_be_zero && (is_many(self.zero) || self.no_return == NoReturn::Zero) {
            NoReturn::Zero
        } else if can_be_nan
            && (is_many(self.nan) && self.scans >= FIRST || self.no_return == NoReturn::Nan)
        {
            NoReturn::Nan
        } else {
            NoReturn::Infinite
        }
    }

    /// True if these can be the counts and flags of a scanner with this many rays.
    pub(in crate::circles) fn is_sound(&self, rays: usize) -> bool {
        let counts = [self.scans, self.rays, self.infinite, self.zero, self.nan];
        counts.iter().all(|count| count.is_finite() && *count >= 0.0)
            && (self.worked.is_empty() || self.worked.len() == rays)
    }

    /// Ranges of a scan with +inf for a miss and NaN for no information.
    ///
    /// Below `range_min` is no information, at or above `range_max` a miss. Invalid rays beside a
    /// range below `nearest` stay "no information": the same surface may be too near to be measured
    /// there. All in metres.
    #[must_use]
    pub fn marked(
        &self,
        ranges: &[f32],
        [range_min, range_max]: [f64; 2],
        nearest: f64,
    ) -> Vec<f64> {
        let limit = range_max as f32;
        let limited = |&range: &f32| match f64::from(range) {
            near if near < range_min || near <= 0.0 => f64::NAN,
            _ if range >= limit => f64::INFINITY,
            range => range,
        };
        let mut marked: Vec<f64> = ranges.iter().map(limited).collect();
        let is_invalid: fn(&f32) -> bool = match self.no_return {
            NoReturn::Infinite => return marked,
            NoReturn::Zero => |&range| range == 0.0,
            NoReturn::Nan => |range| range.is_nan(),
        };
        let can_be_masked = self.no_return == NoReturn::Nan;
        // From a valid ray on, once around: the last ray may be the neighbour of the first.
        let first = ranges.iter().position(|range| !is_invalid(range)).unwrap_or(0);
        let around: Vec<usize> = (first..ranges.len()).chain(0..first).collect();
        let mut before = f64::NAN;
        for run in around.chunk_by(|a, b| is_invalid(&ranges[*a]) == is_invalid(&ranges[*b])) {
            let after = around[(run[run.len() - 1] + around.len() + 1 - first) % around.len()];
            let is_near = before < nearest || marked[after] < nearest;
            before = marked[run[run.len() - 1]];
            if !is_invalid(&ranges[run[0]]) || is_near {
                continue;
            }
            for &ray in run {
                if !can_be_masked || self.worked.get(ray) == Some(&true) {
                    marked[ray] = f64::INFINITY;
                }
            }
        }
        marked
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: [f64; 2] = [0.1, 10.0];

    /// Rays of `value`, but for five at 3 m from ray `first` on.
    fn scan(value: f32, first: usize) -> Vec<f32> {
        (0..40).map(|ray| if (first..first + 5).contains(&ray) { 3.0 } else { value }).collect()
    }

    fn after<'a>(scans: impl IntoIterator<Item = &'a [f32]>) -> Misses {
        let mut misses = Misses::default();
        scans.into_iter().for_each(|ranges| misses.add(ranges, LIMITS));
        misses
    }

    fn marked(misses: &Misses, ranges: &[f32]) -> Vec<f64> {
        misses.marked(ranges, LIMITS, 0.2)
    }

    #[test]
    fn limits_of_the_scanner_hold() {
        let ranges = [0.05, 3.0, 10.0, 9.999_999, 12.0, f32::INFINITY, f32::NAN, 0.0, -1.0];
        let found = marked(&Misses::default(), &ranges);
        assert_eq!((found[1], found[3].is_finite()), (3.0, true));
        assert!([2, 4, 5].iter().all(|&ray| found[ray] == f64::INFINITY));
        assert!([0, 6, 7, 8].iter().all(|&ray| found[ray].is_nan()));
    }

    #[test]
    fn zeros_are_misses_where_nothing_else_is() {
        let zeros = scan(0.0, 10);
        let misses = after([&zeros[..]]);
        assert_eq!(misses.no_return, NoReturn::Zero);
        let expected: Vec<f64> = scan(f32::INFINITY, 10).into_iter().map(f64::from).collect();
        assert_eq!(marked(&misses, &zeros), expected);
    }

    #[test]
    fn zeros_beside_misses_are_no_information() {
        let mut ranges = scan(f32::INFINITY, 10);
        ranges[20..24].fill(0.0);
        let misses = after([&ranges[..]]);
        assert_eq!(misses.no_return, NoReturn::Infinite);
        assert!(marked(&misses, &ranges)[20..24].iter().all(|range| range.is_nan()));
        // A driver that is learnt wrongly at first.
        let mut misses = after([&scan(0.0, 10)[..]]);
        assert_eq!(misses.no_return, NoReturn::Zero);
        (0..5).for_each(|_| misses.add(&ranges, LIMITS));
        assert_eq!(misses.no_return, NoReturn::Infinite);
    }

    #[test]
    fn few_invalid_rays_are_no_information() {
        let mut ranges = [3.0; 40];
        ranges[7] = 0.0;
        let mut misses = Misses::default();
        (0..100).for_each(|_| misses.add(&ranges, LIMITS));
        assert_eq!(misses.no_return, NoReturn::Infinite);
        // Later many: the robot has left the room. Back in a room they mean the same.
        (0..20).for_each(|_| misses.add(&scan(0.0, 10), LIMITS));
        assert_eq!(misses.no_return, NoReturn::Zero);
        (0..1000).for_each(|_| misses.add(&ranges, LIMITS));
        assert_eq!(misses.no_return, NoReturn::Zero);
    }

    /// A scanner that starts with zeros, and a driver that gives NaN from then on.
    #[test]
    fn what_a_scanner_gives_while_it_starts_is_forgotten() {
        let mut misses = Misses::default();
        misses.add(&[0.0; 40], LIMITS);
        assert_eq!(misses.no_return, NoReturn::Infinite);
        misses.add(&scan(0.0, 10), LIMITS);
        assert_eq!(misses.no_return, NoReturn::Zero);
        (0..300).for_each(|count| misses.add(&scan(f32::NAN, count % 35), LIMITS));
        assert_eq!(misses.no_return, NoReturn::Nan);
    }

    #[test]
    fn ranges_at_the_limit_are_misses_and_zeros_beside_them_are_not() {
        let mut ranges = scan(10.0, 10);
        ranges[20..24].fill(0.0);
        let misses = after([&ranges[..]]);
        assert_eq!(misses.no_return, NoReturn::Infinite);
        assert!(marked(&misses, &ranges)[20..24].iter().all(|range| range.is_nan()));
    }

    #[test]
    fn a_mask_of_nan_stays_no_information() {
        let mut misses = Misses::default();
        let mut masked = [7.0; 40];
        masked[..4].fill(f32::NAN);
        masked[30..].fill(f32::NAN);
        (0..50).for_each(|_| misses.add(&masked, LIMITS));
        assert_eq!(misses.no_return, NoReturn::Infinite);
        // Outside the mask the rays work, and their NaN are misses.
        for count in 0..50 {
            masked[4..30].fill(f32::NAN);
            masked[4 + count % 20..][..5].fill(3.0);
            misses.add(&masked, LIMITS);
        }
        assert_eq!(misses.no_return, NoReturn::Nan);
        let found = marked(&misses, &masked);
        assert!(found[..4].iter().chain(&found[30..]).all(|range| range.is_nan()));
        assert!(found[4..30].iter().all(|range| !range.is_nan()));
    }

    #[test]
    fn rays_that_may_have_met_something_too_near_are_no_information() {
        let mut ranges = scan(0.0, 10);
        ranges[10..15].fill(0.15);
        let misses = after([&ranges[..]]);
        assert!(marked(&misses, &ranges)[..10].iter().all(|range| range.is_nan()));
        // Across the seam of a full turn.
        let mut ranges = scan(0.0, 20);
        ranges[35..].fill(0.15);
        let found = marked(&misses, &ranges);
        assert!(found[..20].iter().chain(&found[25..35]).all(|range| range.is_nan()));
    }
}
