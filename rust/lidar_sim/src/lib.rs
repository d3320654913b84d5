//! LiDAR simulator: shapes, movers, ray patterns, noise.
//!
//! A [`scene::Scene`] holds bodies at rest under a bounding-volume tree and movers on
//! [`trajectory::Trajectory`]s. [`simulate::scan`] lets a [`ray_patterns::Lidar`] on a trajectory of
//! its own look at it: every ray has its own time, every random number depends on nothing but
//! seed, scan and ray, so that the result is the same for any number of threads.

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

/// The error for a parameter that has another value than expected.
pub(crate) fn refused(
    name: &'static str,
    expected: &'static str,
    got: &dyn std::fmt::Debug,
) -> Error {
    Error::Parameter { name, expected, got: format!("{got:?}") }
}
