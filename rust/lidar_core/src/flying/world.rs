//! Where the detector's map lies in the world: known places, other maps, jumps of the pose.

use super::detector::FlyingObjectDetector;
use super::scan::RawScan;
use super::voxel_map::VoxelMap;
use crate::Error;
use crate::geometry::transform::Transform;

impl FlyingObjectDetector {
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
        self.map = VoxelMap::new(self.parameters.map.relative_to([0.0; 3]), self.map.threads())?;
        self.tracker.reset();
        for sensor in self.sensors.values_mut() {
            sensor.last_stamp_ns = None;
        }
        (self.anchored, self.map_from_world) = (false, Transform::IDENTITY);
        (self.scans, self.last_stamp_ns) = (0, None);
        (self.last_pose, self.held_pose) = (None, None);
        Ok(())
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
        if !origin.iter().all(|value| value.is_finite()) {
            return Err(Error::PointOutOfRange { point });
        }
        self.map = VoxelMap::new(self.parameters.map.relative_to(origin), self.map.threads())?;
        self.place_origin(origin);
        Ok(())
    }

    fn place_origin(&mut self, origin: [f64; 3]) {
        self.anchored = true;
        self.map_from_world =
            Transform { translation: origin.map(|value| -value), ..Transform::IDENTITY };
    }
}
