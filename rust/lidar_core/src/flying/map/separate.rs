//! Removal of groups of occupied voxels that are separate from the background (hold too few
//! confident voxels).
//!
//! Source: Vrba et al., sec. III-D, eq. 23. The removal is incremental: a group is searched only if
//! one of its voxels has changed its state, or if a neighbour is no longer occupied. A search ends
//! as soon as it finds enough confident voxels, or a voxel of a group that had enough at the last
//! removal. So the cost depends on the number of changes, not on the size of the map.

use super::blocks::{Block, Place};
use super::changes::Changes;
use super::filter::{filtered, two_to_minus};
use super::islands::{Search, SearchMemory};
use super::layers::Layer;
use super::parameters::Separation;
use super::voxel_map::VoxelMap;
use crate::Error;
use crate::geometry::lattice::Voxel;

impl VoxelMap {
    /// Find groups of occupied voxels with fewer than `min_confident` confident ones, and pull each
    /// of their voxels once towards free. Returns the number of voxels that were pulled.
    ///
    /// # Errors
    /// [`Error::Parameter`] if `max_gap` is not a distance of 0 to 64 voxels.
    ///
    /// # Source
    /// Vrba et al., sec. III-D, eq. 23.
    pub fn remove_separate(&mut self, separation: Separation) -> Result<usize, Error> {
        let separate = self.separate_voxels(separation)?;
        Ok(self.pull_to_free(separate))
    }

    /// Like [`VoxelMap::remove_separate`], but removes nothing until some group has enough
    /// confident voxels. Otherwise the removal would lower the values of a new background faster
    /// than a sparse sensor can raise them.
    ///
    /// # Errors
    /// As [`VoxelMap::remove_separate`].
    pub fn remove_separate_from_background(
        &mut self,
        separation: Separation,
    ) -> Result<usize, Error> {
        let separate = self.separate_voxels(separation)?;
        if self.has_background() {
            return Ok(self.pull_to_free(separate));
        }
        // Nothing was pulled, so these groups must be found again.
        self.changes.restart();
        Ok(0)
    }

    /// Voxels of separate groups, among the groups that have changed, and their neighbours if
    /// `separation.dilate` is set.
    fn separate_voxels(&mut self, separation: Separation) -> Result<Vec<Layer>, Error> {
        // Longer than other functions: one search, whose steps share its memory.
        let looks_at_all = self.changes.settled_with != Some(separation);
        if looks_at_all {
            (self.changes.search_memory, self.changes.neighbours) = (SearchMemory::default(), None);
        }
        let neighbours = match self.changes.neighbours.take() {
            Some(neighbours) => neighbours,
            None => separation.neighbours(self.lattice().voxel_size())?,
        };
        let memory = std::mem::take(&mut self.changes.search_memory);
        let Changes { anchor, gained, lost, kept, .. } = &self.changes;
        let forgotten = anchor.filter(|&voxel| self.blocks.slot(Place::of(voxel)).is_none());
        let min_confident = separation.min_confident;
        let mut search = Search::new(&self.blocks, &neighbours, kept, min_confident, memory);
        // The known background first: most other searches end where they reach it.
        search.look_around(anchor.map(Layer::of).as_slice());
        if looks_at_all {
            search.look_around(&self.occupied_layers());
        } else {
            // Only groups that lost voxels can have come apart. Once they are searched, what was anchored
            // before is anchored still, and searches from new voxels may end there.
            search.look_around(lost);
            search.trust_last();
            search.look_around(gained);
        }
        if search.anchor().is_none() && forgotten.is_none() && !looks_at_all {
            // The known background is gone, and another may lie far from every change.
            search.look_around(&self.occupied_layers());
        }
        // A forgotten anchor still counts, so that groups are as separate as in a map that kept it.
        let anchor = search.anchor().or(forgotten);
        let mut memory = search.finish();
        let mut separate = std::mem::take(&mut memory.separate);
        self.changes.search_memory = memory;
        (self.changes.settled_with, self.changes.anchor) = (Some(separation), anchor);
        self.changes.gained.clear();
        self.changes.lost.clear();
        if separation.dilate {
            separate = neighbours.dilated(&separate);
        }
        self.changes.neighbours = Some(neighbours);
        Ok(separate)
    }

    /// Pull observed voxels that are not permanent once towards free. Returns their number.
    fn pull_to_free(&mut self, separate: Vec<Layer>) -> usize {
        let (g_free, keep) = (self.parameters().g_free, two_to_minus(1.0));
        let (levels, tentative) = (self.levels(), self.tentative_from());
        let mut count = 0;
        for &layer in &separate {
            let Some(slot) = self.blocks.slot(layer.place) else { continue };
            let Some(block) = self.blocks.at_mut(slot) else { continue };
            let mut left = Layer { bits: 0, ..layer };
            for offset in layer.offsets() {
                let value = block.value(offset);
                if value.is_finite() {
                    let value = filtered(value, g_free, keep);
                    levels.store(block, offset, value);
                    left.bits |= u64::from(value >= tentative) << (offset & 63);
                    count += 1;
                }
            }
            self.changes.note(left, u64::MAX); // the rest of the group may be separate now
        }
        self.changes.search_memory.separate = separate; // its memory is used again
        count
    }

    /// Make observed voxels occupied, and their groups part of the background, even if the groups
    /// are small: an object that stands still from the beginning is no flying object. Rays may
    /// clear the voxels later.
    pub(crate) fn keep(&mut self, voxels: &[Voxel]) {
        let (g_occ, confident) = (self.parameters().g_occ, self.confident_from());
        for &voxel in voxels {
            let stored = self.blocks.stored(voxel);
            if stored.is_finite() && stored < confident {
                self.rewrite(voxel, |_| g_occ);
                self.changes.kept.insert(Place(voxel));
            }
        }
    }

    /// True if a group of occupied voxels had enough confident ones at the last removal, or when
    /// the map forgot the place of the group. Without such a group, "separate" has no meaning.
    #[must_use]
    pub fn has_background(&self) -> bool {
        self.changes.anchor.is_some()
    }

    /// Every voxel that is tentatively or confidently occupied, in ascending order.
    #[must_use]
    pub fn occupied_voxels(&self) -> Vec<Voxel> {
        let voxels = |layer: Layer| layer.offsets().map(move |offset| layer.place.voxel(offset));
        let mut voxels: Vec<Voxel> = self.occupied_layers().into_iter().flat_map(voxels).collect();
        voxels.sort_unstable();
        voxels
    }

    fn occupied_layers(&self) -> Vec<Layer> {
        let layers = |block: &Block| {
            let place = block.place;
            let layer = move |(z, bits)| Layer { place, z, bits };
            (0..).zip(block.tentative).map(layer).filter(|layer| layer.bits != 0)
        };
        self.blocks.iter().flat_map(layers).collect()
    }
}
