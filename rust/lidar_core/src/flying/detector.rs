//! The pipeline: raw scans in, point classes, detections and tracks out.

use super::background::burn_in::Gate;
use super::background::burn_in_time::BurnIn;
use super::background::pose_jump::Held;
use super::background::static_points::Standing;
use super::classify::classified::Judged;
use super::classify::flood::{check_steps, search_radius};
use super::detect::detections::Found;
use super::detect::follow_up::track;
use super::detect::visibility::ScanView;
use super::frame::{Frame, Teammate, Timing};
use super::integrate::classified_scan::IntegrateStats;
use super::integrate::integrator::Integrator;
use super::map::saved_body::SavedBody;
use super::map::voxel_map::VoxelMap;
use super::parameters::FlyingParameters;
use super::point_class::{FLYING, UNKNOWN};
use super::scan::prepared::{Prepared, RawScan};
use super::scan::sensor::Sensor;
use super::track::{PointCloudTracker, Track};
use crate::Error;
use crate::geometry::cluster::angular_gap::{AngularGap, label_seen};
use crate::geometry::lattice::{Voxel, wide};
use crate::geometry::transform::Transform;
use crate::util::budget::MAX_SENSORS;
use crate::util::stopwatch::Clock;
use crate::util::threads::Workers;
use std::collections::BTreeMap;

/// Detection and tracking of flying objects in scans of one or several LiDARs.
pub struct FlyingObjectDetector {
    pub(super) parameters: FlyingParameters,
    pub(super) workers: Workers,
    pub(super) map: VoxelMap,
    integrator: Integrator,
    pub(super) tracker: PointCloudTracker,
    pub(super) sensors: BTreeMap<String, Sensor>,
    /// Robot as an earlier run found it, for sensors that are met again.
    pub(super) recalled: BTreeMap<String, SavedBody>,
    pub(super) teammates: Vec<Teammate>,
    pub(super) anchored: bool,
    pub(super) map_from_world: Transform,
    pub(super) scans: u32,
    pub(super) burn_in: BurnIn,
    /// True if the last scan that was used left tracks to report.
    pub(super) reporting: bool,
    pub(super) held: Option<Held>,
    /// Points per voxel in the scans of the burn-in, to find what stands still.
    pub(super) standing: Standing,
    scratch: Scratch,
}

