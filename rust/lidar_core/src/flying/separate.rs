//! Removal of occupied voxels that are separate from confidently occupied ones.
//!
//! Source: Vrba et al., sec. III-D, eq. 23. Incremental: a component is looked at only if one of
//! its voxels changed its state, or one beside it ceased to be occupied; the look ends as soon
//! as enough confident voxels are found. Cost follows the changes, not the size of the map.

use super::blocks::{Bits, Block, Blocks, EDGE, EDGE_BITS, Place, VOLUME, has, offset_of};
use super::voxel_map::{VoxelMap, filtered, two_to_minus};
use crate::Error;
use crate::error::require;
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
    /// Spare memory of the searches, clear.
    marks: Vec<Mark>,
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
        let starts =
            if looks_at_all { self.occupied_voxels() } else { self.changes.voxels.clone() };
        let mut search = Search {
            blocks: &self.blocks,
            neighbours: &neighbours,
            kept: &self.changes.kept,
            min_confident: separation.min_confident,
            marks: Marks::take(&mut self.changes.marks, self.blocks.len()),
            separate: Vec::new(),
            anchor: None,
        };
        for voxel in self.changes.anchor.into_iter().chain(starts) {
            search.look_around(voxel);
        }
        if search.anchor.is_none() && !looks_at_all {
            for voxel in self.occupied_voxels() {
                search.look_around(voxel); // the known background is gone: is there another?
            }
        }
        let Search { mut separate, anchor, marks, .. } = search;
        self.changes.marks = marks.give_back();
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
        for &voxel in separate {
            self.rewrite(voxel, |value| filtered(value, g_free, keep));
            self.changes.note(voxel); // what is left of the group is looked at again
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
        for block in self.blocks.iter().filter(|block| block.tentative != [0; 8]) {
            for offset in (0..VOLUME).filter(|&offset| has(&block.tentative, offset)) {
                voxels.push(block.place.voxel(offset));
            }
        }
        voxels.sort_unstable();
        voxels
    }
}

/// Rows of neighbours: for every (dy, dz) how far the reach goes along x, in voxels.
struct Neighbours {
    rows: Vec<(i32, i32, i32)>,
}

impl Neighbours {
    /// Neighbours whose centre is at most `reach` voxels away; exactly this distance counts.
    ///
    /// # Errors
    /// [`Error::Parameter`] unless 0 <= reach <= 64.
    fn within(reach: f64) -> Result<Self, Error> {
        const MOST: f64 = 64.0;
        let got = format_args!("{reach} voxels");
        require((0.0..=MOST).contains(&reach), "max_gap", "a distance of 0 to 64 voxels", got)?;
        let square = (reach * (1.0 + 1e-12)).powi(2); // 0.75 / 0.25 and the like stay inside
        let most = reach.ceil() as i32;
        let mut rows = Vec::new();
        for dz in -most..=most {
            for dy in -most..=most {
                let rest = square - f64::from(dy * dy + dz * dz);
                if rest >= 0.0 {
                    rows.push((dy, dz, rest.sqrt().floor() as i32));
                }
            }
        }
        Ok(Self { rows })
    }

    /// `voxels` and all their neighbours, in ascending order.
    fn dilated(&self, voxels: &[Voxel]) -> Vec<Voxel> {
        let mut dilated = Vec::new();
        for &voxel in voxels {
            self.each_stretch(voxel, |[x, y, z], length| {
                dilated.extend((x..x + length).map(|x| [x, y, z]));
            });
        }
        dilated.sort_unstable();
        dilated.dedup();
        dilated
    }

    /// Visit every stretch of a row inside one block: its first voxel and its length, 1 to 8.
    fn each_stretch(&self, voxel: Voxel, mut visit: impl FnMut(Voxel, i32)) {
        for &(dy, dz, reach) in &self.rows {
            let (mut x, end) = (voxel[0] - reach, voxel[0] + reach + 1);
            while x < end {
                let wall = ((x >> EDGE_BITS) + 1) * EDGE;
                visit([x, voxel[1] + dy, voxel[2] + dz], wall.min(end) - x);
                x = wall;
            }
        }
    }
}

/// Bits of the row of x that holds `voxel`.
fn row_of(bits: &Bits, voxel: Voxel) -> u8 {
    let offset = offset_of(voxel);
    (bits[offset >> 6] >> (offset & 0b11_1000)) as u8
}

/// Tentative bits of the row of x that holds `voxel`.
pub(crate) fn row_bits(block: &Block, voxel: Voxel) -> u8 {
    row_of(&block.tentative, voxel)
}

fn set_row(bits: &mut Bits, voxel: Voxel, row: u8) {
    let offset = offset_of(voxel);
    bits[offset >> 6] |= u64::from(row) << (offset & 0b11_1000);
}

