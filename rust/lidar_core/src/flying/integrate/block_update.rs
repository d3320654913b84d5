//! Update of the map by the marks of one scan: the only place where a scan changes values.
//!
//! Source: Vrba et al., eqs 9 and 12.

use super::accumulator::{Accumulator, Slot};
use super::voxel_update::Rule;
use crate::Error;
use crate::flying::map::blocks::{Bits, Block, Place, VOLUME};
use crate::flying::map::layers::Layer;
use crate::flying::map::voxel_map::VoxelMap;
use rayon::prelude::*;

/// Blocks that a thread takes at a time.
const BLOCKS_AT_A_TIME: usize = 16;

/// A block that a scan marked.
pub(crate) struct Task {
    place: Place,
    marks: Slot,
    /// Slot of the block in the map; None while it has none.
    home: Option<u32>,
    /// The block, taken out of the map meanwhile.
    block: Option<Box<Block>>,
    /// Voxels that are updated.
    voxels: usize,
    /// Voxels whose groups have to be looked at.
    changed: Bits,
    /// Voxels that were at least tentatively occupied before.
    before: Bits,
}

impl VoxelMap {
    /// Apply the marks of a scan. Returns the number of voxels that were updated.
    ///
    /// # Errors
    /// [`Error::Limit`]; the map is unchanged then.
    pub(crate) fn update(
        &mut self,
        sums: &mut Accumulator,
        weighted: bool,
    ) -> Result<usize, Error> {
        let mut tasks = std::mem::take(&mut self.tasks);
        let admitted = sums.marked().filter(|(place, _)| self.admits_some(*place));
        tasks.extend(admitted.map(|(place, marks)| Task {
            home: self.blocks.slot(place),
            place,
            marks,
            block: None,
            voxels: 0,
            changed: [0; 8],
            before: [0; 8],
        }));
        let taken = self.take_blocks(&mut tasks);
        if taken.is_ok() {
            self.run(&mut tasks, sums, weighted);
        }
        let voxels = tasks.iter().map(|task| task.voxels).sum();
        for Task { place, home, block, changed, before, .. } in tasks.drain(..) {
            if let (Some(home), Some(block)) = (home, block) {
                let layers = (0..).zip(changed.into_iter().zip(before));
                for (z, (bits, before)) in layers.filter(|(_, (bits, _))| *bits != 0) {
                    self.changes.note(Layer { place, z, bits }, before);
                }
                self.blocks.put(home, block);
            }
        }
        self.tasks = tasks; // its memory is used again
        taken.map(|()| voxels)
    }

    /// Take the blocks out of the map, made where they are missing: all or none.
    fn take_blocks(&mut self, tasks: &mut [Task]) -> Result<(), Error> {
        // All that can fail comes first: after it `make` finds its memory.
        self.blocks.reserve(tasks.iter().filter(|task| task.home.is_none()).count())?;
        for task in tasks {
            // Missing blocks are made in the order of `marked`, which does not depend on the threads.
            let home = task.home.unwrap_or_else(|| self.blocks.make(task.place));
            task.home = Some(home);
            // Each task owns its block, so threads need no lock; only a pointer is moved.
            task.block = self.blocks.take(home);
        }
        Ok(())
    }

    fn run(&self, tasks: &mut [Task], sums: &Accumulator, weighted: bool) {
        let rule = Rule::of(self, weighted);
        let run = |tasks: &mut [Task]| {
            let mut spare = [0; VOLUME];
            // All are looked at before any is changed: their memory is waited for once.
            for Task { block, marks, voxels, .. } in &mut *tasks {
                let (Some(block), (marks, met)) = (block, sums.block(*marks, &mut spare)) else {
                    continue;
                };
                block.hold(met);
                *voxels = rule.count(block, marks, met);
            }
            for Task { block, marks, changed, before, .. } in tasks {
                let (Some(block), (marks, met)) = (block, sums.block(*marks, &mut spare)) else {
                    continue;
                };
                // Kept to tell voxels that became occupied from those that ceased to be.
                *before = block.tentative;
                *changed = rule.apply(block, marks, met);
            }
        };
        match &self.pool {
            Some(pool) => {
                pool.install(|| tasks.par_chunks_mut(BLOCKS_AT_A_TIME).for_each(run));
            }
            None => tasks.chunks_mut(BLOCKS_AT_A_TIME).for_each(run),
        }
    }

    fn admits_some(&self, place: Place) -> bool {
        self.limits.is_none_or(|[low, high]| {
            let (first, last) = (place.voxel(0), place.voxel(VOLUME - 1));
            (0..3).all(|axis| last[axis] >= low[axis] && first[axis] <= high[axis])
        })
    }
}
