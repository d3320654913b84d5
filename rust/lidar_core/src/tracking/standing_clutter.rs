//! Persistent measurements: the density of static clutter by place, learnt from scans.

use super::near::{NearIndex, Rectangle};
use serde::{Deserialize, Serialize};

/// Least age of the measurements that are used [ns]: moving targets have left their place by then.
const OLDER_NS: i64 = 10_000_000_000;
/// Prior of every place: this number of scans without a measurement.
const PRIOR: f64 = 10.0;
/// Time for which scans are stored [ns]. Scans with many measurements are stored at a lower rate.
const KEPT_NS: i64 = 60_000_000_000;
/// Largest number of stored scans of a scanner.
const MOST_SCANS: usize = 300;
/// Largest number of stored measurements of a scanner.
const MOST_PLACES: usize = 4096;
/// Largest number of removed entries of a log: only forged saved states have more.
const FARTHEST: u64 = u64::MAX / 2;

/// Measurements of a scanner, stored once for all states of a tracker that refer to parts of them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlaceLog {
    /// Times of scans [ns], in order.
    scans: Vec<i64>,
    /// Times and places [m] of measurements, in the order of their times.
    places: Vec<(i64, [f64; 2])>,
    /// Counts of the scans and of the measurements that were removed before these.
    dropped: [u64; 2],
}

/// Part of a [`PlaceLog`] to which one state of a tracker refers: its last measurements.
///
/// States of different times share their common entries. A tracker that stores many states for late
/// scans therefore needs hardly more memory than the measurements themselves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StandingClutter {
    /// Indices of the first scan and of the one after the last, counted from the first scan ever.
    scans: [u64; 2],
    /// Indices of the first measurement and of the one after the last, counted from the first ever.
    places: [u64; 2],
}

impl PlaceLog {
    /// Remove entries older than `oldest`, the oldest stored state.
    pub fn forget(&mut self, oldest: &StandingClutter) {
        drop_front(&mut self.scans, &mut self.dropped[0], oldest.scans[0]);
        drop_front(&mut self.places, &mut self.dropped[1], oldest.places[0]);
    }

    /// Remove entries that are not in `newest`, the newest state.
    pub fn end_with(&mut self, newest: &StandingClutter) {
        let count = |end: u64, dropped: u64| end.saturating_sub(dropped) as usize;
        self.scans.truncate(count(newest.scans[1], self.dropped[0]));
        self.places.truncate(count(newest.places[1], self.dropped[1]));
    }

    /// Number of stored measurements.
    #[must_use]
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// True if no measurement is stored.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }
}

/// Remove the values before index `first`, if they are at least half of all values. `dropped`:
/// index of the first value. Each value is moved at most twice in this way.
fn drop_front<T>(values: &mut Vec<T>, dropped: &mut u64, first: u64) {
    let count = first.saturating_sub(*dropped);
    if 2 * count >= values.len() as u64 {
        values.drain(..values.len().min(count as usize));
        *dropped += count;
    }
}

/// The values with the indices `first` to `end`. `dropped`: index of the first stored value.
fn window<T>(values: &[T], dropped: u64, [first, end]: [u64; 2]) -> &[T] {
    let place = |number: u64| number.saturating_sub(dropped) as usize;
    values.get(place(first)..place(end)).unwrap_or_default()
}

impl StandingClutter {
    /// True if this can be a part of `log`.
    #[must_use]
    pub fn is_of(&self, log: &PlaceLog) -> bool {
        let is_inside = |[first, end]: [u64; 2], dropped: u64, count: usize| {
            dropped <= FARTHEST
                && dropped <= first
                && first <= end
                && end <= dropped.saturating_add(count as u64)
        };
        is_inside(self.scans, log.dropped[0], log.scans.len())
            && is_inside(self.places, log.dropped[1], log.places.len())
    }

    /// Add the places of a scan that is not older than the last one; places that are not finite are
    /// left out. Scans that come too often for the stored number are skipped. Entries of later
    /// states are dropped from the log.
    pub fn take(
        &mut self,
        log: &mut PlaceLog,
        stamp_ns: i64,
        places: impl Iterator<Item = [f64; 2]>,
    ) {
        let finite = places.filter(|place| place.iter().all(|value| value.is_finite()));
        let found: Vec<(i64, [f64; 2])> = finite.map(|place| (stamp_ns, place)).collect();
        let most = (MOST_PLACES / found.len().max(1)).clamp(1, MOST_SCANS);
        let apart = KEPT_NS / most as i64;
        let last = window(&log.scans, log.dropped[0], self.scans).last();
        if last.is_some_and(|last| stamp_ns.saturating_sub(*last) < apart) {
            return;
        }
        log.end_with(self);
        log.scans.push(stamp_ns);
        log.places.extend(found);
        self.scans[1] = log.dropped[0] + log.scans.len() as u64;
        self.places[1] = log.dropped[1] + log.places.len() as u64;
        self.scans[0] = self.scans[0].max(self.scans[1].saturating_sub(MOST_SCANS as u64));
        let forgotten = window(&log.scans, log.dropped[0], self.scans)[0];
        let places = window(&log.places, log.dropped[1], self.places);
        let by_age = places.partition_point(|(stamp, _)| *stamp < forgotten);
        let by_number = places.len().saturating_sub(MOST_PLACES);
        self.places[0] += by_age.max(by_number) as u64;
    }

