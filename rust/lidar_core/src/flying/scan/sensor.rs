//! State of the detector for one LiDAR: last stamp, the robot itself, rays.
//!
//! Longer than other files: parameters, state and saved state of a sensor name the same properties.

use super::body::Body;
use super::raw_scan::RawScan;
use super::untimed::{SweepMotion, Untimed};
use crate::Error;
use crate::flying::map::saved_body::SavedBody;
use crate::flying::sky::source::SkySource;
use crate::flying::sky::{Beams, RayPattern, ScanToObserve, Sky, SkyObservation};
use crate::geometry::lattice::wide;
use crate::geometry::transform::{Transform, minus, norm};
use crate::util::full_state::impossible;
use serde::{Deserialize, Serialize};

/// A range of directions in the lidar frame [rad]: azimuth from, to, elevation from, to. If the azimuth crosses +-pi,
/// "from" is larger than "to".
pub type Sector = [f64; 4];

/// Longest time between two scans from which the motion of the sensor is computed [s].
const LONGEST_PAUSE: f64 = 1.0;

/// Parameters of one LiDAR.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorParameters {
    /// Smallest range of the returns that are used [m].
    pub min_range: f64,
    /// Corners of a box around the robot, lidar frame [m]. Returns inside are not used. None: no box.
    pub self_box: Option<[[f64; 3]; 2]>,
    /// Directions towards the robot itself. Their rays are not used.
    pub blind_sectors: Vec<Sector>,
    /// For each index of a point in the cloud, whether the ray with this index hits the robot. None: not known.
    pub self_mask: Option<Vec<bool>>,
    /// Number of first scans from which the directions towards the robot are learnt. 0: they are not learnt.
    pub learn_mask_scans: u32,
    /// Range within which repeated returns from one direction are of the robot [m]. These returns, and rays without
    /// return in such directions, are not used.
    pub learn_mask_range: f64,
    /// If true, masks apply only to rays without return, else to all rays.
    pub mask_empty_only: bool,
    /// How the directions of rays without return are known.
    pub beams: Beams,
    /// Names and ray patterns of known sensors. Error messages suggest these names.
    pub known_sensors: Vec<(String, RayPattern)>,
    /// If true, the robot is found from returns that stay in place in the sensor's frame.
    pub find_body: bool,
    /// Number of returns per ray. The cloud contains this number of equal parts, one per return.
    pub returns_per_ray: usize,
}

/// Best mode: rays without return, and the robot itself, are found from the returns.
impl Default for SensorParameters {
    fn default() -> Self {
        Self {
            min_range: 0.3,
            self_box: None,
            blind_sectors: Vec::new(),
            self_mask: None,
            learn_mask_scans: 10,
            learn_mask_range: 1.0,
            mask_empty_only: false,
            beams: Beams::Learnt,
            known_sensors: Vec::new(),
            find_body: true,
            returns_per_ray: 1,
        }
    }
}

impl SensorParameters {
    /// Every return is used at any range, and neither the robot nor the sky is searched for.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            min_range: 0.0,
            learn_mask_scans: 0,
            beams: Beams::Given,
            find_body: false,
            ..Self::default()
        }
    }
}

/// State of one LiDAR.
#[derive(Clone, Debug)]
pub(crate) struct Sensor {
    pub(crate) parameters: SensorParameters,
    pub(crate) last_stamp_ns: Option<i64>,
    /// Pose of the sensor at the last scan that was used, in the frame of the map.
    pub(crate) last_pose: Option<Transform>,
    /// State of the search for the sky. None if rays without return are given.
    pub(crate) sky: Option<Sky>,
    pub(crate) body: Option<Box<Body>>,
    /// What is known about clouds without times. None if the times are as given.
    untimed: Option<Untimed>,
    learnt_scans: u32,
    /// Whether the air was ever full of droplets.
    is_in_droplets: bool,
    /// For each cell of direction, the number of scans with a near return.
    near_counts: Vec<u32>,
    directions: Vec<[f32; 3]>,
}

