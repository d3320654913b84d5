//! The pipeline: raw scans in, point classes, detections and tracks out.

use super::blocks::Cursor;
use super::classify::{Verdict, classify};
use super::clusters::Cluster;
use super::detection::Detection;
use super::flood::{check_steps, search_radius};
use super::frame::{Clock, Found, Frame, Teammate, Timing};
use super::gate::Gate;
use super::integrate::{
    BACKGROUND, ClassifiedScan, FLYING, INVALID, IntegrateStats, Origins, UNKNOWN,
};
use super::near::{Near, is_observed_free};
use super::parameters::FlyingParameters;
use super::scan::{Prepared, RawScan};
use super::sensor::Sensor;
use super::track::{Detections, PointCloudTracker, Track};
use super::visibility::ScanView;
use super::voxel_map::VoxelMap;
use crate::Error;
use crate::geometry::cluster::label;
use crate::geometry::lattice::{floor, wide};
use crate::geometry::transform::{Transform, minus, norm};
use std::collections::BTreeMap;

/// Detection and tracking of flying objects in scans of one or several LiDARs.
pub struct FlyingObjectDetector {
    pub(super) parameters: FlyingParameters,
    pub(super) map: VoxelMap,
    pub(super) tracker: PointCloudTracker,
    pub(super) sensors: BTreeMap<String, Sensor>,
    pub(super) teammates: Vec<Teammate>,
    pub(super) anchored: bool,
    pub(super) map_from_world: Transform,
    pub(super) scans: u32,
    pub(super) last_stamp_ns: Option<i64>,
    pub(super) last_pose: Option<Transform>,
    pub(super) held_pose: Option<Transform>,
}

impl FlyingObjectDetector {
    /// A detector that works with `threads` threads.
    ///
    /// # Errors
    /// [`Error::Parameter`] for values that cannot work.
    pub fn new(parameters: FlyingParameters, threads: usize) -> Result<Self, Error> {
        let voxel_size = parameters.map.voxel_size;
        parameters.separation.check(voxel_size)?;
        search_radius(parameters.classify.search_distance, voxel_size)?;
        check_steps("close_distance", parameters.classify.close_distance, voxel_size)?;
        label(&[], &parameters.clustering)?;
        Ok(Self {
            map: VoxelMap::new(parameters.map.relative_to([0.0; 3]), threads)?,
            tracker: PointCloudTracker::new(parameters.tracker, threads)?,
            parameters,
            sensors: BTreeMap::new(),
            teammates: Vec::new(),
            anchored: false,
            map_from_world: Transform::IDENTITY,
            scans: 0,
            last_stamp_ns: None,
            last_pose: None,
            held_pose: None,
        })
    }

    /// Process one scan.
    ///
    /// # Errors
    /// For input that cannot be used; the detector is unchanged then.
    pub fn process(&mut self, raw: &RawScan<'_>) -> Result<Frame, Error> {
        self.process_while(raw, &|| true)
    }

    /// The same, but given up if `keep_going` says false between stages.
    ///
    /// # Errors
    /// [`Error::Interrupted`], and those of `process`; the detector is unchanged then.
    pub fn process_while(
        &mut self,
        raw: &RawScan<'_>,
        keep_going: &dyn Fn() -> bool,
    ) -> Result<Frame, Error> {
        let was_anchored = self.anchored;
        let frame = self.process_anchored(raw, keep_going);
        if frame.is_err() && !was_anchored {
            self.anchored = false; // the next scan says where the map begins
        }
        frame
    }