    /// Density of clutter [1/m^2] at each place, for a scan at `stamp_ns` [ns]. `places`: positions
    /// [m], each with half the width of its window [m].
    ///
    /// It is the mean of a gamma distribution: the number of measurements in the window, divided by
    /// the area and by the number of scans since the first of them plus [`PRIOR`].
    #[must_use]
    pub fn densities(&self, log: &PlaceLog, stamp_ns: i64, places: &[([f64; 2], f64)]) -> Vec<f64> {
        let until = stamp_ns.saturating_sub(OLDER_NS);
        let all = window(&log.places, log.dropped[1], self.places);
        let old = &all[..all.partition_point(|(stamp, _)| *stamp <= until)];
        let index = NearIndex::new(old.iter().map(|(_, place)| *place).zip(0..).collect());
        let looks = window(&log.scans, log.dropped[0], self.scans);
        let scans = looks.partition_point(|stamp| *stamp <= until);
        let mut near = Vec::new();
        let density = |(at, half): &([f64; 2], f64)| {
            near.clear();
            index.collect(&Rectangle::around(*at, [*half; 2]), &mut near);
            let Some(first) = near.iter().map(|number| old[*number].0).min() else { return 0.0 };
            let since = scans.saturating_sub(looks.partition_point(|stamp| *stamp < first));
            near.len() as f64 / ((PRIOR + since as f64) * 4.0 * half * half)
        };
        places.iter().map(density).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: i64 = 1_000_000_000;

    /// A state, and the log of which it knows a part.
    #[derive(Clone, Default)]
    struct Seen {
        state: StandingClutter,
        log: PlaceLog,
    }

    impl Seen {
        fn take(&mut self, stamp_ns: i64, places: impl Iterator<Item = [f64; 2]>) {
            self.state.take(&mut self.log, stamp_ns, places);
            assert!(self.state.is_of(&self.log));
        }

        fn densities(&self, stamp_ns: i64, places: &[([f64; 2], f64)]) -> Vec<f64> {
            self.state.densities(&self.log, stamp_ns, places)
        }
    }

    fn seen(place_of: impl Fn(i64) -> Option<[f64; 2]>) -> Seen {
        let mut seen = Seen::default();
        (0..100).for_each(|k| seen.take(k * SECOND, place_of(k).into_iter()));
        seen
    }

    fn at(seen: &Seen, place: [f64; 2]) -> f64 {
        seen.densities(100 * SECOND, &[(place, 2.0)])[0]
    }

    /// 60 of 91 scans that are old enough; ten more without a measurement.
    #[test]
    fn what_stands_is_counted_where_it_stands() {
        let jetty = seen(|k| (k % 3 < 2).then_some([5.0, 1.0 + 0.01 * k as f64]));
        assert!((at(&jetty, [5.5, 1.5]) - 61.0 / (101.0 * 16.0)).abs() < 1e-12);
        assert_eq!(at(&jetty, [7.5, 1.5]), 0.0);
        assert_eq!(Seen::default().densities(0, &[([0.0; 2], 1.0)]), [0.0]);
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
        let mut busy = Seen::default();
        for k in 0..3000 {
            let far = (0..250).map(|y| [500.0, f64::from(y)]);
            busy.take(k * SECOND / 30, far.chain([[5.0, 1.0]]));
        }
        assert!(at(&busy, [5.0, 1.0]) > 0.4 / 16.0);
        assert_eq!(at(&busy, [50.0, 1.0]), 0.0);
    }

    #[test]
    fn memory_is_bounded() {
        let mut seen = Seen::default();
        for k in 0..1000 {
            seen.take(k * SECOND, (0..100).map(|y| [0.0, f64::from(y)]));
            seen.log.forget(&seen.state);
        }
        let (scans, places) = (seen.log.scans.len(), seen.log.places.len());
        assert!(scans <= 2 * MOST_SCANS && places <= 2 * MOST_PLACES + 100, "{scans} {places}");
        let [first, end] = seen.state.places;
        assert!((end - first) as usize <= MOST_PLACES && seen.state.is_of(&seen.log));
        seen.take(1000 * SECOND, [[f64::NAN, 0.0]].into_iter());
        assert!(seen.log.places.iter().all(|(_, place)| place[0] == 0.0));
    }

    /// States of many times know the same places, and each finds what it found in its time.
    #[test]
    fn states_of_all_times_share_one_log() {
        let place = |k: i64| [(k % 7) as f64, 0.1 * k as f64];
        let density = |seen: &Seen, k: i64| seen.densities(k * SECOND, &[(place(k), 2.0)])[0];
        let (mut seen, mut kept) = (Seen::default(), Vec::new());
        for k in 0..700 {
            kept.push((seen.state, density(&seen, k)));
            seen.take(k * SECOND, [place(k), [3.0, 3.0]].into_iter());
        }
        for (k, (state, expected)) in kept.iter().enumerate() {
            let then = Seen { state: *state, log: seen.log.clone() };
            assert_eq!(density(&then, k as i64), *expected);
        }
        assert_eq!(seen.log.len(), 1400);
        // Going on from an earlier state gives what it would have given without the later ones.
        let mut again = Seen { state: kept[200].0, log: seen.log.clone() };
        (200..700).for_each(|k| again.take(k * SECOND, [place(k), [3.0, 3.0]].into_iter()));
        assert!(again.state == seen.state && again.log == seen.log);
        // What no state knows any more goes; the others stay as they are.
        seen.log.forget(&kept[699].0);
        let then = Seen { state: kept[699].0, log: seen.log.clone() };
        assert!(seen.log.len() < 1400 && then.state.is_of(&seen.log));
        assert_eq!(density(&then, 699), kept[699].1);
        assert!(!kept[1].0.is_of(&seen.log));
    }
}
