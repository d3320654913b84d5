//! Marks of points beyond the window of the rays.

use super::dense_blocks::{MarkRow, rows_of};
use super::mark::Mark;
use crate::flying::map::block_shape::{EDGE, VOLUME};
use crate::flying::map::blocks::Place;
use crate::util::key_hasher::KeyHasher;
use std::collections::HashMap;
use std::hash::BuildHasherDefault;

/// Points beyond the window, row by row: a stray return must not widen it, nor take a block.
#[derive(Default)]
pub(crate) struct SparseBlocks {
    slots: HashMap<Place, u32, BuildHasherDefault<KeyHasher>>,
    /// Blocks with their slots.
    pub(in crate::flying::integrate) opened: Vec<(Place, u32)>,
    /// The last block that was asked for: points side by side share it.
    last: Option<(Place, u32)>,
    /// Per slot, a bit for each row that holds marks; then the index of each such row.
    met: Vec<u64>,
    places: Vec<[u32; VOLUME / EDGE as usize]>,
    rows: Vec<MarkRow>,
}

impl SparseBlocks {
    /// Slot of a block, made when first met; None if there are more than `most`.
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

    /// Place of a mark that is about to be set.
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

    /// Marks of all rows.
    #[inline(always)]
    pub(in crate::flying::integrate) fn marks_mut(&mut self) -> &mut [Mark] {
        self.rows.as_flattened_mut()
    }

    /// Copy the rows of a block to their places in a whole one. Returns a bit for each.
    pub(crate) fn copy(&self, slot: usize, block: &mut [Mark; VOLUME]) -> u64 {
        let rows: &mut [MarkRow] = block.as_chunks_mut().0;
        // The other rows keep the marks of another block: readers look at rows in the mask only.
        for row in rows_of(self.met[slot]) {
            rows[row] = self.rows[self.places[slot][row] as usize];
        }
        self.met[slot]
    }

    /// Empty it for the next scan.
    pub(crate) fn clear(&mut self) {
        self.slots.clear();
        self.opened.clear();
        self.last = None;
        self.met.clear();
        self.places.clear();
        self.rows.clear();
    }
}
