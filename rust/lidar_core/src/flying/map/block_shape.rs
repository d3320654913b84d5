//! Size of a block of voxels, and stored data per voxel and per row.

/// Voxels along the edge of a block, as a power of two.
pub(crate) const EDGE_BITS: i32 = 3;
/// Voxels along the edge of a block.
pub(crate) const EDGE: i32 = 1 << EDGE_BITS;
/// Voxels in a block.
pub(crate) const VOLUME: usize = 1 << (3 * EDGE_BITS);

/// One bit per voxel of a block: a word per layer of z, a byte per row of x.
pub(crate) type Bits = [u64; EDGE as usize];

/// Values of the voxels of a row of x.
pub(crate) type Row = [f32; EDGE as usize];

/// True if the bit of a voxel is set.
#[inline]
pub(crate) fn has(bits: &Bits, offset: usize) -> bool {
    bits[offset >> 6] >> (offset & 63) & 1 == 1
}

/// Set or clear the bit of a voxel.
#[inline]
pub(crate) fn assign(bits: &mut Bits, offset: usize, value: bool) {
    let mask = 1 << (offset & 63);
    if value {
        bits[offset >> 6] |= mask;
    } else {
        bits[offset >> 6] &= !mask;
    }
}
