//! How long something has been in a voxel.

use crate::Error;
use crate::flying::map::blocks::Place;
use crate::geometry::lattice::Voxel;
use crate::util::full_state::impossible;
use crate::util::key_hasher::KeyHasher;
use serde::{Deserialize, Serialize};
use std::collections::{HashMap, HashSet};
use std::hash::BuildHasherDefault;

/// Time after which an object that does not move at its new place becomes background [s].
const STANDS: f64 = 10.0;
/// Time for which an object without returns is remembered [s].
const HIDDEN: f64 = 2.0;

/// Smallest share of the voxels of a moving part that were entered later than the first one. What has only become
/// visible, such as a post that rays missed before, is in all its voxels from the first scan on.
const LATER: f64 = 0.4;

/// Voxels with something in them.
pub(super) type Stays = HashMap<Place, Stay, BuildHasherDefault<KeyHasher>>;

/// Times at which something was in a voxel that had been free [ns].
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct Stay {
    pub(super) first_ns: i64,
    pub(super) last_ns: i64,
    /// Whether nothing was close below it.
    pub(super) is_in_air: bool,
    /// Whether it was part of something that is known to have come from beside.
    pub(super) moves: bool,
}

impl Stay {
    /// A stay that begins, of something on the ground.
    pub(super) fn new(stamp_ns: i64) -> Self {
        Self { first_ns: stamp_ns, last_ns: stamp_ns, is_in_air: false, moves: false }
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

/// True if something came into the voxels of a part one after the other. `firsts`: when it came into each [ns].
pub(super) fn came_in_turn(firsts: &[i64]) -> bool {
    let earliest = firsts.iter().min();
    is_large_share(firsts.iter().filter(|&first| Some(first) > earliest).count(), firsts.len())
}

/// True if something came into a part from beside: later than into its first voxels, neither above nor below these.
/// Something thin that stands, such as a post, may also be seen voxel by voxel. `firsts`: when it came into each voxel
/// [ns].
pub(super) fn came_from_beside(firsts: &[(Voxel, i64)]) -> bool {
    let Some(earliest) = firsts.iter().map(|(_, first)| *first).min() else { return false };
    let column = |voxel: &Voxel| [voxel[0], voxel[1]];
    let early = firsts.iter().filter(|(_, first)| *first == earliest);
    let columns: HashSet<[i32; 2]> = early.map(|(voxel, _)| column(voxel)).collect();
    let later = firsts.iter().filter(|(voxel, _)| !columns.contains(&column(voxel)));
    is_large_share(later.count(), firsts.len())
}

fn is_large_share(later: usize, all: usize) -> bool {
    later > 0 && later as f64 >= LATER * all as f64
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