    fn process_anchored(
        &mut self,
        raw: &RawScan<'_>,
        keep_going: &dyn Fn() -> bool,
    ) -> Result<Frame, Error> {
        let mut clock = Clock::start();
        let sensor = self.sensor(raw.sensor);
        sensor.check_stamp(raw.sensor, raw.stamp_ns)?;
        let stamp_ns = self.tracker_stamp(raw.stamp_ns)?;
        self.anchor(raw)?;
        let scan = Prepared::new(raw, &sensor, &self.map_from_world)?;
        let mut timing = Timing { prepare: clock.lap(), ..Timing::default() };

        if let Some(gate) = self.contradiction(&scan) {
            self.held_pose = Some(self.map_from_world.inverse().after(&scan.pose));
            return Ok(self.held_frame(raw, &scan, gate, timing));
        }
        let labels = self.labels(&scan)?;
        let clusters = Cluster::all(&scan.points, &labels);
        timing.cluster = clock.lap();
        if !keep_going() {
            return Err(Error::Interrupted);
        }

        let gate = self.parameters.seed.gate(self.scans, &self.map, self.needed());
        let mut verdicts = self.verdicts(&scan, &clusters)?;
        let mut class = point_classes(&scan, &labels, &verdicts);
        let after_update = self.parameters.classify.after_update;
        if after_update {
            replace(&mut class, FLYING, UNKNOWN); // rule B is judged below
        }
        timing.classify = clock.lap();
        if !keep_going() {
            return Err(Error::Interrupted);
        }

        let stats = self.integrate(&scan, &class)?; // the last stage that may refuse the scan
        if after_update {
            verdicts = self.verdicts(&scan, &clusters)?;
            class = point_classes(&scan, &labels, &verdicts);
        }
        self.accept(raw, &scan, sensor);
        self.fill_pockets(&clusters, &verdicts, &scan);
        timing.integrate = clock.lap();
        self.map.remove_separate_from_background(self.parameters.separation)?;
        timing.separate = clock.lap();

        let found = self.detections(&scan, &clusters, &verdicts, raw.pose_covariance.as_ref());
        self.track(&scan, &found, stamp_ns)?;
        timing.track = clock.lap();
        Ok(self.frame(raw, class, &scan, found, Some(stats), gate, timing))
    }

    /// Confirmed tracks predicted to `stamp_ns`, world frame: compensates latency.
    #[must_use]
    pub fn tracks_at(&self, stamp_ns: i64) -> Vec<Track> {
        let world_from_map = self.map_from_world.inverse();
        let mut tracks = self.tracker.tracks_at(stamp_ns);
        tracks.retain(|track| track.reported);
        tracks.into_iter().map(|track| track.moved(&world_from_map)).collect()
    }

    /// Known flying objects: labelled in the following frames instead of reported.
    pub fn set_teammates(&mut self, teammates: Vec<Teammate>) {
        self.teammates = teammates;
    }

    /// The map; its coordinates are relative to its origin.
    #[must_use]
    pub fn map(&self) -> &VoxelMap {
        &self.map
    }

    fn sensor(&self, name: &str) -> Sensor {
        let parameters =
            self.parameters.sensors.get(name).unwrap_or(&self.parameters.default_sensor);
        self.sensors.get(name).cloned().unwrap_or_else(|| Sensor::new(parameters.clone()))
    }

    /// Two sensors may fire at the same time; the tracker wants distinct stamps.
    fn tracker_stamp(&self, stamp_ns: i64) -> Result<i64, Error> {
        let taken = self.last_stamp_ns == Some(stamp_ns);
        let stamp_ns = stamp_ns.saturating_add(i64::from(taken));
        self.tracker.check_stamp(stamp_ns)?;
        Ok(stamp_ns)
    }

    fn labels(&self, scan: &Prepared) -> Result<Vec<i32>, Error> {
        if !self.parameters.cluster_voxels {
            return label(&scan.points, &self.parameters.clustering);
        }
        let lattice = self.map.lattice();
        let center = |&point: &[f32; 3]| match floor(lattice.scaled(wide(point))) {
            Some(voxel) => lattice.center(voxel).map(|value| value as f32),
            None => [f32::NAN; 3],
        };
        let centers: Vec<[f32; 3]> = scan.points.iter().map(center).collect();
        label(&centers, &self.parameters.clustering)
    }

    fn needed(&self) -> usize {
        self.parameters.separation.min_confident
    }

