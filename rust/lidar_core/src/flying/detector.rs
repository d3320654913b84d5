//! The detector: it takes raw scans and returns point classes, detections and tracks.
//!
//! Longer than other files: only this file may use the private fields of the detector. Parts in other files would share
//! its whole state.

use super::background::burn_in::BurnIn;
use super::background::pose_jump::{HeldScan, PoseCheck};
use super::background::static_points::StaticPoints;
use super::classify::expected::near_structure;
use super::classify::pockets::free_pockets;
use super::classify::scan_classifier::{ScanClassifier, ScanToClassify};
use super::detect::detection::Teammate;
use super::detect::detections::{ScanDetections, ScanToDetect, detect};
use super::detect::follow_up::{Hints, add_followed, update_tracks, watch};
use super::detect::visibility::ScanView;
use super::frame::{Frame, Timing};
use super::full_state::{DetectorState, KIND, SavedDetector};
use super::integrate::classified_scan::{ClassifiedScan, IntegrateStats};
use super::integrate::integrator::Integrator;
use super::integrate::pose_weights::PoseNoise;
use super::map::local_map::LocalMap;
use super::map::voxel_map::VoxelMap;
use super::moving::ground_movers::GroundMovers;
use super::moving::static_map::StaticMapper;
use super::moving::things::ScanOfMovers;
use super::parameters::FlyingParameters;
use super::point_class::PointClass;
use super::reporting_gate::ReportingGate;
use super::scan::prepared::{Prepared, RawScan};
use super::scan::sensors::Sensors;
use super::track::{PointCloudTracker, Track};
use super::track_before_detect::{ScanOfFew, TrackBeforeDetect};
use crate::Error;
use crate::geometry::lattice::wide;
use crate::geometry::transform::{Transform, minus, norm};
use crate::util::budget::check_scan_memory;
use crate::util::cancel;
use crate::util::full_state::{opened, sealed};
use crate::util::stopwatch::Clock;
use crate::util::threads::Workers;
use std::path::Path;

/// Detection and tracking of flying objects in scans of one or several LiDARs.
pub struct FlyingObjectDetector {
    parameters: FlyingParameters,
    workers: Workers,
    // State between scans.
    local: LocalMap,
    sensors: Sensors,
    teammates: Vec<Teammate>,
    scans: u32,
    burn_in: BurnIn,
    /// Whether tracks are reported: true if the gate of the last used scan was open.
    is_reporting: bool,
    // Stages in the order of their calls; memory of a scan is used again by the next one.
    scan: Prepared,
    pose_check: PoseCheck,
    classifier: ScanClassifier,
    integrator: Integrator,
    static_points: StaticPoints,
    tracker: PointCloudTracker,
    movers: GroundMovers,
    before_detect: TrackBeforeDetect,
    /// Collects static points. None unless a static map is asked for.
    static_map: Option<StaticMapper>,
    makes_static_map: bool,
}

impl FlyingObjectDetector {
    /// A detector that computes on `threads` threads.
    ///
    /// # Errors
    /// [`Error::Parameter`] for values that cannot work.
    pub fn new(parameters: FlyingParameters, threads: usize) -> Result<Self, Error> {
        parameters.check()?;
        let workers = Workers::new(threads)?;
        Ok(Self {
            local: LocalMap::new(&parameters.map)?,
            sensors: Sensors::default(),
            teammates: Vec::new(),
            scans: 0,
            burn_in: BurnIn::default(),
            is_reporting: false,
            scan: Prepared::default(),
            pose_check: PoseCheck::default(),
            classifier: ScanClassifier::default(),
            integrator: Integrator::on(workers.clone()),
            static_points: StaticPoints::default(),
            tracker: PointCloudTracker::new(parameters.tracker, threads)?,
            movers: GroundMovers::default(),
            before_detect: TrackBeforeDetect::default(),
            static_map: None,
            makes_static_map: false,
            workers,
            parameters,
        })
    }

    /// Process one scan: update the map, detect and track flying objects. Returns the results in the world frame.
    ///
    /// # Errors
    /// For input that cannot be used, and [`Error::Interrupted`] if the call is asked to stop before
    /// it changes the map ([`cancel`]); the detector is unchanged then.
    pub fn process(&mut self, raw: &RawScan<'_>) -> Result<Frame, Error> {
        let (was_anchored, was_met) = (self.local.is_anchored, self.sensors.contains(raw.sensor));
        let frame = self.run_stages(raw);
        if frame.is_err() && !was_anchored {
            self.local = LocalMap::new(&self.parameters.map)?; // the next scan says where it begins
        }
        if frame.is_err() && !was_met {
            self.sensors.remove(raw.sensor);
        }
        frame
    }

