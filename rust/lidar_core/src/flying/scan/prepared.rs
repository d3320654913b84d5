//! Preparation of a raw scan: points, rays and masks in the frame of the map.
//!
//! Longer than other files: every step fills lists of one scan, which have to stay of one length.

use super::point_poses::Poses;
pub use super::raw_scan::RawScan;
use super::sensor::Sensor;
use super::untimed::{PointTimes, SweepMotion};
use crate::Error;
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::point_class::PointClass;
use crate::flying::sky::source::SkySource;
use crate::flying::sky::{ScanToObserve, SkyObservation};
use crate::geometry::lattice::wide;
use crate::geometry::motion::ScanPoses;
use crate::geometry::transform::{Transform, norm};
use crate::util::budget::check_points;
use crate::util::cancel;
use rayon::ThreadPool;
use rayon::prelude::*;

/// Number of points from which on a second thread saves time.
const POINTS_PER_TASK: usize = 8192;

/// A scan in the frame of the map. It keeps its memory for the next scan. Each index is one entry: a point, a ray
/// without return, or no information. Entries from the index `rows` on were added to the raw scan: rays without return
/// and known points.
#[derive(Default)]
pub(crate) struct Prepared {
    /// Number of entries of the raw scan.
    pub(crate) rows: usize,
    /// Coordinates of the points [m]. NaN where there is nothing to classify.
    pub(crate) points: Vec<[f32; 3]>,
    /// Start point of every ray [m]. None if all rays start at the position of `pose`.
    pub(crate) origins: Option<Vec<[f64; 3]>>,
    pub(crate) directions: Option<Vec<[f32; 3]>>,
    pub(crate) no_return: Vec<bool>,
    pub(crate) no_ray: Option<Vec<bool>>,
    /// Length up to which rays without return clear voxels [m]. None: up to the maximum range.
    pub(crate) reach: Option<Vec<f32>>,
    /// Time of every point after the stamp [s]. None: all are of the stamp.
    pub(crate) delays: Option<Vec<f32>>,
    /// Pose of the sensor at the middle of the scan, in the frame of the map.
    pub(crate) pose: Transform,
    /// Where the times of the points come from.
    pub(crate) point_times: PointTimes,
    /// Motion of the sensor during a scan without times. None if the points do not show it.
    pub(crate) sweep: Option<SweepMotion>,
    /// Motion of the sensor since its last scan, frame of the map [m]. Zero if that is not known.
    pub(crate) moved: [f64; 3],
    pub(crate) rebuilt: usize,
    /// Class of every entry before classification.
    pub(crate) unknown: Vec<PointClass>,
    /// For each entry, whether its point may be on the robot. Empty if no point may be.
    pub(crate) maybe_own: Vec<bool>,
    /// Source of the rays without return; `sky_share`: share of all rays that go into the sky.
    pub(crate) sky: SkySource,
    pub(crate) sky_share: f64,
    /// Objects that reach below this height are on the ground [m, frame of the map].
    pub(crate) ground: f64,
    /// Flat objects that reach below this height are on the ground too, even if the lowest returns may not be on the
    /// ground [m, frame of the map].
    pub(crate) low: f64,
    /// Height of flat ground [m, frame of the map]. None if no flat ground is seen.
    pub(crate) floor: Option<f64>,
    /// The sky as the scan shows it. None if the sky is not estimated.
    pub(crate) sky_observation: Option<Box<SkyObservation>>,
    poses: Poses,
}

impl Prepared {
    /// Prepare a scan.
    ///
    /// # Errors
    /// [`Error::Length`], [`Error::Value`] or [`Error::Limit`] for input that cannot be used.
    pub(crate) fn take(
        &mut self,
        raw: &RawScan<'_>,
        sensor: &Sensor,
        map_from_world: &Transform,
        pool: Option<&ThreadPool>,
    ) -> Result<(), Error> {
        check(raw, sensor)?;
        cancel::check()?;
        let motion = ScanPoses::new(raw.poses, raw.pose_stamps_ns)?;
        let mut poses = std::mem::take(&mut self.poses);
        let found = poses.find(raw, &motion, map_from_world).and_then(|()| cancel::check());
        if found.is_ok() {
            self.estimate_times(raw, sensor, &mut poses);
            self.take_rows(raw, sensor, &poses, pool);
        }
        self.poses = poses; // its memory is used again
        found?;
        cancel::check()
    }

