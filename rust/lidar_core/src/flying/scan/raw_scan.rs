//! One scan as the sensor delivered it, before any processing.

/// One scan as the sensor delivered it, in its own frame.
#[derive(Clone, Copy, Debug)]
pub struct RawScan<'a> {
    /// Name of the LiDAR that gave the scan.
    pub sensor: &'a str,
    /// Time of the scan [ns]: its start.
    pub stamp_ns: i64,
    /// True if the rays are in the same order in every scan.
    pub organised: bool,
    /// Coordinates of the points, lidar frame [m]. Not finite for rays without information.
    pub points: &'a [[f32; 3]],
    /// True for rays without return within range. None: not known.
    pub no_return: Option<&'a [bool]>,
    /// Direction of every ray, lidar frame. None: not known.
    pub directions: Option<&'a [[f32; 3]]>,
    /// Time of every point [ns]. None: not known.
    pub point_time_ns: Option<&'a [i64]>,
    /// Poses `world_from_lidar`, 4x4 row-major: one, or a stream.
    pub poses: &'a [[f64; 16]],
    /// Times of the poses of a stream [ns]. None: there is one pose.
    pub pose_stamps_ns: Option<&'a [i64]>,
    /// Covariance of the pose: translation [m], then the angles about x, y, z [rad] (eq. 38). None:
    /// not known.
    pub pose_covariance: Option<[[f64; 6]; 6]>,
}

impl RawScan<'_> {
    /// True if the entry `row` has information: it is a point, or a ray without return. Drivers
    /// leave the times of other entries at 0.
    pub(crate) fn is_informative(&self, row: usize) -> bool {
        self.no_return.is_some_and(|flags| flags[row])
            || self.points[row].iter().all(|value| value.is_finite())
    }

    /// Middle between the first and the last time of entries with information [ns]. None without
    /// times or such entries.
    pub(crate) fn middle_ns(&self) -> Option<i64> {
        let times = self.point_time_ns?;
        let rows = (0..times.len()).filter(|&row| self.is_informative(row));
        let known = || rows.clone().map(|row| times[row]);
        let (first, last) = (known().min()?, known().max()?);
        Some(first + (last - first) / 2) // no overflow: both are near `stamp_ns`
    }
}
