//! Size of a block of voxels, and stored data per voxel and per row.

/// Number of voxels along the edge of a block, as base-2 logarithm.
pub(crate) const EDGE_BITS: i32 = 3;
/// Number of voxels along the edge of a block.
pub(crate) const EDGE: i32 = 1 << EDGE_BITS;
/// Number of voxels in a block.
pub(crate) const VOLUME: usize = 1 << (3 * EDGE_BITS);

/// One bit per voxel of a block: a word per z layer, and in it a byte per row along x.
pub(crate) type Bits = [u64; EDGE as usize];

/// Values of the voxels of one row along x.
pub(crate) type Row = [f32; EDGE as usize];

/// True if the bit of the voxel `offset` of a block is set.
#[inline]
pub(crate) fn has(bits: &Bits, offset: usize) -> bool {
    bits[offset >> 6] >> (offset & 63) & 1 == 1
}

/// Set or clear the bit of the voxel `offset` of a block.
#[inline]
pub(crate) fn assign(bits: &mut Bits, offset: usize, value: bool) {
    let mask = 1 << (offset & 63);
    if value {
        bits[offset >> 6] |= mask;
    } else {
        bits[offset >> 6] &= !mask;
    }
}
