//! Update of tracks with a scan (updateTrack of Algorithm 2): prediction, association with
//! clusters, correction.

use super::association::pairs::AlongX;
use super::belief::existence::{CLEARED, MANY_RAYS, MOVED, Sight};
use super::buffer::Buffer;
use super::candidates::candidates;
use super::cluster_assignment::ClusterAssignment;
use super::measurement::{CloudScan, Measurement, Offset, SearchRegion};
use super::motion::seconds;
use super::parameters::{Ageing, Association, Motion, TrackerParameters};
use super::split::{Division, unite};
use super::state::PointTrack;
use super::visibility::occupancy::{ENOUGH_RAYS, Occupancy, Visibility};
use super::visibility::select::{Ball, hits};
use crate::Error;
use crate::estimation::assignment::{Pair, assign};
use crate::estimation::chi2;
use crate::estimation::kalman::{self, Gaussian};
use crate::geometry::cluster::Labeller;
use crate::util::object_pool::ObjectPool;
use nalgebra::Vector3;
use rayon::ThreadPool;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Result of the update of tracks with a scan.
#[derive(Debug, Default)]
pub(super) struct UpdateOutcome {
    pub(super) corrected: Vec<i64>,
    /// For each corrected track, the index in the cloud of one point of its cluster.
    pub(super) rows: Vec<u32>,
    /// Number of measurements that were not used because their innovation covariance could not be
    /// factorised.
    pub(super) rejected: usize,
}

pub(super) struct Updater {
    pub(super) parameters: TrackerParameters,
    /// Largest squared Mahalanobis distance of a track and its measurement.
    gate: f64,
    /// Cost, in the assignment, of a track without a measurement.
    unassigned: f64,
    labellers: ObjectPool<Labeller>,
    pool: ThreadPool,
}

impl Updater {
    pub(super) fn new(parameters: TrackerParameters, threads: usize) -> Result<Self, Error> {
        parameters.check()?;
        let (gate, unassigned) = match parameters.association {
            Association::Paper => (f64::INFINITY, 0.0),
            Association::Global { gate_probability, clutter_density } => (
                chi2::quantile(gate_probability, 3)?,
                // -2 ln of the likelihood of clutter, without what every pair shares
                -2.0 * libm::log(clutter_density) - 3.0 * libm::log(TAU),
            ),
        };
        let (labellers, pool) = (ObjectPool::default(), crate::util::threads::pool(threads)?);
        Ok(Self { parameters, gate, unassigned, labellers, pool })
    }

    /// Predict every track that is older than the scan to the time of the scan, and correct it with
    /// its cluster.
    pub(super) fn update(
        &self,
        tracks: &mut [PointTrack],
        scan: &CloudScan<'_>,
    ) -> Result<UpdateOutcome, Error> {
        let model = &self.parameters.motion;
        let older = tracks.iter().filter(|track| track.stamp_ns < scan.stamp_ns);
        let turned: Vec<_> = older.map(|track| track.turned_at(scan.stamp_ns, model)).collect();
        let mut due = predicted(tracks, scan.stamp_ns, model);
        let regions: Vec<SearchRegion> = due
            .iter()
            .zip(turned)
            .map(|((_, track), turned)| self.search_region(track, turned))
            .collect();
        let found = match self.parameters.association {
            Association::Paper => self.nearest(&regions, scan)?,
            Association::Global { .. } => {
                let assignment = self.one_to_one(&regions, scan)?;
                assignment.count(due.iter_mut().map(|(_, track)| &mut **track));
                assignment.measured(&regions, self.parameters.hiding)
            }
        };
        for (_, track) in &mut due {
            track.left = has_left(track, scan);
        }
        let mut outcome = UpdateOutcome::default();
        for ((due, region), measurement) in due.into_iter().zip(&regions).zip(found) {
            let rays = self.rays(region, scan.visibility, measurement.is_some());
            self.correct(due, region, measurement, rays, &mut outcome);
        }
        Ok(outcome)
    }

    /// Correct a predicted track with its measurement. Without one, its uncertainty grows if
    /// `rays`, the number of rays through its place, is large enough that the target should have
    /// given returns. `dt`: time of the prediction [s].
    fn correct(
        &self,
        (dt, track): (f64, &mut PointTrack),
        region: &SearchRegion,
        measurement: Option<Measurement>,
        rays: usize,
        outcome: &mut UpdateOutcome,
    ) {
        let row = measurement.as_ref().and_then(|measurement| measurement.row);
        track.nis = None;
        track.sight = if measurement.is_some() {
            Sight::Followed
        } else {
            Sight::without(track.expected_returns(rays))
        };
        let corrected = measurement.map(|found| {
            match region.turned_by(&found, self.parameters.hiding, self.gate) {
                Some(turned) => track.correct_turned(&found, turned),
                None => track.correct(&found),
            }
        });
        match corrected {
            Some(Ok(())) => {
                if let Some(hiding) = &self.parameters.hiding {
                    track.remember_size(dt, hiding);
                }
                outcome.corrected.push(track.id);
                outcome.rows.extend(row);
                return;
            }
            Some(Err(_)) => outcome.rejected += 1,
            None => {}
        }
        if rays >= ENOUGH_RAYS {
            track.grow_old(dt, &self.parameters.motion);
        }
    }

