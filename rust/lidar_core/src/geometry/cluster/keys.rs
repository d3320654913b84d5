//! Sort keys of points: the cube and the octant that contain them.

use crate::Error;
use crate::geometry::lattice::wide;
use crate::util::vector_unit::dispatch;
use pulp::{Simd, WithSimd};
use std::ops::{Add, BitAnd, BitOr, Shl, Shr, Sub};

/// Relative margin for rounding, so that two points at exactly the largest reach are never more
/// than two octants apart.
const CELL_MARGIN: f64 = 1.0 + 1e-6;
/// Largest number of cells along one axis. A cell is as wide as the reach.
const MAX_CELLS: f64 = (1u64 << 31) as f64;
/// Number of bits for the place of an octant in its cube: two for each axis.
pub(super) const OCTANT_BITS: u32 = 6;

/// Grid of octants that are half as wide as the reach, in cubes of 4 x 4 x 4 octants. Two points of
/// one octant are always linked (its diagonal is 0.866 of the reach), so octants are linked instead
/// of points. The octants of a cube are the bits of a word.
pub(crate) struct OctantGrid {
    low: [f64; 3],
    /// Number of octants per metre.
    octants: f64,
    /// Number of bits of a cube's index along every axis.
    pub(crate) bits: [u32; 3],
    /// Number of bits of the index of a point.
    pub(super) index_bits: u32,
}

impl OctantGrid {
    /// The grid over the finite points [m] for a largest link distance `largest` [m]. None if no
    /// point is finite.
    ///
    /// # Errors
    /// [`Error::PointOutOfRange`] if the cloud is more than 2^31 cells wide.
    pub(crate) fn of(points: &[[f32; 3]], largest: f64) -> Result<Option<Self>, Error> {
        let [low, high] = dispatch(Extent(points));
        if low[0] > high[0] {
            return Ok(None);
        }
        let (low, high) = (wide(low), wide(high));
        let cell_size = largest * CELL_MARGIN;
        let mut bits = [0; 3];
        for axis in 0..3 {
            let cells = (high[axis] - low[axis]) / cell_size;
            if cells >= MAX_CELLS {
                return Err(Error::PointOutOfRange { point: high });
            }
            bits[axis] = (cells as u64 / 2 + 3).ilog2() + 1; // one cube of room on either side
        }
        let index_bits = usize::BITS - points.len().leading_zeros();
        Ok(Some(Self { low, octants: 2.0 / cell_size, bits, index_bits }))
    }

    pub(super) fn key_bits(&self) -> u32 {
        self.bits.iter().sum::<u32>() + OCTANT_BITS
    }

    /// Index of the point to which a sort entry belongs.
    #[inline]
    pub(crate) fn row<K: Key>(&self, entry: K) -> usize {
        (entry.low() & ((1 << self.index_bits) - 1)) as usize
    }

    /// Key of a point [m]: the indices of its cube along z, y, x, then its octant in the lowest
    /// bits, in the same order of axes.
    #[inline]
    pub(crate) fn key<K: Key>(&self, point: [f32; 3]) -> K {
        let point = wide(point);
        let (mut cubes, mut octant) = (K::from(0), 0);
        for axis in [2, 1, 0] {
            // No coordinate lies below `low`: truncation rounds down here.
            let index = ((point[axis] - self.low[axis]) * self.octants) as i64 as u64;
            // From 1 on: steps to neighbours then never run into the next row of keys.
            cubes = cubes << self.bits[axis] | K::from((index >> 2) + 1);
            octant = octant << 2 | (index & 3);
        }
        cubes << OCTANT_BITS | K::from(octant)
    }
}

/// A sort key with the index of its point in the bits below it: 64 bits where the extent of the
/// cloud allows this, otherwise 128.
pub(super) trait Key:
    Copy
    + Ord
    + From<u64>
    + Shl<u32, Output = Self>
    + Shr<u32, Output = Self>
    + BitOr<Output = Self>
    + BitAnd<Output = Self>
    + Add<Output = Self>
    + Sub<Output = Self>
{
    /// The lowest 64 bits.
    fn low(self) -> u64;
}

impl Key for u64 {
    fn low(self) -> u64 {
        self
    }
}

impl Key for u128 {
    fn low(self) -> u64 {
        self as u64
    }
}

/// Number of points that are included in the box at a time.
const LANES: usize = 16;

/// Lowest and highest corner of the box around the finite points. Lowest is above highest if there
/// are none.
struct Extent<'a>(&'a [[f32; 3]]);

impl WithSimd for Extent<'_> {
    type Output = [[f32; 3]; 2];

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> [[f32; 3]; 2] {
        let (mut low, mut high) = ([[f32::INFINITY; 3]; LANES], [[f32::NEG_INFINITY; 3]; LANES]);
        let (bundles, rest) = self.0.as_chunks::<LANES>();
        let mut bundle = [[f32::NAN; 3]; LANES];
        bundle[..rest.len()].copy_from_slice(rest);
        for points in bundles.iter().chain([&bundle]) {
            let mut are_finite = true;
            for value in points.as_flattened() {
                are_finite &= value.abs() < f32::INFINITY;
            }
            let mut taken = *points;
            // Most bundles hold finite points alone.
            if !are_finite {
                for point in taken.iter_mut().filter(|point| !is_finite(**point)) {
                    *point = [f32::NAN; 3]; // infinities too: no comparison with NaN holds
                }
            }
            for lane in 0..LANES {
                for axis in 0..3 {
                    let value = taken[lane][axis];
                    let (least, most) = (low[lane][axis], high[lane][axis]);
                    low[lane][axis] = if value < least { value } else { least };
                    high[lane][axis] = if value > most { value } else { most };
                }
            }
        }
        let (mut lowest, mut highest) = (low[0], high[0]);
        for (low, high) in low.iter().zip(&high) {
            for axis in 0..3 {
                lowest[axis] = lowest[axis].min(low[axis]);
                highest[axis] = highest[axis].max(high[axis]);
            }
        }
        [lowest, highest]
    }
}

#[inline(always)]
pub(crate) fn is_finite(point: [f32; 3]) -> bool {
    point.iter().all(|value| value.is_finite())
}
