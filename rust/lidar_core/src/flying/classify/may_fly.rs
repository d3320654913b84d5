//! Properties of a cluster that exclude flight: its position relative to the robot, the ground and
//! mirror images.

use super::clusters::Cluster;
use super::occupied_nearby::OccupiedNearby;
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::scan::prepared::Prepared;
use crate::flying::sky::ON_GROUND;
use crate::geometry::lattice::wide;
use crate::geometry::transform::{minus, norm};

/// Height up to which objects count as patches of ground, if they are as low as the lowest returns
/// [m].
const FLAT: f64 = 0.1;
/// Points within this distance of the centre of a cluster may belong to the same target [m].
const OWN_RADIUS: f64 = 0.75;
/// A cluster is alone if no points of other objects are within this distance of its centre [m].
const ALONE_RADIUS: f64 = 2.0;
/// Largest distance of a mirror image from the mirrored position of its object [m]. The floor is
/// not quite flat.
const MIRROR_ERROR: f64 = 0.75;

/// True if no point is beside a cluster, except points that may belong to the same target.
pub(super) fn is_alone(points: &[[f32; 3]], cluster: &Cluster<'_>) -> bool {
    let is_beside = |(row, point): (usize, &[f32; 3])| {
        let distance = norm(minus(wide(*point), cluster.centroid));
        distance > OWN_RADIUS
            && distance <= ALONE_RADIUS
            && !cluster.members.iter().any(|&member| member as usize == row)
    };
    !points.iter().enumerate().any(is_beside)
}

/// False if a cluster may be a part of the robot, stands on the ground or is a reflection, or if
/// the map has no background yet.
pub(crate) fn may_fly(map: &VoxelMap, scan: &Prepared, cluster: &Cluster<'_>) -> bool {
    let is_own = |row: &&u32| scan.maybe_own.get(**row as usize).copied().unwrap_or(false);
    let may_be_own = || 2 * cluster.members.iter().filter(is_own).count() > cluster.members.len();
    let is_flat = cluster.extent()[2] < FLAT && cluster.low[2] < scan.low;
    let is_at_floor = scan.floor.is_some_and(|floor| (cluster.low[2] - floor).abs() < ON_GROUND);
    let is_on_ground = is_flat || is_at_floor || cluster.low[2] < scan.ground;
    !may_be_own()
        && !is_on_ground
        && map.has_background()
        && !is_mirrored(map, scan, cluster.centroid)
}

/// True if a place is below flat ground, and its mirror image above is occupied: points there are
/// reflections.
fn is_mirrored(map: &VoxelMap, scan: &Prepared, [x, y, z]: [f64; 3]) -> bool {
    scan.floor.filter(|floor| z < floor - ON_GROUND).is_some_and(|floor| {
        OccupiedNearby::new(map, MIRROR_ERROR).is_close([x, y, 2.0 * floor - z])
    })
}
