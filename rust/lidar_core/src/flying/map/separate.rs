//! Removal of occupied voxels that are separate from confidently occupied ones.
//!
//! Source: Vrba et al., sec. III-D, eq. 23. Incremental: a component is looked at only if one of
//! its voxels changed its state, or one beside it ceased to be occupied; the look ends as soon
//! as enough confident voxels are found, or a voxel of a group that had enough at the last removal.
//! Cost follows the changes, not the size of the map.

use super::blocks::{Block, Place};
use super::filter::{filtered, two_to_minus};
use super::islands::{Marks, Search};
use super::layers::{Layer, Neighbours};
use super::voxel_map::VoxelMap;
use crate::Error;
use crate::geometry::lattice::Voxel;
use crate::util::key_hasher::Spread;
use std::collections::HashSet;
use std::hash::BuildHasherDefault;

/// Layers with changes that are kept; above it, as when removal has been given up, all is looked at again.
const MOST_CHANGES: usize = 1 << 20;

/// Voxels whose occupied state changed since the last removal.
#[derive(Clone, Default)]
pub(crate) struct Changes {
    /// Voxels that became occupied, at least tentatively.
    gained: Vec<Layer>,
    /// Voxels that ceased to be occupied, or confidently so, and those that removal left occupied.
    lost: Vec<Layer>,
    /// The parameters of the last removal; with others every component is looked at.
    settled_with: Option<Separation>,
    /// A voxel of a component that had enough confident voxels.
    anchor: Option<Voxel>,
    /// Memory that the searches use again.
    marks: Marks,
    /// Neighbours for the parameters of the last removal.
    neighbours: Option<Neighbours>,
    /// Voxels whose groups are never separate: see [`VoxelMap::keep`].
    pub(crate) kept: HashSet<Place, BuildHasherDefault<Spread>>,
}

impl Changes {
    /// Note voxels of a layer that changed, given those of it that were occupied before.
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

    /// Forget the history: the next removal looks at every component.
    pub(crate) fn restart(&mut self) {
        *self = Self { kept: std::mem::take(&mut self.kept), ..Self::default() };
    }
}

fn add(layers: &mut Vec<Layer>, layer: Layer) {
    match layers.last_mut().filter(|last| last.is_same(&layer)) {
        Some(last) => last.bits |= layer.bits,
        None if layer.bits != 0 => layers.push(layer),
        None => {}
    }
}

/// When a group of occupied voxels is separate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Separation {
    /// Largest distance between the centres of neighbours in a group, d_sep [m].
    pub max_gap: f64,
    /// A group with fewer confidently occupied voxels is removed, n_conf,min.
    pub min_confident: usize,
    /// Observed voxels within `max_gap` of a removed one are pulled towards free too; those of a
    /// permanent one when its group has changed, not by every removal.
    pub dilate: bool,
}

impl Separation {
    fn neighbours(&self, voxel_size: f64) -> Result<Neighbours, Error> {
        Neighbours::within(self.max_gap / voxel_size)
    }

    /// # Errors
    /// [`Error::Parameter`] if `max_gap` is not a distance of 0 to 64 voxels.
    pub(crate) fn check(&self, voxel_size: f64) -> Result<(), Error> {
        self.neighbours(voxel_size).map(drop)
    }
}

impl VoxelMap {
    /// Pull every voxel of a group of at least tentatively occupied voxels that holds fewer
    /// than `min_confident` confident ones once towards free. Returns the voxels changed.
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

    /// Like [`VoxelMap::remove_separate`], but removes nothing before some group holds enough
    /// confident voxels: a young background would be pulled down faster than a sparse sensor can
    /// build it up.
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

    /// Members of separate groups, of those groups that changed; with their neighbours if these are
    /// pulled too.
    fn separate_voxels(&mut self, separation: Separation) -> Result<Vec<Layer>, Error> {
        let looks_at_all = self.changes.settled_with != Some(separation);
        if looks_at_all {
            (self.changes.marks, self.changes.neighbours) = (Marks::default(), None);
        }
        let neighbours = match self.changes.neighbours.take() {
            Some(neighbours) => neighbours,
            None => separation.neighbours(self.lattice().voxel_size())?,
        };
        let marks = std::mem::take(&mut self.changes.marks);
        let Changes { anchor, gained, lost, kept, .. } = &self.changes;
        let min_confident = separation.min_confident;
        let mut search = Search::new(&self.blocks, &neighbours, kept, min_confident, marks);
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
        if search.anchor().is_none() && !looks_at_all {
            // The known background is gone: is there another?
            search.look_around(&self.occupied_layers());
        }
        let anchor = search.anchor();
        let mut marks = search.finish();
        let mut separate = std::mem::take(&mut marks.separate);
        self.changes.marks = marks;
        (self.changes.settled_with, self.changes.anchor) = (Some(separation), anchor);
        self.changes.gained.clear();
        self.changes.lost.clear();
        if separation.dilate {
            separate = neighbours.dilated(&separate);
        }
        self.changes.neighbours = Some(neighbours);
        Ok(separate)
    }

    /// Pull observed voxels that are not permanent once towards free; their number.
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
            self.changes.note(left, u64::MAX); // what is left of the group is looked at again
        }
        self.changes.marks.separate = separate; // its memory is used again
        count
    }

    /// Make observed voxels occupied and their groups part of the background, however small: what
    /// stands still from the beginning is no flying object. Rays may clear them later.
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

    /// True if some group of occupied voxels holds enough confident ones, as of the last
    /// removal: without that, "separate" has no meaning.
    #[must_use]
    pub fn has_background(&self) -> bool {
        self.changes.anchor.is_some()
    }

    /// Every voxel that is at least tentatively occupied, in a fixed order.
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
