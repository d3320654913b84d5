//! Changes of a voxel map since the last removal of separate voxels.

use super::block_shape::{Bits, EDGE};
use super::blocks::Place;
use super::islands::SearchMemory;
use super::layers::{Layer, Neighbours};
use super::parameters::Separation;
use crate::Error;
use crate::geometry::lattice::Voxel;
use crate::util::full_state::impossible;
use crate::util::key_hasher::KeyHasher;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use std::hash::BuildHasherDefault;

/// Largest number of layers with changes that are kept. With more, the next removal searches the
/// whole map.
const MOST_CHANGES: usize = 1 << 20;

/// Voxels whose occupied state has changed since the last removal of separate voxels.
#[derive(Clone, Default)]
pub(crate) struct Changes {
    /// Voxels that became tentatively or confidently occupied.
    pub(super) gained: Vec<Layer>,
    /// Voxels that are no longer occupied, or no longer confidently, and voxels that the removal
    /// left occupied.
    pub(super) lost: Vec<Layer>,
    /// Parameters of the last removal. A removal with other parameters searches the whole map.
    /// None: there was no removal.
    pub(super) settled_with: Option<Separation>,
    /// A voxel of a group with enough confident voxels. None: there was no such group. It stays
    /// when the map forgets the voxel's block, because no scan has shown that the group is gone.
    pub(super) anchor: Option<Voxel>,
    /// Memory of the searches for groups, used again.
    pub(super) search_memory: SearchMemory,
    /// Neighbourhood for the parameters of the last removal. None: not computed yet.
    pub(super) neighbours: Option<Neighbours>,
    /// Voxels whose groups never count as separate: objects that stand still from the beginning.
    pub(crate) kept: HashSet<Place, BuildHasherDefault<KeyHasher>>,
}

impl Changes {
    /// Note that the voxels of `layer` have changed their state. `before`: bits of those that were
    /// occupied before.
    pub(crate) fn note(&mut self, layer: Layer, before: u64) {
        if self.settled_with.is_none() {
            return; // the next removal looks at everything
        }
        add(&mut self.gained, Layer { bits: layer.bits & !before, ..layer });
        add(&mut self.lost, Layer { bits: layer.bits & before, ..layer });
        if self.gained.len() + self.lost.len() > MOST_CHANGES {
            (self.gained, self.lost) = (Vec::new(), Vec::new());
            self.settled_with = None;
        }
    }

    /// The state to save. A map restored from it gives the same results, bit by bit.
    pub(super) fn saved(&self) -> SavedChanges {
        let mut kept: Vec<Place> = self.kept.iter().copied().collect();
        kept.sort_unstable(); // equal states give equal bytes
        SavedChanges {
            gained: self.gained.clone(),
            lost: self.lost.clone(),
            settled_with: self.settled_with,
            anchor: self.anchor,
            anchored: self.search_memory.anchored(),
            kept,
        }
    }

    /// Changes from a saved state of a map with `blocks` blocks.
    ///
    /// # Errors
    /// [`Error::Format`] for a state that no map has.
    pub(super) fn restored(saved: SavedChanges, blocks: usize) -> Result<Self, Error> {
        let SavedChanges { gained, lost, settled_with, anchor, anchored, kept } = saved;
        let is_layer = |layer: &Layer| (0..EDGE).contains(&layer.z);
        if anchored.len() > blocks || !gained.iter().chain(&lost).all(is_layer) {
            return Err(impossible("changes of blocks that do not exist"));
        }
        let (search_memory, kept) = (SearchMemory::restored(anchored), kept.into_iter().collect());
        Ok(Self { gained, lost, settled_with, anchor, search_memory, neighbours: None, kept })
    }

    /// Discard the history of changes, so that the next removal searches the whole map.
    pub(crate) fn restart(&mut self) {
        let (kept, anchor) = (std::mem::take(&mut self.kept), self.anchor);
        *self = Self { kept, anchor, ..Self::default() };
    }
}

/// [`Changes`] in a saved state.
#[derive(Serialize, Deserialize)]
pub(super) struct SavedChanges {
    gained: Vec<Layer>,
    lost: Vec<Layer>,
    settled_with: Option<Separation>,
    anchor: Option<Voxel>,
    anchored: Vec<Bits>,
    kept: Vec<Place>,
}

fn add(layers: &mut Vec<Layer>, layer: Layer) {
    match layers.last_mut().filter(|last| last.is_same(&layer)) {
        Some(last) => last.bits |= layer.bits,
        None if layer.bits != 0 => layers.push(layer),
        None => {}
    }
}