    /// A closed gate if most returns in observed voxels lie in free space, away from anything
    /// occupied.
    fn contradiction(&self, scan: &Prepared) -> Option<Gate> {
        const SAMPLES: usize = 2048;
        const ENOUGH: u32 = 200;
        let limit = self.parameters.mismatch_share.filter(|_| self.map.has_background())?;
        let returns: Vec<_> = scan.points.iter().filter(|point| point[0].is_finite()).collect();
        let mut cursor = Cursor::new(&self.map.blocks);
        let mut near = Near::new(&self.map, self.parameters.classify.close_distance);
        let (mut observed, mut free) = (0u32, 0u32);
        for &&point in returns.iter().step_by((returns.len() / SAMPLES).max(1)) {
            let point = wide(point);
            let Some(voxel) = floor(self.map.lattice().scaled(point)) else { continue };
            if cursor.stored(voxel).is_nan() {
                continue;
            }
            observed += 1;
            free +=
                u32::from(is_observed_free(&self.map, &mut cursor, voxel) && !near.is_close(point));
        }
        let contradicts = observed >= ENOUGH && f64::from(free) > limit * f64::from(observed);
        contradicts.then(|| Gate::PoseMismatch { per_mille: 1000 * free / observed })
    }

    fn verdicts(&self, scan: &Prepared, clusters: &[Cluster]) -> Result<Vec<Verdict>, Error> {
        let mut parameters = self.parameters.classify.clone();
        parameters.background_extent =
            self.parameters.seed.background_extent(self.scans, parameters.background_extent);
        let origin = scan.pose.translation;
        let mut verdicts = classify(&self.map, &scan.points, clusters, origin, &parameters)?;
        let ground = self.parameters.seed.ground_height;
        let world_from_map = self.map_from_world.inverse();
        for (verdict, cluster) in verdicts.iter_mut().zip(clusters) {
            if ground.is_some_and(|height| world_from_map.apply(cluster.low)[2] < height) {
                *verdict = Verdict { class: BACKGROUND, ..Verdict::default() };
            } else if verdict.class == FLYING && !self.map.has_background() {
                *verdict = Verdict { class: UNKNOWN, ..Verdict::default() };
            }
        }
        Ok(verdicts)
    }

    fn integrate(&mut self, scan: &Prepared, class: &[u8]) -> Result<IntegrateStats, Error> {
        let stats = self.map.integrate(&ClassifiedScan {
            points: &scan.points,
            class,
            origins: Origins::Each(&scan.origins),
            directions: scan.directions.as_deref(),
            no_return: scan.directions.is_some().then_some(&scan.no_return),
            no_ray: scan.no_ray.as_deref(),
        })?;
        if self.scans == 0 {
            self.parameters.seed.seed_take_off(&mut self.map, scan.pose.translation)?;
        }
        Ok(stats)
    }

    fn accept(&mut self, raw: &RawScan<'_>, scan: &Prepared, mut sensor: Sensor) {
        let needs_directions = raw.no_return.is_some() && raw.directions.is_none();
        sensor.learn(raw.stamp_ns, raw.points, needs_directions);
        self.sensors.insert(raw.sensor.to_owned(), sensor);
        self.scans = self.scans.saturating_add(1);
        self.last_stamp_ns =
            Some(self.last_stamp_ns.map_or(raw.stamp_ns, |last| last.max(raw.stamp_ns)));
        self.last_pose = Some(scan.pose);
        self.held_pose = None;
        if let Some(distance) = self.parameters.forget_distance {
            self.map.forget(scan.pose.translation, distance);
        }
    }

    /// Enclosed uncertain voxels around flying objects become free, unless they hold points.
    fn fill_pockets(&mut self, clusters: &[Cluster], verdicts: &[Verdict], scan: &Prepared) {
        if !self.parameters.classify.fill_pockets {
            return;
        }
        let below = self.map.uncertain_from().next_down();
        for (verdict, cluster) in verdicts.iter().zip(clusters).filter(|(v, _)| v.class == FLYING) {
            let lattice = *self.map.lattice();
            let mut held: Vec<_> = cluster
                .members
                .iter()
                .filter_map(|&row| floor(lattice.scaled(wide(scan.points[row as usize]))))
                .collect();
            held.sort_unstable();
            for &voxel in verdict.explored.iter().filter(|voxel| held.binary_search(voxel).is_err())
            {
                self.map.rewrite(voxel, |value| if value.is_infinite() { value } else { below });
            }
        }
    }