    fn run_stages(&mut self, raw: &RawScan<'_>) -> Result<Frame, Error> {
        // Longer than other functions: all stages in their order, and nothing else.
        check_scan_memory(raw.points.len())?;
        let (mut clock, mut timing) = (Clock::start(), Timing::default());
        let stamp_ns = self.prepare(raw)?;
        timing.prepare = clock.lap();
        let FlyingParameters { mismatch_share, classify, pose, range_std, .. } = &self.parameters;
        let (local, scan, distance) = (&self.local, &self.scan, classify.close_distance);
        if let Some(gate) =
            self.pose_check.check(&scan.points, &local.map, *mismatch_share, distance)
        {
            cancel::begin_to_write()?;
            #[cfg(canary_10)]
            if self.scan.points.len() > 12 {
                crate::util::planted("canary 10");
            }
            return Ok(self.hold(raw, gate, timing));
        }
        let covariance = raw.pose_covariance;
        let noise = pose.noise(covariance, &scan.pose, local.map_from_world, *range_std);
        let (burn_in, gate) = self.next_burn_in(raw);
        let cast = self.classify_and_cast(&noise, stamp_ns, &mut clock, &mut timing)?;
        self.tracker.check_room(self.classifier.count_of(PointClass::Flying))?;

        // The last stage that may refuse the scan.
        let seed = &self.parameters.seed;
        self.static_points.look(&self.scan.points, gate, seed, &self.local.map);
        let stats = self.update_map(&noise, cast)?;
        self.map_what_stands();
        let standing = self.accept(raw, burn_in, gate);
        timing.integrate = clock.lap();
        if self.parameters.removal_waits {
            self.local.map.remove_separate_from_background(self.parameters.separation)?;
        } else {
            self.local.map.remove_separate(self.parameters.separation)?;
        }
        timing.separate = clock.lap();

        let found = self.detect_and_track(noise, stamp_ns, &standing)?;
        timing.track = clock.lap();
        Ok(self.frame(raw, found, Some(stats), gate, timing))
    }

    /// Transform the scan to the frame of the map. Returns its stamp for the tracker [ns].
    fn prepare(&mut self, raw: &RawScan<'_>) -> Result<i64, Error> {
        let sensor = self.sensors.meet(raw.sensor, &self.parameters)?;
        sensor.check_stamp(raw.sensor, raw.stamp_ns)?;
        // Sensors may fire at the same time; the tracker wants distinct stamps.
        let stamp_ns = self.tracker.free_stamp(raw.stamp_ns);
        self.tracker.check_stamp(stamp_ns)?;
        if let Some(pose) = raw.poses.first() {
            self.local.anchor(&self.parameters.map, [pose[3], pose[7], pose[11]])?;
        }
        self.scan.take(raw, sensor, &self.local.map_from_world, self.workers.pool())?;
        self.scan.find_sky(raw, sensor, &self.local.map)?;
        cancel::check()?;
        Ok(stamp_ns)
    }

    /// The burn-in with this scan, and whether the detections of this scan are reported.
    fn next_burn_in(&self, raw: &RawScan<'_>) -> (BurnIn, ReportingGate) {
        let FlyingParameters { seed, separation, .. } = &self.parameters;
        let sensor = self.sensors.get(raw.sensor);
        let step = sensor.and_then(|sensor| sensor.since_last(raw.stamp_ns));
        let next = self.burn_in.after(step, seed);
        let gate = self.burn_in.gate(&next, seed, &self.local.map, separation.min_confident);
        (next, gate)
    }

