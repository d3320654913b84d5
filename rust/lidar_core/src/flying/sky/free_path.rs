//! Free length of a ray through the map, up to the first voxel that returns have shown to be
//! occupied.

use crate::flying::map::block_shape::{EDGE, has};
use crate::flying::map::blocks::{Cursor, Place, offset_of};
use crate::flying::map::voxel_map::VoxelMap;
use crate::geometry::lattice::{Voxel, floor};
use std::ops::Range;

/// Rays from one point through the map, which end before occupied voxels.
pub(super) struct FreePath<'a> {
    map: &'a VoxelMap,
    cursor: Cursor<'a>,
    origin: [f64; 3],
}

impl<'a> FreePath<'a> {
    pub(super) fn through(map: &'a VoxelMap, origin: [f64; 3]) -> Self {
        Self { map, cursor: Cursor::new(&map.blocks), origin }
    }

    /// Length along a direction without tentatively or confidently occupied voxels, at most `reach`
    /// [m].
    pub(super) fn length(&mut self, direction: [f64; 3], reach: f64) -> f64 {
        let size = self.map.lattice().voxel_size();
        let steps = (2.0 * reach / size) as usize;
        let mut step = 1;
        while step <= steps {
            let along = 0.5 * size * step as f64;
            let Some(voxel) = self.voxel_after(step, direction) else { return along };
            let place = Place::of(voxel);
            match self.cursor.block(place) {
                Some(block) if has(&block.tentative, offset_of(voxel)) => return along - size,
                Some(block) if block.has_tentative() => step += 1,
                _ => step = self.last_step_in(place, step..steps, direction) + 1,
            }
        }
        reach
    }

    /// The voxel after a number of steps of half a voxel. None if it is too far away.
    fn voxel_after(&self, step: usize, direction: [f64; 3]) -> Option<Voxel> {
        let lattice = self.map.lattice();
        let along = 0.5 * lattice.voxel_size() * step as f64;
        let place = std::array::from_fn(|axis| self.origin[axis] + along * direction[axis]);
        floor(lattice.scaled(place))
    }

    /// The last of the steps whose place is in a block, or one before it. The first one is in the block.
    fn last_step_in(&self, block: Place, steps: Range<usize>, direction: [f64; 3]) -> usize {
        let lattice = self.map.lattice();
        let size = lattice.voxel_size();
        let (edge, origin) = (f64::from(EDGE) * size, lattice.origin());
        let leaves = |axis: usize| {
            let index = f64::from(block.0[axis]) + f64::from(u8::from(direction[axis] >= 0.0));
            (index * edge + origin[axis] - self.origin[axis]) / direction[axis]
        };
        let length = (0..3).map(leaves).fold(f64::INFINITY, f64::min);
        // Coordinates along a ray never turn back. So all places between two in the block are in it too.
        let mut last = ((2.0 * length / size) as usize).clamp(steps.start, steps.end);
        let is_in = |step| self.voxel_after(step, direction).map(Place::of) == Some(block);
        while last > steps.start && !is_in(last) {
            last -= 1;
        }
        last
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::flying::map::parameters::MapParameters;
    use crate::flying::map::parameters::tests::parameters;

    /// The same length, with every step taken.
    fn slow_length(map: &VoxelMap, from: [f64; 3], direction: [f64; 3], reach: f64) -> f64 {
        let size = map.lattice().voxel_size();
        let mut cursor = Cursor::new(&map.blocks);
        for step in 1..=(2.0 * reach / size) as usize {
            let along = 0.5 * size * step as f64;
            let place = std::array::from_fn(|axis| from[axis] + along * direction[axis]);
            let Some(voxel) = floor(map.lattice().scaled(place)) else { return along };
            if cursor.is_tentative(voxel) {
                return along - size;
            }
        }
        reach
    }

    #[test]
    fn steps_that_are_left_out_change_no_bit() -> Result<(), Error> {
        let mut seed = 7u64;
        let mut random = || {
            seed = seed
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        for voxel_size in [0.25, 0.3, 0.07] {
            let mut map = VoxelMap::new(MapParameters { voxel_size, ..parameters() })?;
            let occupied: Vec<[f32; 3]> = (0..60)
                .map(|_| [0; 3].map(|_: i32| (160.0 * voxel_size * random()) as f32))
                .collect();
            map.set_occupied(&occupied)?;
            let (mut ended, mut jumped) = (0, 0);
            for ray in 0..4000 {
                let from = [0; 3].map(|_: i32| 100.0 * voxel_size * random());
                let target = occupied[ray % occupied.len()].map(f64::from);
                let way: [f64; 3] = match ray % 4 {
                    0 => [0; 3].map(|_: i32| random()),
                    1 => [0.0, if ray % 8 == 1 { 1.0 } else { -1.0 }, 0.0],
                    2 => [random(), 0.0, -random()],
                    _ => std::array::from_fn(|axis| target[axis] - from[axis]),
                };
                let length = way.map(|part| part * part).iter().sum::<f64>().sqrt();
                let direction = way.map(|part| part / length);
                let reach = 200.0 * voxel_size;
                let mut path = FreePath::through(&map, from);
                let free = path.length(direction, reach);
                assert_eq!(free.to_bits(), slow_length(&map, from, direction, reach).to_bits());
                ended += usize::from(free < reach);
                jumped += usize::from(free == reach);
            }
            assert!(ended > 500 && jumped > 500, "{ended} {jumped}");
        }
        Ok(())
    }
}
