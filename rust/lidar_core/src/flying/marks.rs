//! What one scan did to every voxel that it met.

use super::blocks::{Place, VOLUME, offset_of};
use super::window::Window;
use crate::Error;
use crate::geometry::lattice::Voxel;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// What one scan did to one voxel, in 32 bits: the class of the points inside in the highest
/// two, below them their number, or without points the length of rays in 1/16384 edges.
pub(crate) type Mark = u32;
/// Of points, their number, or in a weighted scan their weight in units of 1 / `POINT_UNITS`.
const COUNT_BITS: u32 = 30;
pub(crate) const MAX_COUNT: u32 = (1 << COUNT_BITS) - 1;
/// Weight units per point, in scans whose points have weights.
pub(crate) const POINT_UNITS: u32 = 1024;
/// Length units per voxel edge.
pub(crate) const UNITS_PER_EDGE: f64 = 16_384.0;
/// More than a ray can add to a mark: a diagonal.
const MOST_UNITS: u32 = (1.75 * UNITS_PER_EDGE) as u32;
/// So many rays cannot make an empty mark overflow.
pub(super) const RAYS_FROM_EMPTY: usize = (u32::MAX / MOST_UNITS) as usize;
/// The same of a full one.
pub(super) const RAYS_FROM_FULL: usize = ((u32::MAX - MAX_COUNT) / MOST_UNITS) as usize;
const EMPTY: u32 = u32::MAX;

/// Classes that a voxel's points can have, weakest first: of several the strongest counts
/// (first matching case of eq. 9: background, then flying or unknown, then rays).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Content {
    Rays,
    Unknown,
    Flying,
    Background,
}

/// Number of the content, and how much of it (points, or length units).
#[inline(always)]
pub(crate) fn tag_and_count(mark: Mark) -> (u32, u32) {
    (mark >> COUNT_BITS, mark & MAX_COUNT)
}

/// Marks of one scan, block by block. Reused from scan to scan.
///
/// Of a window that lies in memory as a whole, the slot of a block is its index.
#[derive(Default)]
pub(crate) struct Accumulator {
    window: Option<Window>,
    /// Slots of the blocks of the window; those of a whole one are filled in by `settle`.
    table: Vec<u32>,
    /// Indices of the blocks that have a slot.
    touched: Vec<u32>,
    /// Marks of all slots. Zero outside the blocks that were touched.
    marks: Vec<Mark>,
    /// Blocks with points beyond the window: a stray return must not widen it.
    far: BTreeMap<Place, Box<[Mark; VOLUME]>>,
    visits: u64,
    /// Most blocks that one scan may touch.
    most: usize,
}

impl Accumulator {
    /// Empty the accumulator and aim it at `window`; it will touch at most `most` blocks.
    pub(super) fn aim(&mut self, window: Window, most: usize) {
        let blocks = self.marks.as_chunks_mut::<VOLUME>().0;
        for &index in &self.touched {
            blocks[self.table[index as usize] as usize] = [0; VOLUME];
            self.table[index as usize] = EMPTY;
        }
        self.touched.clear();
        self.far.clear();
        self.visits = 0;
        self.most = most;
        self.table.resize(window.len(), EMPTY);
        if window.is_whole() && self.marks.len() < window.len() * VOLUME {
            self.marks = vec![0; window.len() * VOLUME]; // memory that is not used is not had
        }
        self.window = Some(window);
    }

    /// Slot of the block at `index` of the window, made when first met.
    #[inline(always)]
    fn slot(&mut self, window: &Window, index: usize) -> usize {
        match self.table.get(index) {
            Some(&slot) if slot != EMPTY => slot as usize,
            _ => self.open(window, index),
        }
    }

    #[cold]
    fn open(&mut self, window: &Window, index: usize) -> usize {
        let slot = if window.is_whole() { index } else { self.touched.len() };
        if self.touched.len() > self.most {
            return slot.saturating_sub(1); // too many: `check` says so, and no mark is used
        }
        self.table[index] = slot as u32;
        self.touched.push(index as u32);
        self.marks.resize(self.marks.len().max((slot + 1) * VOLUME), 0);
        slot
    }

    /// Add lengths, in the lower halves of `visits`, to the voxels whose bits in the window are in
    /// the upper halves. Sums may pass the largest mark until `settle`.
    #[inline(always)]
    pub(super) fn add(&mut self, window: &Window, visits: impl Iterator<Item = u64>) {
        if window.is_whole() {
            let marks = self.marks.as_mut_slice();
            for visit in visits {
                if let Some(mark) = marks.get_mut((visit >> 32) as usize) {
                    *mark = mark.wrapping_add(visit as u32);
                }
            }
            return;
        }
        for visit in visits.filter(|&visit| visit as u32 != 0) {
            let place = (visit >> 32) as usize;
            let mark = self.slot(window, place / VOLUME) * VOLUME + place % VOLUME;
            self.marks[mark] = self.marks[mark].wrapping_add(visit as u32);
        }
    }