    /// Find the motion during a scan without times.
    fn estimate_times(&mut self, raw: &RawScan<'_>, sensor: &Sensor, poses: &mut Poses) {
        let is_given = raw.point_time_ns.is_some();
        self.point_times = if is_given { PointTimes::Given } else { PointTimes::None };
        self.sweep = if is_given { None } else { sensor.sweep_motion(raw, &poses.middle) };
        if let Some(motion) = self.sweep.as_ref().filter(|motion| motion.is_skewed) {
            poses.move_along(motion, raw.points.len());
            self.point_times = PointTimes::Estimated;
        }
    }

    fn take_rows(
        &mut self,
        raw: &RawScan<'_>,
        sensor: &Sensor,
        poses: &Poses,
        pool: Option<&ThreadPool>,
    ) {
        self.rows = raw.points.len();
        self.pose = poses.middle;
        self.moved = sensor.moved(&self.pose, raw.stamp_ns);
        (self.sky, self.sky_share, self.rebuilt) = (SkySource::Unknown, 0.0, 0);
        (self.reach, self.directions) = (None, None);
        (self.ground, self.low) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
        self.floor = None;
        self.no_return.clear();
        self.no_return.resize(self.rows, false);
        refill(&mut self.origins, poses.of_rows().map(|poses| poses.map(|pose| pose.translation)));
        let delay = |time: &i64| (time.saturating_sub(raw.stamp_ns) as f64 * 1e-9) as f32;
        refill(&mut self.delays, raw.point_time_ns.map(|times| times.iter().map(delay)));
        if let Some(motion) = self.sweep.as_ref().filter(|motion| motion.is_skewed) {
            let delays: Vec<f32> = motion.delays().collect();
            let of_rows = (0..self.rows).map(|row| delays[motion.sweep.block_of(row)]);
            refill(&mut self.delays, Some(of_rows));
        }
        self.take_farthest_returns(raw.points, sensor.parameters.returns_per_ray);
        self.take_points(raw, sensor, poses, pool);
        self.take_body(raw, sensor);
        if raw.no_return.is_some() && (raw.directions.is_some() || sensor.sky.is_none()) {
            self.take_empty_rays(raw, sensor, poses);
        }
        self.unknown.resize(self.points.len(), PointClass::Unknown);
    }

    /// Add the rays without return that are not given: those into the sky, limited by `map`.
    ///
    /// # Errors
    /// [`Error::Parameter`] if the sensor that the configuration states cannot have given the scan.
    pub(crate) fn find_sky(
        &mut self,
        raw: &RawScan<'_>,
        sensor: &Sensor,
        map: &VoxelMap,
    ) -> Result<(), Error> {
        let is_given = raw.no_return.is_some() && raw.directions.is_some();
        let Some(sky) = sensor.sky.as_ref().filter(|_| !is_given) else {
            self.sky_observation = None;
            return Ok(());
        };
        sky.check(raw.points, &sensor.parameters.known_sensors)?;
        let mut observation = self.sky_observation.take().unwrap_or_default();
        let scan = ScanToObserve {
            points: raw.points,
            no_return: raw.no_return,
            map_from_lidar: &self.pose,
            stamp_ns: raw.stamp_ns,
            is_masked: &|direction| sensor.is_masked(usize::MAX, direction),
            map,
        };
        let is_known = sensor.observe_sky(&scan, &mut observation);
        self.take_out(observation.is_droplet());
        if is_known {
            (self.sky, self.sky_share) = (sensor.sky_source(raw.stamp_ns), observation.share);
            self.append_sky(&observation.directions, &observation.reach);
            self.ground = self.pose.translation[2] + observation.ground();
            self.low = self.pose.translation[2] + observation.low();
            self.floor = observation.floor().map(|height| self.pose.translation[2] + height);
        }
        self.sky_observation = Some(observation);
        Ok(())
    }

    /// Exclude points that are droplets in the air.
    fn take_out(&mut self, is_droplet: &[bool]) {
        for (point, _) in self.points.iter_mut().zip(is_droplet).filter(|(_, is_one)| **is_one) {
            *point = [f32::NAN; 3];
        }
    }