/// Memory that a scan leaves to the next one.
#[derive(Default)]
struct Scratch {
    scan: Prepared,
    judged: Judged,
    sampled: Vec<(Voxel, [f64; 3])>,
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
        let workers = Workers::new(threads)?;
        Ok(Self {
            map: VoxelMap::new(parameters.map.relative_to([0.0; 3]))?,
            integrator: Integrator::on(workers.clone()),
            workers,
            tracker: PointCloudTracker::new(parameters.tracker, threads)?,
            parameters,
            sensors: BTreeMap::new(),
            recalled: BTreeMap::new(),
            teammates: Vec::new(),
            anchored: false,
            map_from_world: Transform::IDENTITY,
            scans: 0,
            burn_in: BurnIn::default(),
            reporting: false,
            held: None,
            standing: Standing::default(),
            scratch: Scratch::default(),
        })
    }

    /// Process one scan.
    ///
    /// # Errors
    /// For input that cannot be used; the detector is unchanged then.
    pub fn process(&mut self, raw: &RawScan<'_>) -> Result<Frame, Error> {
        self.process_while(raw, &|| true)
    }

    /// Like [`Self::process`], but gives up if `keep_going` says false between stages.
    ///
    /// # Errors
    /// [`Error::Interrupted`], and those of `process`; the detector is unchanged then.
    pub fn process_while(
        &mut self,
        raw: &RawScan<'_>,
        keep_going: &dyn Fn() -> bool,
    ) -> Result<Frame, Error> {
        let (was_anchored, was_met) = (self.anchored, self.sensors.contains_key(raw.sensor));
        let mut scratch = std::mem::take(&mut self.scratch);
        let mut integrator = std::mem::take(&mut self.integrator);
        let frame = self.process_anchored(raw, &mut scratch, &mut integrator, keep_going);
        (self.scratch, self.integrator) = (scratch, integrator); // their memory is used again
        if frame.is_err() && !was_anchored {
            self.unanchor(); // the next scan says where the map begins
        }
        if frame.is_err() && !was_met {
            self.sensors.remove(raw.sensor);
        }
        frame
    }

    fn process_anchored(
        &mut self,
        raw: &RawScan<'_>,
        scratch: &mut Scratch,
        integrator: &mut Integrator,
        keep_going: &dyn Fn() -> bool,
    ) -> Result<Frame, Error> {
        let mut clock = Clock::start();
        let Scratch { scan, judged, sampled } = scratch;
        let stamp_ns = self.prepare(raw, scan)?;
        let mut timing = Timing { prepare: clock.lap(), ..Timing::default() };

        if let Some(gate) = self.contradiction(scan, sampled) {
            return Ok(self.hold(raw, scan, judged, gate, timing));
        }
        let seed = &self.parameters.seed;
        let burn_in = self.burn_in.after(self.sensors[raw.sensor].since_last(raw.stamp_ns), seed);
        let gate = seed.gate(&self.burn_in, &burn_in, &self.map, self.needed());
        let cast = self.judge_and_cast(raw, scan, judged, integrator, &mut clock, &mut timing)?;
        go_on(keep_going)?;
        self.tracker.check_room(judged.count_of(FLYING))?;

        // The last stage that may refuse the scan.
        let stats = self.update_map(raw, scan, judged, integrator, cast)?;
        self.accept(raw, scan, gate);
        self.burn_in = burn_in;
        self.fill_pockets(&judged.verdicts, scan);
        self.keep_standing(scan, gate);
        timing.integrate = clock.lap();
        if self.parameters.removal_waits {
            self.map.remove_separate_from_background(self.parameters.separation)?;
        } else {
            self.map.remove_separate(self.parameters.separation)?;
        }
        timing.separate = clock.lap();

        let FlyingParameters { target_radius, range_std, .. } = self.parameters;
        let (spread, pool) = (self.pose_spread(raw, scan), self.workers.pool());
        let view = ScanView::new(scan, target_radius, range_std, spread, pool);
        let verdicts = judged.verdicts.iter().enumerate();
        let mut found = self.detections(&view, scan, &judged.clusters, verdicts);
        let followed = track(&mut self.tracker, &self.map, &view, scan, &found, stamp_ns)?;
        self.add_followed(judged, &mut found, &followed, &view, scan);
        timing.track = clock.lap();
        Ok(self.frame(raw, &judged.class, scan, found, Some(stats), gate, timing))
    }

    /// Put the scan into the frame of the map; its stamp for the tracker.
    fn prepare(&mut self, raw: &RawScan<'_>, scan: &mut Prepared) -> Result<i64, Error> {
        self.meet(raw.sensor)?;
        self.sensors[raw.sensor].check_stamp(raw.sensor, raw.stamp_ns)?;
        let stamp_ns = self.tracker_stamp(raw.stamp_ns)?;
        self.anchor(raw)?;
        let (sensor, pool) = (&self.sensors[raw.sensor], self.workers.pool());
        scan.take(raw, sensor, &self.map_from_world, pool)?;
        scan.find_sky(raw, sensor, &self.map)?;
        Ok(stamp_ns)
    }

    /// Clusters of a scan and what they are, and the rays into the sums of `integrator`: at the same time
    /// where there are threads for both. What came of casting, if it was done.
    fn judge_and_cast(
        &self,
        raw: &RawScan<'_>,
        scan: &Prepared,
        judged: &mut Judged,
        integrator: &mut Integrator,
        clock: &mut Clock,
        timing: &mut Timing,
    ) -> Result<Option<Result<(), Error>>, Error> {
        let mut judge = || self.judge(scan, judged, clock, timing);
        match self.workers.pool().filter(|_| self.take_off_ground(scan).is_none()) {
            Some(pool) => {
                let (told, cast) = pool.join(judge, || self.cast(raw, scan, integrator));
                told.map(|()| Some(cast))
            }
            None => judge().map(|()| None),
        }
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

    /// Rays into the sky that the last scan was given: unit directions in the world, and how far
    /// they clear [m]. None of them where rays without return are given.
    #[must_use]
    pub fn sky_rays(&self) -> Vec<([f64; 3], f32)> {
        let scan = &self.scratch.scan;
        let Some(look) = scan.look.as_ref().filter(|_| scan.rebuilt > 0) else {
            return Vec::new();
        };
        let world_from_map = self.world_from_map();
        let turned = |&direction| world_from_map.rotate(wide(direction));
        look.directions.iter().map(turned).zip(look.reach.iter().copied()).collect()
    }

    /// A sensor that may be new.
    fn meet(&mut self, name: &str) -> Result<(), Error> {
        let FlyingParameters { sensors, default_sensor, .. } = &self.parameters;
        if self.sensors.contains_key(name) {
            return Ok(());
        }
        check_sensors(self.sensors.len() + 1, name)?;
        let mut sensor = Sensor::new(sensors.get(name).unwrap_or(default_sensor).clone());
        if let Some(saved) = self.recalled.get(name) {
            sensor.recall(saved);
        }
        self.sensors.insert(name.to_owned(), sensor);
        Ok(())
    }

    /// Sensors may fire at the same time; the tracker wants distinct stamps.
    fn tracker_stamp(&self, stamp_ns: i64) -> Result<i64, Error> {
        let stamp_ns = self.tracker.free_stamp(stamp_ns);
        self.tracker.check_stamp(stamp_ns)?;
        Ok(stamp_ns)
    }

    fn needed(&self) -> usize {
        self.parameters.separation.min_confident
    }

    fn accept(&mut self, raw: &RawScan<'_>, scan: &mut Prepared, gate: Gate) {
        let needs_directions = raw.organised && raw.no_return.is_some() && raw.directions.is_none();
        if let Some(sensor) = self.sensors.get_mut(raw.sensor) {
            let look = scan.look.as_deref_mut();
            sensor.learn(
                raw.stamp_ns,
                raw.points,
                raw.no_return,
                &scan.pose,
                look,
                needs_directions,
            );
        }
        // Scans of one sensor come in order, so that no detection is older than a cloud.
        let sensors = self.sensors.len().max(self.parameters.sensors.len());
        self.tracker.keep_points(sensors > 1);
        self.scans = self.scans.saturating_add(1);
        self.reporting = gate == Gate::Open;
        self.held = None;
        if let Some(distance) = self.parameters.forget_distance {
            self.map.forget(scan.pose.translation, distance);
        }
    }

    /// Use nothing of a scan, but remember where it was taken.
    fn hold(
        &mut self,
        raw: &RawScan<'_>,
        scan: &Prepared,
        judged: &mut Judged,
        gate: Gate,
        timing: Timing,
    ) -> Frame {
        let world_from_lidar = self.map_from_world.inverse().after(&scan.pose);
        self.held = Some(Held { sensor: raw.sensor.to_owned(), world_from_lidar });
        judged.tell_nothing(scan);
        self.frame(raw, &judged.class, scan, Found::default(), None, gate, timing)
    }

    #[allow(clippy::too_many_arguments)] // the parts of a frame, each made by another stage
    fn frame(
        &self,
        raw: &RawScan<'_>,
        class: &[u8],
        scan: &Prepared,
        found: Found,
        integrated: Option<IntegrateStats>,
        gate: Gate,
        timing: Timing,
    ) -> Frame {
        let mut point_class = class[..scan.rows].to_vec();
        let (own_rows, own_body) = self.tell_own_body(raw, scan, &mut point_class);
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
            sky: scan.sky,
            sky_share: scan.sky_share,
            sky_rays: scan.rebuilt,
            own_body,
            own_rows,
            own_body_is_decided: self.knows_own_body(raw),
            integrated,
            timing,
        }
    }
}