/// What the searches of one removal know of the voxels of a block.
#[derive(Clone, Copy, Default)]
struct Mark {
    /// Some search has met them.
    met: Bits,
    /// Their group holds enough confident voxels.
    anchored: Bits,
}

/// Marks per slot of the map's pool; only touched ones are cleared.
struct Marks {
    marks: Vec<Mark>,
    touched: Vec<u32>,
}

impl Marks {
    fn take(spare: &mut Vec<Mark>, slots: usize) -> Self {
        let mut marks = std::mem::take(spare);
        marks.resize(slots, Mark::default());
        Self { marks, touched: Vec::new() }
    }

    fn at(&mut self, slot: u32) -> &mut Mark {
        let mark = &mut self.marks[slot as usize];
        if mark.met == [0; 8] {
            self.touched.push(slot);
        }
        mark
    }

    fn give_back(mut self) -> Vec<Mark> {
        for slot in self.touched {
            self.marks[slot as usize] = Mark::default();
        }
        self.marks
    }
}

/// Breadth-first searches of one removal; what one search learns, the others use.
struct Search<'a> {
    blocks: &'a Blocks,
    neighbours: &'a Neighbours,
    kept: &'a HashSet<Place, BuildHasherDefault<Spread>>,
    min_confident: usize,
    marks: Marks,
    /// Members of separate groups.
    separate: Vec<Voxel>,
    /// A voxel of some anchored group.
    anchor: Option<Voxel>,
}

impl Search<'_> {
    /// Look at the group of a voxel that changed; if it is no longer occupied, at the groups
    /// around it, which it may have held together.
    fn look_around(&mut self, voxel: Voxel) {
        let Some((slot, block)) = self.blocks.find(Place::of(voxel)) else { return };
        if has(&block.tentative, offset_of(voxel)) {
            if !has(&self.marks.at(slot).met, offset_of(voxel)) {
                self.component(voxel);
            }
            return;
        }
        let (neighbours, blocks) = (self.neighbours, self.blocks);
        neighbours.each_stretch(voxel, |first, length| {
            let Some((slot, block)) = blocks.find(Place::of(first)) else { return };
            let row = stretch(first, length) & row_bits(block, first);
            for x in (0..8).filter(|x| row >> x & 1 == 1) {
                let beside = [(first[0] & !7) + x, first[1], first[2]];
                if !has(&self.marks.at(slot).met, offset_of(beside)) {
                    self.component(beside);
                }
            }
        });
    }

    /// Search the group of `start` until it is anchored, or known whole and separate.
    fn component(&mut self, start: Voxel) {
        let mut members = Vec::new();
        let mut confident = 0;
        let mut anchored = self.min_confident == 0;
        self.meet(start, 1, &mut members, &mut confident);
        let mut next = 0;
        while let Some(&voxel) = members.get(next).filter(|_| !anchored) {
            next += 1;
            let neighbours = self.neighbours;
            neighbours.each_stretch(voxel, |first, length| {
                anchored |= self.meet(first, length, &mut members, &mut confident);
            });
            anchored |= confident >= self.min_confident;
        }
        if !anchored {
            if !members.iter().any(|&voxel| self.kept.contains(&Place(voxel))) {
                self.separate.append(&mut members);
            }
            return;
        }
        self.anchor = self.anchor.or(Some(start));
        for voxel in members {
            if let Some((slot, _)) = self.blocks.find(Place::of(voxel)) {
                let mark = &mut self.marks.at(slot).anchored;
                set_row(mark, voxel, 1 << (voxel[0] & 7));
            }
        }
    }

    /// Add the new occupied voxels of a stretch. True if one of its voxels is anchored.
    fn meet(
        &mut self,
        first: Voxel,
        length: i32,
        members: &mut Vec<Voxel>,
        confident: &mut usize,
    ) -> bool {
        let Some((slot, block)) = self.blocks.find(Place::of(first)) else { return false };
        let row = stretch(first, length) & row_bits(block, first);
        if row == 0 {
            return false;
        }
        let mark = self.marks.at(slot);
        let new = row & !row_of(&mark.met, first);
        set_row(&mut mark.met, first, new);
        *confident += (new & row_of(&block.confident, first)).count_ones() as usize;
        for x in (0..8).filter(|x| new >> x & 1 == 1) {
            members.push([(first[0] & !7) + x, first[1], first[2]]);
        }
        row & row_of(&mark.anchored, first) != 0
    }
}

/// Bits of `length` voxels of a row of x, from `first` on.
fn stretch(first: Voxel, length: i32) -> u8 {
    let ones = ((1u32 << length) - 1) << (first[0] & 7);
    ones as u8 // a stretch ends with its block
}
