//! Surroundings of a cluster that seems to fly: surfaces to which it may belong, and whether the
//! space below it was seen.

use super::hole::View;
use crate::flying::classify::clusters::Cluster;
use crate::flying::scan::prepared::Prepared;
use crate::geometry::lattice::wide;
use crate::geometry::transform::minus;

/// Distance within which parts of a surface that returns few rays are near the rest of it [m].
const NEAR: f64 = 1.5;
/// Size of the region below a cluster in which rays are expected: this far below it, and `BESIDE`
/// to both sides [m].
const BELOW: f64 = 0.4;
/// Width by which the region below a cluster is wider than the cluster, on both sides [m].
const BESIDE: f64 = 0.1;
/// Rays below a cluster are lost if at least this number is cast there, and at most the share
/// `LOST` of them returns.
const FEWEST_CAST: f64 = 4.0;
/// Largest share of the rays below a cluster that returns, if they count as lost.
const LOST: f64 = 0.15;
/// Tangents of two angles below a cluster. At one of them rays must be cast too, or else the field
/// of view ends below the cluster; its last cells of 2 degrees are only partly inside. There are
/// two angles (3 and 5 degrees) because rows may be 2 degrees apart.
const FURTHER_DOWN: [f64; 2] = [0.0524, 0.0875];

/// Largest distance between two rows of a sparse sensor on one target [m]. `SAME_RANGE`: returns
/// whose range differs by less belong to the target [m].
const NEXT_ROW: f64 = 0.5;
/// Largest difference in range of returns of one target [m].
const SAME_RANGE: f64 = 0.5;
/// Rays pass below a cluster if they return at least this much further away, and `JUST_BELOW` below
/// its end [m].
const BEHIND: f64 = 1.0;
/// Distance below the end of a cluster from which on a ray passes below it [m].
const JUST_BELOW: f64 = 0.1;
/// Smallest number of rays that must pass below a cluster. A single ray may pass between the legs
/// of a person.
const FEWEST_PASSING: usize = 2;

/// Returns are in front of a cluster if they are nearer by at least this [m].
const IN_FRONT: f64 = 1.0;
/// Depth below the cluster in which objects in front of it are searched for [m]. At 10 m this depth
/// contains two rows of a sensor with rows 2 degrees apart.
const SEEN_BELOW: f64 = 0.8;
/// An object is upright if some of its returns differ in height by at least this [m], and by at
/// least the difference of their horizontal distances. The ground in front of a cluster is not
/// upright, even if it rises towards the cluster.
const UPRIGHT: f64 = 0.05;

/// True if a cluster has more returns of surfaces around it than returns of its own. `is_flying`:
/// for every point of the scan, whether it belongs to an object that seems to fly and is therefore
/// no surface.
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

/// True if rays are cast below a cluster, or below the returns that continue it downwards, and
/// hardly any of them returns: wet or dark ground, or fog, absorbs them. Then no return shows
/// whether the cluster stands on something. False if the field of view ends below it, or if the sky
/// is not estimated.
pub(crate) fn are_rays_lost_below(scan: &Prepared, cluster: &Cluster<'_>) -> bool {
    let sky = scan.sky_observation.as_ref();
    sky.is_some_and(|sky| are_lost_below(scan, cluster, |direction| sky.density_at(direction)))
}

/// True if returns continue the cluster downwards at its range, and rays pass below the lowest of
/// these returns: the next row of a sparse sensor has met the same target. An object that stands on
/// the ground continues down to the ground.
pub(crate) fn is_free_below_rest(scan: &Prepared, cluster: &Cluster<'_>) -> bool {
    let Some(edge) = LowerEdge::of(scan, cluster) else { return false };
    let below: Vec<ReturnBelow> = edge.below(scan).collect();
    let end = edge.end_of_rest(&below);
    let passes = |one: &&ReturnBelow| {
        one.further > BEHIND && (end - NEXT_ROW..end - JUST_BELOW).contains(&one.up)
    };
    end < edge.low && below.iter().filter(passes).count() >= FEWEST_PASSING
}