    /// Predict hypotheses of `stamp_ns` to the present, and correct them with the buffered clouds
    /// that are newer. Removes hypotheses that have become too uncertain.
    ///
    /// # Source
    /// Vrba et al., Algorithm 2, lines 22-25.
    pub(super) fn replay(
        &self,
        mut hypotheses: Vec<PointTrack>,
        stamp_ns: i64,
        buffer: &Buffer,
        occupied: &dyn Occupancy,
    ) -> Result<Vec<PointTrack>, Error> {
        for cloud in buffer.newer_than(stamp_ns) {
            let scan = CloudScan {
                points: &cloud.points,
                delays: cloud.delays.as_deref(),
                stamp_ns: cloud.stamp_ns,
                occupied,
                visibility: None,
            };
            self.update(&mut hypotheses, &scan)?;
        }
        let radius = &self.parameters.radius;
        hypotheses.retain(|hypothesis| hypothesis.radius(radius) <= radius.max);
        Ok(hypotheses)
    }

    /// Radius of a track's search region [m]. Whether it is bounded from above: see [`Ageing`].
    pub(super) fn search_radius(&self, track: &PointTrack) -> f64 {
        let radius = track.radius(&self.parameters.radius);
        match self.parameters.ageing {
            Ageing::Paper => radius,
            Ageing::Visible { .. } => radius.min(self.parameters.radius.max),
        }
    }

    /// Assign rows to columns so that the sum of -2 ln(likelihood) is smallest. `rows` and
    /// `columns` are positions [m]. Returns the column of every row, or None.
    ///
    /// `offset` gives the difference of a pair and its covariance. It gives None if the pair is out
    /// of reach, as are all pairs further apart than `reach` [m].
    pub(super) fn assign(
        &self,
        rows: impl ExactSizeIterator<Item = Vector3<f64>>,
        columns: impl ExactSizeIterator<Item = Vector3<f64>>,
        reach: f64,
        offset: impl Fn(usize, usize) -> Option<Offset>,
    ) -> Result<Vec<Option<usize>>, Error> {
        let (n_rows, n_columns) = (rows.len(), columns.len());
        let columns = AlongX::of(columns);
        let near = |(row, place): (usize, Vector3<f64>)| {
            columns.near(place.x, place.x, reach).map(move |column| (row, column))
        };
        let mut pairs = Vec::new();
        for (row, column) in rows.enumerate().flat_map(near) {
            let Some(Offset { y, covariance, least_cost }) = offset(row, column) else { continue };
            let Ok(distance) = kalman::mahalanobis(&y, &covariance) else { continue };
            let cost = (distance.squared + distance.log_determinant).max(least_cost);
            if distance.squared <= self.gate && cost.is_finite() {
                pairs.push(Pair { row, column, cost });
            }
        }
        assign(n_rows, n_columns, &pairs, self.unassigned)
    }

    fn search_region(&self, track: &PointTrack, turned: Option<Gaussian<9>>) -> SearchRegion {
        SearchRegion {
            estimate: track.estimate.clone(),
            turned,
            radius: self.search_radius(track),
            size: track.size,
            confirmed: track.confirmed,
        }
    }

    /// Number of rays that would have met the target of a track, counted up to [`MANY_RAYS`], for a
    /// track that was not found. It decides whether the track ages, and is evidence for the
    /// target's existence.
    fn rays(
        &self,
        region: &SearchRegion,
        visibility: Option<&dyn Visibility>,
        is_found: bool,
    ) -> usize {
        match (self.parameters.ageing, visibility) {
            (Ageing::Visible { .. }, Some(visibility)) if !is_found => {
                visibility.rays(region.position().into(), region.radius, MANY_RAYS)
            }
            _ => MANY_RAYS,
        }
    }