    /// Share of the sensor's rays that gave the points with the indices `rows`. Several points may be of one ray.
    pub(crate) fn share_of_rays(&self, rows: &[u32], returns_per_ray: usize) -> f64 {
        let in_scan = self.rows / returns_per_ray.max(1);
        let mut rays: Vec<usize> = rows.iter().map(|&row| row as usize % in_scan.max(1)).collect();
        if returns_per_ray > 1 {
            rays.sort_unstable();
            rays.dedup();
        }
        // Drivers that leave rows out leave rays out: the search for the sky knows how many.
        let known = self.sky_observation.as_ref().map_or(0.0, |observation| observation.rays);
        rays.len() as f64 / (in_scan as f64).max(known).max(1.0)
    }

    /// Rays into the sky that were found: unit directions in the world, and lengths that they clear [m].
    pub(crate) fn sky_rays(&self, world_from_map: &Transform) -> Vec<([f64; 3], f32)> {
        let Some(observation) = self.sky_observation.as_ref().filter(|_| self.rebuilt > 0) else {
            return Vec::new();
        };
        let turned = |&direction| world_from_map.rotate(wide(direction));
        observation.directions.iter().map(turned).zip(observation.reach.iter().copied()).collect()
    }

    /// Mark the points that may be on the robot, before the sensor has moved far enough.
    fn take_body(&mut self, raw: &RawScan<'_>, sensor: &Sensor) {
        self.maybe_own.clear();
        if let Some(body) = sensor.body.as_ref().filter(|body| body.may_be_found()) {
            let maybe = raw.points.iter().map(|&point| body.may_contain(wide(point)));
            self.maybe_own.extend(maybe);
        }
        if !self.maybe_own.contains(&true) {
            self.maybe_own.clear();
        }
    }

    /// Start point of the ray with the index `row` [m, frame of the map].
    #[inline]
    pub(crate) fn origin(&self, row: usize) -> [f64; 3] {
        self.origins.as_ref().map_or(self.pose.translation, |origins| origins[row])
    }

    fn take_points(
        &mut self,
        raw: &RawScan<'_>,
        sensor: &Sensor,
        poses: &Poses,
        pool: Option<&ThreadPool>,
    ) {
        let taken = |(row, &point): (usize, &[f32; 3])| {
            let at = wide(point);
            let usable = at.iter().all(|value| value.is_finite())
                && !raw.no_return.is_some_and(|flags| flags[row])
                && !sensor.is_own(row, at);
            if usable { narrow(poses.at(row).apply(at)) } else { [f32::NAN; 3] }
        };
        let rows = raw.points.par_iter().with_min_len(POINTS_PER_TASK).enumerate().map(taken);
        match pool {
            Some(pool) => pool.install(|| rows.collect_into_vec(&mut self.points)),
            None => {
                self.points.clear();
                self.points.extend(raw.points.iter().enumerate().map(taken));
            }
        }
    }

    /// Cast only one ray to the farthest of several returns of a ray: the path to the nearer returns is part of it.
    fn take_farthest_returns(&mut self, points: &[[f32; 3]], returns: usize) {
        if returns <= 1 {
            self.no_ray = None;
            return;
        }
        let no_ray = refilled(&mut self.no_ray, std::iter::repeat_n(true, points.len()));
        let rays = points.len() / returns;
        let range = |row: usize| {
            let range = norm(wide(points[row]));
            if range.is_finite() { range } else { -1.0 }
        };
        for ray in 0..rays {
            let mut farthest = ray;
            for row in (1..returns).map(|part| part * rays + ray) {
                if range(row) > range(farthest) {
                    farthest = row;
                }
            }
            no_ray[farthest] = false;
        }
    }

    fn take_empty_rays(&mut self, raw: &RawScan<'_>, sensor: &Sensor, poses: &Poses) {
        let Some(flags) = raw.no_return else { return };
        let remembered = |row| if raw.organised { sensor.direction(row) } else { None };
        let none = std::iter::repeat_n([f32::NAN; 3], flags.len());
        let (directions, mut n_empty, mut n_known) = (refilled(&mut self.directions, none), 0, 0);
        for row in (0..flags.len()).filter(|&row| flags[row]) {
            if self.no_ray.as_ref().is_some_and(|no_ray| no_ray[row]) {
                continue;
            }
            n_empty += 1;
            let known = raw.directions.map(|all| all[row]).or_else(|| remembered(row));
            let Some(direction) = known else { continue };
            n_known += 1;
            if !sensor.is_masked(row, wide(direction)) {
                self.no_return[row] = true;
                directions[row] = narrow(poses.at(row).rotate(wide(direction)));
            }
        }
        if n_known > 0 || n_empty == 0 {
            self.sky = SkySource::Given;
            let rays = flags.len() / sensor.parameters.returns_per_ray;
            self.sky_share = n_known as f64 / rays.max(1) as f64;
        }
    }