/// True if an upright object in front of a cluster hides the space below it: a screen, the side of
/// a table or a car.
pub(crate) fn is_hidden_below(scan: &Prepared, cluster: &Cluster<'_>) -> bool {
    let Some(edge) = LowerEdge::of(scan, cluster) else { return false };
    let below: Vec<ReturnBelow> =
        edge.below(scan).filter(|one| one.up >= edge.low - SEEN_BELOW).collect();
    let in_front = || below.iter().filter(|one| one.further < -IN_FRONT);
    let highest = in_front().max_by(|one, other| one.up.total_cmp(&other.up));
    let Some(top) = highest.filter(|_| 2 * in_front().count() > below.len()) else {
        return false;
    };
    let level = |one: &ReturnBelow| libm::hypot(one.way[0], one.way[1]);
    let is_upright = |one: &ReturnBelow| {
        let height = top.way[2] - one.way[2];
        height >= UPRIGHT && height >= (level(top) - level(one)).abs()
    };
    in_front().any(is_upright)
}

/// True if rays are lost below a cluster. `density`: rays per steradian that are cast in a
/// direction.
fn are_lost_below(
    scan: &Prepared,
    cluster: &Cluster<'_>,
    density: impl Fn([f64; 3]) -> f64,
) -> bool {
    let Some(edge) = LowerEdge::of(scan, cluster) else { return false };
    let below: Vec<ReturnBelow> = edge.below(scan).collect();
    // A sparse sensor often takes two rows that met one target for two things: rays are lost below the lower one.
    let low = edge.end_of_rest(&below);
    let LowerEdge { view, left, right, .. } = &edge;
    let density_below =
        |down: f64| density(view.direction([0.5 * (left + right), low - 0.5 * BELOW - down]));
    let cast = density_below(0.0) * BELOW * (right - left) / (view.range * view.range);
    let mut further_down = FURTHER_DOWN.iter().map(|tangent| tangent * view.range);
    if cast < FEWEST_CAST || !further_down.any(|down| density_below(down) > 0.0) {
        return false;
    }
    let returns = below.iter().filter(|one| (low - BELOW..low).contains(&one.up)).count();
    (returns as f64) < LOST * cast
}

/// The lower edge of a cluster, in the plane through the cluster across the line of sight [m].
pub(super) struct LowerEdge {
    pub(super) view: View,
    /// Left and right end of the region below the cluster, somewhat wider than the cluster [m].
    pub(super) left: f64,
    pub(super) right: f64,
    low: f64,
}

/// A return that is seen below a cluster.
pub(super) struct ReturnBelow {
    /// Height in the plane through the cluster across the line of sight [m].
    pub(super) up: f64,
    /// Difference of its range to that of the cluster, positive if it is further away [m].
    pub(super) further: f64,
    /// Vector from the sensor to the return [m].
    pub(super) way: [f64; 3],
}

impl LowerEdge {
    pub(super) fn of(scan: &Prepared, cluster: &Cluster<'_>) -> Option<Self> {
        let view = View::of(scan, cluster)?;
        let (mut left, mut right, mut low) = (f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY);
        let place = |&row: &u32| view.seen(wide(scan.points[row as usize]));
        for ([aside, up], _) in cluster.members.iter().filter_map(place) {
            (left, right, low) = (left.min(aside), right.max(aside), low.min(up));
        }
        Some(Self { view, left: left - BESIDE, right: right + BESIDE, low })
    }

    /// Height of the lowest of the returns `below` that continue the cluster downwards at its
    /// range, row by row. Height of its own lower end if there are none.
    pub(super) fn end_of_rest(&self, below: &[ReturnBelow]) -> f64 {
        let is_beside = |one: &&ReturnBelow| one.further.abs() < SAME_RANGE;
        let mut heights: Vec<f64> = below.iter().filter(is_beside).map(|one| one.up).collect();
        heights.sort_unstable_by(|one, other| other.total_cmp(one));
        let next = |end: f64, up: f64| if end - up <= NEXT_ROW { up } else { end };
        heights.into_iter().fold(self.low, next)
    }

