//! Pose of the detector's map in the world: known places, other maps.

use super::background::burn_in_time::BurnIn;
use super::detector::FlyingObjectDetector;
use super::map::saved_body::SavedBody;
use super::map::voxel_map::VoxelMap;
use super::scan::prepared::RawScan;
use crate::Error;
use crate::error::require;
use crate::geometry::transform::Transform;
use crate::util::budget::MAX_SENSORS;
use std::path::Path;

/// Places further from the world's origin cannot be told apart to a millimetre [m].
const FARTHEST: f64 = 1e12;

impl FlyingObjectDetector {
    /// Make the voxels of `points` [m, world] occupied, or free, for good (sec. III-E).
    ///
    /// # Errors
    /// As [`VoxelMap::set_free`].
    pub fn set_known(&mut self, points: &[[f64; 3]], occupied: bool) -> Result<(), Error> {
        let Some(&first) = points.first() else { return Ok(()) };
        let was_anchored = self.anchored;
        if !was_anchored {
            self.anchor_at(first)?;
        }
        let points = self.in_map(points);
        let outcome =
            if occupied { self.map.set_occupied(&points) } else { self.map.set_free(&points) };
        if outcome.is_err() && !was_anchored {
            self.unanchor();
        }
        outcome
    }

    /// Take over a map, such as one of an earlier run; its own parameters stay in force.
    ///
    /// # Errors
    /// [`Error::Parameter`] if its voxels differ in size from the configured ones.
    pub fn set_map(&mut self, map: VoxelMap) -> Result<(), Error> {
        let voxel_size = map.parameters().voxel_size;
        let fits = voxel_size == self.parameters.map.voxel_size;
        require(fits, "voxel_size", "a map with the configured size", voxel_size)?;
        self.place_origin(map.parameters().origin);
        self.map = map;
        self.forget_motion();
        Ok(())
    }

    /// Write the map, and what is known of the robot, to a file that [`VoxelMap::load`] reads, too.
    ///
    /// # Errors
    /// As [`VoxelMap::save`].
    pub fn save_map(&self, path: &Path) -> Result<(), Error> {
        let not_met = self.recalled.iter().filter(|(name, _)| !self.sensors.contains_key(*name));
        let mut bodies: Vec<SavedBody> = not_met.map(|(_, body)| body.clone()).collect();
        for (name, sensor) in &self.sensors {
            if let Some((voxels, is_decided)) = sensor.body.as_ref().and_then(|body| body.known()) {
                let voxels = voxels.to_vec();
                bodies.push(SavedBody { sensor: name.clone(), is_decided, voxels });
            }
        }
        bodies.sort_by(|one, other| one.sensor.cmp(&other.sensor));
        bodies.truncate(MAX_SENSORS); // of sensors that were not met lately
        self.map.save_with(path, &bodies)
    }

    /// Take over the map of a file, and what it knows of the robot, for every sensor that has not found
    /// it itself.
    ///
    /// # Errors
    /// As [`VoxelMap::load`] and [`FlyingObjectDetector::set_map`]; the detector is unchanged then.
    pub fn load_map(&mut self, path: &Path) -> Result<(), Error> {
        let (map, bodies) = VoxelMap::load_with(path)?;
        self.set_map(map)?;
        for body in &bodies {
            if let Some(sensor) = self.sensors.get_mut(&body.sensor) {
                sensor.recall(body);
            }
        }
        self.recalled = bodies.into_iter().map(|body| (body.sensor.clone(), body)).collect();
        Ok(())
    }

    /// Points [m, world] in the frame of the map.
    #[must_use]
    pub fn in_map(&self, points: &[[f64; 3]]) -> Vec<[f32; 3]> {
        let local = |&point: &[f64; 3]| self.map_from_world.apply(point).map(|value| value as f32);
        points.iter().map(local).collect()
    }

    /// Pose of the map's frame in the world.
    #[must_use]
    pub fn world_from_map(&self) -> Transform {
        self.map_from_world.inverse()
    }

    /// Forget map, tracks and poses. Track numbers go on; what was learnt of the sensors stays.
    ///
    /// # Errors
    /// None that [`FlyingObjectDetector::new`] did not have.
    pub fn reset(&mut self) -> Result<(), Error> {
        self.map = VoxelMap::new(self.parameters.map.relative_to([0.0; 3]))?;
        (self.anchored, self.map_from_world) = (false, Transform::IDENTITY);
        self.scans = 0;
        self.burn_in = BurnIn::default();
        self.forget_motion();
        for sensor in self.sensors.values_mut() {
            sensor.last_stamp_ns = None;
        }
        Ok(())
    }

    /// Tracks, and poses in the frame of a map that is no more.
    fn forget_motion(&mut self) {
        self.tracker.reset();
        (self.reporting, self.held) = (false, None);
        self.standing.clear();
        for sensor in self.sensors.values_mut() {
            sensor.last_pose = None;
            sensor.forget_places();
        }
    }

    /// Back to the empty map of an unknown place.
    pub(super) fn unanchor(&mut self) {
        (self.anchored, self.map_from_world) = (false, Transform::IDENTITY);
        if let Ok(map) = VoxelMap::new(self.parameters.map.relative_to([0.0; 3])) {
            self.map = map; // cannot fail: it could be made before
        }
    }

    /// The local frame: the first pose's position, on a corner of the world's voxels.
    pub(super) fn anchor(&mut self, raw: &RawScan<'_>) -> Result<(), Error> {
        match raw.poses.first() {
            Some(pose) if !self.anchored => self.anchor_at([pose[3], pose[7], pose[11]]),
            _ => Ok(()),
        }
    }

    fn anchor_at(&mut self, point: [f64; 3]) -> Result<(), Error> {
        let size = self.parameters.map.voxel_size;
        let origin = point.map(|value| (value / size).round() * size);
        if !origin.iter().all(|value| value.abs() <= FARTHEST) {
            return Err(Error::PointOutOfRange { point });
        }
        self.map = VoxelMap::new(self.parameters.map.relative_to(origin))?;
        self.place_origin(origin);
        Ok(())
    }

    fn place_origin(&mut self, origin: [f64; 3]) {
        self.anchored = true;
        self.map_from_world =
            Transform { translation: origin.map(|value| -value), ..Transform::IDENTITY };
    }
}