    /// Append a known point that was not measured.
    pub(crate) fn append_known(&mut self, point: [f32; 3]) {
        let origins = self.origins.get_or_insert_with(|| {
            vec![self.pose.translation; self.points.len()] // so far in one point
        });
        origins.push(wide(point)); // its ray has no length
        self.points.push(point);
        self.unknown.push(PointClass::Unknown);
        self.no_return.push(false);
        if let Some(directions) = &mut self.directions {
            directions.push([f32::NAN; 3]);
        }
        if let Some(no_ray) = &mut self.no_ray {
            no_ray.push(false);
        }
        if let Some(reach) = &mut self.reach {
            reach.push(f32::INFINITY);
        }
        if let Some(delays) = &mut self.delays {
            delays.push(0.0);
        }
    }

    /// Append rays without return, given by directions in the frame of the map and lengths that they clear [m].
    fn append_sky(&mut self, rays: &[[f32; 3]], reach: &[f32]) {
        let all = self.rows + rays.len();
        let none = std::iter::repeat_n([f32::NAN; 3], self.rows);
        refill(&mut self.directions, Some(none.chain(rays.iter().copied())));
        let endless = std::iter::repeat_n(f32::INFINITY, self.rows);
        refill(&mut self.reach, Some(endless.chain(reach.iter().copied())));
        self.points.resize(all, [f32::NAN; 3]);
        if let Some(origins) = &mut self.origins {
            origins.resize(all, self.pose.translation);
        }
        self.no_return.resize(all, true);
        if let Some(delays) = &mut self.delays {
            delays.resize(all, 0.0);
        }
        if let Some(no_ray) = &mut self.no_ray {
            no_ray.resize(all, false);
        }
        self.unknown.resize(all, PointClass::Unknown);
        self.rebuilt = rays.len();
    }
}

fn check(raw: &RawScan<'_>, sensor: &Sensor) -> Result<(), Error> {
    let expected = raw.points.len();
    check_points(expected)?;
    let lengths = [
        ("no_return", raw.no_return.map(<[_]>::len)),
        ("directions", raw.directions.map(<[_]>::len)),
        ("point_time_ns", raw.point_time_ns.map(<[_]>::len)),
        ("self_mask", sensor.parameters.self_mask.as_ref().map(Vec::len)),
    ];
    for (name, got) in lengths {
        if let Some(got) = got.filter(|&got| got != expected) {
            return Err(Error::Length { name, expected, got });
        }
    }
    let returns = sensor.parameters.returns_per_ray;
    if returns == 0 || !expected.is_multiple_of(returns) {
        return Err(Error::Value {
            name: "points_lidar",
            expected: "`returns_per_ray` equal parts",
            index: expected,
            got: format!("{expected} points for {returns} parts"),
        });
    }
    check_times(raw)
}

/// Check that point times are of the same clock as `stamp_ns`. Otherwise targets would be displaced arbitrarily.
fn check_times(raw: &RawScan<'_>) -> Result<(), Error> {
    const LONGEST_SCAN_NS: u64 = 10_000_000_000;
    let Some(times) = raw.point_time_ns else { return Ok(()) };
    let is_off = |&(row, time): &(usize, &i64)| {
        time.abs_diff(raw.stamp_ns) > LONGEST_SCAN_NS && raw.is_informative(row)
    };
    match times.iter().enumerate().find(is_off) {
        Some((index, time)) => Err(Error::Value {
            name: "point_time_ns",
            expected: "times within 10 s of `stamp_ns`",
            index,
            got: format!("{time}, and {} as `stamp_ns`", raw.stamp_ns),
        }),
        None => Ok(()),
    }
}