    /// The returns of the scan below the cluster, between its left and right end.
    pub(super) fn below<'a>(
        &'a self,
        scan: &'a Prepared,
    ) -> impl Iterator<Item = ReturnBelow> + 'a {
        scan.points.iter().filter_map(|&point| {
            let ([aside, up], further) = self.view.seen(wide(point))?;
            let is_below = (self.left..self.right).contains(&aside) && up < self.low;
            is_below.then(|| ReturnBelow { up, further, way: self.view.way(wide(point)) })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flying::classify::clusters::Clusters;

    /// Result for a target of three returns at a distance from a wall of ten. `wall_flies`: whether
    /// the wall seems to fly.
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

    /// Result for a target of 5 x 5 returns, 10 m away. `ground_returns`: whether rays below it end
    /// on the ground.
    fn lost_below(ground_returns: bool, cast: impl Fn([f64; 3]) -> f64) -> bool {
        let target =
            (0..25).map(|row| [10.0, 0.1 * (row % 5) as f32, 1.0 + 0.1 * (row / 5) as f32]);
        let ground =
            (0..15).map(|row| [9.0, 0.09 * (row % 5) as f32, 0.6 + 0.09 * (row / 5) as f32]);
        let mut scan = Prepared::default();
        scan.points = target.chain(ground.filter(|_| ground_returns)).collect();
        let labels: Vec<i32> = (0..40).map(|row| if row < 25 { 0 } else { -1 }).collect();
        let mut clusters = Clusters::default();
        clusters.fill(&scan.points, &labels[..scan.points.len()]);
        are_lost_below(&scan, &clusters.get(0), cast)
    }

    /// Result for a row of returns 10 m away. `rows`: heights of the rows below it, and their
    /// ranges [m].
    fn free_below_rest(rows: &[(f32, f32)]) -> bool {
        let row = |up: f32, range: f32| {
            (0..5).map(move |step| [range, 0.02 * step as f32 * range, 0.1 * up * range])
        };
        let mut scan = Prepared::default();
        scan.points = row(0.0, 10.0).collect();
        scan.points.extend(rows.iter().flat_map(|&(up, range)| row(up, range)));
        let labels: Vec<i32> =
            (0..scan.points.len() as i32).map(|row| if row < 5 { 0 } else { -1 }).collect();
        let mut clusters = Clusters::default();
        clusters.fill(&scan.points, &labels);
        is_free_below_rest(&scan, &clusters.get(0))
    }

    #[test]
    fn a_target_of_two_rows_is_free_below_and_what_stands_is_not() {
        assert!(free_below_rest(&[(-0.35, 10.1), (-0.7, 16.0)]));
        // Nothing below it is of it, the ground follows, nothing follows, or the next part is far below.
        assert!(!free_below_rest(&[(-0.35, 16.0), (-0.7, 16.0)]));
        assert!(!free_below_rest(&[(-0.35, 10.1), (-0.7, 10.0), (-1.05, 9.0), (-1.4, 7.0)]));
        assert!(!free_below_rest(&[(-0.35, 10.1)]));
        assert!(!free_below_rest(&[(-0.7, 10.1), (-1.05, 16.0)]));
    }

    /// Result for a target 6 m away, `height` [m] above the sensor. `returns`: heights above the
    /// sensor and distances of the returns below it [m].
    fn hidden_below(height: f32, returns: &[(f32, f32)]) -> bool {
        let row =
            |up: f32, away: f32| (0..5).map(move |step| [away, 0.02 * step as f32 * away, up]);
        let mut scan = Prepared::default();
        scan.points = row(height, 6.0).collect();
        scan.points.extend(returns.iter().flat_map(|&(up, away)| row(up, away)));
        let labels: Vec<i32> =
            (0..scan.points.len() as i32).map(|row| if row < 5 { 0 } else { -1 }).collect();
        let mut clusters = Clusters::default();
        clusters.fill(&scan.points, &labels);
        is_hidden_below(&scan, &clusters.get(0))
    }

    #[test]
    fn what_stands_in_front_hides_the_space_below_and_ground_does_not() {
        // A screen 2 m away, above the sensor and below it.
        assert!(hidden_below(0.7, &[(0.15, 2.0), (0.08, 2.0)]));
        assert!(hidden_below(-0.2, &[(-0.09, 2.0), (-0.14, 2.0), (-0.2, 2.0)]));
        // More than half of what is below must be in front, by more than 1 m.
        assert!(!hidden_below(0.7, &[(0.15, 2.0), (0.08, 2.0), (0.6, 9.0), (0.5, 9.0)]));
        assert!(!hidden_below(0.7, &[(0.5, 5.1), (0.4, 5.1)]));
        // Ground that rises by 10 degrees towards a person above the sensor.
        assert!(!hidden_below(0.6, &[(0.42, 5.0), (0.25, 4.0), (0.07, 3.0)]));
        // The ground in front of a person: as high in all rows, nearer in each.
        assert!(!hidden_below(-1.2, &[(-1.3, 5.5), (-1.3, 5.2), (-1.3, 4.9)]));
        assert!(!hidden_below(-1.2, &[(-1.3, 4.8)]));
        // The surface behind, or parts of the target itself, hide nothing; nor does nothing.
        assert!(!hidden_below(0.7, &[(0.8, 9.0), (0.7, 9.0)]));
        assert!(!hidden_below(0.7, &[(0.5, 6.0), (0.4, 6.1)]));
        assert!(!hidden_below(0.7, &[]));
        // What is far below the target in the scan does not, either.
        assert!(!hidden_below(2.0, &[(0.1, 2.0), (0.0, 2.0)]));
    }

    #[test]
    fn rays_are_lost_below_where_they_are_cast_and_do_not_return() {
        assert!(lost_below(false, |_| 1e4));
        assert!(!lost_below(true, |_| 1e4), "the ground in front of it returns them");
        assert!(!lost_below(false, |_| 0.0), "the field of view ends");
    }

    #[test]
    fn rays_are_lost_below_the_rest_of_what_is_there() {
        let row = |up: f32, away: f32| (0..5).map(move |step| [away, 0.1 * step as f32, up]);
        let is_lost = |below: &[(f32, f32)]| {
            let mut scan = Prepared::default();
            scan.points = row(1.0, 10.0).collect();
            scan.points.extend(below.iter().flat_map(|&(up, away)| row(up, away)));
            let labels: Vec<i32> =
                (0..scan.points.len() as i32).map(|at| if at < 5 { 0 } else { -1 }).collect();
            let mut clusters = Clusters::default();
            clusters.fill(&scan.points, &labels);
            are_lost_below(&scan, &clusters.get(0), |_| 1e4)
        };
        // A second row on the same target, and nothing below it.
        assert!(is_lost(&[(0.65, 10.1)]));
        // The ground follows, nearer or further away; or what is there is no part of the target.
        assert!(!is_lost(&[(0.65, 10.1), (0.5, 9.0), (0.4, 8.5)]));
        assert!(!is_lost(&[(0.65, 10.1), (0.55, 16.0), (0.45, 16.0)]));
        assert!(!is_lost(&[(1.1, 14.0)]));
    }

    #[test]
    fn at_the_edge_of_the_field_of_view_no_ray_is_lost() {
        // The lowest return is at an elevation of 5.7 degrees, the middle of what is below at 4.6.
        let elevation =
            |way: [f64; 3]| libm::atan2(way[2], libm::hypot(way[0], way[1])).to_degrees();
        let down_to =
            |degrees: f64| move |way: [f64; 3]| if elevation(way) > degrees { 1e4 } else { 0.0 };
        assert!(!lost_below(false, down_to(4.0)), "only the rest of a cell is in it");
        assert!(lost_below(false, down_to(-1.0)));
        // Rows lie 2 degrees apart: one of two cells below has none.
        let in_rows = |way: [f64; 3]| {
            if (elevation(way) / 2.0).floor() as i32 % 2 == 0 { 1e4 } else { 0.0 }
        };
        assert!(lost_below(false, in_rows));
    }
}
