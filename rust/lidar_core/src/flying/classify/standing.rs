//! Whether a thing that stands still during the burn-in is in the air.
//!
//! Rule B asks for free voxels on every way out. Before the sky, the directions next to returns are not trusted, so a
//! few voxels beside a target that hovers there are never shown to be free, and rule B finds a way out through them.
//! Such a target would be background until it has moved away. What is found here is watched with an unknown kind until
//! it moves, so a few unknown voxels around it are accepted.

use super::classifier::ClusterRules;
use super::clusters::Cluster;
use super::may_fly::{is_alone, may_fly};
use super::shadow::Shadow;
use crate::flying::map::blocks::Cursor;
use crate::flying::scan::prepared::Prepared;
use crate::geometry::lattice::{Voxel, floor, wide};

/// Distance around the box of a thing up to which the space is examined [m], in at least two steps.
const AROUND: f64 = 0.75;
/// Smallest share of free voxels there. Those that the thing itself hides from the sensor do not count.
const LEAST_FREE: f64 = 0.9;

/// True if nothing is around a cluster of the size of a target: no other point within 2 m of its centre, no occupied
/// voxel within 0.75 m of its box except beside its own voxels, and nearly all space there that it does not hide is free.
pub(super) fn is_in_air(rules: &ClusterRules<'_>, scan: &Prepared, cluster: &Cluster<'_>) -> bool {
    let ClusterRules { map, points, parameters, .. } = *rules;
    if cluster.members.len() < parameters.min_points
        || rules.is_gated(cluster, cluster.diagonal())
        || !may_fly(map, scan, cluster)
        || !is_alone(points, cluster)
    {
        return false;
    }
    let lattice = map.lattice();
    let own: Vec<[f64; 3]> =
        cluster.members.iter().map(|&row| wide(points[row as usize])).collect();
    let Some([low, high]) = box_of(own.iter().filter_map(|&at| floor(lattice.scaled(at)))) else {
        return false;
    };
    let shadow = Shadow::of(&own, rules.origin, lattice);
    let steps = (AROUND / lattice.voxel_size()).ceil().max(2.0) as i32;
    let (mut cursor, bound) = (Cursor::new(&map.blocks), map.uncertain_from());
    let (mut n_free, mut n_all) = (0_u32, 0_u32);
    let side = |axis: usize| low[axis].saturating_sub(steps)..=high[axis].saturating_add(steps);
    for voxel in side(0).flat_map(|x| side(1).flat_map(move |y| side(2).map(move |z| [x, y, z]))) {
        let away = |axis: usize| (low[axis] - voxel[axis]).max(voxel[axis] - high[axis]).max(0);
        let steps_away = (0..3).map(away).max().unwrap_or(0);
        if steps_away <= 1 && cursor.is_tentative(voxel) {
            continue; // its own points of other scans
        }
        if cursor.is_tentative(voxel) {
            return false;
        }
        let is_free = map.known(cursor.stored(voxel)) < bound;
        if steps_away > 0 && (is_free || !shadow.hides(voxel)) {
            n_all += 1;
            n_free += u32::from(is_free);
        }
    }
    n_all > 0 && f64::from(n_free) >= LEAST_FREE * f64::from(n_all)
}

/// Smallest and largest indices of voxels. None without voxels.
fn box_of(voxels: impl Iterator<Item = Voxel>) -> Option<[Voxel; 2]> {
    voxels.fold(None, |bounds, voxel| {
        let [low, high] = bounds.unwrap_or([voxel; 2]);
        let each =
            |of: fn(i32, i32) -> i32, one: Voxel| [0, 1, 2].map(|axis| of(one[axis], voxel[axis]));
        Some([each(i32::min, low), each(i32::max, high)])
    })
}
