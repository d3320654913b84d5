//! Blocks that bound the rays of one scan.

use super::blocks::{EDGE, EDGE_BITS, Place, VOLUME, offset_of};
use crate::Error;
use crate::geometry::lattice::Voxel;

/// Most blocks in the window of one scan: a voxel's place then fits 32 bits.
const MAX_WINDOW: u64 = 1 << 23;
/// Windows of at most so many blocks lie in memory as a whole. 64 MiB, of which only what rays meet
/// is ever used.
const MAX_WHOLE: usize = 1 << 15;

/// Blocks that bound the rays of one scan.
///
/// A voxel's place in the window is a row of bits: its place in the block, then that of the block,
/// each along x, y and z, so that a step along an axis is one addition.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Window {
    low: [i32; 3],
    size: [usize; 3],
    /// Bits that the index of a block takes along x, y, z.
    bits: [u32; 3],
}

impl Window {
    /// The window that spans both voxels.
    ///
    /// # Errors
    /// [`Error::Limit`] if it holds too many blocks.
    pub(crate) fn spanning(low: Voxel, high: Voxel) -> Result<Self, Error> {
        let (low, high) = (Place::of(low).0, Place::of(high).0);
        let size: [u64; 3] =
            std::array::from_fn(|axis| u64::from(high[axis].abs_diff(low[axis])) + 1);
        let bits = size.map(|edge| edge.next_power_of_two().trailing_zeros());
        let blocks = size[2].checked_shl(bits[0] + bits[1]);
        if blocks.is_some_and(|blocks| blocks >> (bits[0] + bits[1]) == size[2])
            && blocks.is_some_and(|blocks| blocks <= MAX_WINDOW)
        {
            return Ok(Self { low, size: size.map(|edge| edge as usize), bits });
        }
        Err(Error::Limit {
            what: format!("a scan that spans {size:?} blocks of 8 voxels"),
            limit: MAX_WINDOW,
            key: "raise `voxel_size` or lower `max_range`",
        })
    }

    /// Blocks of the window and beside it, up to powers of two along x and y.
    pub(super) fn len(&self) -> usize {
        self.size[2] << (self.bits[0] + self.bits[1])
    }

    /// Whether it lies in memory as a whole.
    pub(super) fn is_whole(&self) -> bool {
        self.len() <= MAX_WHOLE
    }

    /// Indices of its blocks.
    pub(super) fn indices(&self) -> impl Iterator<Item = usize> {
        let [x, y, z] = self.size;
        let [along, across, _] = self.bits;
        (0..z).flat_map(move |z| {
            (0..y).flat_map(move |y| (0..x).map(move |x| (z << across | y) << along | x))
        })
    }

    pub(super) fn index(&self, place: Place) -> usize {
        let [x, y, z]: [usize; 3] =
            std::array::from_fn(|axis| place.0[axis].wrapping_sub(self.low[axis]) as usize);
        (z << self.bits[1] | y) << self.bits[0] | x
    }

    /// Bits of a voxel.
    #[inline(always)]
    pub(super) fn bits_of(&self, voxel: Voxel) -> u64 {
        (self.index(Place::of(voxel)) * VOLUME + offset_of(voxel)) as u64
    }

    /// Those of them that belong to an axis.
    #[inline(always)]
    pub(super) fn bits_along(&self, axis: usize) -> u64 {
        let below: u32 = self.bits[..axis].iter().sum();
        let (inside, block) = ((EDGE as u64) - 1, (1 << self.bits[axis]) - 1);
        inside << (EDGE_BITS as usize * axis) | (block * VOLUME as u64) << below
    }

    pub(super) fn holds(&self, place: Place) -> bool {
        (0..3).all(|axis| (place.0[axis].wrapping_sub(self.low[axis]) as usize) < self.size[axis])
    }

    pub(super) fn place(&self, index: usize) -> Place {
        let [x, y, _] = self.bits;
        let inside = [index & ((1 << x) - 1), index >> x & ((1 << y) - 1), index >> (x + y)];
        Place(std::array::from_fn(|axis| self.low[axis] + inside[axis] as i32))
    }
}
