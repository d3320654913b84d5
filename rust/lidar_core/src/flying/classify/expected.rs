//! Targets that tracks predict near structure.
//!
//! By rule A, everything close to an occupied voxel is background. But if a confirmed track
//! predicts its target there, a separate cluster in unoccupied voxels is that target.

use super::clusters::Cluster;
use crate::flying::map::blocks::Cursor;
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::track::{ExpectedTarget, Occupancy};
use crate::geometry::lattice::{floor, wide};
use crate::geometry::transform::{minus, norm};

/// Distance outside the box of a target within which points may belong to it [m]: a target may
/// brake in front of a wall.
const MARGIN: f64 = 0.25;
/// Smallest size that is assumed for a target [m].
const SMALLEST: f64 = 0.3;
/// Smallest share of a target's points in observed voxels that are not occupied; `STARTED`: the
/// same for a target that begins to move.
const MOSTLY: f64 = 0.5;
/// Smallest share of the points in unoccupied voxels, for a target that begins to move.
const STARTED: f64 = 0.25;
/// Largest ratio of a cluster's sides to the size of its target.
const LARGEST: f64 = 1.6;

/// A scan, with the targets that the search expects in it.
#[derive(Clone, Copy)]
pub(crate) struct ExpectedIn<'a> {
    /// Expected targets near structure. Other targets are found without this list.
    targets: &'a [ExpectedTarget],
    pub(crate) points: &'a [[f32; 3]],
    /// Time of every point after the stamp [s]. None: all are of the stamp.
    pub(crate) delays: Option<&'a [f32]>,
    map: &'a VoxelMap,
}

/// Those of the targets that are near structure, within the distance of rule A.
pub(crate) fn near_structure(
    mut targets: Vec<ExpectedTarget>,
    map: &VoxelMap,
    close_distance: f64,
) -> Vec<ExpectedTarget> {
    targets.retain(|target| {
        let reach = close_distance + norm(target.half) + map.lattice().voxel_size();
        map.any_within(target.position, reach)
    });
    targets
}

impl<'a> ExpectedIn<'a> {
    pub(crate) fn new(
        targets: &'a [ExpectedTarget],
        points: &'a [[f32; 3]],
        delays: Option<&'a [f32]>,
        map: &'a VoxelMap,
    ) -> Self {
        Self { targets, points, delays, map }
    }

    /// Indices of the points that may belong to a target: near its predicted position, and in
    /// unoccupied voxels or where the target itself has stood.
    pub(crate) fn rows(self) -> Vec<usize> {
        let mut cursor = Cursor::new(&self.map.blocks);
        let is_chosen = |&row: &usize| {
            let point = wide(self.points[row]);
            let mut near =
                self.targets.iter().filter(|target| self.holds(target, point, row, MARGIN));
            near.any(|target| is_own_place(target, point) || self.is_clear(&mut cursor, point))
        };
        if self.targets.is_empty() {
            return Vec::new();
        }
        (0..self.points.len()).filter(is_chosen).collect()
    }

    /// Index of the cluster of every target that has one: the cluster with most points among those
    /// that may be the target and for which `is_allowed` is true.
    pub(crate) fn clusters<'c>(
        self,
        clusters: impl Iterator<Item = (usize, Cluster<'c>)> + Clone,
        is_allowed: impl Fn(usize, &Cluster<'_>) -> bool,
    ) -> Vec<usize> {
        let best = |target: &ExpectedTarget| {
            let own = clusters.clone().filter(|(index, cluster)| {
                self.may_be(target, cluster) && is_allowed(*index, cluster)
            });
            own.max_by_key(|(index, cluster)| (cluster.members.len(), usize::MAX - index))
        };
        let mut found: Vec<usize> =
            self.targets.iter().filter_map(best).map(|(index, _)| index).collect();
        found.sort_unstable();
        found.dedup();
        found
    }

    fn may_be(self, target: &ExpectedTarget, cluster: &Cluster<'_>) -> bool {
        let Some(&row) = cluster.members.first() else { return false };
        let largest = LARGEST * target.size.into_iter().fold(SMALLEST, f64::max);
        // Only the near side of a target is seen, so the centroid of its points is not its centre.
        let is_near = self.holds(target, cluster.centroid, row as usize, MARGIN);
        if !is_near || cluster.extent().iter().any(|&side| side > largest) {
            return false;
        }
        let mut cursor = Cursor::new(&self.map.blocks);
        let is_clear = |row: &&u32| self.is_clear(&mut cursor, wide(self.points[**row as usize]));
        // What has stood leaves its own place by and by, and the map takes its new place for structure, too, if
        // it is not known as soon as it moves.
        let least = if target.has_stood { STARTED } else { MOSTLY };
        cluster.members.iter().filter(is_clear).count() as f64
            > least * cluster.members.len() as f64
    }

    /// True if `place` is inside the box of a target at the time of the point `row`, enlarged by
    /// `margin` [m].
    fn holds(self, target: &ExpectedTarget, place: [f64; 3], row: usize, margin: f64) -> bool {
        let delay = self.delays.map_or(0.0, |delays| f64::from(delays[row]));
        (0..3).all(|axis| {
            let offset = place[axis] - target.position[axis] - delay * target.velocity[axis];
            offset.abs() <= target.half[axis] + margin // false for NaN
        })
    }

    /// True if the voxel of `place` was observed and is not occupied.
    fn is_clear(self, cursor: &mut Cursor<'_>, place: [f64; 3]) -> bool {
        floor(self.map.lattice().scaled(place))
            .is_some_and(|voxel| !cursor.stored(voxel).is_nan() && !cursor.is_tentative(voxel))
    }
}

/// True if `place` is where a target has stood, or may have gone to. The occupied voxels there are
/// then the target itself.
fn is_own_place(target: &ExpectedTarget, place: [f64; 3]) -> bool {
    let away = minus(place, target.position);
    target.has_stood && (0..3).all(|axis| away[axis].abs() <= target.half[axis])
}
