//! The pipeline: raw scans in, point classes, detections and tracks out.

use super::classify::{Verdict, classify, judge_again};
use super::clusters::Cluster;
use super::flood::{check_steps, distinct, search_radius};
use super::found::Found;
use super::frame::{Frame, Teammate, Timing};
use super::gate::Gate;
use super::integrate::{
    BACKGROUND, ClassifiedScan, FLYING, INVALID, IntegrateStats, Origins, UNKNOWN,
};
use super::jump::Held;
use super::parameters::FlyingParameters;
use super::scan::{Prepared, RawScan};
use super::sensor::Sensor;
use super::standing::Standing;
use super::track::{PointCloudTracker, Track};
use super::visibility::ScanView;
use super::voxel_map::VoxelMap;
use crate::Error;
use crate::clock::Clock;
use crate::geometry::gaps::{AngularGap, label_seen};
use crate::geometry::lattice::{floor, wide};
use crate::geometry::transform::Transform;
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
    /// Whether the last scan that was used left tracks to be reported.
    pub(super) reporting: bool,
    pub(super) held: Option<Held>,
    /// What the scans of the burn-in held.
    pub(super) standing: Standing,
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
        let gap = AngularGap { origin: [0.0; 3], max_angle: parameters.cluster_angle };
        label_seen(&[], &gap, &parameters.clustering, None)?;
        Ok(Self {
            map: VoxelMap::new(parameters.map.relative_to([0.0; 3]), threads)?,
            tracker: PointCloudTracker::new(parameters.tracker, threads)?,
            parameters,
            sensors: BTreeMap::new(),
            teammates: Vec::new(),
            anchored: false,
            map_from_world: Transform::IDENTITY,
            scans: 0,
            reporting: false,
            held: None,
            standing: Standing::default(),
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
            self.unanchor(); // the next scan says where the map begins
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
        let mut scan = Prepared::new(raw, &sensor, &self.map_from_world)?;
        let mut timing = Timing { prepare: clock.lap(), ..Timing::default() };

        if let Some(gate) = self.contradiction(&scan) {
            let world_from_lidar = self.map_from_world.inverse().after(&scan.pose);
            self.held = Some(Held { sensor: raw.sensor.to_owned(), world_from_lidar });
            return Ok(self.held_frame(raw, &scan, gate, timing));
        }
        let gate = self.parameters.seed.gate(self.scans, &self.map, self.needed());
        let mut rows = Vec::new();
        let mut judged = self.judge(&scan, &mut rows, &mut clock, &mut timing, keep_going)?;
        self.tracker.check_room(count_of(&judged.verdicts, FLYING))?;

        // The last stage that may refuse the scan.
        let stats = self.update_map(raw, &mut scan, &mut judged)?;
        self.accept(raw, &scan, sensor, gate);
        self.fill_pockets(&judged.verdicts, &scan);
        self.keep_standing(&scan);
        timing.integrate = clock.lap();
        self.map.remove_separate_from_background(self.parameters.separation)?;
        timing.separate = clock.lap();

        let view = self.view(raw, &scan);
        let mut found = self.detections(&view, &scan, &judged.clusters, &judged.verdicts);
        let followed = self.track(&view, &scan, &found, stamp_ns)?;
        self.add_followed(&mut judged, &mut found, &followed, &view, &scan);
        timing.track = clock.lap();
        Ok(self.frame(raw, judged.class, &scan, found, Some(stats), gate, timing))
    }

    /// The map after the scan; what flies is judged on it where that is asked for.
    fn update_map(
        &mut self,
        raw: &RawScan<'_>,
        scan: &mut Prepared,
        judged: &mut Judged<'_>,
    ) -> Result<IntegrateStats, Error> {
        let stats = self.integrate(raw, scan, &mut judged.class)?;
        if self.parameters.classify.after_update {
            judge_again(&mut judged.verdicts, self.verdicts(scan, &judged.clusters)?);
            judged.class = point_classes(scan, &judged.labels, &judged.verdicts);
        }
        Ok(stats)
    }

    /// Clusters of a scan, with their `rows`, and what the map says that they are.
    fn judge<'a>(
        &self,
        scan: &Prepared,
        rows: &'a mut Vec<u32>,
        clock: &mut Clock,
        timing: &mut Timing,
        keep_going: &dyn Fn() -> bool,
    ) -> Result<Judged<'a>, Error> {
        let labels = self.labels(scan)?;
        let clusters = Cluster::all(&scan.points, &labels, rows);
        timing.cluster = clock.lap();
        go_on(keep_going)?;

        let verdicts = self.verdicts(scan, &clusters)?;
        let mut class = point_classes(scan, &labels, &verdicts);
        if self.parameters.classify.after_update {
            replace(&mut class, FLYING, UNKNOWN); // rule B is judged after the map update
        }
        timing.classify = clock.lap();
        go_on(keep_going)?;
        Ok(Judged { labels, clusters, verdicts, class })
    }

    /// Confirmed tracks predicted to `stamp_ns`, world frame: compensates latency.
    #[must_use]
    pub fn tracks_at(&self, stamp_ns: i64) -> Vec<Track> {
        if !self.reporting {
            return Vec::new();
        }
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

    /// Sensors may fire at the same time; the tracker wants distinct stamps.
    fn tracker_stamp(&self, stamp_ns: i64) -> Result<i64, Error> {
        let stamp_ns = self.tracker.free_stamp(stamp_ns);
        self.tracker.check_stamp(stamp_ns)?;
        Ok(stamp_ns)
    }

    fn labels(&self, scan: &Prepared) -> Result<Vec<i32>, Error> {
        let gap =
            AngularGap { origin: scan.pose.translation, max_angle: self.parameters.cluster_angle };
        let (clustering, pool) = (&self.parameters.clustering, self.map.pool.as_ref());
        if !self.parameters.cluster_voxels {
            return label_seen(&scan.points, &gap, clustering, pool);
        }
        let lattice = self.map.lattice();
        let center = |&point: &[f32; 3]| match floor(lattice.scaled(wide(point))) {
            Some(voxel) => lattice.center(voxel).map(|value| value as f32),
            None => [f32::NAN; 3],
        };
        let centers: Vec<[f32; 3]> = scan.points.iter().map(center).collect();
        label_seen(&centers, &gap, clustering, pool)
    }

    fn needed(&self) -> usize {
        self.parameters.separation.min_confident
    }

    fn verdicts(&self, scan: &Prepared, clusters: &[Cluster<'_>]) -> Result<Vec<Verdict>, Error> {
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

    fn integrate(
        &mut self,
        raw: &RawScan<'_>,
        scan: &mut Prepared,
        class: &mut Vec<u8>,
    ) -> Result<IntegrateStats, Error> {
        let ground = self.parameters.seed.take_off_ground(scan.pose.translation);
        for ground in ground.filter(|_| self.scans == 0).into_iter().flatten() {
            scan.append_known(ground);
            class.push(BACKGROUND);
        }
        let stats = self.map.integrate(&ClassifiedScan {
            points: &scan.points,
            class: &*class,
            origins: Origins::Each(&scan.origins),
            directions: scan.directions.as_deref(),
            no_return: scan.directions.is_some().then_some(&scan.no_return),
            no_ray: scan.no_ray.as_deref(),
            pose_error: self.pose_error(raw, scan).as_ref(),
        })?;
        Ok(stats)
    }

    fn accept(&mut self, raw: &RawScan<'_>, scan: &Prepared, mut sensor: Sensor, gate: Gate) {
        let needs_directions = raw.organised && raw.no_return.is_some() && raw.directions.is_none();
        sensor.learn(raw.stamp_ns, raw.points, needs_directions);
        sensor.last_pose = Some(scan.pose);
        self.sensors.insert(raw.sensor.to_owned(), sensor);
        self.scans = self.scans.saturating_add(1);
        self.reporting = gate == Gate::Open;
        self.held = None;
        if let Some(distance) = self.parameters.forget_distance {
            self.map.forget(scan.pose.translation, distance);
        }
    }

    /// Enclosed uncertain voxels around flying objects become free, unless they hold points.
    fn fill_pockets(&mut self, verdicts: &[Verdict], scan: &Prepared) {
        if !self.parameters.classify.fill_pockets {
            return;
        }
        let lattice = *self.map.lattice();
        let place = |&point: &[f32; 3]| floor(lattice.scaled(wide(point)));
        let held = distinct(scan.points.iter().filter_map(place).collect());
        let below = self.map.uncertain_from().next_down();
        let flying = verdicts.iter().filter(|verdict| verdict.class == FLYING);
        for &voxel in flying.flat_map(|verdict| &verdict.explored) {
            if held.binary_search(&voxel).is_err() {
                self.map.rewrite(voxel, |value| value.min(below)); // NaN: never observed
            }
        }
    }

    fn view<'a>(&self, raw: &RawScan<'_>, scan: &'a Prepared) -> ScanView<'a> {
        let FlyingParameters { target_radius, range_std, .. } = self.parameters;
        ScanView::new(scan, target_radius, range_std, self.pose_spread(raw, scan))
    }

    fn held_frame(&self, raw: &RawScan<'_>, scan: &Prepared, gate: Gate, timing: Timing) -> Frame {
        let class = point_classes(scan, &vec![-1; scan.rows], &[]);
        self.frame(raw, class, scan, Found::default(), None, gate, timing)
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
            tracks: self.tracks_at(raw.stamp_ns),
            gate,
            clears_sky: scan.clears_sky,
            rebuilt_rays: scan.rebuilt,
            integrated,
            timing,
        }
    }
}

/// A scan in clusters.
pub(super) struct Judged<'a> {
    /// Cluster of every row, -1 for none.
    pub(super) labels: Vec<i32>,
    pub(super) clusters: Vec<Cluster<'a>>,
    /// What each cluster is.
    pub(super) verdicts: Vec<Verdict>,
    /// Class of every row.
    pub(super) class: Vec<u8>,
}

fn go_on(keep_going: &dyn Fn() -> bool) -> Result<(), Error> {
    if keep_going() { Ok(()) } else { Err(Error::Interrupted) }
}

fn count_of(verdicts: &[Verdict], class: u8) -> usize {
    verdicts.iter().filter(|verdict| verdict.class == class).count()
}

/// Class of every row: that of its cluster; unknown for points in no cluster.
pub(super) fn point_classes(scan: &Prepared, labels: &[i32], verdicts: &[Verdict]) -> Vec<u8> {
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