    /// Note that rays were cast which visit so many voxels.
    pub(super) fn count(&mut self, visits: u64) {
        self.visits += visits;
    }

    /// Full marks stay full; the blocks of a whole window that rays met are noted.
    pub(super) fn settle(&mut self) {
        let blocks = self.marks.as_chunks_mut().0;
        match self.window {
            Some(window) if window.is_whole() => {
                for index in window.indices() {
                    if hold_down(&mut blocks[index]) && self.table[index] == EMPTY {
                        self.table[index] = index as u32;
                        self.touched.push(index as u32);
                    }
                }
            }
            _ => {
                for &index in &self.touched {
                    hold_down(&mut blocks[self.table[index as usize] as usize]);
                }
            }
        }
    }

    /// Note a point, or as many units, of class `content` in `voxel`.
    pub(crate) fn mark_points(&mut self, voxel: Voxel, content: Content, units: u32) {
        let tag = content as u32;
        let Some(mark) = self.mark(voxel) else { return };
        if *mark >> COUNT_BITS < tag {
            *mark = tag << COUNT_BITS | units.min(MAX_COUNT);
        } else if *mark >> COUNT_BITS == tag {
            *mark = tag << COUNT_BITS | (*mark & MAX_COUNT).saturating_add(units).min(MAX_COUNT);
        }
    }

    /// Note that points of the background may lie in `voxel`, unless it holds others.
    pub(crate) fn mark_beside(&mut self, voxel: Voxel, units: u32) {
        let others = [Content::Unknown as u32, Content::Flying as u32];
        if self.mark(voxel).is_some_and(|mark| !others.contains(&tag_and_count(*mark).0)) {
            self.mark_points(voxel, Content::Background, units);
        }
    }

    /// Mark of a voxel.
    #[inline]
    pub(super) fn mark(&mut self, voxel: Voxel) -> Option<&mut Mark> {
        let window = self.window?;
        let place = Place::of(voxel);
        if window.holds(place) {
            let slot = self.slot(&window, window.index(place));
            return self.marks.get_mut(slot * VOLUME + offset_of(voxel));
        }
        if self.far.len() > self.most {
            return None; // as in `open`
        }
        let block = self.far.entry(place).or_insert_with(|| Box::new([0; VOLUME]));
        Some(&mut block[offset_of(voxel)])
    }

    /// Add the lengths that `other` summed up in the same window.
    pub(super) fn absorb(&mut self, other: &Self, window: &Window) {
        self.visits += other.visits;
        for &index in &other.touched {
            self.slot(window, index as usize);
        }
        let mut sources = vec![None; self.marks.len() / VOLUME];
        for (index, marks) in other.blocks() {
            if let Some(source) = sources.get_mut(self.table[index] as usize) {
                *source = Some(marks);
            }
        }
        let add = |(marks, source): (&mut [Mark; VOLUME], &Option<&[Mark; VOLUME]>)| {
            let Some(source) = source else { return };
            for (mark, more) in marks.iter_mut().zip(source.iter()) {
                *mark = (*mark + more).min(MAX_COUNT); // both are settled
            }
        };
        self.marks.as_chunks_mut().0.par_iter_mut().zip(&sources).for_each(add);
    }

    /// # Errors
    /// [`Error::Limit`] if the scan touches too many blocks; its marks are of no use then.
    pub(crate) fn check(&self) -> Result<(), Error> {
        if self.touched.len() > self.most || self.far.len() > self.most {
            return Err(Error::Limit {
                what: format!("a scan that touches more than {} voxels", self.most * VOLUME),
                limit: (self.most * VOLUME) as u64,
                key: "voxel_map.max_voxels",
            });
        }
        Ok(())
    }

    /// Voxels visited by rays, each visit counted.
    pub(crate) fn visits(&self) -> u64 {
        self.visits
    }

    /// Index and marks of every block in the window that was touched.
    fn blocks(&self) -> impl Iterator<Item = (usize, &[Mark; VOLUME])> {
        let blocks = self.marks.as_chunks().0;
        self.touched
            .iter()
            .map(move |&index| (index as usize, &blocks[self.table[index as usize] as usize]))
    }

    /// Marked blocks in ascending order of place.
    pub(crate) fn marked(&self) -> Vec<(Place, &[Mark; VOLUME])> {
        let Some(window) = self.window else { return Vec::new() };
        let mut marked: Vec<_> = self
            .blocks()
            .map(|(index, marks)| (window.place(index), marks))
            .chain(self.far.iter().map(|(&place, marks)| (place, &**marks)))
            .collect();
        marked.sort_unstable_by_key(|&(place, _)| place);
        marked
    }
}

/// Make overfull marks full. Whether any is set.
fn hold_down(marks: &mut [Mark; VOLUME]) -> bool {
    let all = marks.iter().fold(0, |all, mark| all | mark);
    if all > MAX_COUNT {
        marks.iter_mut().for_each(|mark| *mark = (*mark).min(MAX_COUNT));
    }
    all != 0
}
