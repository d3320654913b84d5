//! Rule A: whether an occupied voxel is close to a point.

use crate::flying::map::blocks::{Block, Cursor, Place, offset_of};
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::track::Occupancy;
use crate::geometry::lattice::{Voxel, floor};
use crate::geometry::transform::minus;

/// Rule A for single points: whether the centre of a tentatively occupied voxel is closer than a
/// distance.
pub(crate) struct OccupiedNearby<'a> {
    cursor: Cursor<'a>,
    map: &'a VoxelMap,
    /// Square of the distance below which a voxel is close [m^2].
    limit: f64,
    half: i32,
}

impl<'a> OccupiedNearby<'a> {
    pub(crate) fn new(map: &'a VoxelMap, distance: f64) -> Self {
        // A centre that close lies at most this many voxels from the point's own.
        let half = (distance / map.lattice().voxel_size() + 0.5).floor() as i32;
        Self { cursor: Cursor::new(&map.blocks), map, limit: distance * distance, half }
    }

    /// Like `new`, but voxels at exactly `distance` [m] are close too.
    fn up_to(map: &'a VoxelMap, distance: f64) -> Self {
        let near = Self::new(map, distance);
        Self { limit: near.limit.next_up(), ..near }
    }

    pub(crate) fn is_close(&mut self, point: [f64; 3]) -> bool {
        let lattice = self.map.lattice();
        let Some(home) = floor(lattice.scaled(point)) else { return false };
        let limit = self.limit;
        let near = |voxel: Voxel| {
            let [x, y, z] = minus(lattice.center(voxel), point);
            x * x + y * y + z * z < limit
        };
        if self.cursor.is_tentative(home) && near(home) {
            return true; // the usual case on known background
        }
        for z in home[2] - self.half..=home[2] + self.half {
            for y in home[1] - self.half..=home[1] + self.half {
                let (mut x, end) = (home[0] - self.half, home[0] + self.half);
                while x <= end {
                    let wall = (x & !7) + 8;
                    if let Some(block) = self.cursor.block(Place::of([x, y, z])) {
                        let mut row = row_bits(block, [x, y, z]) >> (x & 7);
                        let mut at = x;
                        while row != 0 && at <= end {
                            if row & 1 == 1 && near([at, y, z]) {
                                return true;
                            }
                            row >>= 1;
                            at += 1;
                        }
                    }
                    x = wall;
                }
            }
        }
        false
    }
}

/// Tentatively occupied voxels in the row of `voxel` along x: one bit each.
fn row_bits(block: &Block, voxel: Voxel) -> u8 {
    let offset = offset_of(voxel);
    (block.tentative[offset >> 6] >> (offset & 0b11_1000)) as u8
}

impl Occupancy for VoxelMap {
    fn any_within(&self, point: [f64; 3], distance: f64) -> bool {
        OccupiedNearby::up_to(self, distance).is_close(point)
    }
}

/// True if the map contains `voxel` as free. Used to check poses.
pub(crate) fn is_observed_free(map: &VoxelMap, cursor: &mut Cursor<'_>, voxel: Voxel) -> bool {
    cursor
        .block(Place::of(voxel))
        .is_some_and(|block| block.value(offset_of(voxel)) < map.uncertain_from())
}