/// [`Sensor`] in a saved state, without its parameters.
#[derive(Serialize, Deserialize)]
pub(super) struct SavedSensor {
    last_stamp_ns: Option<i64>,
    last_pose: Option<Transform>,
    sky: Option<Sky>,
    body: Option<Box<Body>>,
    untimed: Option<Untimed>,
    learnt_scans: u32,
    is_in_droplets: bool,
    near_counts: Vec<u32>,
    directions: Vec<[f32; 3]>,
}

impl Sensor {
    pub(crate) fn new(parameters: SensorParameters) -> Self {
        Self {
            sky: Sky::of(&parameters.beams),
            body: parameters.find_body.then(Box::default),
            untimed: (parameters.beams != Beams::Given).then(Untimed::default),
            parameters,
            last_stamp_ns: None,
            last_pose: None,
            learnt_scans: 0,
            is_in_droplets: false,
            near_counts: Vec::new(),
            directions: Vec::new(),
        }
    }

    /// The state to save, without `parameters`. A sensor restored from it gives the same results, bit by bit.
    pub(super) fn saved(&self) -> SavedSensor {
        SavedSensor {
            last_stamp_ns: self.last_stamp_ns,
            last_pose: self.last_pose,
            sky: self.sky.clone(),
            body: self.body.clone(),
            untimed: self.untimed.clone(),
            learnt_scans: self.learnt_scans,
            is_in_droplets: self.is_in_droplets,
            near_counts: self.near_counts.clone(),
            directions: self.directions.clone(),
        }
    }

    /// Restore the saved state of a sensor with the same parameters.
    ///
    /// # Errors
    /// [`Error::Format`] for a state that no sensor has.
    pub(super) fn restore(&mut self, saved: SavedSensor) -> Result<(), Error> {
        match (&mut self.sky, saved.sky) {
            (Some(sky), Some(saved)) => sky.restore(saved)?,
            (None, None) => {}
            _ => return Err(impossible("a sensor with other sources of its rays")),
        }
        let cells = [0, 6 * FACE_CELLS * FACE_CELLS];
        if self.body.is_some() != saved.body.is_some()
            || !saved.body.as_ref().is_none_or(|body| body.is_whole())
            || self.untimed.is_some() != saved.untimed.is_some()
            || !saved.untimed.as_ref().is_none_or(Untimed::is_whole)
            || !cells.contains(&saved.near_counts.len())
        {
            return Err(impossible("parts of a sensor contradict each other"));
        }
        (self.last_stamp_ns, self.last_pose) = (saved.last_stamp_ns, saved.last_pose);
        (self.body, self.untimed) = (saved.body, saved.untimed);
        self.learnt_scans = saved.learnt_scans;
        self.is_in_droplets = saved.is_in_droplets;
        (self.near_counts, self.directions) = (saved.near_counts, saved.directions);
        Ok(())
    }

    /// Time since the last scan [s]; None before the first one.
    pub(crate) fn since_last(&self, stamp_ns: i64) -> Option<f64> {
        self.last_stamp_ns.map(|last| stamp_ns.saturating_sub(last) as f64 * 1e-9)
    }

    /// Check that a scan is newer than all earlier ones of this sensor.
    ///
    /// # Errors
    /// [`Error::Time`] if `stamp_ns` is not newer than the last scan of this sensor.
    pub(crate) fn check_stamp(&self, name: &str, stamp_ns: i64) -> Result<(), Error> {
        match self.last_stamp_ns {
            Some(last) if stamp_ns <= last => Err(Error::Time {
                what: format!(
                    "stamp_ns: expected a stamp after {last}, the last scan of sensor {name:?}, got \
                     {stamp_ns}; a late or repeated scan cannot be used"
                ),
            }),
            _ => Ok(()),
        }
    }

