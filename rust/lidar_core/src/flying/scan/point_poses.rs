//! Poses of the sensor at the times of the points of a scan.

use super::raw_scan::RawScan;
use super::untimed::SweepMotion;
use crate::Error;
use crate::geometry::motion::{PointPoses, ScanPoses};
use crate::geometry::transform::Transform;

/// Pose of the sensor at the time of every entry of a scan, in the frame of the map.
#[derive(Default)]
pub(crate) struct Poses {
    /// Poses of the entries. Not used if all entries share `middle`.
    rows: PointPoses,
    differ: bool,
    /// Pose of the sensor at the middle time of the scan, in the frame of the map.
    pub(crate) middle: Transform,
}

impl Poses {
    pub(crate) fn find(
        &mut self,
        raw: &RawScan<'_>,
        motion: &ScanPoses<'_>,
        map_from_world: &Transform,
    ) -> Result<(), Error> {
        let times = raw.point_time_ns.filter(|_| motion.is_stream());
        let mut middle_ns = raw.stamp_ns;
        if let Some(times) = times {
            self.rows.fill(motion, "point_time_ns", times, |row| raw.is_informative(row))?;
            self.rows.move_to(map_from_world);
            middle_ns = raw.middle_ns().unwrap_or(raw.stamp_ns);
        }
        let middle = motion.at(middle_ns).ok_or_else(|| Error::Value {
            name: "stamp_ns",
            expected: "a stamp within 20 ms of `pose_stamps_ns`",
            index: 0,
            got: raw.stamp_ns.to_string(),
        })?;
        (self.differ, self.middle) = (times.is_some(), map_from_world.after(&middle));
        Ok(())
    }

    /// Use the motion during a scan without times. Its middle is at the pose of the scan.
    pub(super) fn move_along(&mut self, motion: &SweepMotion, points: usize) {
        let blocks = motion.poses.iter().map(|pose| self.middle.after(pose));
        self.rows.fill_blocks(blocks, points, |row| motion.sweep.block_of(row));
        self.differ = true;
    }

    /// Pose of every entry. None if all entries share one pose.
    pub(super) fn of_rows(&self) -> Option<impl Iterator<Item = &Transform>> {
        self.differ.then(|| (0..self.rows.points()).map(|row| self.rows.at(row)))
    }

    #[inline]
    pub(crate) fn at(&self, row: usize) -> &Transform {
        if self.differ { self.rows.at(row) } else { &self.middle }
    }
}
