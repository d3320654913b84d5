//! Marks of many blocks, and which of their rows hold any.

use super::mark::{MAX_COUNT, Mark};
use crate::flying::map::block_shape::{EDGE, VOLUME};
use crate::util::vector_unit::dispatch;
use pulp::{Simd, WithSimd};
use rayon::ThreadPool;
use rayon::prelude::*;

/// Marks of a row of x.
pub(in crate::flying::integrate) type MarkRow = [Mark; EDGE as usize];
/// Blocks that a thread takes at a time.
const BLOCKS_AT_A_TIME: usize = 64;

/// Marks of blocks by their slot. All zero between scans.
#[derive(Default)]
pub(in crate::flying::integrate) struct DenseBlocks {
    marks: Vec<Mark>,
    /// Per block, a bit for each row that holds marks; marks of rays count once they are settled.
    met: Vec<u64>,
}

impl DenseBlocks {
    /// Slots that it has.
    pub(crate) fn len(&self) -> usize {
        self.met.len()
    }

    /// Have so many slots from the start: untouched pages cost no memory.
    pub(crate) fn reserve(&mut self, slots: usize) {
        if self.len() < slots {
            // `vec![0; n]` takes zeroed pages from the system, which cost nothing until they are touched;
            // `resize` would write all of them.
            (self.marks, self.met) = (vec![0; slots * VOLUME], vec![0; slots]);
        }
    }

    /// Grow to so many slots as blocks are opened; false if the memory cannot be had.
    #[must_use]
    pub(crate) fn grow(&mut self, slots: usize) -> bool {
        let more = slots.saturating_sub(self.len());
        let has_room =
            self.marks.try_reserve(more * VOLUME).is_ok() && self.met.try_reserve(more).is_ok();
        if has_room && more > 0 {
            self.marks.resize(slots * VOLUME, 0);
            self.met.resize(slots, 0);
        }
        has_room
    }

    /// Marks of all slots.
    #[inline(always)]
    pub(in crate::flying::integrate) fn marks_mut(&mut self) -> &mut [Mark] {
        &mut self.marks
    }

    /// Place of a mark that is about to be set.
    #[inline(always)]
    pub(in crate::flying::integrate) fn spot(&mut self, slot: usize, offset: usize) -> usize {
        // 512 voxels are 64 rows of 8: a bit for each fits one word.
        self.met[slot] |= 1 << (offset / EDGE as usize);
        slot * VOLUME + offset
    }

    /// Rows of a block that hold marks.
    pub(crate) fn met(&self) -> &[u64] {
        &self.met
    }

    /// Marks of all blocks.
    pub(crate) fn blocks(&self) -> &[[Mark; VOLUME]] {
        self.marks.as_chunks().0
    }

    /// Hold the sums of rays in `slots` down to the largest, and note the rows that they met.
    pub(crate) fn settle(&mut self, slots: impl Iterator<Item = usize>) {
        dispatch(Settle { dense: self, slots });
    }

    /// Add the marks that `other` holds in `sources`, by slot. Both are settled.
    pub(crate) fn absorb(&mut self, other: &Self, sources: &[u32]) {
        let add = |((marks, met), &source): ((&mut [Mark; VOLUME], &mut u64), &u32)| {
            let Some(&more) = other.met.get(source as usize) else { return };
            let (rows, others) =
                (marks.as_chunks_mut().0, other.blocks()[source as usize].as_chunks().0);
            for row in rows_of(more) {
                add_row(&mut rows[row], &others[row]);
            }
            *met |= more;
        };
        self.par_blocks().zip(sources).for_each(add);
    }

    /// Empty every row that holds marks.
    pub(crate) fn clear(&mut self, pool: Option<&ThreadPool>) {
        let clear = |(marks, met): (&mut [Mark; VOLUME], &mut u64)| {
            let rows: &mut [MarkRow] = marks.as_chunks_mut().0;
            // Only rows with marks are written: the cost follows the scan, not the window.
            rows_of(std::mem::take(met)).for_each(|row| rows[row] = [0; EDGE as usize]);
        };
        match pool {
            Some(pool) => pool.install(|| self.par_blocks().for_each(clear)),
            None => self.marks.as_chunks_mut().0.iter_mut().zip(&mut self.met).for_each(clear),
        }
    }

    fn par_blocks(
        &mut self,
    ) -> impl IndexedParallelIterator<Item = (&mut [Mark; VOLUME], &mut u64)> {
        let blocks = self.marks.as_chunks_mut().0.par_iter_mut();
        blocks.zip(&mut self.met).with_min_len(BLOCKS_AT_A_TIME)
    }
}

/// Rows whose bits are set, in ascending order.
#[inline(always)]
pub(crate) fn rows_of(mut bits: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let row = bits.trailing_zeros() as usize;
        bits &= bits.wrapping_sub(1);
        (row < 64).then_some(row)
    })
}

#[inline(always)]
fn add_row(marks: &mut MarkRow, more: &MarkRow) {
    for (mark, more) in marks.iter_mut().zip(more) {
        // Both are below 2^30, so the sum fits. Sums that stop at one value are the same in any order.
        *mark = (mark.wrapping_add(*more)).min(MAX_COUNT);
    }
}

struct Settle<'a, I> {
    dense: &'a mut DenseBlocks,
    slots: I,
}

impl<I: Iterator<Item = usize>> WithSimd for Settle<'_, I> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let blocks = self.dense.marks.as_chunks_mut::<VOLUME>().0;
        for slot in self.slots {
            self.dense.met[slot] = settle_block(&mut blocks[slot]);
        }
    }
}

/// Limit marks to `MAX_COUNT`. Returns a bit for every row that holds marks.
#[inline(always)]
fn settle_block(marks: &mut [Mark; VOLUME]) -> u64 {
    let (mut met, mut all) = (0, 0);
    for (row, marks) in marks.as_chunks::<{ EDGE as usize }>().0.iter().enumerate() {
        let any = marks.iter().fold(0, |any, mark| any | mark);
        met |= u64::from(any != 0) << row;
        all |= any;
    }
    // The OR of all marks exceeds it exactly if one of them does, since `MAX_COUNT` is all ones.
    // Full marks are rare: most blocks skip the second pass.
    if all > MAX_COUNT {
        marks.iter_mut().for_each(|mark| *mark = (*mark).min(MAX_COUNT));
    }
    met
}
