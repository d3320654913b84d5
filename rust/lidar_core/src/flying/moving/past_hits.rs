//! Voxels that had returns a while ago.

use crate::Error;
use crate::flying::map::block_shape::{Bits, assign, has};
use crate::flying::map::blocks::{Place, offset_of};
use crate::geometry::lattice::Voxel;
use crate::util::full_state::impossible;
use crate::util::key_hasher::KeyHasher;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::hash::BuildHasherDefault;

/// Time for which returns are remembered at least, unless a set is full, and half of the time for which they are
/// remembered at most [s].
const REMEMBERED: f64 = 10.0;
/// Number of blocks in a set from which on the next scan begins a new one (some 40 MB), however short the time was.
const MOST_BLOCKS: usize = 1 << 18;

/// Set of voxels: one bit for each voxel of a block.
#[derive(Default)]
struct VoxelSet {
    slots: HashMap<Place, usize, BuildHasherDefault<KeyHasher>>,
    bits: Vec<Bits>,
    /// The block of the newest voxel: points beside each other in a scan are mostly in one block.
    newest: Option<(Place, usize)>,
}

impl VoxelSet {
    fn insert(&mut self, voxel: Voxel) {
        let place = Place::of(voxel);
        let slot = match self.newest {
            Some((known, slot)) if known == place => slot,
            _ => *self.slots.entry(place).or_insert(self.bits.len()),
        };
        if slot == self.bits.len() {
            self.bits.push(Bits::default());
        }
        self.newest = Some((place, slot));
        assign(&mut self.bits[slot], offset_of(voxel), true);
    }

    fn contains(&self, voxel: Voxel) -> bool {
        let slot = self.slots.get(&Place::of(voxel));
        slot.is_some_and(|&slot| has(&self.bits[slot], offset_of(voxel)))
    }

    fn saved(&self) -> Vec<(Place, Bits)> {
        let mut saved: Vec<_> =
            self.slots.iter().map(|(&place, &slot)| (place, self.bits[slot])).collect();
        saved.sort_unstable_by_key(|(place, _)| *place);
        saved
    }

    fn restored(saved: Vec<(Place, Bits)>) -> Self {
        let slots = saved.iter().zip(0..).map(|((place, _), slot)| (*place, slot)).collect();
        Self { slots, bits: saved.into_iter().map(|(_, bits)| bits).collect(), newest: None }
    }
}

/// Voxels that had returns in the last 10 to 20 seconds.
///
/// Two sets take turns, so that nothing has to be removed voxel by voxel. Voxels outside of the map count too: the
/// sensor may come closer.
#[derive(Default)]
pub(super) struct PastHits {
    newer: VoxelSet,
    older: VoxelSet,
    /// Time at which the newer set was begun [ns].
    since_ns: Option<i64>,
}

/// [`PastHits`] in a saved state.
#[derive(Serialize, Deserialize)]
pub(crate) struct SavedPastHits {
    newer: Vec<(Place, Bits)>,
    older: Vec<(Place, Bits)>,
    since_ns: Option<i64>,
}

impl PastHits {
    /// Whether the newer and the older set count at a time [ns].
    fn counts(&self, now_ns: i64) -> [bool; 2] {
        let since_ns = self.since_ns.unwrap_or(now_ns);
        let age = (i128::from(now_ns) - i128::from(since_ns)) as f64 * 1e-9;
        if age <= REMEMBERED && self.newer.bits.len() <= MOST_BLOCKS {
            [true; 2]
        } else {
            [age <= 2.0 * REMEMBERED, false]
        }
    }

    /// Forget what is too old at a time [ns].
    pub(super) fn forget(&mut self, now_ns: i64) {
        let [is_newer_kept, is_older_kept] = self.counts(now_ns);
        if !is_older_kept {
            let newer = std::mem::take(&mut self.newer);
            self.older = if is_newer_kept { newer } else { VoxelSet::default() };
            self.since_ns = Some(now_ns);
        }
        self.since_ns.get_or_insert(now_ns);
    }

