//! CellBits of a window that hold a voxel which rays may change.

use super::window::Window;
use crate::flying::map::inert::CellBits;
use crate::flying::map::voxel_map::VoxelMap;

/// All cells of a block.
pub(in crate::flying::integrate) const ALL: CellBits = CellBits::MAX;

/// For every block of a window, the cells that hold a voxel which rays may change.
#[derive(Default)]
pub(crate) struct LiveCells {
    blocks: Vec<CellBits>,
    /// CellBits that are passed.
    n_inert: usize,
    /// CellBits of the blocks that the map holds or refuses.
    n_known: usize,
}

impl LiveCells {
    /// CellBits of blocks by their index.
    #[cfg(test)]
    pub(in crate::flying::integrate) fn of(blocks: Vec<CellBits>) -> Self {
        Self { blocks, ..Self::default() }
    }

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
                    self.set(index, block.inert.live_cells());
                }
            }
        } else {
            for index in window.indices() {
                if let Some(block) = map.blocks.get(window.place(index)) {
                    self.set(index, block.inert.live_cells());
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

    fn set(&mut self, index: usize, live: CellBits) {
        self.n_inert += live.count_zeros() as usize;
        self.n_known += CellBits::BITS as usize;
        self.blocks[index] = live;
    }

    /// True if enough of what is known is passed to pay for the search of what is not: one cell in
    /// sixteen.
    pub(in crate::flying::integrate) fn is_worth_it(&self) -> bool {
        16 * self.n_inert > self.n_known
    }

    /// CellBits of the block at `index` of the window.
    pub(in crate::flying::integrate) fn at(&self, index: usize) -> CellBits {
        self.blocks[index]
    }
}
