//! What is around a cluster that seems to fly: surfaces, of which it may be a part, or nothing.

use crate::flying::classify::clusters::Cluster;
use crate::flying::scan::prepared::Prepared;
use crate::geometry::lattice::wide;
use crate::geometry::transform::minus;

/// Parts of a surface of which most returns are lost lie this near to the rest of it [m].
const NEAR: f64 = 1.5;

/// True if more returns of surfaces lie around a cluster than it has itself. `is_flying` tells of every
/// row of the scan whether it is of something that seems to fly: that is no surface.
pub(crate) fn is_among_surfaces(
    scan: &Prepared,
    cluster: &Cluster<'_>,
    is_flying: &[bool],
) -> bool {
    let reach = NEAR + 0.5 * cluster.diagonal();
    let is_near = |point: [f32; 3]| {
        let offset = minus(wide(point), cluster.centroid);
        offset.iter().map(|part| part * part).sum::<f64>() <= reach * reach
    };
    let around = (scan.points.iter().zip(is_flying))
        .filter(|&(&point, &is_flying)| !is_flying && is_near(point));
    around.take(cluster.members.len() + 1).count() > cluster.members.len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flying::classify::clusters::Clusters;

    /// Three returns of a target at a distance from a wall of ten, all or none of which fly.
    fn among(distance: f32, wall_flies: bool) -> bool {
        let target = (0..3).map(|step| [10.0, 0.1 * step as f32, 2.0]);
        let wall = (0..10).map(|step| [10.0 + distance, 0.1 * step as f32, 2.0]);
        let mut scan = Prepared::default();
        scan.points = target.chain(wall).collect();
        let labels: Vec<i32> = (0..13).map(|row| if row < 3 { 0 } else { -1 }).collect();
        let mut clusters = Clusters::default();
        clusters.fill(&scan.points, &labels);
        let is_flying: Vec<bool> = (0..13).map(|row| row < 3 || wall_flies).collect();
        is_among_surfaces(&scan, &clusters.get(0), &is_flying)
    }

    #[test]
    fn a_wall_beside_a_cluster_counts_and_one_far_away_does_not() {
        assert!(among(1.2, false));
        assert!(!among(2.0, false));
        assert!(!among(1.2, true), "what flies is no surface");
    }
}
