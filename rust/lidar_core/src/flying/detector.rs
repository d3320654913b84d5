//! The pipeline: raw scans in, point classes, detections and tracks out.

use super::blocks::Cursor;
use super::classify::{ClassifyParameters, Cluster, Near, Verdict, classify, is_observed_free};
use super::detection::Detection;
use super::gate::{Gate, SeedParameters};
use super::integrate::{
    BACKGROUND, ClassifiedScan, FLYING, INVALID, IntegrateStats, Origins, UNKNOWN,
};
use super::scan::{Prepared, RawScan};
use super::sensor::{Sensor, SensorParameters};
use super::separate::Separation;
use super::track::{Detections, PointCloudTracker, Track, TrackerParameters};
use super::visibility::ScanView;
use super::voxel_map::{MapParameters, VoxelMap};
use crate::Error;
use crate::geometry::cluster::{Clustering, label};
use crate::geometry::lattice::{floor, wide};
use crate::geometry::transform::{Transform, minus, norm};
use std::collections::BTreeMap;
use std::time::Instant;

/// All parameters of the detector.
#[derive(Clone, Debug, PartialEq)]
pub struct FlyingParameters {
    /// The map; its origin is set by the detector.
    pub map: MapParameters,
    /// Clusters of points (eqs 13-15).
    pub clustering: Clustering,
    /// Classes of clusters (sec. III-B).
    pub classify: ClassifyParameters,
    /// Removal of separate voxels (sec. III-D).
    pub separation: Separation,
    /// Seeds of the background.
    pub seed: SeedParameters,
    /// LiDARs by name; `default_sensor` for the others.
    pub sensors: BTreeMap<String, SensorParameters>,
    /// LiDARs that `sensors` does not name.
    pub default_sensor: SensorParameters,
    /// Tracks (sec. III-F).
    pub tracker: TrackerParameters,
    /// Range noise [m].
    pub range_std: f64,
    /// The smallest target that must be seen [m]: radius.
    pub target_radius: f64,
    /// Share of returns in free space from which a scan is held; None never holds.
    pub mismatch_share: Option<f64>,
    /// The map forgets what is further from the sensor [m].
    pub forget_distance: Option<f64>,
}

/// Milliseconds spent per stage.
#[derive(Clone, Copy, Debug, Default)]
pub struct Timing {
    /// Transform, deskew, masks.
    pub prepare: f64,
    /// Clustering.
    pub cluster: f64,
    /// Classification.
    pub classify: f64,
    /// Map update.
    pub integrate: f64,
    /// Removal of separate voxels.
    pub separate: f64,
    /// Tracking.
    pub track: f64,
}

/// Result of one scan; positions in the world frame.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Time of the scan [ns].
    pub stamp_ns: i64,
    /// Class of every point of the input.
    pub point_class: Vec<u8>,
    /// Flying objects in this scan.
    pub detections: Vec<Detection>,
    /// Known teammates that were seen: id and measured position.
    pub teammates: Vec<(i64, Detection)>,
    /// Confirmed tracks at the time of the scan.
    pub tracks: Vec<Track>,
    /// Whether detections are reported.
    pub gate: Gate,
    /// Whether rays without return clear open sky.
    pub clears_sky: bool,
    /// Rays without return that were rebuilt.
    pub rebuilt_rays: usize,
    /// What the scan did to the map; None if it was held.
    pub integrated: Option<IntegrateStats>,
    /// Time per stage.
    pub timing: Timing,
}

/// A known flying object that is not to be reported.
#[derive(Clone, Copy, Debug)]
pub struct Teammate {
    /// Its name.
    pub id: i64,
    /// Where it says it is, world frame [m].
    pub position: [f64; 3],
    /// Detections this near are taken for it [m].
    pub radius: f64,
}

/// Detection and tracking of flying objects in scans of one or several LiDARs.
pub struct FlyingObjectDetector {
    parameters: FlyingParameters,
    map: VoxelMap,
    tracker: PointCloudTracker,
    sensors: BTreeMap<String, Sensor>,
    teammates: Vec<Teammate>,
    anchored: bool,
    map_from_world: Transform,
    scans: u32,
    last_stamp_ns: Option<i64>,
    last_pose: Option<Transform>,
    held_pose: Option<Transform>,
}

