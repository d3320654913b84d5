//! Noise of a scanner's ranges, estimated from neighbouring rays; the configured noise is the prior.

use super::preprocess::polar_scan::PolarScan;
use super::segment::segments::Segments;
use serde::{Deserialize, Serialize};

/// Median of the absolute value of a normal variable of deviation one.
const MEDIAN: f64 = 0.674_489_750_196_081_7;
/// Sum of the squares of the weights of a third difference: 1, 3, 3, 1.
const SQUARES: f64 = 20.0;
/// Least number of differences by which a scan is judged.
const FEWEST: usize = 12;
/// Number of differences with as much information as one independent difference: neighbours share
/// rays.
const SHARED: f64 = 8.0;
/// Weight of the configured noise, in independent differences.
const PRIOR: f64 = 4.0;
/// Number of independent differences that the mean remembers.
const MEMORY: f64 = 2_000.0;
/// Logarithm of the ratio of the estimated to the used deviation above which the estimate is used.
const STEP: f64 = 0.15;
/// Least difference of the estimated from the used deviation at which the estimate is used, in
/// standard deviations of the estimate.
const SURE: f64 = 3.0;
/// Largest factor on the configured deviation, up and down.
const FACTOR: f64 = 8.0;
/// Least estimated deviation [m], unless a smaller one is configured: below it the shape of
/// surfaces and the steps of the ranges count, not noise.
const LEAST: f64 = 0.002;

/// Standard deviation of the ranges of one scanner, estimated from its scans.
///
/// On a smooth surface the range is a smooth function of the bearing: third differences of four
/// neighbouring rays hold hardly anything but noise, whether the surface stands, moves or is bent,
/// and wherever the scanner is. Their median ignores the few across an edge.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct RangeNoise {
    configured: f64,
    /// Deviation that is used [m].
    used: f64,
    variance: f64,
    weight: f64,
}

impl RangeNoise {
    pub(super) fn new(configured: f64) -> Self {
        Self { configured, used: configured, variance: configured * configured, weight: PRIOR }
    }

    /// Standard deviation of a range that fits use [m]. It is the configured one as long as that is
    /// right, and does not change with every scan, so that scans in another order give the same
    /// map.
    pub(super) fn std(&self) -> f64 {
        self.used
    }

    /// Estimated standard deviation of a range [m].
    pub(super) fn estimate(&self) -> f64 {
        let least = LEAST.min(self.configured).max(self.configured / FACTOR);
        self.variance.sqrt().clamp(least, self.configured * FACTOR)
    }

    /// True if the scans give more information than the configuration.
    pub(super) fn is_known(&self) -> bool {
        self.weight > 2.0 * PRIOR
    }

    /// True if a restored estimate is possible.
    pub(super) fn is_sound(&self) -> bool {
        self.configured > 0.0 && self.used > 0.0 && self.variance >= 0.0 && self.weight > 0.0
    }

    /// Update the statistics with the surfaces of a scan.
    pub(super) fn add(&mut self, scan: &PolarScan, segments: &Segments) {
        let mut found = Vec::new();
        for number in 0..segments.len() {
            let rays = segments.rays_of(number);
            // The outermost rays of a surface graze it.
            let inner = rays.get(1..rays.len().saturating_sub(1)).unwrap_or_default();
            found.extend(inner.windows(4).filter_map(|four| third_difference(scan, four)));
        }
        if found.len() < FEWEST {
            return;
        }
        let count = found.len() as f64 / SHARED;
        let middle = found.len() / 2;
        let (_, median, _) = found.select_nth_unstable_by(middle, f64::total_cmp);
        let variance = *median * *median / (MEDIAN * MEDIAN * SQUARES);
        let weight = self.weight + count;
        self.variance += (variance - self.variance) * count / weight;
        self.weight = weight.min(MEMORY);
        let apart = libm::log(self.estimate() / self.used).abs();
        if apart > STEP.max(SURE / (2.0 * self.weight).sqrt()) {
            self.used = self.estimate();
        }
    }
}

/// Magnitude of the third difference of the ranges of four neighbouring rays [m]; None if they do
/// not follow each other, or one has no range.
fn third_difference(scan: &PolarScan, four: &[u32]) -> Option<f64> {
    let &[a, b, c, d] = four else { return None };
    let is_row = [(a, b), (b, c), (c, d)].iter().all(|&(one, next)| one.abs_diff(next) == 1);
    let [a, b, c, d] = [a, b, c, d].map(|ray| scan.ranges.get(ray as usize).copied());
    let difference = (d? - 3.0 * c? + 3.0 * b? - a?).abs();
    (is_row && difference.is_finite()).then_some(difference)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::circles::segment::segments::Side;

    /// A wall and a post of 0.3 m with uniform errors of this deviation, a ray each 0.5 degrees.
    fn scan(std: f64, state: &mut u32) -> (PolarScan, Segments) {
        let bearings: Vec<f64> = (-80..80).map(|ray| f64::from(ray) * 0.008_73).collect();
        let mut error = || {
            *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (f64::from(*state) / f64::from(u32::MAX) - 0.5) * std * 12.0_f64.sqrt()
        };
        let ranges = bearings.iter().map(|&angle| {
            let across = 2.0 * libm::sin(angle - 0.3);
            let post = 2.0 * libm::cos(angle - 0.3) - (0.09 - across * across).sqrt();
            if post.is_nan() { 4.0 / libm::cos(angle) + error() } else { post + error() }
        });
        let ranges: Vec<f64> = ranges.collect();
        let is_post = |ray: u32| ranges[ray as usize] < 3.0;
        let mut segments =
            Segments { labels: vec![0; 160], starts: vec![0], ..Segments::default() };
        for kind in [true, false] {
            let rays: Vec<u32> = (0..160).filter(|&ray| is_post(ray) == kind).collect();
            segments.push(&rays, [Side::Free; 2]);
        }
        (PolarScan { ranges, bearings }, segments)
    }

    #[test]
    fn the_noise_is_found_wherever_it_starts() {
        let mut state = 1;
        for (told, std) in [(0.01, 0.03), (0.03, 0.01), (0.01, 0.01), (0.01, 0.005)] {
            let mut noise = RangeNoise::new(told);
            assert!(!noise.is_known());
            for _ in 0..40 {
                let (scan, segments) = scan(std, &mut state);
                noise.add(&scan, &segments);
            }
            let found = noise.estimate();
            assert!((found / std - 1.0).abs() < 0.12, "{told} {std}: {found}");
            assert!((noise.std() / found).ln().abs() <= STEP && noise.is_known());
            assert_eq!(noise.std() == told, told == std);
        }
    }

    #[test]
    fn without_surfaces_the_configuration_counts() {
        let mut noise = RangeNoise::new(0.02);
        let ranges = vec![1.0, 3.0, 1.0, 3.0, 1.0];
        let scan = PolarScan { ranges, bearings: (0..5).map(f64::from).collect() };
        let mut segments = Segments { labels: vec![0; 5], starts: vec![0], ..Segments::default() };
        segments.push(&[0, 1, 2, 3, 4], [Side::Free; 2]);
        (0..100).for_each(|_| noise.add(&scan, &segments));
        assert_eq!((noise.std(), noise.is_known()), (0.02, false));
    }
}
