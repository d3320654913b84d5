//! Targets just above the ground, as a sparse sensor sees them.
//!
//! Where the next row below a target meets the ground in front of it, no ray passes between the target and the
//! ground. Nearly all such targets stand on the ground: riders, people, cars.

use super::surroundings::{LowerEdge, ReturnBelow};
use crate::flying::classify::clusters::Cluster;
use crate::flying::scan::prepared::Prepared;
use crate::geometry::lattice::wide;

/// Smallest distance of the ground returns in front of a target and behind it from the target [m].
const APART: f64 = 1.0;
/// Returns less than this below the lower end of a target are of its own row, and returns that are closer in height
/// are of one row [m].
const ROW: f64 = 0.1;
/// Width on both sides of a target in which its lowest row may meet the ground behind [m].
const ASIDE: f64 = 1.0;
/// Steepest slope of the ground from the returns in front to those behind.
const STEEPEST: f64 = 0.05;
/// Smallest number of ground returns in front, and behind.
const FEWEST: usize = 2;

/// True if the next row below a cluster meets the ground in front of it, and its own lowest row meets the same ground
/// behind, on one of its sides.
pub(super) fn is_just_above_ground(scan: &Prepared, cluster: &Cluster<'_>) -> bool {
    let Some(edge) = LowerEdge::of(scan, cluster) else { return false };
    let below: Vec<ReturnBelow> = edge.below(scan).collect();
    let end = edge.end_of_rest(&below);
    let next = below.iter().map(|one| one.up).filter(|&up| up < end - ROW);
    let next = next.fold(f64::NEG_INFINITY, f64::max);
    let row = || below.iter().filter(|one| (next - ROW..=next).contains(&one.up));
    // Tables in front and walls behind lie along the rays, too.
    let is_low = |height: f64| scan.pose.translation[2] + height < scan.low;
    let front = row().filter(|one| one.further < -APART).map(place);
    let front: Vec<[f64; 2]> = front.filter(|&[_, up]| is_low(up)).collect();
    if front.len() < FEWEST.max(row().count() / 2 + 1) {
        return false;
    }
    let [distance, height] = mean(&front);
    let is_ground =
        |[far, up]: [f64; 2]| is_low(up) && (up - height).abs() <= STEEPEST * (far - distance);
    let behind: Vec<[f64; 2]> = beside(scan, &edge, end).collect();
    let n_ground = behind.iter().filter(|&&one| is_ground(one)).count();
    n_ground >= FEWEST && 2 * n_ground > behind.len()
}

/// Places behind a target, on both sides of it, where its lowest row ends. `end`: height of the row, as in
/// [`ReturnBelow::up`].
fn beside<'a>(
    scan: &'a Prepared,
    edge: &'a LowerEdge,
    end: f64,
) -> impl Iterator<Item = [f64; 2]> + 'a {
    scan.points.iter().filter_map(move |&point| {
        let ([aside, up], further) = edge.view.seen(wide(point))?;
        let is_beside = (edge.left - ASIDE..edge.left).contains(&aside)
            || (edge.right..edge.right + ASIDE).contains(&aside);
        let is_behind = is_beside && (up - end).abs() <= ROW && further > APART;
        is_behind.then(|| place(&ReturnBelow { up, further, way: edge.view.way(wide(point)) }))
    })
}

/// Horizontal distance of a return from the sensor, and its height above the sensor [m].
fn place(one: &ReturnBelow) -> [f64; 2] {
    [libm::hypot(one.way[0], one.way[1]), one.way[2]]
}

fn mean(places: &[[f64; 2]]) -> [f64; 2] {
    let count = places.len() as f64;
    [0, 1].map(|axis| places.iter().map(|place| place[axis]).sum::<f64>() / count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flying::classify::clusters::Clusters;

    /// Result for a target 15 m away whose lowest row is at the height -1.7 m. `rows`: distances, heights and places
    /// aside of other rows [m].
    fn is_just_above(rows: &[(f32, f32, f32)]) -> bool {
        let row = |(away, up, aside): (f32, f32, f32)| {
            (0..5).map(move |step| [away, (aside + 0.1 * step as f32) * away / 15.0, up])
        };
        let mut scan = Prepared::default();
        scan.low = -1.9;
        scan.points = row((15.0, -1.2, 0.0)).chain(row((15.0, -1.7, 0.0))).collect();
        scan.points.extend(rows.iter().copied().flat_map(row));
        let labels: Vec<i32> =
            (0..scan.points.len() as i32).map(|row| if row < 10 { 0 } else { -1 }).collect();
        let mut clusters = Clusters::default();
        clusters.fill(&scan.points, &labels);
        is_just_above_ground(&scan, &clusters.get(0))
    }

    #[test]
    fn what_no_ray_passes_below_is_just_above_the_ground() {
        let (front, behind) = ((10.0, -2.1, 0.0), (20.0, -2.25, 0.7));
        assert!(is_just_above(&[front, behind]));
        assert!(is_just_above(&[front, (20.0, -2.25, -1.0)]), "on the other side");
        assert!(!is_just_above(&[front]), "nothing shows that the ground goes on");
        assert!(!is_just_above(&[behind]), "nothing is below");
        assert!(!is_just_above(&[front, (60.0, -6.8, 0.7)]), "a roof ends in front of it");
        assert!(!is_just_above(&[(18.0, -2.3, 0.0), behind]), "a ray passes below");
        assert!(!is_just_above(&[(8.0, -1.1, 0.0), behind, front]), "a table is in front");
        assert!(!is_just_above(&[front, (16.0, -1.81, 0.7)]), "a wall is behind");
    }
}
