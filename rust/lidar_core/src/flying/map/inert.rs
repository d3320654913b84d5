//! Inert voxels of a block: voxels that no ray changes.
//!
//! A ray pulls a voxel towards `g_free`. A voxel with exactly this value keeps it to the bit: in 64
//! bits, keep * g + (1 - keep) * g differs from g by far less than half a step of 32 bits. An
//! infinite value is permanent. Voxels with either value are inert; a voxel that was never observed
//! is not.

use super::block_shape::{EDGE, Row};

/// Number of voxels along the edge of a cell, as base-2 logarithm.
pub(crate) const CELL_BITS: u32 = 1;
/// Number of cells along the edge of a block.
pub(crate) const CELLS: u32 = EDGE as u32 >> CELL_BITS;

/// Cells of 2 x 2 x 2 voxels in a block: one bit per cell, in the order of x, then y, then z.
pub(crate) type CellBits = u64;

/// Pairs of neighbouring voxels along x that are known to be inert.
///
/// A missing bit costs time; a wrong bit would change results. So writing a value clears the bit,
/// and only an inspection of the values sets it.
#[derive(Clone, Copy, Default)]
pub(crate) struct Inert {
    /// One bit per row: first for the first pair of voxels of the row, then for the second, and so
    /// on.
    pairs: [u64; CELLS as usize],
}

impl Inert {
    /// Clear the bit of the voxel `offset`, which is about to be written.
    #[inline]
    pub(crate) fn forget(&mut self, offset: usize) {
        let (row, at) = (offset / EDGE as usize, offset % EDGE as usize);
        self.pairs[at >> CELL_BITS] &= !(1 << row);
    }

    /// Clear the bits of a row, which is about to be written.
    #[inline]
    pub(crate) fn forget_row(&mut self, row: usize) {
        self.pairs.iter_mut().for_each(|pairs| *pairs &= !(1 << row));
    }

    /// Set the bits of a row from its values. `g_free`: value towards which rays pull.
    #[inline(always)]
    pub(crate) fn note(&mut self, row: usize, values: &Row, g_free: f32) {
        // Of bits: -0.0 would become 0.0.
        let is_inert = values
            .map(|value| (value.to_bits() == g_free.to_bits()) | (value.abs() == f32::INFINITY));
        for (bits, pair) in self.pairs.iter_mut().zip(is_inert.as_chunks::<2>().0) {
            *bits = *bits & !(1 << row) | u64::from(pair[0] & pair[1]) << row;
        }
    }

    /// True if all voxels of a row are known to be inert.
    #[inline(always)]
    pub(crate) fn holds(&self, row: usize) -> bool {
        self.pairs.iter().fold(1, |all, pairs| all & pairs >> row) & 1 == 1
    }

    /// Cells that may contain a voxel that is not inert.
    pub(crate) fn live_cells(&self) -> CellBits {
        let mut inert = 0;
        for (x, pairs) in self.pairs.iter().enumerate() {
            // A byte per layer of z, and in it a bit per y: two rows of two layers make a cell, so that two
            // shifts test all cells of this x at once.
            let rows = pairs & pairs >> 1;
            let cells = rows & rows >> 8 & 0x0055_0055_0055_0055;
            // A byte has four cells of y in its even bits. They spread over 16 bits, four apart, so that those of
            // the four x fit between them.
            let cells = (cells | cells << 4) & 0x0505_0505_0505_0505;
            inert |= ((cells | cells << 2) & 0x1111_1111_1111_1111) << x;
        }
        !inert
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flying::map::blocks::offset_of;

    #[test]
    fn a_cell_is_passed_once_all_its_voxels_are_inert() {
        let free = -1000.0;
        for cell in 0..64 {
            let [x, y, z] = [cell & 3, cell >> 2 & 3, cell >> 4].map(|at| 2 * at);
            let mut inert = Inert::default();
            for row in 0..4 {
                assert_eq!(inert.live_cells(), u64::MAX);
                let mut values = [-990.0; EDGE as usize];
                values[x as usize] = free;
                values[x as usize + 1] = f32::NEG_INFINITY;
                let offset = offset_of([0, y + row % 2, z + row / 2]);
                inert.note(offset / EDGE as usize, &values, free);
            }
            assert_eq!(inert.live_cells(), !(1 << cell));
            let mut other = inert;
            inert.forget(offset_of([x + 1, y + 1, z]));
            other.forget_row(offset_of([0, y, z + 1]) / EDGE as usize);
            assert_eq!([inert, other].map(|inert| inert.live_cells()), [u64::MAX; 2]);
        }
    }

    #[test]
    fn only_the_bits_of_g_free_and_infinity_are_inert() {
        let is_inert = |value: f32, g_free: f32| {
            let mut inert = Inert::default();
            inert.note(5, &[g_free, g_free, value, g_free, g_free, g_free, g_free, g_free], g_free);
            inert.holds(5)
        };
        assert!(is_inert(-1000.0, -1000.0) && is_inert(f32::INFINITY, -1000.0));
        assert!(is_inert(0.0, 0.0) && !is_inert(-0.0, 0.0) && !is_inert(f32::NAN, -1000.0));
        assert!(!is_inert((-1000f32).next_up(), -1000.0));
    }
}
