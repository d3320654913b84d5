//! Poses over time: given at stamps, interpolated between them.

use lidar_core::Error;
use lidar_core::geometry::transform::{Transform, minus};

/// Poses at increasing stamps; constant velocity between them, at rest outside.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    stamps_ns: Vec<i64>,
    poses: Vec<Transform>,
}

impl Trajectory {
    /// Make a trajectory of stamps [ns] and the poses at these times.
    ///
    /// # Errors
    /// [`Error::Length`] if the arrays differ in length, [`Error::Value`] if there is no stamp,
    /// a stamp is not after the one before, or a pose is not finite.
    pub fn new(stamps_ns: Vec<i64>, poses: Vec<Transform>) -> Result<Self, Error> {
        if stamps_ns.len() != poses.len() {
            return Err(Error::Length {
                name: "poses",
                expected: stamps_ns.len(),
                got: poses.len(),
            });
        }
        let bad =
            |index: usize, expected, got| Error::Value { name: "stamps_ns", expected, index, got };
        if stamps_ns.is_empty() {
            return Err(bad(0, "at least one stamp", "none".into()));
        }
        if let Some(index) = (1..stamps_ns.len()).find(|&i| stamps_ns[i] <= stamps_ns[i - 1]) {
            return Err(bad(index, "after the stamp before", stamps_ns[index].to_string()));
        }
        for (index, pose) in poses.iter().enumerate() {
            let mut values = pose.rotation.iter().flatten().chain(&pose.translation);
            if !values.all(|value| value.is_finite()) {
                let got = format!("{pose:?}");
                return Err(Error::Value { name: "poses", expected: "finite", index, got });
            }
        }
        Ok(Self { stamps_ns, poses })
    }

    /// Trajectory with a constant pose.
    #[must_use]
    pub fn at_rest(pose: Transform) -> Self {
        Self { stamps_ns: vec![0], poses: vec![pose] }
    }

    /// The pose at `stamp_ns`.
    #[must_use]
    pub fn pose_at(&self, stamp_ns: i64) -> Transform {
        let next = self.stamps_ns.partition_point(|&stamp| stamp <= stamp_ns);
        if next == 0 {
            return self.poses[0];
        }
        if next == self.poses.len() {
            return self.poses[next - 1];
        }
        let (before, after) = (&self.poses[next - 1], &self.poses[next]);
        let start = self.stamps_ns[next - 1];
        let fraction =
            stamp_ns.abs_diff(start) as f64 / self.stamps_ns[next].abs_diff(start) as f64;
        if before.rotation == after.rotation {
            let way = minus(after.translation, before.translation);
            let translation =
                std::array::from_fn(|axis| before.translation[axis] + fraction * way[axis]);
            return Transform { rotation: before.rotation, translation };
        }
        before.interpolate(after, fraction)
    }

    /// Velocity [m/s] just after `stamp_ns`.
    #[must_use]
    pub fn velocity_at(&self, stamp_ns: i64) -> [f64; 3] {
        let next = self.stamps_ns.partition_point(|&stamp| stamp <= stamp_ns);
        if next == 0 || next == self.poses.len() {
            return [0.0; 3];
        }
        let seconds = self.stamps_ns[next].abs_diff(self.stamps_ns[next - 1]) as f64 * 1e-9;
        minus(self.poses[next].translation, self.poses[next - 1].translation)
            .map(|way| way / seconds)
    }

    /// First and last stamp [ns].
    #[must_use]
    pub fn span_ns(&self) -> (i64, i64) {
        (self.stamps_ns[0], self.stamps_ns[self.stamps_ns.len() - 1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64) -> Transform {
        Transform { translation: [x, 0.0, 0.0], ..Transform::IDENTITY }
    }

    #[test]
    fn between_stamps_on_the_line_outside_at_rest() -> Result<(), Error> {
        let path = Trajectory::new(vec![0, 2_000_000_000], vec![at(1.0), at(5.0)])?;
        for (stamp, x, speed) in
            [(-1, 1.0, 0.0), (500_000_000, 2.0, 2.0), (3_000_000_000, 5.0, 0.0)]
        {
            assert_eq!(path.pose_at(stamp).translation[0], x);
            assert_eq!(path.velocity_at(stamp)[0], speed);
        }
        Ok(())
    }

    #[test]
    fn what_is_no_trajectory_is_refused() {
        assert!(Trajectory::new(vec![], vec![]).is_err());
        assert!(Trajectory::new(vec![1, 1], vec![at(0.0); 2]).is_err());
        assert!(Trajectory::new(vec![1], vec![at(f64::NAN)]).is_err());
        assert!(matches!(Trajectory::new(vec![1], vec![]), Err(Error::Length { .. })));
    }
}