    /// Find clusters and their classes, and cast the rays (at the same time, if there are threads for both). Returns
    /// the result of casting. None if the rays were not cast.
    fn classify_and_cast(
        &mut self,
        noise: &PoseNoise,
        stamp_ns: i64,
        clock: &mut Clock,
        timing: &mut Timing,
    ) -> Result<Option<Result<(), Error>>, Error> {
        // Longer than other functions: two closures run side by side and borrow most stages, which a
        // split would pass on as a dozen arguments.
        let waits = self.take_off_ground().is_some(); // points of it are added after classification
        let Self {
            parameters,
            workers,
            local,
            burn_in,
            scan,
            classifier,
            integrator,
            movers,
            tracker,
            ..
        } = self;
        let (background_extent, pool) = (burn_in.background_extent(parameters), workers.pool());
        let distance = parameters.classify.close_distance;
        let follows = parameters.classify.follow_tracks;
        let targets = if follows { tracker.expected_at(stamp_ns) } else { Vec::new() };
        let expected = near_structure(targets, &local.map, distance);
        let in_air = movers.beside_air(&scan.points, local.map.lattice());
        let input = ScanToClassify {
            scan,
            local,
            background_extent,
            parameters,
            expected: &expected,
            in_air: &in_air,
            pool,
        };
        let watch = cancel::watch();
        let mut classify = || {
            watch.run(|| {
                let [cluster_ms, classify_ms] = classifier.classify(&input, clock)?;
                if parameters.tells_movers() {
                    let things = classifier.unknown_things(&input);
                    let origin = scan.pose.translation;
                    let (points, class) = (scan.points.as_slice(), classifier.class());
                    let (maybe_own, floor) = (&scan.maybe_own[..], scan.floor);
                    let to_search =
                        ScanOfMovers { points, class, maybe_own, origin, floor, things: &things };
                    movers.find(&to_search, &local.map, stamp_ns)?;
                    classifier.lift(&input, movers.in_air(), movers.over_unseen());
                }
                Ok::<_, Error>([cluster_ms, classify_ms + clock.lap()])
            })
        };
        let (classified, cast) = match pool.filter(|_| !waits) {
            Some(pool) => {
                let rays = ClassifiedScan::before_classes(scan, noise);
                let mut cast = || watch.run(|| integrator.cast(&local.map, &rays));
                let (classified, cast) = pool.join(classify, &mut cast);
                (classified, Some(cast))
            }
            None => (classify(), None),
        };
        [timing.cluster, timing.classify] = classified?;
        Ok(cast)
    }

    /// Points on the ground below the first position of the sensor. None if the height of the sensor is not known.
    fn take_off_ground(&self) -> Option<[[f32; 3]; 2]> {
        let ground = self.parameters.seed.take_off_ground(self.scan.pose.translation);
        ground.filter(|_| self.scans == 0)
    }

    /// Update the map with the scan, and classify again on the updated map if the parameters require it. `cast`: result
    /// of casting the rays; None if they were not cast yet.
    fn update_map(
        &mut self,
        noise: &PoseNoise,
        cast: Option<Result<(), Error>>,
    ) -> Result<IntegrateStats, Error> {
        let ground = self.take_off_ground();
        let Self { parameters, workers, local, burn_in, scan, classifier, integrator, .. } = self;
        match cast {
            Some(outcome) => outcome?,
            None => {
                for point in ground.into_iter().flatten() {
                    scan.append_known(point);
                    classifier.add_row(PointClass::Background);
                }
                integrator.cast(&local.map, &ClassifiedScan::before_classes(scan, noise))?;
            }
        }
        let stats = integrator.apply(&mut local.map, classifier.class(), noise.error.as_ref())?;
        if parameters.classify.after_update {
            let background_extent = burn_in.background_extent(parameters);
            let pool = workers.pool();
            let input = ScanToClassify {
                scan,
                local,
                background_extent,
                parameters,
                expected: &[],
                in_air: &[],
                pool,
            };
            classifier.reclassify(&input)?;
        }
        Ok(stats)
    }

    /// Store the observations of an accepted scan. Returns the indices of the clusters in free space that have become
    /// background because they stand still.
    fn accept(&mut self, raw: &RawScan<'_>, burn_in: BurnIn, gate: ReportingGate) -> Vec<usize> {
        if self.parameters.tells_movers() {
            self.movers.accept();
        }
        let Self { parameters, local, sensors, scan, classifier, static_points, tracker, .. } =
            self;
        if let Some(sensor) = sensors.get_mut(raw.sensor) {
            let observation = scan.sky_observation.as_deref_mut();
            sensor.learn_from(raw, &scan.pose, observation, scan.sweep.as_ref());
        }
        // Scans of one sensor come in order, so that no detection is older than a cloud.
        tracker.keep_points(sensors.len().max(parameters.sensors.len()) > 1);
        self.scans = self.scans.saturating_add(1);
        (self.burn_in, self.is_reporting) = (burn_in, gate == ReportingGate::Open);
        self.pose_check.held = None;
        let FlyingParameters { forget_distance, classify, seed, .. } = parameters;
        if let Some(distance) = *forget_distance {
            local.map.forget(scan.pose.translation, distance);
        }
        if classify.fill_pockets {
            free_pockets(&mut local.map, classifier.classifications(), &scan.points);
        }
        let distance = classify.close_distance;
        let map = &mut local.map;
        let found = (&scan.points[..], classifier.clusters(), classifier.classifications());
        let standing = static_points.take(found, gate, seed, distance, map, tracker);
        let input = ScanToClassify {
            scan,
            local,
            background_extent: None,
            parameters,
            expected: &[],
            in_air: &[],
            pool: None,
        };
        classifier.standing_in_air(&standing, &input)
    }

