//! One scan as the sensor delivered it, before anything is done with it.

/// One scan as the sensor delivered it, in its own frame.
#[derive(Clone, Copy, Debug)]
pub struct RawScan<'a> {
    /// Which of the robot's LiDARs.
    pub sensor: &'a str,
    /// Start of the scan [ns].
    pub stamp_ns: i64,
    /// True if the rays come in the same order in every scan.
    pub organised: bool,
    /// Coordinates [m]; not finite for rays without information.
    pub points: &'a [[f32; 3]],
    /// True for rays without return within range.
    pub no_return: Option<&'a [bool]>,
    /// Direction of every ray.
    pub directions: Option<&'a [[f32; 3]]>,
    /// Time of every point [ns].
    pub point_time_ns: Option<&'a [i64]>,
    /// `world_from_lidar`, 4x4 row-major: one, or a stream.
    pub poses: &'a [[f64; 16]],
    /// Stamps of the stream [ns].
    pub pose_stamps_ns: Option<&'a [i64]>,
    /// Covariance of the pose: translation, then the angles about x, y, z (eq. 38).
    pub pose_covariance: Option<[[f64; 6]; 6]>,
}

impl RawScan<'_> {
    /// True if a row holds information; drivers leave the times of others at 0.
    pub(crate) fn is_informative(&self, row: usize) -> bool {
        self.no_return.is_some_and(|flags| flags[row])
            || self.points[row].iter().all(|value| value.is_finite())
    }

    /// Half way between the first and the last time of a row that tells anything [ns].
    pub(crate) fn middle_ns(&self) -> Option<i64> {
        let times = self.point_time_ns?;
        let rows = (0..times.len()).filter(|&row| self.is_informative(row));
        let known = || rows.clone().map(|row| times[row]);
        let (first, last) = (known().min()?, known().max()?);
        Some(first + (last - first) / 2) // no overflow: both are near `stamp_ns`
    }
}
