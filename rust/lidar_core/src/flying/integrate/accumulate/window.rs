//! Window: the box of blocks around the rays of one scan.

use crate::Error;
use crate::flying::map::block_shape::{EDGE, EDGE_BITS};
use crate::flying::map::blocks::Place;
use crate::geometry::lattice::Voxel;

/// Largest number of blocks in the window of one scan. A voxel's place then fits 32 bits.
const MAX_WINDOW: u64 = 1 << 23;
/// Largest number of blocks along an axis. For longer rays, rounding would move walls by a part of
/// a voxel (docs/adr/0002).
const MAX_ALONG: u64 = 1 << 11;
/// Largest number of blocks of a window that is in memory as a whole. It takes 64 MiB of address
/// space. Only the memory of blocks that rays meet is used.
const MAX_WHOLE: usize = 1 << 15;

/// The box of blocks around the rays of one scan.
///
/// A voxel's place in the window is a word of bits: its place in the block in the lowest bits, then
/// the index of the block, each along all axes. So a step along an axis is one addition. For this,
/// the lengths along the axes are rounded up to powers of two, except for the axis whose bits come
/// last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Window {
    low: [i32; 3],
    size: [usize; 3],
    /// Number of bits of a block's index along x, y, z.
    bits: [u32; 3],
    /// Lowest bit of each axis of the block's index, within the place of a voxel.
    lowest: [u32; 3],
    /// Axes in the order of their bits, lowest first.
    order: [usize; 3],
    /// Number of block indices: the blocks of the window, with lengths rounded up to powers of two.
    len: usize,
}

/// Number of bits for the place of a voxel in its block.
const INSIDE: u32 = 3 * EDGE_BITS as u32;

impl Window {
    /// The smallest window that contains both voxels.
    ///
    /// # Errors
    /// [`Error::Limit`] if it would hold too many blocks.
    pub(crate) fn spanning(low: Voxel, high: Voxel) -> Result<Self, Error> {
        let (low, high) = (Place::of(low).0, Place::of(high).0);
        let size: [u64; 3] =
            std::array::from_fn(|axis| u64::from(high[axis].abs_diff(low[axis])) + 1);
        if let Some(edge) = size.into_iter().find(|&edge| edge > MAX_ALONG) {
            return Err(Error::Limit {
                what: format!("a scan that spans {edge} blocks of 8 voxels along an axis"),
                limit: MAX_ALONG,
                key: "raise `voxel_size` or lower `max_range`",
            });
        }
        let bits = size.map(|edge| edge.next_power_of_two().trailing_zeros());
        let order = order_of(size, bits);
        let last = order[2];
        // The last axis has no axis above its bits, so it needs no padding to a power of two.
        let len = size[last] << (bits.iter().sum::<u32>() - bits[last]);
        if len <= MAX_WINDOW {
            let (mut lowest, mut next) = ([0; 3], INSIDE);
            for axis in order {
                lowest[axis] = next;
                next += bits[axis];
            }
            let (size, len) = (size.map(|edge| edge as usize), len as usize);
            return Ok(Self { low, size, bits, lowest, order, len });
        }
        Err(Error::Limit {
            what: format!("a scan that spans {size:?} blocks of 8 voxels"),
            limit: MAX_WINDOW,
            key: "raise `voxel_size` or lower `max_range`",
        })
    }

    /// Number of block indices, including those that only the rounding to powers of two adds.
    pub(crate) fn len(&self) -> usize {
        self.len
    }

    /// True if the marks of the whole window are in memory.
    pub(crate) fn is_whole(&self) -> bool {
        self.len <= MAX_WHOLE
    }

    /// Indices of the blocks in the window.
    pub(crate) fn indices(&self) -> impl Iterator<Item = usize> {
        let [i, j, k] = self.order.map(|axis| (self.size[axis], self.lowest[axis] - INSIDE));
        let along = |(size, lowest): (usize, u32)| (0..size).map(move |block| block << lowest);
        along(k).flat_map(move |k| along(j).flat_map(move |j| along(i).map(move |i| k | j | i)))
    }

    /// Coordinate of the window's first voxel along an axis.
    pub(crate) fn first(&self, axis: usize) -> i32 {
        self.low[axis] << EDGE_BITS
    }

    /// Number of voxels along an axis.
    pub(crate) fn extent(&self, axis: usize) -> u32 {
        (self.size[axis] << EDGE_BITS) as u32 // at most 2^14
    }

