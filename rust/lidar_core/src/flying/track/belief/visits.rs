//! Places where detections appeared and disappeared, without a flying target that explains them.
//!
//! Leaves in the wind, flags and wires are seen at the same places again and again, each time for a
//! moment. A target comes to a place where nothing was before. So for every detection of a track it
//! is counted how often something else was at its place, long before the track began.

use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Detections within this distance of a place count as detections at the place [m].
const REACH: f64 = 0.5;
/// Detections count only if they are at least this much older than a track [ns]. Later ones may be
/// of its own target.
const BEFORE_NS: i64 = 1_000_000_000;
/// Time without detections between two visits of a place [ns]. Something that passes once, such as
/// a person or a puff of dust, or that stays for a while, is one visit.
const VISIT_NS: i64 = 2_000_000_000;
/// Number of visits for which [`Visits::share`] is one half.
const HALF: f64 = 2.0;
/// Detections are kept for this time [ns], and at most `MOST` of them.
const KEPT_NS: i64 = 60_000_000_000;
/// Largest number of detections that are kept.
const MOST: usize = 4096;

/// One detection that no flying target explains: time, track and position [m].
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Visit {
    stamp_ns: i64,
    /// ID of the track that it fed.
    id: i64,
    place: [f64; 3],
}

/// The latest detections that no flying target explains.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(in crate::flying::track) struct Visits {
    last: VecDeque<Visit>,
}

impl Visits {
    /// How often something else was at `place` [m] long before track `id` began at `born_ns`: 0 for
    /// never, towards 1 for often.
    pub(in crate::flying::track) fn share(&self, place: [f64; 3], id: i64, born_ns: i64) -> f64 {
        let until = born_ns.saturating_sub(BEFORE_NS);
        let is_at = |visit: &&Visit| {
            let apart = [0, 1, 2].map(|axis| (visit.place[axis] - place[axis]).powi(2));
            visit.id != id && visit.stamp_ns <= until && apart.iter().sum::<f64>() <= REACH * REACH
        };
        let mut times: Vec<i64> =
            self.last.iter().filter(is_at).map(|visit| visit.stamp_ns).collect();
        times.sort_unstable();
        let is_apart = |pair: &&[i64]| pair[1].saturating_sub(pair[0]) >= VISIT_NS;
        let gaps = times.windows(2).filter(is_apart).count();
        let visits = (gaps + usize::from(!times.is_empty())) as f64;
        visits / (visits + HALF)
    }

    /// Add a detection at `place` [m] that fed track `id`.
    pub(in crate::flying::track) fn add(&mut self, stamp_ns: i64, id: i64, place: [f64; 3]) {
        self.last.push_back(Visit { stamp_ns, id, place });
        let oldest = stamp_ns.saturating_sub(KEPT_NS);
        while self.last.front().is_some_and(|visit| visit.stamp_ns < oldest)
            || self.last.len() > MOST
        {
            self.last.pop_front();
        }
    }

    /// Remove the detections of track `id`, which turned out to be a flying target.
    pub(in crate::flying::track) fn forget(&mut self, id: i64) {
        self.last.retain(|visit| visit.id != id);
    }

    /// Replace IDs of tracks after a merge: each pair is the ID that stays and the ID that ends.
    pub(in crate::flying::track) fn rename(&mut self, merged: &[[i64; 2]]) {
        if !merged.is_empty() {
            self.last.iter_mut().for_each(|visit| visit.id = renamed(visit.id, merged));
        }
    }

    /// Whether a saved state may contain these detections, if the tracker has given only IDs below
    /// `next_id`.
    pub(in crate::flying::track) fn is_possible(&self, next_id: i64) -> bool {
        self.last.len() <= MOST && self.last.iter().all(|visit| (0..next_id).contains(&visit.id))
    }

    pub(in crate::flying::track) fn clear(&mut self) {
        self.last.clear();
    }
}

/// ID of a track after a merge. `merged`: pairs of the ID that stays and the ID that ends.
pub(in crate::flying::track) fn renamed(id: i64, merged: &[[i64; 2]]) -> i64 {
    merged.iter().fold(id, |id, &[stays, gone]| if id == gone { stays } else { id })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: i64 = 1_000_000_000;

    fn seen(times: &[i64], place: [f64; 3]) -> Visits {
        let mut visits = Visits::default();
        for (id, second) in (0..).zip(times) {
            visits.add(second * SECOND, id, place);
        }
        visits
    }

    #[test]
    fn a_place_where_things_come_and_go_is_told_from_one_where_nothing_was() {
        let leaves = seen(&[0, 4, 9, 15], [5.0, 1.0, 4.0]);
        assert_eq!(leaves.share([5.3, 1.3, 4.1], 9, 20 * SECOND), 4.0 / 6.0);
        assert_eq!(leaves.share([5.3, 1.3, 4.4], 9, 20 * SECOND), 0.0);
        // What was there lately may be the target itself, and one pass is one visit.
        assert_eq!(leaves.share([5.0, 1.0, 4.0], 9, 15 * SECOND), 3.0 / 5.0);
        assert_eq!(seen(&[4, 5, 5, 5], [0.0; 3]).share([0.0; 3], 9, 20 * SECOND), 1.0 / 3.0);
        // However long something stays, it is one visit, and the clock may show any time.
        for start in [-7, 0, 1, 3] {
            let times: Vec<i64> = [0, 1, 2, 3, 4, 5, 9].map(|second| second + start).to_vec();
            let share = seen(&times, [0.0; 3]).share([0.0; 3], 9, 30 * SECOND);
            assert_eq!(share, 2.0 / 4.0, "{start}");
        }
    }

    #[test]
    fn what_a_target_left_itself_does_not_count() {
        let mut visits = Visits::default();
        (0..10).for_each(|second| visits.add(second * SECOND, 3, [0.0; 3]));
        assert_eq!(visits.share([0.0; 3], 3, 20 * SECOND), 0.0);
        assert_eq!(visits.share([0.0; 3], 4, 20 * SECOND), 1.0 / 3.0);
        visits.rename(&[[5, 3], [4, 5]]); // it is 5 now, and then 4
        assert_eq!(visits.share([0.0; 3], 4, 20 * SECOND), 0.0);
        visits.rename(&[[3, 4]]);
        visits.forget(3);
        assert_eq!(visits.share([0.0; 3], 4, 20 * SECOND), 0.0);
    }

    #[test]
    fn memory_is_bounded() {
        let mut visits = Visits::default();
        (0..10_000).for_each(|k| visits.add(k, k, [0.0; 3]));
        assert_eq!(visits.last.len(), MOST);
        visits.add(KEPT_NS + 20_000, 0, [0.0; 3]);
        assert_eq!(visits.last.len(), 1);
        assert!(visits.is_possible(1) && !visits.is_possible(0));
    }
}
