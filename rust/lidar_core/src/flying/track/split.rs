//! Split of clusters that contain several targets, and union of several clusters of one large
//! target.

use super::association::pairs::AlongX;
use super::measurement::SearchRegion;
use crate::estimation::kalman;
use crate::flying::large_targets::{LARGE, PART_GAP};
use nalgebra::Vector3;

/// Parameters for the split of a cluster into several targets.
#[derive(Clone, Copy, Debug)]
pub(super) struct Division {
    /// A track may own a part of a cluster if one of the cluster's points is within this distance.
    /// Tracks that are no further apart may follow the same target [m].
    pub(super) distance: f64,
    /// Two tracks are certainly apart if their squared Mahalanobis distance is larger.
    pub(super) gate: f64,
    /// Smallest number of points of a part. A cluster with a smaller part stays whole.
    pub(super) min_points: usize,
}

/// The confirmed tracks, sorted along x.
struct Confirmed<'a> {
    regions: Vec<&'a SearchRegion>,
    along_x: AlongX,
    /// Highest speed of these tracks [m/s].
    fastest: f64,
}

impl<'a> Confirmed<'a> {
    fn of(regions: &'a [SearchRegion]) -> Self {
        let regions: Vec<&SearchRegion> =
            regions.iter().filter(|region| region.confirmed).collect();
        let along_x = AlongX::of(regions.iter().map(|region| region.position()));
        let fastest = regions.iter().map(|region| region.velocity().norm()).fold(0.0, f64::max);
        Self { regions, along_x, fastest }
    }
}

/// Position of a point [m], and its time after the stamp [s].
struct TimedPoint {
    at: Vector3<f64>,
    delay: f64,
}

impl TimedPoint {
    fn distance(&self, region: &SearchRegion) -> f64 {
        (self.at - region.position() - region.velocity() * self.delay).norm()
    }
}

impl Division {
    /// Split every cluster near several confirmed tracks that are certainly apart: each point goes
    /// to the nearest of these tracks.
    ///
    /// `labels` are those of [`crate::geometry::cluster::label`]. New parts get new labels.
    pub(super) fn divide(
        &self,
        labels: &mut [i32],
        points: &[[f32; 3]],
        delays: &[f32],
        regions: &[SearchRegion],
    ) {
        let confirmed = Confirmed::of(regions);
        if confirmed.regions.len() < 2 {
            return;
        }
        let mut next = labels.iter().max().map_or(0, |&last| last + 1);
        for rows in rows_of(labels, next) {
            let places: Vec<TimedPoint> = rows
                .iter()
                .map(|&row| TimedPoint {
                    at: Vector3::from(points[row].map(f64::from)),
                    delay: delays.get(row).copied().map_or(0.0, f64::from),
                })
                .collect();
            let parts = self.parts(&places, &confirmed);
            for part in parts.iter().skip(1) {
                part.iter().for_each(|&index| labels[rows[index]] = next);
                next += 1;
            }
        }
    }

    /// Indices of the points of a cluster, by the track that owns them. Empty if the cluster stays
    /// whole.
    fn parts(&self, places: &[TimedPoint], confirmed: &Confirmed<'_>) -> Vec<Vec<usize>> {
        let owners = self.owners(places, confirmed);
        if owners.len() < 2 {
            return Vec::new();
        }
        let mut parts = vec![Vec::new(); owners.len()];
        for (index, place) in places.iter().enumerate() {
            let distance = |&owner: &usize| place.distance(owners[owner]);
            let nearest =
                (0..owners.len()).min_by(|one, other| distance(one).total_cmp(&distance(other)));
            nearest.into_iter().for_each(|owner| parts[owner].push(index));
        }
        parts.retain(|part| !part.is_empty());
        if parts.iter().any(|part| part.len() < self.min_points) {
            parts.clear();
        }
        parts
    }

