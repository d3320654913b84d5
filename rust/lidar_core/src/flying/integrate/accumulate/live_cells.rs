//! Live cells of a window: cells that hold a voxel which rays may change.

use super::window::Window;
use crate::flying::map::inert::{CELLS, CellBits};
use crate::flying::map::voxel_map::VoxelMap;

/// All cells of a block.
pub(in crate::flying::integrate) const ALL: CellBits = CellBits::MAX;

/// For every block of a window, its live cells: those that hold a voxel which rays may change.
#[derive(Default)]
pub(crate) struct LiveCells {
    blocks: Vec<CellBits>,
    /// Number of cells that rays may skip.
    n_inert: usize,
    /// Number of cells in blocks that the map holds, or that are outside its operating volume.
    n_known: usize,
    /// Number of cubes into which the live cells of these blocks are grouped.
    n_cubes: usize,
}

/// Cost of entering a cube into the map of directions, in visits of a ray.
const VISITS_PER_CUBE: usize = 32;
/// Bits of the first brick of 2 x 2 x 2 cells in a block.
const BRICK: CellBits = 0x0033_0033;

/// Call `visit` for the cubes that the live cells of a block make up. Cells that fill a larger cube
/// are one cube. Arguments: lowest corner of the cube and its edge, in cells.
#[inline(always)]
pub(in crate::flying::integrate) fn cubes(live: CellBits, mut visit: impl FnMut([u32; 3], u32)) {
    if live == ALL {
        return visit([0; 3], CELLS);
    }
    for brick in 0..8 {
        let corner = [brick & 1, brick >> 1 & 1, brick >> 2].map(|at| at * CELLS / 2);
        let first = corner[0] + CELLS * (corner[1] + CELLS * corner[2]);
        let mut cells = live >> first & BRICK;
        if cells == BRICK {
            visit(corner, CELLS / 2);
            continue;
        }
        while cells != 0 {
            let cell = cells.trailing_zeros();
            let at = [cell % CELLS, cell / CELLS % CELLS, cell / (CELLS * CELLS)];
            visit([corner[0] + at[0], corner[1] + at[1], corner[2] + at[2]], 1);
            cells &= cells - 1;
        }
    }
}

impl LiveCells {
    /// Live cells with these bits for each block.
    #[cfg(test)]
    pub(in crate::flying::integrate) fn of(blocks: Vec<CellBits>) -> Self {
        Self { blocks, ..Self::default() }
    }

    /// Find the live cells of `map` in `window`.
    pub(crate) fn fill(&mut self, window: &Window, map: &VoxelMap) {
        self.blocks.clear();
        // A block that is missing was never observed.
        self.blocks.resize(window.len(), ALL);
        (self.n_inert, self.n_known, self.n_cubes) = (0, 0, 0);
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
        // Marks outside the operating volume would be cast in vain: nothing is stored there.
        if map.is_bounded() {
            for index in window.indices().filter(|&at| !map.admits_some_of(window.place(at))) {
                self.set(index, 0);
            }
        }
    }

    fn set(&mut self, index: usize, live: CellBits) {
        self.n_inert += live.count_zeros() as usize;
        self.n_known += CellBits::BITS as usize;
        cubes(live, |_, _| self.n_cubes += 1);
        self.blocks[index] = live;
    }

    /// True if skipping saves time: at least one known cell in sixteen is skipped, and more visits
    /// are saved than the search for live cells costs. `visits`: largest number of visits of the
    /// rays.
    pub(in crate::flying::integrate) fn is_worth_it(&self, visits: f64) -> bool {
        let passed = visits * self.n_inert as f64 / self.n_known.max(1) as f64;
        16 * self.n_inert > self.n_known && passed > (VISITS_PER_CUBE * self.n_cubes) as f64
    }

    /// Bits of the live cells of the block at `index` of the window.
    pub(in crate::flying::integrate) fn at(&self, index: usize) -> CellBits {
        self.blocks[index]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubes_make_up_the_cells_of_a_block() {
        for seed in 0..3000u64 {
            let word =
                |salt: u64| (seed * 9 + salt).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(23);
            let live = match seed % 4 {
                0 => word(1) & word(2) & word(3),
                1 => word(1),
                2 => word(1) | word(2) | word(3),
                _ => [0, ALL, BRICK, 1 << 63, !BRICK][seed as usize / 4 % 5],
            };
            let (mut covered, mut count) = (0, 0);
            cubes(live, |[x, y, z], edge| {
                count += 1;
                for cell in 0..edge * edge * edge {
                    let at = [x + cell % edge, y + cell / edge % edge, z + cell / (edge * edge)];
                    let bit: CellBits = 1 << (at[0] + CELLS * (at[1] + CELLS * at[2]));
                    assert_eq!(covered & bit, 0);
                    covered |= bit;
                }
            });
            assert_eq!(covered, live);
            assert!(live != ALL || count == 1);
        }
    }
}
