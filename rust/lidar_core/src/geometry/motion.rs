//! Pose of the sensor at every time of a scan.

use super::transform::Transform;
use crate::Error;
use crate::util::key_hasher::KeyHasher;
use std::collections::HashMap;
use std::hash::BuildHasherDefault;

/// Largest time outside the pose stream for which the nearest pose of the stream is used [ns].
const POSE_SLACK_NS: i64 = 20_000_000;

/// Pose of a scan: one pose, or a stream of poses with times.
#[derive(Clone, Copy, Debug)]
pub struct ScanPoses<'a> {
    poses: &'a [[f64; 16]],
    stamps_ns: &'a [i64],
}

impl<'a> ScanPoses<'a> {
    /// Use poses `world_from_lidar` (4x4, row-major): one for all points, or several with their
    /// stamps [ns].
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Length`] if poses are not finite, or stamps are missing or not
    /// increasing.
    pub fn new(poses: &'a [[f64; 16]], stamps_ns: Option<&'a [i64]>) -> Result<Self, Error> {
        if poses.is_empty() {
            return Err(Error::Length { name: "world_from_lidar", expected: 1, got: 0 });
        }
        if let Some(index) =
            poses.iter().position(|pose| !pose.iter().all(|value| value.is_finite()))
        {
            return Err(Error::Value {
                name: "world_from_lidar",
                expected: "finite values",
                index,
                got: format!("{:?}", poses[index]),
            });
        }
        let stamps_ns: &'a [i64] = match stamps_ns {
            None if poses.len() == 1 => &[0],
            None => &[],
            Some(stamps) => stamps,
        };
        if stamps_ns.len() != poses.len() {
            let (expected, got) = (poses.len(), stamps_ns.len());
            return Err(Error::Length { name: "pose_stamps_ns", expected, got });
        }
        if let Some(index) = stamps_ns.windows(2).position(|pair| pair[0] >= pair[1]) {
            return Err(Error::Value {
                name: "pose_stamps_ns",
                expected: "increasing stamps",
                index: index + 1,
                got: stamps_ns[index + 1].to_string(),
            });
        }
        Ok(Self { poses, stamps_ns })
    }

    /// True if the sensor may move during the scan.
    #[must_use]
    pub fn is_stream(&self) -> bool {
        self.poses.len() > 1
    }

    /// Pose at `stamp_ns`. None if the stamp is more than 20 ms outside the stream.
    #[must_use]
    pub fn at(&self, stamp_ns: i64) -> Option<Transform> {
        let (first, last) = (*self.stamps_ns.first()?, *self.stamps_ns.last()?);
        if !self.is_stream() {
            return self.poses.first().map(Transform::from_matrix);
        }
        // Saturating, since stamps may lie anywhere in 64 bits.
        let outside = first.saturating_sub(stamp_ns).max(stamp_ns.saturating_sub(last));
        if outside > POSE_SLACK_NS {
            return None;
        }
        let stamp_ns = stamp_ns.clamp(first, last);
        let next =
            self.stamps_ns.partition_point(|&stamp| stamp <= stamp_ns).min(self.poses.len() - 1);
        let (from, to) = (self.stamps_ns[next - 1], self.stamps_ns[next]);
        // Whole nanoseconds are subtracted first: stamps since 1970 exceed the 53 bits of a float.
        let fraction = (stamp_ns - from) as f64 / (to - from) as f64;
        let [before, after] = [next - 1, next].map(|at| Transform::from_matrix(&self.poses[at]));
        Some(before.interpolate(&after, fraction))
    }

    fn outside(&self, name: &'static str, time: i64, index: usize) -> Error {
        let end = |stamp: Option<&i64>| stamp.copied().unwrap_or_default();
        let (first, last) = (end(self.stamps_ns.first()), end(self.stamps_ns.last()));
        Error::Value {
            name,
            expected: "times within 20 ms of `pose_stamps_ns`",
            index,
            got: format!("{time}, outside {first} to {last}"),
        }
    }
}

/// Pose of the sensor for every point of a scan. It keeps its memory for the next scan.
#[derive(Clone, Debug, Default)]
pub struct PointPoses {
    /// The distinct poses. Points with the same time share one pose.
    poses: Vec<Transform>,
    /// For each point, the index of its pose in `poses`.
    places: Vec<u32>,
    known: HashMap<i64, u32, BuildHasherDefault<KeyHasher>>,
}

impl PointPoses {
    /// Compute the pose of every point from its time [ns]. Entries without information may have any
    /// time. `name`: name of the times in error messages.
    ///
    /// # Errors
    /// [`Error::Value`] for the first time that is outside the stream.
    pub fn fill(
        &mut self,
        motion: &ScanPoses<'_>,
        name: &'static str,
        times_ns: &[i64],
        is_informative: impl Fn(usize) -> bool,
    ) -> Result<(), Error> {
        let Self { poses, places, known } = self;
        poses.clear();
        places.clear();
        known.clear();
        for (index, &time) in times_ns.iter().enumerate() {
            // The first stamp always has a pose.
            let time = if is_informative(index) { time } else { motion.stamps_ns[0] };
            let place = match known.get(&time) {
                Some(place) => *place,
                None => {
                    let place = poses.len() as u32; // at most one per point
                    poses.push(motion.at(time).ok_or_else(|| motion.outside(name, time, index))?);
                    known.insert(time, place);
                    place
                }
            };
            places.push(place);
        }
        Ok(())
    }

    /// Set one pose for each block of points. `block_of`: index of the block of a point.
    pub fn fill_blocks(
        &mut self,
        blocks: impl Iterator<Item = Transform>,
        points: usize,
        block_of: impl Fn(usize) -> usize,
    ) {
        self.poses.clear();
        self.poses.extend(blocks);
        self.places.clear();
        self.places.extend((0..points).map(|point| block_of(point) as u32));
    }

    /// Replace every pose by the one in another frame.
    pub fn move_to(&mut self, target_from_source: &Transform) {
        self.poses.iter_mut().for_each(|pose| *pose = target_from_source.after(pose));
    }

    /// Pose for the point with this index.
    #[must_use]
    #[inline]
    pub fn at(&self, point: usize) -> &Transform {
        &self.poses[self.places[point] as usize]
    }

    /// Number of points.
    #[must_use]
    pub fn points(&self) -> usize {
        self.places.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shifted(x: f64) -> [f64; 16] {
        [1.0, 0.0, 0.0, x, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    }

    #[test]
    fn a_stream_is_interpolated_and_not_extrapolated() -> Result<(), Error> {
        let poses = [shifted(0.0), shifted(1.0), shifted(3.0)];
        let motion = ScanPoses::new(&poses, Some(&[0, 100, 200]))?;
        let x = |stamp| motion.at(stamp).map(|pose| pose.translation[0]);
        assert_eq!([x(-5), x(0), x(50), x(150), x(200)], [0.0, 0.0, 0.5, 2.0, 3.0].map(Some));
        assert_eq!(x(200 + POSE_SLACK_NS + 1), None);
        let mut all = PointPoses::default();
        assert!(all.fill(&motion, "times", &[50, 1 << 40], |_| true).is_err());
        all.fill(&motion, "times", &[50, 150, 50], |_| true)?;
        assert_eq!([0, 1, 2].map(|point| all.at(point).translation[0]), [0.5, 2.0, 0.5]);
        assert_eq!((all.points(), all.poses.len()), (3, 2));
        Ok(())
    }

    #[test]
    fn a_bad_stream_is_refused() {
        let poses = [shifted(0.0), shifted(1.0)];
        assert!(ScanPoses::new(&poses, None).is_err());
        assert!(ScanPoses::new(&poses, Some(&[5, 5])).is_err());
        assert!(ScanPoses::new(&poses, Some(&[5])).is_err());
        assert!(ScanPoses::new(&[shifted(f64::NAN)], None).is_err());
        assert!(ScanPoses::new(&[], None).is_err());
    }
}
