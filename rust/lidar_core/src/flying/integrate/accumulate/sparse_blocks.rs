//! Marks of points outside the window of the rays.

use super::dense_blocks::{MarkRow, rows_of};
use super::mark::Mark;
use crate::flying::map::block_shape::{EDGE, VOLUME};
use crate::flying::map::blocks::Place;
use crate::util::key_hasher::KeyHasher;
use std::collections::HashMap;
use std::hash::BuildHasherDefault;

/// Marks of points outside the window, stored row by row, so that a stray return neither widens the
/// window nor needs the memory of a whole block.
#[derive(Default)]
pub(crate) struct SparseBlocks {
    slots: HashMap<Place, u32, BuildHasherDefault<KeyHasher>>,
    /// All blocks with their slots, in the order in which they were opened.
    pub(in crate::flying::integrate) opened: Vec<(Place, u32)>,
    /// The last block that was asked for. Neighbouring points share it.
    last: Option<(Place, u32)>,
    /// For each slot, a bit for every row with marks. `places`: index of each such row in `rows`.
    met: Vec<u64>,
    places: Vec<[u32; VOLUME / EDGE as usize]>,
    rows: Vec<MarkRow>,
}

impl SparseBlocks {
    /// Slot of a block, which is opened if needed. None if more than `most` + 1 blocks would be
    /// open.
    #[inline(always)]
    pub(crate) fn slot(&mut self, place: Place, most: usize) -> Option<usize> {
        if let Some((_, slot)) = self.last.filter(|(last, _)| *last == place) {
            return Some(slot as usize);
        }
        let slot = self.find(place, most)?;
        self.last = Some((place, slot));
        Some(slot as usize)
    }

    #[inline(never)]
    fn find(&mut self, place: Place, most: usize) -> Option<u32> {
        let next = self.opened.len();
        match self.slots.get(&place) {
            Some(&slot) => Some(slot),
            // One slot more than `most` is opened, so that `check` sees the excess.
            None if next > most => None, // the accumulator's `check` says so
            None => {
                self.slots.insert(place, next as u32);
                self.opened.push((place, next as u32));
                self.met.push(0);
                self.places.push([0; VOLUME / EDGE as usize]);
                Some(next as u32)
            }
        }
    }

    /// Index of a mark in `marks_mut`. Its row is made if needed.
    #[inline(always)]
    pub(in crate::flying::integrate) fn spot(&mut self, slot: usize, offset: usize) -> usize {
        let (row, at) = (offset / EDGE as usize, offset % EDGE as usize);
        if self.met[slot] >> row & 1 == 0 {
            self.met[slot] |= 1 << row;
            // A stray return costs a row of 32 bytes, not a block of 2 KiB.
            self.places[slot][row] = self.rows.len() as u32;
            self.rows.push(MarkRow::default());
        }
        self.places[slot][row] as usize * EDGE as usize + at
    }

    /// Marks of all rows, one after another.
    #[inline(always)]
    pub(in crate::flying::integrate) fn marks_mut(&mut self) -> &mut [Mark] {
        self.rows.as_flattened_mut()
    }

    /// Copy the rows with marks of a block to their places in `block`. Returns a bit for each of
    /// these rows.
    pub(crate) fn copy(&self, slot: usize, block: &mut [Mark; VOLUME]) -> u64 {
        let rows: &mut [MarkRow] = block.as_chunks_mut().0;
        // The other rows keep the marks of another block: readers look at rows in the mask only.
        for row in rows_of(self.met[slot]) {
            rows[row] = self.rows[self.places[slot][row] as usize];
        }
        self.met[slot]
    }

    /// Remove all marks.
    pub(crate) fn clear(&mut self) {
        self.slots.clear();
        self.opened.clear();
        self.last = None;
        self.met.clear();
        self.places.clear();
        self.rows.clear();
    }
}