    /// The nearest cluster of every track, as in Algorithm 2, lines 36-43 (Vrba et al.); None if a
    /// track has no cluster.
    fn nearest(
        &self,
        regions: &[SearchRegion],
        scan: &CloudScan<'_>,
    ) -> Result<Vec<Option<Measurement>>, Error> {
        let mut rows_of = vec![Vec::new(); regions.len()];
        for (point, ball) in hits(&self.pool, scan.points, &balls(regions, 0.0)) {
            rows_of[ball as usize].push(point);
        }
        let found: Vec<Result<Option<Measurement>, Error>> = self.pool.install(|| {
            rows_of
                .par_iter()
                .zip(regions)
                .map(|(rows, region)| {
                    let mut labeller = self.labellers.acquire();
                    let points = scan.points_of(rows);
                    let labels = labeller.label(&points, &self.parameters.clustering)?;
                    let distance = |one: &Measurement| (one.position - region.position()).norm();
                    Ok(candidates(rows, labels, scan, &self.parameters)
                        .into_iter()
                        .min_by(|one, other| distance(one).total_cmp(&distance(other))))
                })
                .collect()
        });
        found.into_iter().collect()
    }

    /// Assign the clusters of all regions together to tracks, each cluster to at most one track.
    fn one_to_one(
        &self,
        regions: &[SearchRegion],
        scan: &CloudScan<'_>,
    ) -> Result<ClusterAssignment, Error> {
        // Wide enough that no cluster with its centroid in the region is cut.
        let margin = self.parameters.max_extent.unwrap_or(0.0);
        let mut chosen: Vec<u32> = hits(&self.pool, scan.points, &balls(regions, margin))
            .iter()
            .map(|hit| hit.0)
            .collect();
        chosen.dedup();
        let points = scan.points_of(&chosen);
        let mut labeller = self.labellers.acquire();
        let mut labels = labeller.label(&points, &self.parameters.clustering)?.to_vec();
        let delays: Vec<f32> = chosen.iter().map(|&row| scan.delay(row)).collect();
        if let Some(distance) = self.parameters.split_distance {
            let min_points = self.parameters.clustering.min_points;
            let division = Division { distance, gate: self.gate, min_points };
            division.divide(&mut labels, &points, &delays, regions);
        }
        if let Some(longest) = self.parameters.max_extent {
            unite(&mut labels, &points, &delays, regions, longest);
        }
        let clusters = candidates(&chosen, &labels, scan, &self.parameters);
        let hiding = self.parameters.hiding;
        let rows = regions.iter().map(|region| region.position());
        let columns = clusters.iter().map(|cluster| cluster.position);
        let cluster_of =
            self.assign(rows, columns, reach(regions, &clusters), |track, cluster| {
                regions[track].offset(&clusters[cluster], hiding, self.gate)
            })?;
        Ok(ClusterAssignment { clusters, cluster_of })
    }
}

/// True if a track is away from its first detection for the first time, and the scan shows that
/// nothing is left there. Both conditions exclude false tracks. A track that jumps between the
/// leaves of a tree leaves other leaves behind. A track that follows a gap in front of a background
/// leaves a place that no ray reaches any more.
fn has_left(track: &PointTrack, scan: &CloudScan<'_>) -> bool {
    let holds =
        |point: &[f32; 3]| (Vector3::from(point.map(f64::from)) - track.born_at).norm() <= CLEARED;
    !track.belief.has_moved()
        && (track.position() - track.born_at).norm() > MOVED
        && !scan.points.iter().any(holds)
        && scan.visibility.is_none_or(|view| view.expected(track.born_at.into(), CLEARED))
}

/// Largest distance that any cluster may have from its track's position at the stamp of the scan
/// [m].
fn reach(regions: &[SearchRegion], clusters: &[Measurement]) -> f64 {
    let latest = clusters.iter().map(|cluster| cluster.delay.abs()).fold(0.0, f64::max);
    let flown = |region: &SearchRegion| {
        latest * region.velocity().norm() + 0.5 * latest * latest * region.acceleration().norm()
    };
    let reach = |region: &SearchRegion| region.radius + flown(region);
    regions.iter().map(reach).fold(0.0, f64::max)
}

/// Tracks that are older than `stamp_ns`, predicted to it, each with the time of the prediction
/// [s].
fn predicted<'a>(
    tracks: &'a mut [PointTrack],
    stamp_ns: i64,
    model: &Motion,
) -> Vec<(f64, &'a mut PointTrack)> {
    let older = tracks.iter_mut().filter(|track| track.stamp_ns < stamp_ns);
    let mut due: Vec<_> = older.map(|track| (seconds(track.stamp_ns, stamp_ns), track)).collect();
    for (_, track) in &mut due {
        track.predict(stamp_ns, model);
    }
    due
}

fn balls(regions: &[SearchRegion], margin: f64) -> Vec<Ball> {
    regions
        .iter()
        .map(|region| Ball { center: region.position().into(), radius: region.radius + margin })
        .collect()
}
