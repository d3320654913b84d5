//! Where measurements persist: the density of clutter that stands, by place, learnt from scans.

use super::near::{NearIndex, Rectangle};
use serde::{Deserialize, Serialize};

/// Only measurements that are older count [ns]: by then, what moves has left its place.
const OLDER_NS: i64 = 10_000_000_000;
/// Scans without a measurement with which every place begins.
const PRIOR: f64 = 10.0;
/// Scans of so long are kept [ns], the more apart the more measurements they have.
const KEPT_NS: i64 = 60_000_000_000;
/// Largest numbers of scans and of measurements of a scanner that are kept.
const MOST_SCANS: usize = 300;
const MOST_PLACES: usize = 4096;

/// The last measurements of a scanner.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StandingClutter {
    /// Times of scans [ns], in order.
    scans: Vec<i64>,
    /// Times and places [m] of measurements, in the order of their times.
    places: Vec<(i64, [f64; 2])>,
}

impl StandingClutter {
    /// Take in the places of a scan that is not older than the last one; those that are not finite
    /// are left out. Scans that come too often for the numbers that are kept are passed over.
    pub fn take(&mut self, stamp_ns: i64, places: impl Iterator<Item = [f64; 2]>) {
        let finite = places.filter(|place| place.iter().all(|value| value.is_finite()));
        let found: Vec<(i64, [f64; 2])> = finite.map(|place| (stamp_ns, place)).collect();
        let most = (MOST_PLACES / found.len().max(1)).clamp(1, MOST_SCANS);
        let apart = KEPT_NS / most as i64;
        if self.scans.last().is_some_and(|&last| stamp_ns.saturating_sub(last) < apart) {
            return;
        }
        self.scans.push(stamp_ns);
        self.places.extend(found);
        self.scans.drain(..self.scans.len().saturating_sub(MOST_SCANS));
        let forgotten = self.scans[0];
        let by_age = self.places.partition_point(|(stamp, _)| *stamp < forgotten);
        let by_number = self.places.len().saturating_sub(MOST_PLACES);
        self.places.drain(..by_age.max(by_number));
    }

    /// Density of clutter [1/m^2] at each place, for a scan at `stamp_ns`; `places` come with half
    /// the width [m] of the window that is looked at.
    ///
    /// The mean of a gamma distribution: measurements in the window over the scans since the first
    /// of them, [`PRIOR`] more, and the area.
    #[must_use]
    pub fn densities(&self, stamp_ns: i64, places: &[([f64; 2], f64)]) -> Vec<f64> {
        let until = stamp_ns.saturating_sub(OLDER_NS);
        let old = &self.places[..self.places.partition_point(|(stamp, _)| *stamp <= until)];
        let index = NearIndex::new(old.iter().map(|(_, place)| *place).zip(0..).collect());
        let scans = self.scans.partition_point(|stamp| *stamp <= until);
        let mut near = Vec::new();
        let density = |(at, half): &([f64; 2], f64)| {
            near.clear();
            index.collect(&Rectangle::around(*at, [*half; 2]), &mut near);
            let Some(first) = near.iter().map(|number| old[*number].0).min() else { return 0.0 };
            let since = scans - self.scans.partition_point(|stamp| *stamp < first);
            near.len() as f64 / ((PRIOR + since as f64) * 4.0 * half * half)
        };
        places.iter().map(density).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: i64 = 1_000_000_000;

    fn seen(place_of: impl Fn(i64) -> Option<[f64; 2]>) -> StandingClutter {
        let mut seen = StandingClutter::default();
        (0..100).for_each(|k| seen.take(k * SECOND, place_of(k).into_iter()));
        seen
    }

    fn at(seen: &StandingClutter, place: [f64; 2]) -> f64 {
        seen.densities(100 * SECOND, &[(place, 2.0)])[0]
    }

    /// 60 of 91 scans that are old enough; ten more without a measurement.
    #[test]
    fn what_stands_is_counted_where_it_stands() {
        let jetty = seen(|k| (k % 3 < 2).then_some([5.0, 1.0 + 0.01 * k as f64]));
        assert!((at(&jetty, [5.5, 1.5]) - 61.0 / (101.0 * 16.0)).abs() < 1e-12);
        assert_eq!(at(&jetty, [7.5, 1.5]), 0.0);
        assert_eq!(StandingClutter::default().densities(0, &[([0.0; 2], 1.0)]), [0.0]);
    }

    /// The opposite: a boat does not become clutter of its own, nor does a ship that has just
    /// stopped.
    #[test]
    fn what_moves_leaves_no_clutter_where_it_is() {
        let boat = seen(|k| Some([k as f64, 0.0]));
        assert_eq!(at(&boat, [100.0, 0.0]), 0.0);
        assert!(at(&boat, [50.0, 0.0]) < 5.0 / (50.0 * 16.0));
        let stopped = seen(|k| Some([(k as f64).min(92.0), 0.0]));
        assert!(at(&stopped, [92.0, 0.0]) < 3.0 / (10.0 * 16.0));
    }

    /// What was there for the first half of the scans fades in the second.
    #[test]
    fn what_has_gone_fades() {
        let gone = seen(|k| (k < 50).then_some([5.0, 1.0]));
        let stays = seen(|_| Some([5.0, 1.0]));
        assert!(at(&gone, [5.0, 1.0]) < 0.6 * at(&stays, [5.0, 1.0]));
    }

    /// Thirty scans a second of 250 measurements each: what is kept still reaches back by more than 10 s.
    #[test]
    fn a_busy_scanner_learns_as_well() {
        let mut busy = StandingClutter::default();
        for k in 0..3000 {
            let far = (0..250).map(|y| [500.0, f64::from(y)]);
            busy.take(k * SECOND / 30, far.chain([[5.0, 1.0]]));
        }
        assert!(at(&busy, [5.0, 1.0]) > 0.4 / 16.0);
        assert_eq!(at(&busy, [50.0, 1.0]), 0.0);
    }

    #[test]
    fn memory_is_bounded() {
        let mut seen = StandingClutter::default();
        for k in 0..1000 {
            seen.take(k * SECOND, (0..100).map(|y| [0.0, f64::from(y)]));
        }
        assert!(seen.scans.len() == MOST_SCANS && seen.places.len() <= MOST_PLACES);
        seen.take(1000 * SECOND, [[f64::NAN, 0.0]].into_iter());
        assert!(seen.places.iter().all(|(_, place)| place[0] == 0.0));
    }
}