    /// Detections of the scan, including those that only tracks show, in the frame of the map.
    fn detect_and_track(
        &mut self,
        noise: PoseNoise,
        stamp_ns: i64,
        standing: &[usize],
    ) -> Result<ScanDetections, Error> {
        // Longer than other functions: the inputs of all stages, which borrow from the same fields.
        let Self {
            parameters,
            workers,
            local,
            teammates,
            scan,
            classifier,
            tracker,
            burn_in,
            movers,
            before_detect,
            ..
        } = self;
        let FlyingParameters { target_radius, range_std, .. } = *parameters;
        let view = ScanView::new(scan, target_radius, range_std, noise.spread, workers.pool());
        let map_from_world = local.map_from_world;
        let input = ScanToDetect { scan, view: &view, teammates, map_from_world, parameters };
        let classifications = classifier.classifications().iter().enumerate();
        let mut found = detect(&input, classifier.clusters(), classifications);
        watch(tracker, &input, classifier, standing, stamp_ns);
        let (background_extent, pool) = (burn_in.background_extent(parameters), workers.pool());
        let (expected, in_air) = (&[], &[]); // the classes are known
        let classified =
            ScanToClassify { scan, local, background_extent, parameters, expected, in_air, pool };
        let few = parameters.few_returns().map(|max_distance| ScanOfFew {
            scan,
            map: &local.map,
            clusters: classifier.clusters(),
            parameters: &parameters.classify,
            max_distance,
            stamp_ns,
        });
        if let Some(few) = &few {
            before_detect.look(few);
        }
        let hints = Hints { classifier, before_detect };
        let followed = update_tracks(tracker, &classified, &hints, &view, &found, stamp_ns)?;
        if let Some(few) = few.filter(|_| self.is_reporting) {
            let mut tracked = tracker.confirmed_places();
            tracked.extend(teammates.iter().map(|mate| map_from_world.apply(mate.position)));
            tracker.adopt(&before_detect.weigh(&few, &tracked), stamp_ns);
        }
        add_followed(&input, &local.map, classifier, &mut found, &followed.rows);
        movers.leave_flying(classifier.class());
        let far = parameters.classify.max_distance;
        let is_near = |place: [f64; 3]| {
            far.is_none_or(|far| norm(minus(place, scan.pose.translation)) <= far)
        };
        let unknown = scan.points.iter().zip(classifier.class());
        let unknown = unknown
            .filter(|(point, class)| **class == PointClass::Unknown && is_near(wide(**point)));
        tracker.remember(stamp_ns, unknown.map(|(point, _)| *point));
        for index in followed.on_ground.iter().filter_map(|&row| classifier.cluster_of(row)) {
            movers.add(classifier.clusters().get(index).members);
        }
        Ok(found)
    }

    /// The frame of a scan that is held: nothing of it is used, except that its pose is stored.
    fn hold(&mut self, raw: &RawScan<'_>, gate: ReportingGate, timing: Timing) -> Frame {
        let world_from_lidar = self.local.world_from_map().after(&self.scan.pose);
        self.pose_check.held = Some(HeldScan { sensor: raw.sensor.to_owned(), world_from_lidar });
        self.classifier.leave_unknown(&self.scan);
        self.movers.skip();
        self.frame(raw, ScanDetections::default(), None, gate, timing)
    }

    fn frame(
        &self,
        raw: &RawScan<'_>,
        found: ScanDetections,
        integrated: Option<IntegrateStats>,
        gate: ReportingGate,
        timing: Timing,
    ) -> Frame {
        let (scan, class) = (&self.scan, self.classifier.class());
        let tracks = self.tracks_at(raw.stamp_ns);
        let frame =
            Frame { tracks, gate, integrated, timing, ..Frame::of(raw.stamp_ns, scan, class) };
        let frame = frame.with_own_body(self.sensors.own_body(raw, scan));
        let frame = frame.with_detections(&found, &self.local.world_from_map());
        frame.with_movers(self.movers.rows())
    }

