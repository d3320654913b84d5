//! Poses of the scanner during a sweep.

use crate::Error;
use crate::geometry::motion::{PointPoses, ScanPoses};
use crate::geometry::transform::Transform;

/// Poses `world_from_lidar` of one sweep: at its stamp, and at every ray.
#[derive(Clone, Debug)]
pub struct SweepPoses {
    at_stamp: Transform,
    /// Poses of the rays; None for a scanner at rest.
    moving: Option<PointPoses>,
}

impl SweepPoses {
    /// Poses for a scanner at rest, or for rays that are all measured at once.
    #[must_use]
    pub fn still(world_from_lidar: Transform) -> Self {
        Self { at_stamp: world_from_lidar, moving: None }
    }

    /// Poses of every ray at its own time, from a stream of poses.
    ///
    /// # Errors
    /// [`Error::Value`] for a time more than 20 ms outside the stream.
    pub fn new(
        motion: &ScanPoses<'_>,
        stamp_ns: i64,
        ray_time_ns: Option<&[i64]>,
    ) -> Result<Self, Error> {
        let at_stamp = motion.at(stamp_ns).ok_or_else(|| Error::Value {
            name: "stamp_ns",
            expected: "a stamp within 20 ms of `pose_stamps_ns`",
            index: 0,
            got: stamp_ns.to_string(),
        })?;
        let mut moving = None;
        if let Some(times) = ray_time_ns.filter(|_| motion.is_stream()) {
            let poses = moving.insert(PointPoses::default());
            poses.fill(motion, "ray_time_ns", times, |_| true)?;
        }
        Ok(Self { at_stamp, moving })
    }

    /// `world_from_lidar` at the stamp of the scan.
    #[must_use]
    pub fn at_stamp(&self) -> &Transform {
        &self.at_stamp
    }

    /// `world_from_lidar` while ray `ray` was measured.
    #[must_use]
    #[inline]
    pub fn at(&self, ray: usize) -> &Transform {
        self.moving.as_ref().map_or(&self.at_stamp, |poses| poses.at(ray))
    }

    /// True if the rays have poses of their own.
    #[must_use]
    pub fn is_moving(&self) -> bool {
        self.moving.is_some()
    }

    /// Number of rays with a time of their own; None if all share the stamp.
    pub(crate) fn rays(&self) -> Option<usize> {
        self.moving.as_ref().map(PointPoses::points)
    }

    /// `world_from_level`: origin at the scanner at the stamp, z up, yaw (ZYX order) of the
    /// scanner kept.
    #[must_use]
    pub fn world_from_level(&self) -> Transform {
        let rotation = &self.at_stamp.rotation;
        let (sine, cosine) = match libm::hypot(rotation[0][0], rotation[1][0]) {
            level if level > 0.0 => (rotation[1][0] / level, rotation[0][0] / level),
            _ => (0.0, 1.0), // straight up or down: any yaw
        };
        Transform {
            rotation: [[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]],
            translation: self.at_stamp.translation,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_level_frame_keeps_place_and_yaw() {
        // Pitch 90 degrees short of straight down, after a yaw of 90 degrees.
        let pose = Transform {
            rotation: [[0.0, -1.0, 0.0], [0.6, 0.0, 0.8], [-0.8, 0.0, 0.6]],
            translation: [1.0, 2.0, 3.0],
        };
        let level = SweepPoses::still(pose).world_from_level();
        assert_eq!(level.rotation, [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]);
        assert_eq!(level.translation, pose.translation);
    }

    #[test]
    fn rays_have_the_poses_of_their_times() -> Result<(), Error> {
        let shifted =
            |x| [1.0, 0.0, 0.0, x, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        let poses = [shifted(0.0), shifted(1.0)];
        let motion = ScanPoses::new(&poses, Some(&[0, 100]))?;
        let sweep = SweepPoses::new(&motion, 0, Some(&[0, 25, 50]))?;
        let x = |ray| sweep.at(ray).translation[0];
        assert_eq!([x(0), x(1), x(2)], [0.0, 0.25, 0.5]);
        assert!(!SweepPoses::new(&motion, 0, None)?.is_moving());
        assert!(SweepPoses::new(&motion, 1 << 40, None).is_err());
        Ok(())
    }
}
