//! Voxels of one layer of a block, as the bits of a word, and search for their neighbours.

use super::block_shape::{EDGE, EDGE_BITS};
use super::blocks::{Place, offset_of};
use crate::Error;
use crate::error::require;
use crate::geometry::lattice::Voxel;
use serde::{Deserialize, Serialize};

/// Some of the 64 voxels of one z layer of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Layer {
    pub(crate) place: Place,
    /// Index of the layer along z in its block, 0 to 7.
    pub(crate) z: i32,
    /// One bit per voxel: byte y contains the row along x at y.
    pub(crate) bits: u64,
}

impl Layer {
    #[inline]
    pub(crate) fn of(voxel: Voxel) -> Self {
        let offset = offset_of(voxel);
        Self { place: Place::of(voxel), z: offset as i32 >> 6, bits: 1 << (offset & 63) }
    }

    /// True if both are of the same layer of the same block, even if they contain different voxels.
    #[inline]
    pub(crate) fn is_same(&self, other: &Self) -> bool {
        self.place == other.place && self.z == other.z
    }

    /// Offsets of the voxels in their block, in ascending order.
    pub(crate) fn offsets(self) -> impl Iterator<Item = usize> {
        let (mut bits, first) = (self.bits, 64 * self.z as usize);
        std::iter::from_fn(move || {
            let bit = bits.trailing_zeros() as usize;
            bits &= bits.wrapping_sub(1);
            (bit < 64).then_some(first + bit)
        })
    }

    /// First and last voxel along x, then along y, within the block.
    fn spans(&self) -> [[i32; 2]; 2] {
        // All rows are ORed into one byte: its outer bits are the ends along x.
        let halves = self.bits | self.bits >> 32;
        let quarters = halves | halves >> 16;
        let columns = (quarters | quarters >> 8) as u8;
        let x = [columns.trailing_zeros(), 7 - columns.leading_zeros()];
        let y = [self.bits.trailing_zeros() / 8, 7 - self.bits.leading_zeros() / 8];
        [x, y].map(|ends| ends.map(|end| end as i32))
    }
}

/// Neighbourhood of a voxel: all voxels whose centre is within a given distance.
#[derive(Clone, Debug)]
pub(crate) struct Neighbours {
    /// Largest distance of a neighbour along one axis, in voxels.
    reach: i32,
    /// Reach rounded up to whole blocks, in voxels.
    margin: i32,
    /// Bits of a voxel's neighbours in a layer of a block. There is one entry for every distance
    /// along z and for every position of the voxel along y and x, relative to a corner `margin`
    /// below the block.
    masks: Vec<u64>,
}

impl Neighbours {
    /// Neighbourhood of all voxels whose centre is at most `reach` voxel edges away.
    ///
    /// # Errors
    /// [`Error::Parameter`] unless 0 <= reach <= 64.
    pub(crate) fn within(reach: f64) -> Result<Self, Error> {
        const MOST: f64 = 64.0;
        let got = format_args!("{reach} voxels");
        require((0.0..=MOST).contains(&reach), "max_gap", "a distance of 0 to 64 voxels", got)?;
        let square = (reach * (1.0 + 1e-12)).powi(2); // 0.75 / 0.25 and the like stay inside
        let reach = square.sqrt().floor() as i32;
        // Rounded up to whole blocks, since `of` looks masks up relative to other blocks.
        let margin = (reach + EDGE - 1) & !(EDGE - 1);
        let places = || -margin..EDGE + margin;
        let mut masks = Vec::new();
        for dz in 0..=reach {
            for y in places() {
                let reaches: [i32; EDGE as usize] = std::array::from_fn(|row| {
                    let dy = row as i32 - y;
                    let rest = square - f64::from(dy * dy + dz * dz);
                    if rest >= 0.0 { rest.sqrt().floor() as i32 } else { -1 }
                });
                masks.extend(places().map(|x| mask(x, &reaches)));
            }
        }
        Ok(Self { reach, margin, masks })
    }

    /// The given voxels and all their neighbours, each layer once, in ascending order.
    pub(crate) fn dilated(&self, layers: &[Layer]) -> Vec<Layer> {
        let mut dilated = Vec::new();
        for layer in layers {
            let [x, y, z] = layer.place.0;
            self.any_block(layer, |step| {
                let place = Place([x + step[0], y + step[1], z + step[2]]);
                let near = |z| Layer { place, z, bits: self.of(layer, step, z) };
                dilated.extend(self.layers(layer, step[2]).map(near));
                false
            });
        }
        // Several layers dilate into the same one: side by side they merge, and each voxel is pulled once.
        dilated.sort_unstable_by_key(|layer| (layer.place, layer.z));
        dilated.dedup_by(|next, layer| {
            let is_same = layer.is_same(next);
            layer.bits |= if is_same { next.bits } else { 0 };
            is_same
        });
        dilated
    }

    /// Call `visit` for the blocks that may contain neighbours of a layer, until one call returns
    /// true. The argument is the distance of the block from the layer's own block, in blocks.
    /// Returns whether a call returned true.
    #[inline]
    pub(crate) fn any_block(&self, layer: &Layer, mut visit: impl FnMut([i32; 3]) -> bool) -> bool {
        let [x, y] = layer.spans();
        let blocks = |[first, last]: [i32; 2]| {
            (first - self.reach) >> EDGE_BITS..=(last + self.reach) >> EDGE_BITS
        };
        blocks([layer.z; 2]).any(|dz| blocks(y).any(|dy| blocks(x).any(|dx| visit([dx, dy, dz]))))
    }

    /// Layers that may contain neighbours of `layer`, in the block `dz` blocks above its own.
    #[inline]
    pub(crate) fn layers(&self, layer: &Layer, dz: i32) -> std::ops::RangeInclusive<i32> {
        let z = layer.z - (dz << EDGE_BITS);
        (z - self.reach).max(0)..=(z + self.reach).min(EDGE - 1)
    }

    /// Bits of the neighbours of `layer` in layer `z` of the block that is `step` blocks away from
    /// its own.
    #[inline]
    pub(crate) fn of(&self, layer: &Layer, step: [i32; 3], z: i32) -> u64 {
        let [dx, dy, dz] = step.map(|blocks| blocks << EDGE_BITS);
        let (width, steps) = (EDGE + 2 * self.margin, (z + dz - layer.z).abs());
        // Seen from the other block the voxel lies at x - dx, y - dy; the margin makes both positive.
        let first = (steps * width + self.margin - dy) * width + self.margin - dx;
        let (mut bits, mut around) = (layer.bits, 0);
        while bits != 0 {
            let (x, y) = (bits.trailing_zeros() as i32 & 7, bits.trailing_zeros() as i32 >> 3);
            bits &= bits - 1;
            around |= self.masks[(first + y * width + x) as usize];
        }
        around
    }
}

/// Bits of a layer: in every row, the voxels within the row's reach of position `x`.
fn mask(x: i32, reaches: &[i32; EDGE as usize]) -> u64 {
    let row = |&reach: &i32| {
        let (low, high) = ((x - reach).clamp(0, EDGE), (x + reach + 1).clamp(0, EDGE));
        if low < high { (1u64 << high) - (1 << low) } else { 0 }
    };
    reaches.iter().rev().fold(0, |bits, reach| bits << 8 | row(reach))
}
