//! Searches for groups of occupied voxels that hold too few confident ones.
//!
//! Voxels are taken as runs of a row of x: a row of a block is one byte of its bits.

use super::blocks::{Bits, Block, Blocks, EDGE, EDGE_BITS, Place, has, offset_of};
use crate::Error;
use crate::error::require;
use crate::geometry::lattice::Voxel;
use crate::spread::Spread;
use std::collections::HashSet;
use std::hash::BuildHasherDefault;

/// Voxels side by side along x, in one row of a block: the first one and their number.
#[derive(Clone, Copy)]
struct Run {
    first: Voxel,
    length: i32,
}

/// Rows of neighbours: for every (dy, dz) how far the reach goes along x, in voxels.
pub(super) struct Neighbours {
    rows: Vec<(i32, i32, i32)>,
}

impl Neighbours {
    /// Neighbours whose centre is at most `reach` voxels away; exactly this distance counts.
    ///
    /// # Errors
    /// [`Error::Parameter`] unless 0 <= reach <= 64.
    pub(super) fn within(reach: f64) -> Result<Self, Error> {
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
    pub(super) fn dilated(&self, voxels: &[Voxel]) -> Vec<Voxel> {
        let mut dilated = Vec::new();
        for &first in voxels {
            self.each_stretch(Run { first, length: 1 }, |Run { first: [x, y, z], length }| {
                dilated.extend((x..x + length).map(|x| [x, y, z]));
            });
        }
        dilated.sort_unstable();
        dilated.dedup();
        dilated
    }

    /// Visit the neighbours of a run, cut where blocks end.
    fn each_stretch(&self, run: Run, mut visit: impl FnMut(Run)) {
        let [first, y, z] = run.first;
        for &(dy, dz, reach) in &self.rows {
            let (mut x, end) = (first - reach, first + run.length + reach);
            while x < end {
                let wall = ((x >> EDGE_BITS) + 1) * EDGE;
                visit(Run { first: [x, y + dy, z + dz], length: wall.min(end) - x });
                x = wall;
            }
        }
    }
}

/// First voxel of the row that holds `voxel`.
fn row_start([x, y, z]: Voxel) -> Voxel {
    [x & !(EDGE - 1), y, z]
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

impl Run {
    /// Its bits in the row.
    fn bits(self) -> u8 {
        let ones = ((1u32 << self.length) - 1) << (self.first[0] & (EDGE - 1));
        ones as u8 // a run ends with its block
    }

    fn voxels(self) -> impl Iterator<Item = Voxel> {
        let [first, y, z] = self.first;
        (first..first + self.length).map(move |x| [x, y, z])
    }

    /// Runs of the bits of the row that `start` begins.
    fn each(start: Voxel, mut bits: u8, mut visit: impl FnMut(Self)) {
        while bits != 0 {
            let from = bits.trailing_zeros();
            let length = (bits >> from).trailing_ones();
            let run =
                Self { first: [start[0] + from as i32, start[1], start[2]], length: length as i32 };
            bits &= !run.bits();
            visit(run);
        }
    }
}

/// What the searches of one removal know of the voxels of a block.
#[derive(Clone, Copy, Default)]
struct Mark {
    /// Some search has met them.
    met: Bits,
    /// Their group holds enough confident voxels.
    anchored: Bits,
}

/// Marks per slot of the map's pool, clear between removals.
#[derive(Clone, Default)]
pub(super) struct Marks {
    marks: Vec<Mark>,
    /// Slots whose marks are not clear.
    touched: Vec<u32>,
}

impl Marks {
    fn at(&mut self, slot: u32) -> &mut Mark {
        let mark = &mut self.marks[slot as usize];
        if mark.met == [0; 8] {
            self.touched.push(slot);
        }
        mark
    }
}

/// Blocks found lately: a search goes from neighbour to neighbour.
struct Lately<'a> {
    blocks: &'a Blocks,
    known: [(Place, Option<(u32, &'a Block)>); 64],
}

impl<'a> Lately<'a> {
    fn new(blocks: &'a Blocks) -> Self {
        Self { blocks, known: [(Place([i32::MAX; 3]), None); 64] } // no voxel lies there
    }

    #[inline]
    fn find(&mut self, place: Place) -> Option<(u32, &'a Block)> {
        let [x, y, z] = place.0.map(|index| index as usize & 3);
        let known = &mut self.known[z << 4 | y << 2 | x];
        if known.0 != place {
            *known = (place, self.blocks.find(place));
        }
        known.1
    }
}

/// Breadth-first searches of one removal; what one search learns, the others use.
pub(super) struct Search<'a> {
    blocks: Lately<'a>,
    neighbours: &'a Neighbours,
    kept: &'a HashSet<Place, BuildHasherDefault<Spread>>,
    min_confident: usize,
    marks: Marks,
    /// Of the group that is searched.
    members: Vec<Run>,
    /// Members of separate groups.
    separate: Vec<Voxel>,
    anchor: Option<Voxel>,
}

impl<'a> Search<'a> {
    pub(super) fn new(
        blocks: &'a Blocks,
        neighbours: &'a Neighbours,
        kept: &'a HashSet<Place, BuildHasherDefault<Spread>>,
        min_confident: usize,
        mut marks: Marks,
    ) -> Self {
        marks.marks.resize(blocks.len(), Mark::default());
        Self {
            blocks: Lately::new(blocks),
            neighbours,
            kept,
            min_confident,
            marks,
            members: Vec::new(),
            separate: Vec::new(),
            anchor: None,
        }
    }

    /// A voxel of some group with enough confident ones.
    pub(super) fn anchor(&self) -> Option<Voxel> {
        self.anchor
    }

    /// Members of separate groups, and the marks for the next removal.
    pub(super) fn finish(self) -> (Vec<Voxel>, Marks) {
        let Marks { mut marks, mut touched } = self.marks;
        for slot in touched.drain(..) {
            marks[slot as usize] = Mark::default();
        }
        (self.separate, Marks { marks, touched })
    }

    /// Look at the groups of voxels that changed; where one is no longer occupied, at the groups
    /// around it, which it may have held together.
    pub(super) fn look_around(&mut self, voxels: &[Voxel]) {
        for same_row in voxels.chunk_by(|&one, &other| row_start(one) == row_start(other)) {
            let start = row_start(same_row[0]);
            let Some((slot, block)) = self.blocks.find(Place::of(start)) else { continue };
            let changed = same_row.iter().fold(0, |bits, voxel| bits | 1 << (voxel[0] - start[0]));
            let occupied = row_bits(block, start);
            self.each_unmet(slot, start, changed & occupied);
            let neighbours = self.neighbours;
            Run::each(start, changed & !occupied, |gone| {
                neighbours.each_stretch(gone, |beside| {
                    let Some((slot, block)) = self.blocks.find(Place::of(beside.first)) else {
                        return;
                    };
                    let row = beside.bits() & row_bits(block, beside.first);
                    self.each_unmet(slot, row_start(beside.first), row);
                });
            });
        }
    }

    /// Search the groups of the occupied voxels `bits` of a row that no search has met.
    fn each_unmet(&mut self, slot: u32, start: Voxel, bits: u8) {
        for x in (0..EDGE).filter(|x| bits >> x & 1 == 1) {
            let voxel = [start[0] + x, start[1], start[2]];
            if !has(&self.marks.marks[slot as usize].met, offset_of(voxel)) {
                self.component(voxel);
            }
        }
    }

    /// Search the group of `start` until it is anchored, or known whole and separate.
    fn component(&mut self, start: Voxel) {
        let mut members = std::mem::take(&mut self.members);
        members.clear();
        let mut confident = 0;
        let mut anchored = self.min_confident == 0;
        self.meet(Run { first: start, length: 1 }, &mut members, &mut confident);
        let mut next = 0;
        while let Some(&run) = members.get(next).filter(|_| !anchored) {
            next += 1;
            let neighbours = self.neighbours;
            neighbours.each_stretch(run, |beside| {
                anchored |= self.meet(beside, &mut members, &mut confident);
            });
            anchored |= confident >= self.min_confident;
        }
        if anchored {
            self.anchor = self.anchor.or(Some(start));
            for run in &members {
                if let Some((slot, _)) = self.blocks.find(Place::of(run.first)) {
                    set_row(&mut self.marks.at(slot).anchored, run.first, run.bits());
                }
            }
        } else if !members.iter().flat_map(|run| run.voxels()).any(|voxel| self.is_kept(voxel)) {
            self.separate.extend(members.iter().flat_map(|run| run.voxels()));
        }
        self.members = members;
    }

    fn is_kept(&self, voxel: Voxel) -> bool {
        !self.kept.is_empty() && self.kept.contains(&Place(voxel))
    }

    /// Add the new occupied voxels of a run. True if one of its voxels is anchored.
    fn meet(&mut self, run: Run, members: &mut Vec<Run>, confident: &mut usize) -> bool {
        let first = run.first;
        let Some((slot, block)) = self.blocks.find(Place::of(first)) else { return false };
        let row = run.bits() & row_bits(block, first);
        if row == 0 {
            return false;
        }
        let mark = self.marks.at(slot);
        let new = row & !row_of(&mark.met, first);
        set_row(&mut mark.met, first, new);
        *confident += (new & row_of(&block.confident, first)).count_ones() as usize;
        Run::each(row_start(first), new, |run| members.push(run));
        row & row_of(&mark.anchored, first) != 0
    }
}