impl FlyingObjectDetector {
    fn knows_own_body(&self, raw: &RawScan<'_>) -> bool {
        let body = self.sensors.get(raw.sensor).and_then(|sensor| sensor.body.as_ref());
        body.is_some_and(|body| body.is_decided())
    }

    /// Points on the robot are unknown, not invalid; their rows, and the share of rays that end on it.
    fn tell_own_body(
        &self,
        raw: &RawScan<'_>,
        scan: &Prepared,
        class: &mut [u8],
    ) -> (Vec<u32>, f64) {
        let sensor = self.sensors.get(raw.sensor);
        let Some((sensor, body)) = sensor.and_then(|one| Some((one, one.body.as_ref()?))) else {
            return (Vec::new(), 0.0);
        };
        if !body.is_found() {
            return (Vec::new(), 0.0);
        }
        let on_it = |row: usize| {
            raw.no_return.is_none_or(|flags| !flags[row]) && body.holds(wide(raw.points[row]))
        };
        let rows: Vec<u32> =
            (0..raw.points.len()).filter(|&row| on_it(row)).map(|row| row as u32).collect();
        for &row in &rows {
            class[row as usize] = UNKNOWN;
        }
        let share = scan.share_of_rays(&rows, sensor.parameters.returns_per_ray);
        (rows, share)
    }
}

/// # Errors
/// [`Error::Limit`] for more sensors than are remembered.
pub(super) fn check_sensors(len: usize, name: &str) -> Result<(), Error> {
    if len <= MAX_SENSORS {
        return Ok(());
    }
    Err(Error::Limit {
        what: format!("sensor {name:?}, the detector's {len}th"),
        limit: MAX_SENSORS as u64,
        key: "give the scans of one LiDAR one name, always the same",
    })
}

fn go_on(keep_going: &dyn Fn() -> bool) -> Result<(), Error> {
    if keep_going() { Ok(()) } else { Err(Error::Interrupted) }
}

pub(super) fn replace(classes: &mut [u8], old: u8, new: u8) {
    classes.iter_mut().filter(|class| **class == old).for_each(|class| *class = new);
}