    /// True if the return `point` [m, lidar frame] with the index `row` is on the robot itself, or too near.
    pub(crate) fn is_own(&self, row: usize, point: [f64; 3]) -> bool {
        let p = &self.parameters;
        let range = norm(point);
        let in_box = p.self_box.is_some_and(|[low, high]| {
            (0..3).all(|axis| (low[axis]..=high[axis]).contains(&point[axis]))
        });
        let is_robot = range < p.learn_mask_range
            && (self.learnt_scans < p.learn_mask_scans || self.is_learnt(point));
        // Drivers mark a ray without return by a point at the sensor: it is never a measurement.
        range <= 0.0
            || range < p.min_range
            || in_box
            || is_robot
            || self.body.as_ref().is_some_and(|body| body.contains(point))
            || (!p.mask_empty_only && self.is_named(row, point))
    }

    /// True if the ray with the index `row` and the direction `direction` (lidar frame) hits the robot itself.
    pub(crate) fn is_masked(&self, row: usize, direction: [f64; 3]) -> bool {
        self.is_learnt(direction) || self.is_named(row, direction)
    }

    /// True if the configuration states that this ray hits the robot.
    fn is_named(&self, row: usize, direction: [f64; 3]) -> bool {
        let p = &self.parameters;
        p.self_mask.as_ref().is_some_and(|mask| mask.get(row) == Some(&true))
            || p.blind_sectors.iter().any(|sector| is_inside(sector, direction))
    }

    /// True if at least a fifth of the learning scans had a near return in this direction (lidar frame).
    fn is_learnt(&self, direction: [f64; 3]) -> bool {
        self.learnt_scans >= self.parameters.learn_mask_scans
            && !self.near_counts.is_empty()
            && self
                .near_counts
                .get(cell_of(direction))
                .is_some_and(|&count| 5 * count >= self.parameters.learn_mask_scans.max(1))
    }

    /// Stored direction of the ray with the index `row`, for clouds without directions. None if this ray never had a
    /// return.
    pub(crate) fn direction(&self, row: usize) -> Option<[f32; 3]> {
        self.directions.get(row).copied().filter(|direction| direction[0].is_finite())
    }

    /// Estimate the sky from a scan. Returns false if the sky is not estimated, or not known yet.
    pub(crate) fn observe_sky(
        &self,
        scan: &ScanToObserve<'_>,
        observation: &mut SkyObservation,
    ) -> bool {
        let Some(sky) = &self.sky else { return false };
        observation.fill(sky, scan);
        sky.is_known_at(scan.stamp_ns) && observation.has_returns()
    }

    /// Source of the rays without return of a scan, if the detector finds them. `Unknown` if the caller gives them, or
    /// if the sky is not known yet.
    pub(crate) fn sky_source(&self, stamp_ns: i64) -> SkySource {
        match &self.sky {
            Some(sky) if !sky.is_known_at(stamp_ns) => SkySource::Unknown,
            Some(sky) if sky.has_rows() => SkySource::Pattern,
            Some(_) => SkySource::Density,
            None => SkySource::Unknown,
        }
    }

    /// Use the voxels of the robot that an earlier run found.
    pub(crate) fn recall(&mut self, saved: &SavedBody) {
        if let Some(body) = &mut self.body {
            body.recall(&saved.voxels, saved.is_decided);
        }
    }

    /// Forget everything that depends on the frame of a map that is no longer used.
    pub(crate) fn forget_places(&mut self) {
        if let Some(sky) = &mut self.sky {
            sky.forget_places();
        }
        if let Some(body) = &mut self.body {
            body.forget_places();
        }
    }

    fn count_near(&mut self, points: &[[f32; 3]], is_droplet: &[bool]) {
        let cells = 6 * FACE_CELLS * FACE_CELLS;
        self.near_counts.resize(cells, 0);
        let mut near = vec![false; cells];
        for (row, point) in points.iter().map(|&point| wide(point)).enumerate() {
            let range = norm(point);
            let is_near = range > 0.0 && range < self.parameters.learn_mask_range;
            if is_near && is_droplet.get(row) != Some(&true) {
                near[cell_of(point)] = true;
            }
        }
        for (count, near) in self.near_counts.iter_mut().zip(near) {
            *count += u32::from(near);
        }
    }