    /// Reported tracks predicted to `stamp_ns`, world frame. With it, a caller can compensate latency.
    #[must_use]
    pub fn tracks_at(&self, stamp_ns: i64) -> Vec<Track> {
        if !self.is_reporting {
            return Vec::new();
        }
        let mut tracks = self.hypotheses_at(stamp_ns);
        tracks.retain(|track| track.reported);
        tracks
    }

    /// All tracks, also those that are not reported, predicted to `stamp_ns`, world frame.
    #[must_use]
    pub fn hypotheses_at(&self, stamp_ns: i64) -> Vec<Track> {
        let world_from_map = self.local.world_from_map();
        let tracks = self.tracker.tracks_at(stamp_ns);
        tracks.into_iter().map(|track| track.moved(&world_from_map)).collect()
    }

    /// Set the known flying objects. In the following frames they are labelled and not reported as detections.
    pub fn set_teammates(&mut self, teammates: Vec<Teammate>) {
        self.teammates = teammates;
    }

    /// The voxel map. Its coordinates are relative to its origin.
    #[must_use]
    pub fn map(&self) -> &VoxelMap {
        &self.local.map
    }

    /// Rays into the sky in the last scan: unit directions in the world, and lengths that they clear [m]. Empty if
    /// the caller gives the rays without return.
    #[must_use]
    pub fn sky_rays(&self) -> Vec<([f64; 3], f32)> {
        self.scan.sky_rays(&self.local.world_from_map())
    }

    /// Make the voxels of `points` [m, world] permanently occupied or free (sec. III-E).
    ///
    /// # Errors
    /// As [`VoxelMap::set_free`].
    pub fn set_known(&mut self, points: &[[f64; 3]], occupied: bool) -> Result<(), Error> {
        self.local.set_known(&self.parameters.map, points, occupied)
    }

    /// Use a map, such as that of an earlier run. The configured parameters stay in force.
    ///
    /// # Errors
    /// [`Error::Parameter`] if its voxels do not have the configured size.
    pub fn set_map(&mut self, map: VoxelMap) -> Result<(), Error> {
        self.local.replace(&self.parameters.map, map)?;
        self.forget_motion();
        Ok(())
    }

    /// Write the map and the known voxels of the robot itself to a file. [`VoxelMap::load`] also reads such files.
    ///
    /// # Errors
    /// As [`VoxelMap::save`].
    pub fn save_map(&self, path: &Path) -> Result<(), Error> {
        self.local.map.save_with(path, &self.sensors.bodies())
    }

    /// Load a map from a file. Sensors that have not found the robot itself use the voxels of the robot in the file.
    ///
    /// # Errors
    /// As [`VoxelMap::load`] and [`FlyingObjectDetector::set_map`]; the detector is unchanged then.
    pub fn load_map(&mut self, path: &Path) -> Result<(), Error> {
        let (map, bodies) = VoxelMap::load_with(path)?;
        self.set_map(map)?;
        self.sensors.recall(bodies);
        Ok(())
    }

    /// Collect a map of all static points from the next scan on.
    pub fn make_static_map(&mut self) {
        self.makes_static_map = true;
    }

    /// Static points [m, world], a few centimetres apart. Empty without [`Self::make_static_map`].
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub fn static_points(&self) -> Result<Vec<[f64; 3]>, Error> {
        let (world_from_map, pool) = (self.local.world_from_map(), self.workers.pool());
        let Some(map) = &self.static_map else { return Ok(Vec::new()) };
        Ok(map.points(pool)?.into_iter().map(|point| world_from_map.apply(wide(point))).collect())
    }

    /// Write the voxels of static points to a file that [`VoxelMap::load`] reads.
    ///
    /// # Errors
    /// [`Error::Parameter`] if no scan was processed since [`Self::make_static_map`]; as
    /// [`VoxelMap::save`], and [`Error::Interrupted`].
    pub fn save_static_map(&self, path: &Path) -> Result<(), Error> {
        let Some(map) = &self.static_map else {
            return Err(Error::Parameter {
                name: "save_static_map",
                expected: "a call of make_static_map before the first scan, and a scan after it",
                got: "no scan of a static map".into(),
            });
        };
        map.cleaned(self.local.map.parameters(), self.workers.pool())?.save(path)
    }

