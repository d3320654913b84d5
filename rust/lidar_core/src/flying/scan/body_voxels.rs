//! Voxels around a sensor, in its frame, in which the detector searches for the robot itself.

use crate::flying::map::saved_body::{EDGE, SIZE};

/// Number of voxels of the cube around a sensor.
pub(super) const VOLUME: usize = EDGE * EDGE * EDGE;
/// Number of words of 64 bits that hold one bit for each of these voxels.
pub(super) const WORDS: usize = VOLUME / 64;
/// Largest distance of connected voxels of a part, along each axis: gaps of one voxel are allowed.
pub(super) const GAP: i32 = 2;

/// Bits of the given voxels and their neighbours. Empty without voxels.
pub(super) fn beside(voxels: &[u32]) -> Vec<u64> {
    let mut mask = if voxels.is_empty() { Vec::new() } else { vec![0; WORDS] };
    for &voxel in voxels {
        around(voxel as usize, GAP, |beside| mask[beside / 64] |= 1 << (beside % 64));
    }
    mask
}

#[inline]
pub(super) fn voxel_of(point: [f64; 3]) -> Option<usize> {
    let mut index = 0;
    for value in point {
        let place = value / SIZE + 0.5 * EDGE as f64;
        if !(0.0..EDGE as f64).contains(&place) {
            return None; // NaN, too
        }
        index = index * EDGE + place as usize;
    }
    Some(index)
}

pub(super) fn center_of(voxel: usize) -> [f64; 3] {
    let place = [voxel / (EDGE * EDGE), voxel / EDGE % EDGE, voxel % EDGE];
    place.map(|index| (index as f64 + 0.5 - 0.5 * EDGE as f64) * SIZE)
}

/// Call `visit` for every voxel within `reach` of a voxel along every axis, including the voxel
/// itself.
pub(super) fn around(voxel: usize, reach: i32, mut visit: impl FnMut(usize)) {
    let place = [voxel / (EDGE * EDGE), voxel / EDGE % EDGE, voxel % EDGE];
    let span = |axis: usize| {
        let index = place[axis] as i32;
        (index - reach).max(0) as usize..=(index + reach).min(EDGE as i32 - 1) as usize
    };
    for x in span(0) {
        for y in span(1) {
            for z in span(2) {
                visit((x * EDGE + y) * EDGE + z);
            }
        }
    }
}

#[inline]
pub(super) fn has(mask: &[u64], voxel: usize) -> bool {
    mask[voxel / 64] >> (voxel % 64) & 1 == 1
}