impl FlyingObjectDetector {
    /// A detector that works with `threads` threads.
    ///
    /// # Errors
    /// [`Error::Parameter`] for values that cannot work.
    pub fn new(parameters: FlyingParameters, threads: usize) -> Result<Self, Error> {
        Ok(Self {
            map: VoxelMap::new(local(&parameters.map, [0.0; 3]), threads)?,
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
        let was_anchored = self.anchored;
        let frame = self.process_anchored(raw);
        if frame.is_err() && !was_anchored {
            self.anchored = false; // the next scan says where the map begins
        }
        frame
    }

    fn process_anchored(&mut self, raw: &RawScan<'_>) -> Result<Frame, Error> {
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
        let labels = label(&scan.points, &self.parameters.clustering)?;
        let clusters = Cluster::all(&scan.points, &labels);
        timing.cluster = clock.lap();

        let gate = self.parameters.seed.gate(self.scans, &self.map, self.needed());
        let verdicts = self.verdicts(&scan, &clusters)?;
        let class = point_classes(&scan, &labels, &verdicts);
        timing.classify = clock.lap();

        let stats = self.integrate(&scan, &class)?; // the last stage that may refuse the scan
        self.accept(raw, &scan, sensor);
        self.fill_pockets(&clusters, &verdicts, &scan);
        timing.integrate = clock.lap();
        self.map.remove_separate(self.parameters.separation)?;
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

    /// Make the voxels of `points` [m, world] occupied, or free, for good (sec. III-E).
    ///
    /// # Errors
    /// As [`VoxelMap::set_free`].
    pub fn set_known(&mut self, points: &[[f64; 3]], occupied: bool) -> Result<(), Error> {
        let Some(&first) = points.first() else { return Ok(()) };
        if !self.anchored {
            self.anchor_at(first)?;
        }
        let points = self.in_map(points);
        if occupied { self.map.set_occupied(&points) } else { self.map.set_free(&points) }
    }

    /// The map; its coordinates are relative to its origin.
    #[must_use]
    pub fn map(&self) -> &VoxelMap {
        &self.map
    }

    /// Take over a map, such as one of an earlier run; its own parameters stay in force.
    ///
    /// # Errors
    /// [`Error::Parameter`] if its voxels differ in size from the configured ones.
    pub fn set_map(&mut self, map: VoxelMap) -> Result<(), Error> {
        if map.parameters().voxel_size != self.parameters.map.voxel_size {
            return Err(Error::Parameter {
                name: "voxel_size",
                expected: "a map with the configured size",
                got: map.parameters().voxel_size.to_string(),
            });
        }
        self.place_origin(map.parameters().origin);
        self.map = map;
        self.tracker.reset();
        Ok(())
    }

    /// Points [m, world] in the frame of the map.
    #[must_use]
    pub fn in_map(&self, points: &[[f64; 3]]) -> Vec<[f32; 3]> {
        let local = |&point: &[f64; 3]| self.map_from_world.apply(point).map(|value| value as f32);
        points.iter().map(local).collect()
    }

    /// Where the frame of the map lies in the world.
    #[must_use]
    pub fn world_from_map(&self) -> Transform {
        self.map_from_world.inverse()
    }

    /// After a jump of the pose (relocalisation, GNSS step): shift the world so that the scan held
    /// last lies where the scan before it was. False if no scan is held.
    pub fn reanchor(&mut self) -> bool {
        let (Some(held), Some(last)) = (self.held_pose.take(), self.last_pose) else {
            return false;
        };
        self.map_from_world = last.after(&held.inverse());
        true
    }

    /// Forget map, tracks and poses. Track numbers go on; what was learnt of the sensors stays.
    ///
    /// # Errors
    /// None that [`FlyingObjectDetector::new`] did not have.
    pub fn reset(&mut self) -> Result<(), Error> {
        self.map = VoxelMap::new(local(&self.parameters.map, [0.0; 3]), self.map.threads())?;
        self.tracker.reset();
        for sensor in self.sensors.values_mut() {
            sensor.last_stamp_ns = None;
        }
        (self.anchored, self.map_from_world) = (false, Transform::IDENTITY);
        (self.scans, self.last_stamp_ns) = (0, None);
        (self.last_pose, self.held_pose) = (None, None);
        Ok(())
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

    /// The local frame: the first pose's position, on a corner of the world's voxels.
    fn anchor(&mut self, raw: &RawScan<'_>) -> Result<(), Error> {
        match raw.poses.first() {
            Some(pose) if !self.anchored => self.anchor_at([pose[3], pose[7], pose[11]]),
            _ => Ok(()),
        }
    }

    fn anchor_at(&mut self, point: [f64; 3]) -> Result<(), Error> {
        let size = self.parameters.map.voxel_size;
        let origin = point.map(|value| (value / size).round() * size);
        if !origin.iter().all(|value| value.is_finite()) {
            return Err(Error::PointOutOfRange { point });
        }
        self.map = VoxelMap::new(local(&self.parameters.map, origin), self.map.threads())?;
        self.place_origin(origin);
        Ok(())
    }

    fn place_origin(&mut self, origin: [f64; 3]) {
        self.anchored = true;
        self.map_from_world =
            Transform { translation: origin.map(|value| -value), ..Transform::IDENTITY };
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
            point_class
                .iter_mut()
                .filter(|class| **class == FLYING)
                .for_each(|class| *class = UNKNOWN);
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

#[derive(Default)]
struct Found {
    detections: Vec<Detection>,
    teammates: Vec<(i64, Detection)>,
}

/// Stop watch for the stages.
struct Clock(Instant);

impl Clock {
    fn start() -> Self {
        Self(Instant::now())
    }

    /// Milliseconds since the last lap.
    fn lap(&mut self) -> f64 {
        let now = Instant::now();
        let passed = now.duration_since(std::mem::replace(&mut self.0, now));
        passed.as_secs_f64() * 1e3
    }
}

/// Map parameters for coordinates relative to `origin`.
fn local(parameters: &MapParameters, origin: [f64; 3]) -> MapParameters {
    let bounds = parameters.bounds.map(|corners| corners.map(|corner| minus(corner, origin)));
    MapParameters { origin, bounds, ..parameters.clone() }
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
