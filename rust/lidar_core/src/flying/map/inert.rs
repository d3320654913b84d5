//! Voxels of a block that no ray changes.
//!
//! A ray pulls a voxel towards `g_free`. One that holds exactly this value stays there to the bit: in
//! 64 bits, keep * g + (1 - keep) * g differs from g by far less than half a step of 32 bits. An
//! infinite value is permanent. Both are inert; a voxel that was never observed is not.

use super::blocks::{EDGE, Row};

/// Voxels along the edge of a brick, as a power of two.
pub(crate) const BRICK_BITS: u32 = 2;

/// Bricks of 4 x 4 x 4 voxels in a block: a bit for each, along x first, then y, then z.
pub(crate) type Bricks = u8;

/// Half rows of a block, four voxels along x, that are known to be inert.
///
/// A bit that is missing costs time; one that is wrong would change results. So whoever writes a value
/// clears it, and only who has looked at the values sets it.
#[derive(Clone, Copy, Default)]
pub(crate) struct Inert {
    /// A bit for every row: for its first four voxels, and for its last four.
    halves: [u64; 2],
}

impl Inert {
    /// A voxel is about to be written.
    #[inline]
    pub(crate) fn forget(&mut self, offset: usize) {
        let (row, at) = (offset / EDGE as usize, offset % EDGE as usize);
        self.halves[at >> BRICK_BITS] &= !(1 << row);
    }

    /// Look at the values of a row; rays pull it towards `g_free`.
    #[inline(always)]
    pub(crate) fn note(&mut self, row: usize, values: &Row, g_free: f32) {
        let is_inert = |value: f32| {
            // Of bits: -0.0 would become 0.0.
            (value.to_bits() == g_free.to_bits()) | (value.abs() == f32::INFINITY)
        };
        let (halves, _) = values.as_chunks::<{ 1 << BRICK_BITS }>();
        for (bits, half) in self.halves.iter_mut().zip(halves) {
            let all = half.iter().fold(true, |all, &value| all & is_inert(value));
            *bits = *bits & !(1 << row) | u64::from(all) << row;
        }
    }

    /// True if all voxels of a row are known to be inert.
    #[inline(always)]
    pub(crate) fn holds(&self, row: usize) -> bool {
        (self.halves[0] & self.halves[1]) >> row & 1 == 1
    }

    /// Bricks that may hold a voxel that is not inert.
    pub(crate) fn live_bricks(&self) -> Bricks {
        /// Rows of the first brick: four along y, in each of four layers of z.
        const ROWS: u64 = 0x0F0F_0F0F;
        (0..8).fold(0, |live, brick| {
            let rows = ROWS << (4 * (brick >> 1 & 1) + 32 * (brick >> 2));
            live | Bricks::from(self.halves[brick & 1] & rows != rows) << brick
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flying::map::blocks::offset_of;

    #[test]
    fn a_brick_is_passed_once_all_its_voxels_are_inert() {
        let free = -1000.0;
        for brick in 0..8 {
            let [x, y, z] = [brick & 1, brick >> 1 & 1, brick >> 2].map(|at| 4 * at);
            let mut inert = Inert::default();
            for row in 0..16 {
                assert_eq!(inert.live_bricks(), 0xFF);
                let mut values = [-990.0; EDGE as usize];
                values[x as usize..x as usize + 4].fill(free);
                values[x as usize + 2] = f32::NEG_INFINITY;
                let offset = offset_of([0, y + row % 4, z + row / 4]);
                inert.note(offset / EDGE as usize, &values, free);
            }
            assert_eq!(inert.live_bricks(), !(1 << brick));
            inert.forget(offset_of([x + 3, y + 3, z]));
            assert_eq!(inert.live_bricks(), 0xFF);
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
