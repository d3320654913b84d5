//! Places of detections that came and went, and that no flying target explains.
//!
//! Leaves in the wind, flags and wires are seen at the same places again and again, each time for a moment. A
//! target comes to a place where nothing was before. So every detection of a track is asked how often something
//! else was there, long before the track began.

use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Detections this near to a place were at it [m].
const REACH: f64 = 0.5;
/// Only what was there so long before a track began counts [ns]: before, it may have been the target itself.
const BEFORE_NS: i64 = 1_000_000_000;
/// A place that was empty for so long [ns] between two detections had two visits. What passes once, such as a person
/// or a puff of dust, and what stays for a while, is one.
const VISIT_NS: i64 = 2_000_000_000;
/// So many visits tell as much as all others together could.
const HALF: f64 = 2.0;
/// Detections are kept for so long [ns], and no more of them than this.
const KEPT_NS: i64 = 60_000_000_000;
const MOST: usize = 4096;

/// A detection that no flying target explains.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Visit {
    stamp_ns: i64,
    /// Number of its track.
    id: i64,
    place: [f64; 3],
}

/// The last detections that no flying target explains.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(in crate::flying::track) struct Visits {
    last: VecDeque<Visit>,
}

impl Visits {
    /// How often something else was at a place, long before a track began: 0 for never, towards 1 for often.
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

    /// Take in a detection at a place that fed track `id`.
    pub(in crate::flying::track) fn add(&mut self, stamp_ns: i64, id: i64, place: [f64; 3]) {
        self.last.push_back(Visit { stamp_ns, id, place });
        let oldest = stamp_ns.saturating_sub(KEPT_NS);
        while self.last.front().is_some_and(|visit| visit.stamp_ns < oldest)
            || self.last.len() > MOST
        {
            self.last.pop_front();
        }
    }

    /// Forget the detections of track `id`, which is a flying target.
    pub(in crate::flying::track) fn forget(&mut self, id: i64) {
        self.last.retain(|visit| visit.id != id);
    }

    /// Give the detections of tracks the numbers that their targets have now: pairs of the number that stays and
    /// the one that goes.
    pub(in crate::flying::track) fn rename(&mut self, merged: &[[i64; 2]]) {
        if !merged.is_empty() {
            self.last.iter_mut().for_each(|visit| visit.id = renamed(visit.id, merged));
        }
    }

    /// True if a tracker that has given numbers below `next_id` may keep them.
    pub(in crate::flying::track) fn is_possible(&self, next_id: i64) -> bool {
        self.last.len() <= MOST && self.last.iter().all(|visit| (0..next_id).contains(&visit.id))
    }

    pub(in crate::flying::track) fn clear(&mut self) {
        self.last.clear();
    }
}

/// The number that a target has now.
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