    /// Learn from an accepted scan. `pose`: that of the sensor in the frame of the map.
    pub(crate) fn learn_from(
        &mut self,
        raw: &RawScan<'_>,
        pose: &Transform,
        observation: Option<&mut SkyObservation>,
        sweep: Option<&SweepMotion>,
    ) {
        let seconds = self.since_last(raw.stamp_ns);
        if let Some(untimed) = &mut self.untimed {
            untimed.learn(sweep.map_or(0.0, |motion| motion.evidence), seconds);
        }
        let needs_directions = raw.organised && raw.no_return.is_some() && raw.directions.is_none();
        self.learn(raw.stamp_ns, raw.points, raw.no_return, pose, observation, needs_directions);
    }

    /// Vector from the pose of the last scan to `pose`, frame of the map [m]. Zero if there was no last scan, or if it
    /// is too old.
    pub(super) fn moved(&self, pose: &Transform, stamp_ns: i64) -> [f64; 3] {
        let is_recent = self.since_last(stamp_ns).is_some_and(|seconds| seconds <= LONGEST_PAUSE);
        match self.last_pose.filter(|_| is_recent) {
            Some(last) => minus(pose.translation, last.translation),
            None => [0.0; 3],
        }
    }

    /// Motion of the sensor during a scan without times, whose pose is `pose` in the frame of the map. None if it is
    /// not known, or if times are as given.
    pub(super) fn sweep_motion(&self, raw: &RawScan<'_>, pose: &Transform) -> Option<SweepMotion> {
        let seconds = self.since_last(raw.stamp_ns).filter(|&seconds| seconds <= LONGEST_PAUSE)?;
        let motion = self.last_pose?.inverse().after(pose);
        self.untimed.as_ref()?.motion(raw, self.parameters.returns_per_ray, &motion, seconds)
    }

    /// Learn properties of the sensor from an accepted scan.
    fn learn(
        &mut self,
        stamp_ns: i64,
        points: &[[f32; 3]],
        no_return: Option<&[bool]>,
        pose: &Transform,
        observation: Option<&mut SkyObservation>,
        needs_directions: bool,
    ) {
        // Longer than other functions: one step for every property of the sensor.
        self.last_stamp_ns = Some(stamp_ns);
        self.last_pose = Some(*pose);
        let mut is_droplet: &[bool] = &[];
        if let (Some(sky), Some(observation)) = (&mut self.sky, observation) {
            sky.take(observation, points);
            is_droplet = observation.is_droplet();
        }
        if !is_droplet.is_empty() && !self.is_in_droplets {
            // Near returns so far may have been of droplets.
            (self.is_in_droplets, self.learnt_scans) = (true, 0);
            self.near_counts.clear();
        }
        if let Some(body) = &mut self.body {
            let is_empty = |row: usize| no_return.is_some_and(|flags| flags[row]);
            let is_drop = |row: usize| is_droplet.get(row).is_some_and(|&is_one| is_one);
            body.learn(points, |row| !is_empty(row) && !is_drop(row), pose);
        }
        if self.learnt_scans < self.parameters.learn_mask_scans {
            self.learnt_scans += 1;
            self.count_near(points, is_droplet);
        }
        if needs_directions {
            if self.directions.len() != points.len() {
                self.directions.clear(); // another mode of the sensor: other rays
            }
            self.directions.resize(points.len(), [f32::NAN; 3]);
            for (direction, &point) in self.directions.iter_mut().zip(points) {
                let range = norm(wide(point)) as f32;
                if range.is_finite() && range > 0.0 {
                    *direction = point.map(|value| value / range);
                }
            }
        }
    }
}

/// Number of cells along the edge of a face of the cube of directions: 2 degrees each.
const FACE_CELLS: usize = 48;

