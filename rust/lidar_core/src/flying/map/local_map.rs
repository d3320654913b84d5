//! A voxel map in a local frame, and the origin of that frame in the world.

use super::parameters::MapParameters;
use super::voxel_map::VoxelMap;
use crate::Error;
use crate::error::require;
use crate::geometry::transform::Transform;

/// Largest coordinate in the world that is accepted [m]. Beyond it, `f64` does not resolve 0.1 mm.
const FARTHEST: f64 = 1e12;

/// A map whose frame is near the robot, so that world coordinates may be large.
pub(crate) struct LocalMap {
    pub(crate) map: VoxelMap,
    pub(crate) map_from_world: Transform,
    /// True if the origin of the frame is known.
    pub(crate) is_anchored: bool,
}

impl LocalMap {
    /// An empty map whose origin in the world is not known yet.
    ///
    /// # Errors
    /// As [`VoxelMap::new`].
    pub(crate) fn new(parameters: &MapParameters) -> Result<Self, Error> {
        Ok(Self {
            map: VoxelMap::new(parameters.relative_to([0.0; 3]))?,
            map_from_world: Transform::IDENTITY,
            is_anchored: false,
        })
    }

    /// Set the origin of an empty map to a corner of the world's voxels near `point` [m, world].
    /// Nothing changes if the origin is already known.
    ///
    /// # Errors
    /// [`Error::PointOutOfRange`], and those of [`VoxelMap::new`]; the map is unchanged then.
    pub(crate) fn anchor(
        &mut self,
        parameters: &MapParameters,
        point: [f64; 3],
    ) -> Result<(), Error> {
        if self.is_anchored {
            return Ok(());
        }
        let size = parameters.voxel_size;
        let origin = point.map(|value| (value / size).round() * size);
        if !origin.iter().all(|value| value.abs() <= FARTHEST) {
            return Err(Error::PointOutOfRange { point });
        }
        self.place(VoxelMap::new(parameters.relative_to(origin))?);
        Ok(())
    }

    /// Replace the map by another one. The configured parameters stay in force.
    ///
    /// # Errors
    /// [`Error::Parameter`] if its voxels do not have the configured size.
    pub(crate) fn replace(
        &mut self,
        parameters: &MapParameters,
        mut map: VoxelMap,
    ) -> Result<(), Error> {
        let voxel_size = map.parameters().voxel_size;
        let fits = voxel_size == parameters.voxel_size;
        let expected = "the configured size; a map of --static-map has 0.1 and is none to go on from: take that of a run";
        require(fits, "voxel_size", expected, voxel_size)?;
        map.set_skip(parameters.skip); // no file holds it
        self.place(map);
        Ok(())
    }

    /// Make the voxels of `points` [m, world] permanently occupied or free (sec. III-E).
    ///
    /// # Errors
    /// As [`VoxelMap::set_free`]; the map is unchanged then.
    pub(crate) fn set_known(
        &mut self,
        parameters: &MapParameters,
        points: &[[f64; 3]],
        occupied: bool,
    ) -> Result<(), Error> {
        let Some(&first) = points.first() else { return Ok(()) };
        let was_anchored = self.is_anchored;
        self.anchor(parameters, first)?;
        let points = self.local(points);
        let outcome =
            if occupied { self.map.set_occupied(&points) } else { self.map.set_free(&points) };
        if outcome.is_err() && !was_anchored {
            *self = Self::new(parameters)?;
        }
        outcome
    }

    /// Points [m, world] in the frame of the map.
    pub(crate) fn local(&self, points: &[[f64; 3]]) -> Vec<[f32; 3]> {
        let local = |&point: &[f64; 3]| self.map_from_world.apply(point).map(|value| value as f32);
        points.iter().map(local).collect()
    }

    /// Pose of the map's frame in the world.
    pub(crate) fn world_from_map(&self) -> Transform {
        self.map_from_world.inverse()
    }

    fn place(&mut self, map: VoxelMap) {
        let translation = map.parameters().origin.map(|value| -value);
        self.map_from_world = Transform { translation, ..Transform::IDENTITY };
        (self.map, self.is_anchored) = (map, true);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_frame_lies_on_a_corner_of_the_voxels_of_the_world() -> Result<(), Error> {
        let parameters = MapParameters::default();
        let mut local = LocalMap::new(&parameters)?;
        local.anchor(&parameters, [1000.13, -20.0, 0.02])?;
        local.anchor(&parameters, [0.0; 3])?; // it has its place
        assert_eq!(local.world_from_map().translation, [1000.25, -20.0, 0.0]);
        assert_eq!(local.local(&[[1001.25, -20.0, 0.5]]), [[1.0, 0.0, 0.5]]);
        Ok(())
    }

    #[test]
    fn refused_places_leave_the_map_without_a_place() -> Result<(), Error> {
        let parameters = MapParameters { max_voxels: 512, ..MapParameters::default() };
        let mut local = LocalMap::new(&parameters)?;
        let far = local.anchor(&parameters, [1e13, 0.0, 0.0]);
        assert!(matches!(far, Err(Error::PointOutOfRange { .. })));
        let many = [[0.0; 3], [50.0, 0.0, 0.0]];
        assert!(matches!(local.set_known(&parameters, &many, true), Err(Error::Limit { .. })));
        assert!(!local.is_anchored);
        local.set_known(&parameters, &many[..1], true)?;
        assert!(local.is_anchored);
        Ok(())
    }
}
