//! LiDAR simulator: shapes, movers, ray patterns, noise.
//!
//! A [`scene::Scene`] holds bodies at rest under a bounding-volume tree and movers on [`trajectory::Trajectory`]s.
//! [`simulate::scan`] simulates a [`ray_patterns::Lidar`] that moves through the scene on a trajectory of its own.
//! Every ray has its own time. Every random number depends only on seed, scan and ray, so that the result is the same
//! for any number of threads.

use lidar_core::Error;

pub mod air;
pub mod circle_beams;
pub mod circle_samples;
pub mod mesh;
pub mod motion;
mod parry;
pub mod random;
pub mod ray_patterns;
pub mod scene;
pub mod scenes;
pub mod shape;
pub mod simulate;
pub mod surface;
pub mod trajectory;

/// Error for a parameter that is out of its range.
pub(crate) fn refused(
    name: &'static str,
    expected: &'static str,
    got: &dyn std::fmt::Debug,
) -> Error {
    Error::Parameter { name, expected, got: format!("{got:?}") }
}