/// Replace the content of `kept` by `values`, in the same memory.
fn refill<T>(kept: &mut Option<Vec<T>>, values: Option<impl Iterator<Item = T>>) {
    match values {
        Some(values) => {
            refilled(kept, values);
        }
        None => *kept = None,
    }
}

fn refilled<T>(kept: &mut Option<Vec<T>>, values: impl Iterator<Item = T>) -> &mut Vec<T> {
    let kept = kept.get_or_insert_default();
    kept.clear();
    kept.extend(values);
    kept
}

fn narrow(point: [f64; 3]) -> [f32; 3] {
    point.map(|value| value as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flying::scan::sensor::SensorParameters;
    use crate::flying::scan::sensor::tests::parameters;

    const STILL: [f64; 16] =
        [1.0, 0.0, 0.0, 10.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];

    fn raw<'a>(points: &'a [[f32; 3]]) -> RawScan<'a> {
        RawScan {
            organised: true,
            sensor: "lidar",
            stamp_ns: 0,
            points,
            no_return: None,
            directions: None,
            point_time_ns: None,
            poses: &[STILL],
            pose_stamps_ns: None,
            pose_covariance: None,
        }
    }

    #[test]
    fn own_returns_vanish_and_the_rest_moves_into_the_map() -> Result<(), Error> {
        let sensor = Sensor::new(parameters());
        let points = [[0.1, 0.0, 0.0], [5.0, 1.0, 0.0], [f32::NAN; 3]];
        let mut scan = Prepared::default();
        scan.take(&raw(&points), &sensor, &Transform::IDENTITY, None)?;
        assert!(scan.points[0][0].is_nan() && scan.points[2][0].is_nan());
        assert_eq!(scan.points[1], [15.0, 1.0, 0.0]);
        assert_eq!(scan.sky, SkySource::Unknown);
        Ok(())
    }

    #[test]
    fn of_two_returns_the_farther_one_casts_the_ray() -> Result<(), Error> {
        let sensor = Sensor::new(SensorParameters { returns_per_ray: 2, ..parameters() });
        let points = [[4.0, 0.0, 0.0], [0.0, 9.0, 0.0], [8.0, 0.0, 0.0], [f32::NAN; 3]];
        let mut scan = Prepared::default();
        scan.take(&raw(&points), &sensor, &Transform::IDENTITY, None)?;
        assert_eq!(scan.no_ray, Some(vec![true, false, false, true]));
        assert!(scan.take(&raw(&points[..3]), &sensor, &Transform::IDENTITY, None).is_err());
        Ok(())
    }

    #[test]
    fn a_share_of_rays_counts_every_ray_once_and_those_that_drivers_leave_out() {
        let mut scan = Prepared { rows: 20, ..Prepared::default() };
        assert_eq!(scan.share_of_rays(&[0, 3, 13], 1), 0.15);
        assert_eq!(scan.share_of_rays(&[0, 3, 13], 2), 0.2);
        let mut observation = SkyObservation::default();
        observation.rays = 40.0;
        scan.sky_observation = Some(Box::new(observation));
        assert_eq!(scan.share_of_rays(&[0, 3], 1), 0.05);
        assert_eq!(Prepared::default().share_of_rays(&[], 1), 0.0);
    }

    #[test]
    fn every_column_has_its_own_origin() -> Result<(), Error> {
        let mut ahead = STILL;
        ahead[3] = 11.0;
        let poses = [STILL, ahead];
        let points = [[5.0, 0.0, 0.0]; 3];
        let rolling = RawScan {
            poses: &poses,
            pose_stamps_ns: Some(&[0, 100]),
            point_time_ns: Some(&[0, 50, 100]),
            ..raw(&points)
        };
        let (mut scan, sensor) = (Prepared::default(), Sensor::new(parameters()));
        scan.take(&rolling, &sensor, &Transform::IDENTITY, None)?;
        assert_eq!(
            scan.points.iter().map(|point| point[0]).collect::<Vec<_>>(),
            [15.0, 15.5, 16.0]
        );
        assert_eq!(scan.origin(1), [10.5, 0.0, 0.0]);
        scan.take(&raw(&points[..2]), &sensor, &Transform::IDENTITY, None)?; // nothing is left of it
        assert_eq!((scan.points.len(), scan.origin(1)), (2, [10.0, 0.0, 0.0]));
        assert!(scan.delays.is_none() && scan.origins.is_none());
        Ok(())
    }
}