    /// Add the scan to the static map, if this is asked for.
    fn map_what_stands(&mut self) {
        if self.makes_static_map {
            self.static_map.get_or_insert_default().take(&self.scan);
        }
    }

    /// Points [m, world] in the frame of the map.
    #[must_use]
    pub fn in_map(&self, points: &[[f64; 3]]) -> Vec<[f32; 3]> {
        self.local.local(points)
    }

    /// Pose of the map's frame in the world.
    #[must_use]
    pub fn world_from_map(&self) -> Transform {
        self.local.world_from_map()
    }

    /// The whole state between two scans as bytes, for [`Self::from_state`]. The rays of [`Self::sky_rays`] are not
    /// included.
    ///
    /// # Errors
    /// [`Error::Limit`] if the bytes do not fit into memory.
    pub fn to_state(&self) -> Result<Vec<u8>, Error> {
        // One that was asked for begins with the next scan, also of the object that is restored.
        let asked = self.makes_static_map && self.static_map.is_none();
        let begun = asked.then(StaticMapper::default);
        let state = DetectorState {
            local: self.local.state(),
            sensors: self.sensors.saved(),
            teammates: &self.teammates,
            scans: self.scans,
            burn_in: &self.burn_in,
            is_reporting: self.is_reporting,
            held: &self.pose_check.held,
            static_points: self.static_points.saved(),
            tracker: self.tracker.state(),
            movers: self.movers.saved(),
            before_detect: self.before_detect.saved(),
            static_map: self.static_map.as_ref().or(begun.as_ref()).map(StaticMapper::state),
        };
        sealed(KIND, &self.parameters, &state)
    }

    /// The detector of a saved state. Its later results are equal to those of the saved detector, bit by bit.
    ///
    /// # Errors
    /// Errors of [`FlyingObjectDetector::new`]; [`Error::Format`] for bytes that
    /// [`FlyingObjectDetector::to_state`] did not make, [`Error::Parameter`] for the state of a
    /// detector with other parameters.
    pub fn from_state(
        parameters: FlyingParameters,
        threads: usize,
        bytes: &[u8],
    ) -> Result<Self, Error> {
        let saved: SavedDetector = opened(KIND, &parameters, bytes)?;
        let mut detector = Self::new(parameters, threads)?;
        detector.local = LocalMap::restored(saved.local)?;
        detector.sensors = Sensors::restored(saved.sensors, &detector.parameters)?;
        detector.teammates = saved.teammates;
        (detector.scans, detector.burn_in) = (saved.scans, saved.burn_in);
        (detector.is_reporting, detector.pose_check.held) = (saved.is_reporting, saved.held);
        detector.static_points = StaticPoints::restored(saved.static_points)?;
        detector.tracker.restore(saved.tracker)?;
        detector.movers = GroundMovers::restored(saved.movers)?;
        detector.before_detect = TrackBeforeDetect::restored(saved.before_detect)?;
        detector.static_map = saved.static_map.map(StaticMapper::restored).transpose()?;
        detector.makes_static_map = detector.static_map.is_some();
        Ok(detector)
    }

    /// Accept a jump of the pose: shift the world so that the pose of the held scan equals that of the last used scan
    /// of the same sensor. Returns false if no scan is held, or if the sensor had no scan before.
    pub fn reanchor(&mut self) -> bool {
        let Some(held) = self.pose_check.held.take() else { return false };
        let last = self.sensors.get(&held.sensor).and_then(|sensor| sensor.last_pose);
        let Some(last) = last else { return false };
        self.local.map_from_world = last.after(&held.world_from_lidar.inverse());
        true
    }

    /// Forget map, tracks and poses. The IDs of later tracks continue. What was learnt about the
    /// sensors is kept, unless other sensors need the room.
    ///
    /// # Errors
    /// Only errors that [`FlyingObjectDetector::new`] could also have had.
    pub fn reset(&mut self) -> Result<(), Error> {
        self.local = LocalMap::new(&self.parameters.map)?;
        (self.scans, self.burn_in) = (0, BurnIn::default());
        self.forget_motion();
        self.sensors.forget_stamps();
        Ok(())
    }

    /// Forget tracks, and poses in the frame of a map that is no longer used.
    fn forget_motion(&mut self) {
        self.tracker.reset();
        (self.is_reporting, self.pose_check.held) = (false, None);
        self.static_points.clear();
        self.movers.clear();
        self.before_detect.clear();
        self.static_map = None;
        self.sensors.forget_places();
    }
}