    /// Confirmed tracks near the cluster that may own a part of it: each is certainly apart from
    /// those before it.
    fn owners<'a>(
        &self,
        places: &[TimedPoint],
        confirmed: &Confirmed<'a>,
    ) -> Vec<&'a SearchRegion> {
        let Some(first) = places.first() else { return Vec::new() };
        let (mut low, mut high, mut latest) = (first.at, first.at, 0.0_f64);
        for place in places {
            (low, high) = (low.inf(&place.at), high.sup(&place.at));
            latest = latest.max(place.delay.abs());
        }
        let delay = places.iter().map(|place| place.delay).sum::<f64>() / places.len() as f64;
        let reach = self.distance + latest * confirmed.fastest;
        let mut near: Vec<usize> = confirmed.along_x.near(low.x, high.x, reach).collect();
        near.sort_unstable();
        let mut owners: Vec<&SearchRegion> = Vec::new();
        for region in near.into_iter().map(|index| confirmed.regions[index]) {
            let reach = self.distance + latest * region.velocity().norm();
            let outside = (low - region.position()).sup(&(region.position() - high));
            let is_near = outside.max() <= reach
                && places.iter().any(|place| place.distance(region) <= self.distance);
            if is_near && owners.iter().all(|owner| self.are_apart(owner, region, delay)) {
                owners.push(region);
            }
        }
        owners
    }

    /// Whether two tracks are certainly apart `delay` seconds after the stamp: by distance and by
    /// Mahalanobis distance.
    fn are_apart(&self, one: &SearchRegion, other: &SearchRegion, delay: f64) -> bool {
        let [(one, spread), (other, more)] = [one, other].map(|region| region.place_at(delay));
        let (y, covariance) = (one - other, spread + more);
        y.norm() > self.distance
            && kalman::mahalanobis(&y, &covariance).is_ok_and(|far| far.squared > self.gate)
    }
}

/// Join the clusters inside the box in which a confirmed track predicts a large target, if they are
/// together no longer than `longest` [m] and nearer to no other track. Without this, a track that
/// is corrected by the tip of a wing instead of the whole wing would jump by half the length of the
/// wing.
pub(super) fn unite(
    labels: &mut [i32],
    points: &[[f32; 3]],
    delays: &[f32],
    regions: &[SearchRegion],
    longest: f64,
) {
    // Longer than other functions: the closures share the box of one track.
    let side = |region: &SearchRegion| region.size.into_iter().fold(0.0, f64::max);
    let confirmed: Vec<&SearchRegion> = regions.iter().filter(|one| one.confirmed).collect();
    for &region in confirmed.iter().filter(|region| side(region) >= LARGE) {
        let count = labels.iter().max().map_or(0, |&last| last + 1);
        let offset = |row: usize| {
            let delay = delays.get(row).copied().map_or(0.0, f64::from);
            Vector3::from(points[row].map(f64::from))
                - region.position()
                - region.velocity() * delay
        };
        let is_own = |rows: &[usize]| {
            let holds = |&row: &usize| {
                let offset = offset(row);
                (0..3).all(|axis| offset[axis].abs() <= 0.5 * region.size[axis] + PART_GAP)
            };
            let mean =
                rows.iter().map(|&row| offset(row)).sum::<Vector3<f64>>() / rows.len() as f64;
            let is_nearest = |other: &&SearchRegion| {
                mean.norm() <= (mean + region.position() - other.position()).norm()
            };
            !rows.is_empty() && rows.iter().all(holds) && confirmed.iter().all(is_nearest)
        };
        let own: Vec<usize> =
            rows_of(labels, count).into_iter().filter(|rows| is_own(rows)).flatten().collect();
        // Also as the scan has them: what is longer there is no measurement of any track.
        let is_short = |place: &dyn Fn(usize) -> Vector3<f64>| {
            let ends = own.iter().map(|&row| (place(row), place(row)));
            ends.reduce(|one, other| (one.0.inf(&other.0), one.1.sup(&other.1)))
                .is_some_and(|(low, high)| (high - low).max() <= longest)
        };
        let as_scanned = |row: usize| Vector3::from(points[row].map(f64::from));
        if let Some(&first) = own.first().filter(|_| is_short(&offset) && is_short(&as_scanned)) {
            let label = labels[first];
            own.iter().for_each(|&row| labels[row] = label);
        }
    }
}

