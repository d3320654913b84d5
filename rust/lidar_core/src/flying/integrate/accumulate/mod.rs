//! Sums of one scan for every voxel: the window of blocks around its rays, and the marks of the
//! voxels.

pub(crate) mod accumulator;
pub(crate) mod dense_blocks;
pub(crate) mod live_cells;
pub(crate) mod mark;
pub(crate) mod sparse_blocks;
pub(crate) mod window;
