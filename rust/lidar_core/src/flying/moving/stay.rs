//! How long something has been in a voxel.

use crate::Error;
use crate::flying::map::blocks::Place;
use crate::util::full_state::impossible;
use crate::util::key_hasher::KeyHasher;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::hash::BuildHasherDefault;

/// Time after which an object that does not move at its new place becomes background [s].
const STANDS: f64 = 10.0;
/// Time for which an object without returns is remembered [s].
const HIDDEN: f64 = 2.0;

/// Voxels with something in them.
pub(super) type Stays = HashMap<Place, Stay, BuildHasherDefault<KeyHasher>>;

/// Times at which something was in a voxel that had been free [ns].
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct Stay {
    pub(super) first_ns: i64,
    pub(super) last_ns: i64,
    /// Whether nothing was close below it.
    pub(super) is_in_air: bool,
}

impl Stay {
    /// A stay that begins, of something on the ground.
    pub(super) fn new(stamp_ns: i64) -> Self {
        Self { first_ns: stamp_ns, last_ns: stamp_ns, is_in_air: false }
    }

    pub(super) fn is_remembered(self, now_ns: i64) -> bool {
        let within = |since_ns: i64, time: f64| {
            (i128::from(now_ns) - i128::from(since_ns)) as f64 * 1e-9 <= time
        };
        within(self.last_ns, HIDDEN) && within(self.first_ns, STANDS)
    }

    pub(super) fn is_longer_than_a_scan(self) -> bool {
        self.first_ns < self.last_ns
    }
}

/// Stays to save, in ascending order of voxels.
pub(super) fn saved_stays(stays: &Stays) -> Vec<(Place, Stay)> {
    let mut saved: Vec<_> = stays.iter().map(|(&place, &stay)| (place, stay)).collect();
    saved.sort_unstable_by_key(|(place, _)| *place);
    saved
}

/// The stays of a saved state.
///
/// # Errors
/// [`Error::Format`] for stays in voxels that do not exist.
pub(super) fn restored_stays(saved: Vec<(Place, Stay)>) -> Result<Stays, Error> {
    if !saved.iter().all(|(place, _)| place.has_neighbours()) {
        return Err(impossible("movers in voxels that do not exist"));
    }
    Ok(saved.into_iter().collect())
}
