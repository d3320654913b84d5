//! Marks of whole blocks, and which of their rows contain marks.

use super::mark::{MAX_COUNT, Mark};
use crate::flying::map::block_shape::{EDGE, VOLUME};
use crate::util::vector_unit::dispatch;
use pulp::{Simd, WithSimd};
use rayon::ThreadPool;
use rayon::prelude::*;

/// Marks of one row of voxels along x.
pub(in crate::flying::integrate) type MarkRow = [Mark; EDGE as usize];
/// Number of blocks that a thread takes at a time.
const BLOCKS_AT_A_TIME: usize = 64;

/// Marks of whole blocks, by slot. All are zero between scans.
#[derive(Default)]
pub(in crate::flying::integrate) struct DenseBlocks {
    marks: Vec<Mark>,
    /// For each block, a bit for every row with marks. Rows with marks of rays are included only
    /// after `settle`.
    met: Vec<u64>,
}

impl DenseBlocks {
    /// Number of slots.
    pub(crate) fn len(&self) -> usize {
        self.met.len()
    }

    /// Make at least this number of slots. Memory pages that are not touched take no physical
    /// memory.
    pub(crate) fn reserve(&mut self, slots: usize) {
        if self.len() < slots {
            // `vec![0; n]` takes zeroed pages from the system, which cost nothing until they are touched;
            // `resize` would write all of them.
            (self.marks, self.met) = (vec![0; slots * VOLUME], vec![0; slots]);
        }
    }

    /// Grow to this number of slots while blocks are opened. False if there is not enough memory.
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

    /// Marks of all slots, one after another.
    #[inline(always)]
    pub(in crate::flying::integrate) fn marks_mut(&mut self) -> &mut [Mark] {
        &mut self.marks
    }

    /// Index of a mark among those of all slots. Its row then counts as one with marks.
    #[inline(always)]
    pub(in crate::flying::integrate) fn spot(&mut self, slot: usize, offset: usize) -> usize {
        // 512 voxels are 64 rows of 8: a bit for each fits one word.
        self.met[slot] |= 1 << (offset / EDGE as usize);
        slot * VOLUME + offset
    }

    /// For each block, a bit for every row with marks.
    pub(crate) fn met(&self) -> &[u64] {
        &self.met
    }

    /// Marks of all blocks, by slot.
    pub(crate) fn blocks(&self) -> &[[Mark; VOLUME]] {
        self.marks.as_chunks().0
    }

    /// Limit the sums of rays in `slots` to the largest count, and note the rows with marks.
    pub(crate) fn settle(&mut self, slots: impl Iterator<Item = usize>) {
        dispatch(Settle { dense: self, slots });
    }

    /// Add the marks of `other`. `sources`: for each own slot, the slot of `other`, or a number
    /// beyond its slots if `other` does not have the block. Both must be settled.
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

    /// Set the marks of all rows that contain marks to 0.
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

/// Indices of the set bits, in ascending order.
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

/// Limit the marks of a block to `MAX_COUNT`. Returns a bit for every row with marks.
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
