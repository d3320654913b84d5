//! Free length of a ray through the map, up to the first voxel that returns have shown to be
//! occupied.

use crate::flying::map::blocks::Cursor;
use crate::flying::map::voxel_map::VoxelMap;
use crate::geometry::lattice::floor;

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
        for step in 1..=steps {
            let along = 0.5 * size * step as f64;
            let place = std::array::from_fn(|axis| self.origin[axis] + along * direction[axis]);
            let Some(voxel) = floor(self.map.lattice().scaled(place)) else { return along };
            if self.cursor.is_tentative(voxel) {
                return along - size;
            }
        }
        reach
    }
}
