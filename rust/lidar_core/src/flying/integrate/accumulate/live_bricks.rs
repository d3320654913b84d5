//! Bricks of a window that hold a voxel which rays may change.

use super::window::Window;
use crate::flying::map::inert::Bricks;
use crate::flying::map::voxel_map::VoxelMap;

/// All bricks of a block.
const ALL: Bricks = Bricks::MAX;
/// Bits of the place of a brick in its block.
pub(in crate::flying::integrate) const INSIDE: u32 = 3;

/// For every block of a window, the bricks that hold a voxel which rays may change.
#[derive(Default)]
pub(crate) struct LiveBricks {
    blocks: Vec<Bricks>,
    /// Bricks that are passed.
    n_inert: usize,
    /// Bricks of the blocks that the map holds or refuses.
    n_known: usize,
}

impl LiveBricks {
    /// Look at what `map` holds in `window`.
    pub(crate) fn fill(&mut self, window: &Window, map: &VoxelMap) {
        self.blocks.clear();
        // A block that is missing was never observed.
        self.blocks.resize(window.len(), ALL);
        (self.n_inert, self.n_known) = (0, 0);
        // The cost follows the lesser of the two: neither the map nor the window may be walked for nothing.
        if map.blocks.len() < window.len() {
            for block in map.blocks.iter() {
                if let Some(index) = window.index_of(block.place) {
                    self.set(index, block.inert.live_bricks());
                }
            }
        } else {
            for index in window.indices() {
                if let Some(block) = map.blocks.get(window.place(index)) {
                    self.set(index, block.inert.live_bricks());
                }
            }
        }
        // Nothing is stored outside the operating volume.
        if map.is_bounded() {
            for index in window.indices().filter(|&at| !map.admits_some_of(window.place(at))) {
                self.set(index, 0);
            }
        }
    }

    fn set(&mut self, index: usize, live: Bricks) {
        self.n_inert += live.count_zeros() as usize;
        self.n_known += Bricks::BITS as usize;
        self.blocks[index] = live;
    }

    /// True if enough of what is known is passed to pay for the search of what is not: one brick in
    /// sixteen.
    pub(in crate::flying::integrate) fn is_worth_it(&self) -> bool {
        16 * self.n_inert > self.n_known
    }

    /// 1 for a brick that holds a voxel which may change, given by that of its block and its own place
    /// there; 0 for others.
    #[inline(always)]
    pub(in crate::flying::integrate) fn is_live(&self, brick: u32) -> u64 {
        let bricks = self.blocks[(brick >> INSIDE) as usize];
        u64::from(bricks >> (brick % (1 << INSIDE)) & 1)
    }

    /// True if rays may have met the block at `index` of the window.
    pub(in crate::flying::integrate) fn has_live(&self, index: usize) -> bool {
        self.blocks[index] != 0
    }
}
