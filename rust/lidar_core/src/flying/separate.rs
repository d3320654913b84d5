//! Removal of occupied voxels that are separate from confidently occupied ones.
//!
//! Source: Vrba et al., sec. III-D, eq. 23. Incremental: a component is looked at only if one of
//! its voxels changed its state, or one beside it ceased to be occupied; the look ends as soon
//! as enough confident voxels are found. Cost follows the changes, not the size of the map.

use super::blocks::{Place, offset_of, ones};
use super::filter::{filtered, two_to_minus};
use super::islands::{Marks, Neighbours, Search};
use super::voxel_map::VoxelMap;
use crate::Error;
use crate::geometry::lattice::Voxel;
use crate::spread::Spread;
use std::collections::HashSet;
use std::hash::BuildHasherDefault;

/// Changes that are kept; above it, as when removal has been given up, all is looked at again.
const MOST_CHANGES: usize = 1 << 22;

/// Voxels whose occupied state changed since the last removal.
#[derive(Clone, Default)]
pub(crate) struct Changes {
    voxels: Vec<Voxel>,
    /// The parameters of the last removal; with others every component is looked at.
    settled_with: Option<Separation>,
    /// A voxel of a component that had enough confident voxels.
    anchor: Option<Voxel>,
    /// Memory that the searches use again.
    marks: Marks,
    /// Voxels whose groups are never separate: see [`VoxelMap::keep`].
    pub(crate) kept: HashSet<Place, BuildHasherDefault<Spread>>,
}

impl Changes {
    #[inline]
    pub(crate) fn note(&mut self, voxel: Voxel) {
        if self.settled_with.is_none() {
            return; // the next removal looks at everything
        }
        if self.voxels.len() == MOST_CHANGES {
            self.voxels = Vec::new();
            self.settled_with = None;
            return;
        }
        self.voxels.push(voxel);
    }

    /// Forget the history: the next removal looks at every component.
    pub(crate) fn restart(&mut self) {
        *self = Self { kept: std::mem::take(&mut self.kept), ..Self::default() };
    }
}

/// When a group of occupied voxels is separate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Separation {
    /// Largest distance between the centres of neighbours in a group, d_sep [m].
    pub max_gap: f64,
    /// A group with fewer confidently occupied voxels is removed, n_conf,min.
    pub min_confident: usize,
    /// Observed voxels within `max_gap` of a removed one are pulled towards free too.
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
        Ok(self.pull_to_free(&separate))
    }

    /// The same, but nothing is removed before some group holds enough confident voxels: a young
    /// background would be pulled down faster than a sparse sensor can build it up.
    ///
    /// # Errors
    /// As [`VoxelMap::remove_separate`].
    pub fn remove_separate_from_background(
        &mut self,
        separation: Separation,
    ) -> Result<usize, Error> {
        let separate = self.separate_voxels(separation)?;
        if self.has_background() {
            return Ok(self.pull_to_free(&separate));
        }
        self.changes.restart();
        Ok(0)
    }

    /// Members of separate groups that are not permanent, of those groups that changed.
    fn separate_voxels(&mut self, separation: Separation) -> Result<Vec<Voxel>, Error> {
        let neighbours = separation.neighbours(self.lattice().voxel_size())?;
        let looks_at_all = self.changes.settled_with != Some(separation);
        let marks = std::mem::take(&mut self.changes.marks);
        let Changes { anchor, voxels, kept, .. } = &self.changes;
        let min_confident = separation.min_confident;
        let mut search = Search::new(&self.blocks, &neighbours, kept, min_confident, marks);
        search.look_around(anchor.as_slice());
        if looks_at_all {
            search.look_around(&self.occupied_voxels());
        } else {
            search.look_around(voxels);
        }
        if search.anchor().is_none() && !looks_at_all {
            // The known background is gone: is there another?
            search.look_around(&self.occupied_voxels());
        }
        let anchor = search.anchor();
        let (mut separate, marks) = search.finish();
        self.changes.marks = marks;
        (self.changes.settled_with, self.changes.anchor) = (Some(separation), anchor);
        self.changes.voxels.clear();
        if separation.dilate {
            separate = neighbours.dilated(&separate);
        }
        separate.retain(|&voxel| self.blocks.stored(voxel).is_finite());
        Ok(separate)
    }

    fn pull_to_free(&mut self, separate: &[Voxel]) -> usize {
        let (g_free, keep) = (self.parameters().g_free, two_to_minus(1.0));
        let (levels, tentative) = (self.levels(), self.tentative_from());
        for &voxel in separate {
            let Some(slot) = self.blocks.slot(Place::of(voxel)) else { continue };
            let Some(block) = self.blocks.at_mut(slot) else { continue };
            let value = filtered(block.value(offset_of(voxel)), g_free, keep);
            levels.store(block, offset_of(voxel), value);
            if value >= tentative {
                self.changes.note(voxel); // what is left of the group is looked at again
            }
        }
        separate.len()
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

    /// Whether some group of occupied voxels holds enough confident ones, as of the last
    /// removal: without that, "separate" has no meaning.
    #[must_use]
    pub fn has_background(&self) -> bool {
        self.changes.anchor.is_some()
    }

    /// Every voxel that is at least tentatively occupied, in a fixed order.
    #[must_use]
    pub fn occupied_voxels(&self) -> Vec<Voxel> {
        let mut voxels = Vec::new();
        for block in self.blocks.iter() {
            voxels.extend(ones(&block.tentative).map(|offset| block.place.voxel(offset)));
        }
        voxels.sort_unstable();
        voxels
    }
}