    /// Detections and teammates of a scan, in the frame of the map.
    fn detections(
        &self,
        scan: &Prepared,
        clusters: &[Cluster],
        verdicts: &[Verdict],
        pose_covariance: Option<&[[f64; 6]; 6]>,
    ) -> Found {
        let mut found = Found::default();
        let turn = Transform { translation: [0.0; 3], ..self.map_from_world };
        for (cluster, verdict) in clusters.iter().zip(verdicts).filter(|(_, v)| v.class == FLYING) {
            let range_std = self.parameters.range_std;
            let mut detection = Detection::of(scan, cluster, verdict, range_std);
            if let Some(covariance) = pose_covariance {
                detection.add_pose_covariance(&scan.pose, &turn, covariance);
            }
            let mate = self.teammates.iter().find(|mate| {
                norm(minus(self.map_from_world.apply(mate.position), detection.position))
                    <= mate.radius
            });
            match mate {
                Some(mate) => found.teammates.push((mate.id, detection)),
                None => found.detections.push(detection),
            }
        }
        found
    }

    fn track(&mut self, scan: &Prepared, found: &Found, stamp_ns: i64) -> Result<(), Error> {
        let view = ScanView::new(scan, self.parameters.target_radius);
        self.tracker.new_point_cloud(
            &scan.points,
            scan.delays.as_deref(),
            &self.map,
            Some(&view),
            stamp_ns,
        )?;
        let positions: Vec<_> = found.detections.iter().map(|found| found.position).collect();
        let covariance: Vec<_> = found.detections.iter().map(|found| found.covariance).collect();
        let extent: Vec<_> = found.detections.iter().map(|found| found.extent).collect();
        let delay: Vec<_> = found.detections.iter().map(|found| found.delay).collect();
        let detections = Detections {
            stamp_ns,
            delay: Some(&delay),
            positions: &positions,
            covariance: Some(&covariance),
            extent: Some(&extent),
        };
        self.tracker.new_detections(&detections, &self.map)?;
        Ok(())
    }

    fn held_frame(&self, raw: &RawScan<'_>, scan: &Prepared, gate: Gate, timing: Timing) -> Frame {
        let class = vec![UNKNOWN; scan.rows];
        self.frame(raw, class, scan, Found::default(), None, gate, timing)
    }

    /// During the burn-in the tracker runs already, unseen; a held scan still has its tracks.
    fn reports(&self, gate: Gate) -> bool {
        matches!(gate, Gate::Open | Gate::PoseMismatch { .. })
    }

    #[allow(clippy::too_many_arguments)] // the parts of a frame, each made by another stage
    fn frame(
        &self,
        raw: &RawScan<'_>,
        mut point_class: Vec<u8>,
        scan: &Prepared,
        found: Found,
        integrated: Option<IntegrateStats>,
        gate: Gate,
        timing: Timing,
    ) -> Frame {
        point_class.truncate(scan.rows);
        if gate != Gate::Open {
            replace(&mut point_class, FLYING, UNKNOWN);
        }
        let found = if gate == Gate::Open { found } else { Found::default() };
        let world_from_map = self.map_from_world.inverse();
        Frame {
            stamp_ns: raw.stamp_ns,
            point_class,
            detections: found.detections.iter().map(|d| d.moved(&world_from_map)).collect(),
            teammates: found
                .teammates
                .iter()
                .map(|(id, d)| (*id, d.moved(&world_from_map)))
                .collect(),
            tracks: if self.reports(gate) { self.tracks_at(raw.stamp_ns) } else { Vec::new() },
            gate,
            clears_sky: scan.clears_sky,
            rebuilt_rays: scan.rebuilt,
            integrated,
            timing,
        }
    }
}

/// Class of every row: that of its cluster; unknown for points in no cluster.
fn point_classes(scan: &Prepared, labels: &[i32], verdicts: &[Verdict]) -> Vec<u8> {
    let class = |(point, &label): (&[f32; 3], &i32)| match usize::try_from(label) {
        Ok(cluster) => verdicts[cluster].class,
        Err(_) if point.iter().all(|value| value.is_finite()) => UNKNOWN,
        Err(_) => INVALID,
    };
    scan.points.iter().zip(labels).map(class).collect()
}

fn replace(classes: &mut [u8], old: u8, new: u8) {
    classes.iter_mut().filter(|class| **class == old).for_each(|class| *class = new);
}