    pub(super) fn insert(&mut self, voxel: Voxel) {
        self.newer.insert(voxel);
    }

    /// True if the voxel had returns that are not too old at a time [ns].
    pub(super) fn contains(&self, voxel: Voxel, now_ns: i64) -> bool {
        let [is_newer_kept, is_older_kept] = self.counts(now_ns);
        is_newer_kept && self.newer.contains(voxel) || is_older_kept && self.older.contains(voxel)
    }

    pub(super) fn saved(&self) -> SavedPastHits {
        let (newer, older) = (self.newer.saved(), self.older.saved());
        SavedPastHits { newer, older, since_ns: self.since_ns }
    }

    /// The past returns of a saved state.
    ///
    /// # Errors
    /// [`Error::Format`] for a state that no detector has.
    pub(super) fn restored(saved: SavedPastHits) -> Result<Self, Error> {
        let SavedPastHits { newer, older, since_ns } = saved;
        let is_set = |of: &[(Place, Bits)]| of.is_sorted_by(|a, b| a.0 < b.0);
        if !is_set(&newer) || !is_set(&older) {
            return Err(impossible("voxels with past returns that are not in order"));
        }
        let [newer, older] = [newer, older].map(VoxelSet::restored);
        Ok(Self { newer, older, since_ns })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: i64 = 1_000_000_000;

    #[test]
    fn returns_are_remembered_for_ten_to_twenty_seconds() {
        let voxels: [Voxel; 4] = [[0, 0, 0], [-1, 7, 8], [-9, 100, -64], [5, 0, 0]];
        let mut hits = PastHits::default();
        hits.forget(0);
        for voxel in &voxels[..3] {
            hits.insert(*voxel);
        }
        for seconds in [1, 10, 11, 20, 21] {
            let now = seconds * SECOND;
            assert_eq!(voxels.map(|voxel| hits.contains(voxel, now)), [true, true, true, false]);
            hits.forget(now);
            assert_eq!(voxels.map(|voxel| hits.contains(voxel, now)), [true, true, true, false]);
        }
        hits.insert([5, 0, 0]);
        let now = 22 * SECOND; // 11 s after the newer set was begun
        assert_eq!(voxels.map(|voxel| hits.contains(voxel, now)), [false, false, false, true]);
        hits.forget(now);
        assert_eq!(voxels.map(|voxel| hits.contains(voxel, now)), [false, false, false, true]);
        assert!(!hits.contains([5, 0, 0], 60 * SECOND));
        hits.forget(60 * SECOND);
        assert!(!hits.contains([5, 0, 0], 60 * SECOND));
    }

    #[test]
    fn a_full_set_is_replaced_before_its_time() {
        let mut hits = PastHits::default();
        for scan in 0..4 {
            hits.forget(scan);
            for at in 0..=MOST_BLOCKS as i32 {
                hits.insert([8 * at, 8 * scan as i32, 0]);
            }
        }
        assert_eq!([hits.newer.bits.len(), hits.older.bits.len()], [MOST_BLOCKS + 1; 2]);
        assert!(hits.contains([0, 24, 0], 3) && !hits.contains([0, 8, 0], 3));
    }

    #[test]
    fn a_saved_set_is_the_same_and_one_out_of_order_is_refused() -> Result<(), Error> {
        let mut hits = PastHits::default();
        hits.forget(0);
        hits.insert([40, 0, 0]);
        hits.insert([-40, 3, 0]);
        hits.forget(15 * SECOND);
        hits.insert([1, 2, 3]);
        let again = PastHits::restored(hits.saved())?;
        for voxel in [[40, 0, 0], [-40, 3, 0], [1, 2, 3]] {
            assert!(again.contains(voxel, 15 * SECOND));
        }
        assert!(!again.contains([0, 0, 0], 15 * SECOND));
        assert_eq!(again.since_ns, Some(15 * SECOND));
        let mut saved = hits.saved();
        saved.older.reverse();
        assert!(PastHits::restored(saved).is_err());
        Ok(())
    }
}
