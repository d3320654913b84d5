//! One sweep as a 2D scanner delivers it.

use super::map::PoseCovariance;
use super::segment::segments::Segments;
use crate::Error;

/// Largest distance of the times of rays from the stamp; larger ones are of another clock [ns].
const LONGEST_SWEEP_NS: u64 = 10_000_000_000;

/// One sweep as the scanner delivered it.
#[derive(Clone, Copy, Debug)]
pub struct RawSweep<'a> {
    /// Name of the scanner.
    pub scanner: &'a str,
    /// Start of the sweep [ns].
    pub stamp_ns: i64,
    /// Range of every ray [m]; +inf is a miss, NaN no information.
    pub ranges: &'a [f32],
    /// Poses `world_from_lidar`, 4x4 row-major: one pose, or a stream.
    pub poses: &'a [[f64; 16]],
    /// Stamps of the pose stream [ns]; None for a single pose.
    pub pose_stamps_ns: Option<&'a [i64]>,
    /// Time of every ray [ns]; None if all rays share the stamp.
    pub ray_time_ns: Option<&'a [i64]>,
    /// Covariance of the pose: translation, then the angles about x, y, z; None for an exact pose.
    pub pose_covariance: Option<PoseCovariance>,
}

impl RawSweep<'_> {
    /// Check that there is one range, and one time if there are any, for each of `expected` rays.
    ///
    /// # Errors
    /// [`Error::Length`] for another number; [`Error::Value`] for times of another clock.
    pub(super) fn check(&self, expected: usize) -> Result<(), Error> {
        let lengths = [
            ("ranges", Some(self.ranges.len())),
            ("ray_time_ns", self.ray_time_ns.map(<[_]>::len)),
        ];
        for (name, got) in lengths {
            if let Some(got) = got.filter(|&got| got != expected) {
                return Err(Error::Length { name, expected, got });
            }
        }
        let times = self.ray_time_ns.unwrap_or_default();
        match times.iter().position(|time| time.abs_diff(self.stamp_ns) > LONGEST_SWEEP_NS) {
            Some(index) => Err(Error::Value {
                name: "ray_time_ns",
                expected: "times within 10 s of `stamp_ns`",
                index,
                got: format!("{}, and {} as `stamp_ns`", times[index], self.stamp_ns),
            }),
            None => Ok(()),
        }
    }
}

/// Mean time of the rays of every segment after the stamp [s].
pub(super) fn delays(segments: &Segments, ray_time_ns: &[i64], stamp_ns: i64) -> Vec<f64> {
    let delay = |&ray: &u32| (ray_time_ns[ray as usize] - stamp_ns) as f64 * 1e-9;
    let mean = |rays: &[u32]| rays.iter().map(delay).sum::<f64>() / rays.len() as f64;
    (0..segments.len()).map(|number| mean(segments.rays_of(number))).collect()
}
