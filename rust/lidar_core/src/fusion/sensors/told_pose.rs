//! Poses of the platform from measurements.

use super::measurement::{Measurement, Sensor};
use super::sensing::Sensing;
use crate::fusion::models::platform::{Platform, Pose};
use crate::fusion::models::space_pose::SpacePose;
use crate::fusion::models::turn::wrapped;
use crate::fusion::models::world::{Plane, Space};
use nalgebra::{Matrix6, Vector3};

/// Plane or space, with the pose that its filters take from a measurement of the platform.
pub trait TellPose {
    /// Set the pose of the platform from `m`. A missing velocity is computed from the last pose.
    fn tell_pose(platform: &mut Platform, m: &Measurement, sensing: &Sensing);
}

impl TellPose for Plane {
    /// Set the pose of the platform from `m`. Of a pose in space, only position, heading and motion
    /// in the plane are used.
    fn tell_pose(platform: &mut Platform, m: &Measurement, sensing: &Sensing) {
        let (v, stamp_ns) = (m.values(), m.stamp_ns());
        let (values, covariance) = if m.sensor() == Sensor::SpacePose {
            let rate = v.get(11).copied();
            let motion = rate.map(|rate| [v[6], v[7], rate]);
            let wide = sensing.space_pose_noise(m);
            let own = [0, 1, 5];
            let level = |wide: Matrix6<f64>| {
                nalgebra::Matrix3::from_fn(|row, column| wide[(own[row], own[column])])
            };
            (([v[0], v[1], v[5]], motion), wide.map(level))
        } else {
            let motion = v.get(3..6).map(|motion| [motion[0], motion[1], motion[2]]);
            (([v[0], v[1], v[2]], motion), sensing.pose_noise(m))
        };
        let ([x, y, yaw], motion) = values;
        let told = motion.map(|[vx, vy, rate]| ([vx, vy], rate));
        let position = [x, y];
        let (velocity, rate) =
            told.unwrap_or_else(|| motion_since(platform.pose, stamp_ns, position, yaw));
        platform.pose = Some(Pose { stamp_ns, position, yaw, velocity, rate, covariance });
    }
}

/// Velocity and turn rate that lead from the last pose to this one.
fn motion_since(
    last: Option<Pose>,
    stamp_ns: i64,
    position: [f64; 2],
    yaw: f64,
) -> ([f64; 2], f64) {
    let Some(last) = last else { return ([0.0; 2], 0.0) };
    let dt = stamp_ns.saturating_sub(last.stamp_ns) as f64 * 1e-9;
    if dt <= 0.0 {
        return (last.velocity, last.rate);
    }
    let velocity = std::array::from_fn(|k| (position[k] - last.position[k]) / dt);
    (velocity, wrapped(yaw - last.yaw) / dt)
}

impl TellPose for Space {
    /// Set the pose of the platform from `m`. A pose in the plane is that of a level platform at
    /// height zero.
    fn tell_pose(platform: &mut Platform, m: &Measurement, sensing: &Sensing) {
        let (v, stamp_ns) = (m.values(), m.stamp_ns());
        let triple = |first: usize| v.get(first..first + 3).map(Vector3::from_column_slice);
        let (pose, has_motion) = if m.sensor() == Sensor::SpacePose {
            let zero = Vector3::zeros;
            let pose = SpacePose {
                stamp_ns,
                position: triple(0).unwrap_or_else(zero),
                attitude: triple(3).unwrap_or_else(zero),
                velocity: triple(6).unwrap_or_else(zero),
                rates: triple(9).unwrap_or_else(zero),
                covariance: sensing.space_pose_noise(m),
            };
            (pose, v.len() == 12)
        } else {
            let mut pose = SpacePose::level(stamp_ns, [v[0], v[1]], v[2]);
            if let Some(motion) = triple(3) {
                pose.velocity = Vector3::new(motion.x, motion.y, 0.0);
                pose.rates = Vector3::new(0.0, 0.0, motion.z);
            }
            pose.covariance = sensing.pose_noise(m).map(|level| {
                let (mut wide, own) = (Matrix6::zeros(), [0, 1, 5]);
                for (row, column) in (0..3).flat_map(|row| (0..3).map(move |c| (row, c))) {
                    wide[(own[row], own[column])] = level[(row, column)];
                }
                wide
            });
            (pose, v.len() == 6)
        };
        let last = platform.in_space.as_deref().filter(|_| !has_motion);
        platform.in_space = Some(Box::new(last.map_or(pose, |last| pose.after(last))));
    }
}
