//! Sums of one scan per voxel: the window of blocks around its rays, with the sums of each voxel.

pub(crate) mod accumulator;
pub(crate) mod dense_blocks;
pub(crate) mod live_cells;
pub(crate) mod mark;
pub(crate) mod sparse_blocks;
pub(crate) mod window;
