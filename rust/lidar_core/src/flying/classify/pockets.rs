//! Pockets: enclosed uncertain voxels around flying objects.

use super::classifier::Classification;
use super::flood::distinct;
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::point_class::PointClass;
use crate::geometry::lattice::{floor, wide};

/// Make the uncertain voxels around flying clusters free, except those that contain `points`.
pub(crate) fn free_pockets(
    map: &mut VoxelMap,
    classifications: &[Classification],
    points: &[[f32; 3]],
) {
    let lattice = *map.lattice();
    let place = |&point: &[f32; 3]| floor(lattice.scaled(wide(point)));
    let with_points = distinct(points.iter().filter_map(place).collect());
    let below = map.uncertain_from().next_down();
    let flying =
        classifications.iter().filter(|classification| classification.class == PointClass::Flying);
    for &voxel in flying.flat_map(|classification| &classification.explored) {
        if with_points.binary_search(&voxel).is_err() {
            map.rewrite(voxel, |value| value.min(below)); // NaN: never observed
        }
    }
}
