//! Update of the map by the marks of one scan. A scan changes values of voxels only in this module.
//!
//! Source: Vrba et al., eqs 9 and 12.

use super::accumulate::accumulator::{Accumulator, Slot};
use super::voxel_update::Rule;
use crate::Error;
use crate::flying::map::block_shape::{Bits, VOLUME};
use crate::flying::map::blocks::{Block, Blocks, Place};
use crate::flying::map::voxel_map::VoxelMap;
use rayon::ThreadPool;
use rayon::prelude::*;

/// Number of blocks that a thread takes at a time.
const BLOCKS_AT_A_TIME: usize = 16;

/// A block in which a scan has marked voxels.
pub(super) struct MarkedBlock {
    place: Place,
    marks: Slot,
    /// Slot of the block in the map. None if the map does not have this block yet.
    home: Option<u32>,
    /// The block, taken out of the map during the update.
    block: Option<Box<Block>>,
    /// Number of voxels with marks.
    voxels: usize,
    /// Number of voxels whose value has changed.
    n_changed: u32,
    /// Voxels whose state has changed, so that their groups must be updated.
    changed: Bits,
    /// Voxels that were at least tentatively occupied before the update.
    before: Bits,
}

/// Apply the marks of a scan to `map`. Returns three numbers of voxels: with marks, with a changed
/// value, and forgotten to make room. `marked`: working memory, empty before and after the call.
///
/// # Errors
/// [`Error::Limit`] if the map has no room for the scan alone; the map is unchanged then.
pub(super) fn update_blocks(
    map: &mut VoxelMap,
    marked: &mut Vec<MarkedBlock>,
    sums: &mut Accumulator,
    weighted: bool,
    pool: Option<&ThreadPool>,
) -> Result<[usize; 3], Error> {
    let admitted = sums.marked().filter(|(place, _)| map.admits_some_of(*place));
    marked.extend(admitted.map(|(place, marks)| MarkedBlock {
        home: map.blocks.slot(place),
        place,
        marks,
        block: None,
        voxels: 0,
        n_changed: 0,
        changed: [0; 8],
        before: [0; 8],
    }));
    let taken = find_room(map, marked).and_then(|forgotten| {
        take_blocks(&mut map.blocks, marked)?;
        Ok(forgotten)
    });
    if taken.is_ok() {
        apply_marks(&Rule::of(map, weighted), marked, sums, pool);
    }
    let voxels = marked.iter().map(|block| block.voxels).sum();
    let changed = marked.iter().map(|block| block.n_changed as usize).sum();
    for MarkedBlock { home, block, changed, before, .. } in marked.drain(..) {
        if let (Some(home), Some(block)) = (home, block) {
            map.put_back(home, block, &changed, &before);
        }
    }
    taken.map(|forgotten| [voxels, changed, forgotten])
}

/// Make room for the scan if the budget of the map has none: the map forgets the blocks farthest
/// from the scan, because the present surroundings of the robot matter most. Returns the number of
/// observed voxels that were forgotten.
fn find_room(map: &mut VoxelMap, marked: &mut [MarkedBlock]) -> Result<usize, Error> {
    let missing = marked.iter().filter(|marked| marked.home.is_none()).count();
    if map.blocks.len() + missing <= map.blocks.max_blocks() {
        return Ok(0);
    }
    let places: Vec<Place> = marked.iter().map(|marked| marked.place).collect();
    let forgotten = map.make_room(missing, &places)?;
    for MarkedBlock { place, home, .. } in marked {
        *home = map.blocks.slot(*place); // the slots have moved
    }
    Ok(forgotten)
}

/// Take the marked blocks out of the map, and make missing ones. On an error, none is taken.
fn take_blocks(blocks: &mut Blocks, marked: &mut [MarkedBlock]) -> Result<(), Error> {
    // All that can fail comes first: after it `make` finds its memory.
    blocks.reserve(marked.iter().filter(|marked| marked.home.is_none()).count())?;
    for MarkedBlock { place, home, block, .. } in marked {
        // Missing blocks are made in the order of `marked`, which does not depend on the threads.
        let slot = home.unwrap_or_else(|| blocks.make(*place));
        *home = Some(slot);
        // Each thread owns its blocks, so none needs a lock; only a pointer is moved.
        *block = blocks.take(slot);
    }
    Ok(())
}

fn apply_marks(
    rule: &Rule,
    marked: &mut [MarkedBlock],
    sums: &Accumulator,
    pool: Option<&ThreadPool>,
) {
    let run = |marked: &mut [MarkedBlock]| {
        let mut spare = [0; VOLUME];
        // All are looked at before any is changed: their memory is waited for once.
        for MarkedBlock { block, marks, voxels, .. } in &mut *marked {
            let (Some(block), (marks, met)) = (block, sums.block(*marks, &mut spare)) else {
                continue;
            };
            block.hold(met);
            *voxels = rule.count(block, marks, met);
        }
        for MarkedBlock { block, marks, changed, n_changed, before, .. } in marked {
            let (Some(block), (marks, met)) = (block, sums.block(*marks, &mut spare)) else {
                continue;
            };
            // Kept to tell voxels that became occupied from those that ceased to be.
            *before = block.tentative;
            (*changed, *n_changed) = rule.apply(block, marks, met);
        }
    };
    match pool {
        Some(pool) => {
            pool.install(|| marked.par_chunks_mut(BLOCKS_AT_A_TIME).for_each(run));
        }
        None => marked.chunks_mut(BLOCKS_AT_A_TIME).for_each(run),
    }
}
