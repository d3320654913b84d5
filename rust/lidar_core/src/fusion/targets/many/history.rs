//! Recent scans, and the tracks before each of them, so that a late scan can be inserted.

use super::track::{Assigned, NewNumbers, Scan};
use super::tracks::{SavedTracks, Tracks};
use crate::Error;
use crate::util::full_state::impossible;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Largest number of scans, and of tracks in them, that are kept.
const MOST_KEPT: usize = 100_000;

/// A processed scan.
#[derive(Clone)]
pub(super) struct Past {
    pub(super) scan: Scan,
    pub(super) assigned: Vec<Assigned>,
    pub(super) births: NewNumbers,
    pub(super) before: Tracks,
}

/// Saved form of [`Past`].
#[derive(Serialize, Deserialize)]
pub(super) struct SavedPast {
    scan: Scan,
    assigned: Vec<Assigned>,
    births: NewNumbers,
    before: SavedTracks,
}

impl Past {
    /// State that changes with scans.
    pub(super) fn saved(&self) -> SavedPast {
        SavedPast {
            scan: self.scan.clone(),
            assigned: self.assigned.clone(),
            births: self.births.clone(),
            before: self.before.saved(),
        }
    }

    /// Restore a saved scan. The filters of its tracks get the parameters of `empty`.
    ///
    /// # Errors
    /// [`Error::Format`] for the state of another model.
    pub(super) fn restored(saved: SavedPast, empty: &Tracks) -> Result<Self, Error> {
        let SavedPast { scan, assigned, births, before } = saved;
        if births.of_column.len() != scan.measurements.len() {
            return Err(impossible("counts of new tracks and measurements differ"));
        }
        Ok(Self { scan, assigned, births, before: empty.restored(&before)? })
    }

    /// True if all track IDs in it are below `next_id`, the next unused ID.
    pub(super) fn is_numbered(&self, next_id: i64) -> bool {
        let mut assigned = self.assigned.iter().filter_map(|one| one.id);
        assigned.all(|id| (0..next_id).contains(&id))
            && self.births.are_below(next_id)
            && self.before.are_below(next_id)
    }
}

/// Remove scans before `oldest` [ns] (all scans if it is None), and the oldest scans if there are
/// too many. Returns the time of the last removed scan [ns].
pub(super) fn forget(scans: &mut VecDeque<Past>, oldest: Option<i64>) -> Option<i64> {
    let mut kept: usize = scans.iter().map(|past| 1 + past.before.len()).sum();
    let is_old = |past: &Past| oldest.is_none_or(|oldest| past.scan.stamp_ns < oldest);
    let mut forgotten = None;
    while let Some(past) = scans.front().filter(|past| kept > MOST_KEPT || is_old(past)) {
        kept -= 1 + past.before.len();
        forgotten = Some(past.scan.stamp_ns);
        scans.pop_front();
    }
    forgotten
}