/// Index of the cell of a direction, which need not be a unit vector, on the six faces of a cube.
fn cell_of(direction: [f64; 3]) -> usize {
    let mut axis = 0;
    for other in 1..3 {
        if direction[other].abs() > direction[axis].abs() {
            axis = other;
        }
    }
    let face = 2 * axis + usize::from(direction[axis] < 0.0);
    let place = |other: usize| {
        let share = 0.5 + 0.5 * direction[other % 3] / direction[axis].abs();
        ((share * FACE_CELLS as f64) as usize).min(FACE_CELLS - 1) // NaN gives 0
    };
    (face * FACE_CELLS + place(axis + 1)) * FACE_CELLS + place(axis + 2)
}

fn is_inside(&[from, to, low, high]: &Sector, direction: [f64; 3]) -> bool {
    let azimuth = libm::atan2(direction[1], direction[0]);
    let elevation = libm::atan2(direction[2], libm::hypot(direction[0], direction[1]));
    let turned =
        if from <= to { (from..=to).contains(&azimuth) } else { azimuth >= from || azimuth <= to };
    turned && (low..=high).contains(&elevation)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn parameters() -> SensorParameters {
        SensorParameters {
            min_range: 0.3,
            self_box: None,
            blind_sectors: Vec::new(),
            self_mask: None,
            learn_mask_scans: 0,
            learn_mask_range: 1.0,
            mask_empty_only: false,
            beams: Beams::Given,
            known_sensors: Vec::new(),
            find_body: false,
            returns_per_ray: 1,
        }
    }

    #[test]
    fn near_returns_of_droplets_hide_nothing_and_those_of_the_robot_do() {
        let learns = SensorParameters { learn_mask_scans: 10, ..parameters() };
        let points = [[0.6, 0.0, 0.1], [0.0, 0.7, 0.1]];
        let mut sensor = Sensor::new(learns);
        for _ in 0..10 {
            sensor.learnt_scans += 1;
            sensor.count_near(&points, &[true, false]);
        }
        assert!(!sensor.is_masked(0, wide(points[0])) && sensor.is_masked(1, wide(points[1])));
    }

    #[test]
    fn rays_that_keep_hitting_the_robot_are_masked() {
        let mut sensor = Sensor::new(SensorParameters { learn_mask_scans: 6, ..parameters() });
        for scan in 0..6 {
            let passer_by = if scan == 0 { 0.5 } else { 9.0 };
            let points = [[0.5, 0.0, 0.0], [0.0, passer_by, 0.0]];
            sensor.learn(scan, &points, None, &Transform::IDENTITY, None, false);
        }
        assert!(sensor.is_masked(0, [1.0, 0.0, 0.0]) && sensor.is_own(0, [0.6, 0.0, 0.0]));
        assert!(!sensor.is_masked(0, [0.0, 1.0, 0.0]) && !sensor.is_own(0, [0.0, 0.5, 0.0]));
        assert!(!sensor.is_own(0, [7.0, 0.0, 0.0])); // what passes the robot is seen
    }

    #[test]
    fn the_way_since_the_last_scan_is_known_after_a_short_pause() {
        let mut sensor = Sensor::new(parameters());
        let at = |x: f64| Transform { translation: [x, 2.0, 0.0], ..Transform::IDENTITY };
        assert_eq!(sensor.moved(&at(3.0), 0), [0.0; 3]); // no scan before
        sensor.learn(0, &[], None, &at(3.0), None, false);
        assert_eq!(sensor.moved(&at(3.5), 100_000_000), [0.5, 0.0, 0.0]);
        assert_eq!(sensor.moved(&at(3.5), 2_000_000_000), [0.0; 3]); // too long ago
    }

    #[test]
    fn a_sector_may_cross_the_back() {
        let sector = [3.0, -3.0, -0.5, 0.5];
        assert!(is_inside(&sector, [-1.0, 0.01, 0.0]) && is_inside(&sector, [-1.0, -0.01, 0.0]));
        assert!(!is_inside(&sector, [1.0, 0.0, 0.0]) && !is_inside(&sector, [-1.0, 0.0, 5.0]));
    }
}