/// Indices of the points of every cluster, by the label of the cluster, for labels below `count`.
fn rows_of(labels: &[i32], count: i32) -> Vec<Vec<usize>> {
    let mut rows = vec![Vec::new(); usize::try_from(count).unwrap_or(0)];
    for (row, &label) in labels.iter().enumerate() {
        if let Ok(label) = usize::try_from(label) {
            rows[label].push(row); // noise is negative
        }
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::kalman::Gaussian;
    use crate::flying::track::motion::Matrix9;
    use nalgebra::SVector;

    const DIVISION: Division = Division { distance: 0.8, gate: 14.0, min_points: 1 };

    fn region(x: f64, std: f64, confirmed: bool) -> SearchRegion {
        let mut mean = SVector::<f64, 9>::zeros();
        mean[0] = x;
        let mut covariance = Matrix9::zeros();
        (0..3).for_each(|axis| covariance[(axis, axis)] = std * std);
        let estimate = Gaussian { mean, covariance };
        SearchRegion { estimate, turned: None, radius: 1.5, size: [0.0; 3], confirmed }
    }

    fn with_speed(mut region: SearchRegion, speed: f64) -> SearchRegion {
        region.estimate.mean[3] = speed;
        region
    }

    fn divided(regions: &[SearchRegion], division: Division) -> Vec<i32> {
        let points = [0.0, 0.3, 0.7, 1.1].map(|x| [x, 0.0, 0.0]);
        let mut labels = vec![0; points.len()];
        division.divide(&mut labels, &points, &[], regions);
        labels
    }

    #[test]
    fn points_go_to_the_nearest_track() {
        let two = [region(0.0, 0.1, true), region(1.2, 0.1, true)];
        assert_eq!(divided(&two, DIVISION), [0, 0, 1, 1]);
    }

    #[test]
    fn a_cluster_stays_whole_where_division_is_not_certain() {
        let certain = || region(0.0, 0.1, true);
        for other in [
            region(0.7, 0.1, true),  // may be the same target
            region(1.2, 0.5, true),  // may be anywhere
            region(1.2, 0.1, false), // may be nothing
            region(2.0, 0.1, true),  // too far
        ] {
            assert_eq!(divided(&[certain(), other], DIVISION), [0; 4]);
        }
        let two = [certain(), region(1.2, 0.1, true)];
        assert_eq!(divided(&two, Division { min_points: 3, ..DIVISION }), [0; 4]);
        assert_eq!(divided(&[], DIVISION), [0; 4]);
    }

    #[test]
    fn parts_of_a_large_target_are_one_and_what_another_track_is_nearer_to_is_not() {
        let wing = || SearchRegion { size: [2.0, 0.5, 0.3], ..region(0.0, 0.1, true) };
        let united = |regions: &[SearchRegion], longest: f64| {
            // A wing, its tip, and something beside it.
            let points = [-1.0, -0.6, 0.9, 2.5].map(|x| [x, 0.0, 0.0]);
            let mut labels = vec![0, 0, 1, 2];
            unite(&mut labels, &points, &[], regions, longest);
            labels
        };
        assert_eq!(united(&[wing()], 2.5), [0, 0, 0, 2]);
        assert_eq!(united(&[wing()], 1.5), [0, 0, 1, 2], "too long");
        assert_eq!(united(&[wing(), region(1.2, 0.1, true)], 2.5), [0, 0, 1, 2]);
        assert_eq!(united(&[wing(), region(1.2, 0.1, false)], 2.5), [0, 0, 0, 2]);
        assert_eq!(united(&[region(0.0, 0.1, true)], 2.5), [0, 0, 1, 2], "a small target");
    }

    #[test]
    fn what_a_fast_target_is_drawn_out_to_by_the_scan_stays_parts() {
        let fast = with_speed(region(0.0, 0.1, true), 10.0);
        let wing = SearchRegion { size: [2.0, 0.5, 0.3], ..fast };
        let united = |longest: f64| {
            let mut labels = vec![0, 0, 1];
            let points = [[-1.0, 0.0, 0.0], [-0.6, 0.0, 0.0], [1.9, 0.0, 0.0]];
            unite(&mut labels, &points, &[0.0, 0.0, 0.1], std::slice::from_ref(&wing), longest);
            labels
        };
        assert_eq!(united(3.0), [0, 0, 0]);
        assert_eq!(united(2.5), [0, 0, 1]); // 1.9 m long, and 2.9 m in the scan
    }

    #[test]
    fn tracks_are_moved_to_the_time_of_every_point() {
        let fast = with_speed(region(0.1, 0.1, true), 10.0);
        let regions = [fast, region(1.6, 0.1, true)];
        let points = [[1.1, 0.0, 0.0], [1.15, 0.0, 0.0]];
        let mut labels = vec![0, 0];
        DIVISION.divide(&mut labels, &points, &[0.1, 0.0], &regions);
        assert_eq!(labels, [0, 1]);
    }
}
