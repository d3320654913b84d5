//! Range of the values of the last measurements on each axis, without outliers.

use serde::{Deserialize, Serialize};

/// Largest number of dimensions of a measurement.
pub const AXES: usize = 4;
/// Number of stored measurements.
const KEPT: usize = 128;
/// Largest number of measurements that are stored from one scan, so that a large scan does not
/// replace all others.
const OF_SCAN: usize = 32;
/// Share of the measurements that is left out at each end of an axis; one at least.
const OUTER: f64 = 0.05;
/// Largest magnitude of a bound, so that volumes stay finite.
const LARGEST: f64 = 1e30;

/// The last measurements of a scanner.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Recent {
    places: Vec<[f64; AXES]>,
    next: usize,
}

impl Recent {
    /// Add the measurements of a scan; of a large scan only some, evenly over their order.
    pub fn take(&mut self, scan: &[[f64; AXES]]) {
        let taken = scan.len().min(OF_SCAN);
        for place in (0..taken).map(|k| scan[k * scan.len() / taken]) {
            if self.places.len() < KEPT {
                self.places.push(place);
            } else {
                self.places[self.next] = place;
            }
            self.next = (self.next + 1) % KEPT;
        }
    }

    /// Lower and upper bound of each axis; None before three measurements.
    ///
    /// The outer 5 % at each end are left out, and the remaining range is enlarged to compensate.
    /// For uniformly distributed values, the bounds are those of all values. A few outliers hardly
    /// change them.
    #[must_use]
    pub fn bounds(&self) -> Option<[[f64; 2]; AXES]> {
        let count = self.places.len();
        let outer = ((count as f64 * OUTER) as usize).max(1);
        let inner = count.checked_sub(2 * outer).filter(|inner| *inner > 0)?;
        let stretch = 0.5 * count as f64 / inner as f64;
        Some(std::array::from_fn(|axis| {
            let mut values: Vec<f64> = self.places.iter().map(|place| place[axis]).collect();
            values.sort_unstable_by(f64::total_cmp);
            let [low, high] =
                [outer, count - 1 - outer].map(|k| values[k].clamp(-LARGEST, LARGEST));
            let (center, half) = (0.5 * (low + high), stretch * (high - low));
            [center - half, center + half]
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn even(count: usize) -> Vec<[f64; AXES]> {
        let at = |k: usize, step: f64| (k as f64 * step) % 1.0;
        (0..count).map(|k| [100.0 * at(k, 0.618_034), 10.0 * at(k, 0.414_214), 0.0, 0.0]).collect()
    }

    fn volume(recent: &Recent) -> f64 {
        recent.bounds().map_or(0.0, |b| (b[0][1] - b[0][0]) * (b[1][1] - b[1][0]))
    }

    #[test]
    fn even_values_give_their_bounds() {
        let mut recent = Recent::default();
        even(300).chunks(10).for_each(|scan| recent.take(scan));
        assert!((volume(&recent) / 1000.0 - 1.0).abs() < 0.05, "{}", volume(&recent));
    }

    #[test]
    fn far_values_hardly_move_the_bounds() {
        for far in [3e3, 1e9, 1e150, f64::MAX, -f64::MAX] {
            for count in [4, 13, 128] {
                let (mut with, mut without) = (Recent::default(), Recent::default());
                let scan = even(count);
                scan.chunks(8).for_each(|scan| without.take(scan));
                let mut spoilt = scan;
                spoilt[count / 2] = [far; AXES];
                spoilt.chunks(8).for_each(|scan| with.take(scan));
                let ratio = volume(&with) / volume(&without);
                assert!((0.3..3.0).contains(&ratio), "{far} {count} {ratio}");
            }
        }
    }

    /// The opposite: where the scanner now measures further away, the bounds follow.
    #[test]
    fn the_bounds_follow_what_is_measured_now() {
        let mut recent = Recent::default();
        even(300).chunks(10).for_each(|scan| recent.take(scan));
        let larger = even(300).iter().map(|p| p.map(|value| 5.0 * value)).collect::<Vec<_>>();
        larger.chunks(10).for_each(|scan| recent.take(scan));
        assert!((volume(&recent) / 25e3 - 1.0).abs() < 0.05, "{}", volume(&recent));
    }

    #[test]
    fn a_large_scan_is_sampled_evenly() {
        let mut recent = Recent::default();
        let line: Vec<[f64; AXES]> = (0..2000).map(|k| [f64::from(k), 0.0, 0.0, 0.0]).collect();
        recent.take(&line);
        let [low, high] = recent.bounds().map_or([f64::NAN; 2], |bounds| bounds[0]);
        assert!((low - 0.0).abs() < 150.0 && (high - 2000.0).abs() < 150.0, "{low} {high}");
    }

    #[test]
    fn values_beyond_all_bounds_give_finite_ones() {
        let mut recent = Recent::default();
        recent.take(&[
            [f64::MAX; AXES],
            [-f64::MAX; AXES],
            [0.0; AXES],
            [f64::MAX; AXES],
            [-f64::MAX; AXES],
        ]);
        let is_finite = |bounds: [[f64; 2]; AXES]| bounds.iter().flatten().all(|b| b.is_finite());
        assert!(recent.bounds().is_some_and(is_finite));
    }
}