    /// First voxel of the block at `index`, relative to the first voxel of the window.
    pub(crate) fn corner(&self, index: usize) -> [u32; 3] {
        std::array::from_fn(|axis| {
            let block = index >> (self.lowest[axis] - INSIDE) & ((1 << self.bits[axis]) - 1);
            (block << EDGE_BITS) as u32
        })
    }

    /// Bits along `axis` of the place of a voxel that is `after` voxels behind the window's first.
    #[inline(always)]
    pub(in crate::flying::integrate) fn bits_at(&self, axis: usize, after: u32) -> u32 {
        let (inside, block) = (after % EDGE as u32, after / EDGE as u32);
        // An axis of one block may have its lowest bit at 32: the block is 0 then, whatever the shift.
        inside << (EDGE_BITS as usize * axis) | block.wrapping_shl(self.lowest[axis])
    }

    /// All bits of a place that belong to an axis.
    #[inline(always)]
    pub(in crate::flying::integrate) fn bits_along(&self, axis: usize) -> u32 {
        let (inside, block) = ((EDGE as u32) - 1, (1u32 << self.bits[axis]) - 1);
        inside << (EDGE_BITS as usize * axis) | block.wrapping_shl(self.lowest[axis])
    }

    /// Place of a voxel. None if it is outside the window.
    #[inline(always)]
    pub(in crate::flying::integrate) fn place_of(&self, voxel: Voxel) -> Option<usize> {
        let mut after = [0; 3];
        for axis in 0..3 {
            // One comparison for both sides: a voxel below the first wraps to a number beyond any size.
            after[axis] = voxel[axis].wrapping_sub(self.first(axis)).cast_unsigned();
            if after[axis] as usize >= self.size[axis] * EDGE as usize {
                return None;
            }
        }
        Some((0..3).fold(0, |bits, axis| bits | self.bits_at(axis, after[axis])) as usize)
    }

    /// Index of the block at `place`. None if it is outside the window.
    pub(crate) fn index_of(&self, place: Place) -> Option<usize> {
        let first = self.place_of(place.voxel(0));
        first.map(|voxel| voxel >> INSIDE)
    }

    pub(crate) fn place(&self, index: usize) -> Place {
        Place(std::array::from_fn(|axis| {
            let block = index >> (self.lowest[axis] - INSIDE) & ((1 << self.bits[axis]) - 1);
            self.low[axis] + block as i32
        }))
    }
}

/// Order of the axes, lowest bits first. The last axis is the one along which rounding to a power
/// of two would add most.
fn order_of(size: [u64; 3], bits: [u32; 3]) -> [usize; 3] {
    let filled = |axis: usize| size[axis] as f64 / f64::from(1u32 << bits[axis]);
    let last = (0..2).fold(2, |last, axis| if filled(axis) < filled(last) { axis } else { last });
    [[1, 2, 0], [0, 2, 1], [0, 1, 2]][last]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flying::map::block_shape::VOLUME;
    use crate::flying::map::blocks::offset_of;

    #[test]
    fn bits_of_a_voxel_are_the_index_of_its_block_and_its_place_there() -> Result<(), Error> {
        let (low, high) = ([-70, -3, -1000], [25, 40, -985]);
        let window = Window::spanning(low, high)?;
        for turns in 0..3 {
            let turned = |mut voxel: Voxel| {
                voxel.rotate_right(turns);
                voxel
            };
            let window = Window::spanning(turned(low), turned(high))?;
            assert_eq!(window.len(), 13 * 8 * 2); // not 16 blocks along the longest axis
            assert!(window.indices().is_sorted());
            for voxel in [low, high, [0, 0, -991], [-65, 39, -992]].map(turned) {
                let place = window.place_of(voxel);
                let index = window.indices().find(|&index| window.place(index) == Place::of(voxel));
                assert!(index.is_some_and(|index| index < window.len()));
                assert_eq!(place, index.map(|index| index * VOLUME + offset_of(voxel)));
            }
        }
        for beyond in [[-73, 0, -1000], [32, 0, -1000], [0, -9, -1000], [0, 0, -984]] {
            assert_eq!(window.place_of(beyond), None);
        }
        Ok(())
    }

    #[test]
    fn windows_that_are_too_long_or_too_large_are_refused() {
        let spans = |high| Window::spanning([0; 3], high).is_ok();
        assert!(spans([16_383, 0, 0]) && spans([0, 16_383, 2047]) && spans([1023, 2047, 2047]));
        assert!(!spans([16_384, 0, 0]) && !spans([0, 0, 16_384]) && !spans([2048, 2047, 2047]));
        assert!(Window::spanning([i32::MIN; 3], [i32::MAX; 3]).is_err());
    }
}
