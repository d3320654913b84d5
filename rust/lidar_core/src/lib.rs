//! LiDAR processing for robots: flying objects, maps of round obstacles, fusion with radar.
//!
//! Three capabilities are built on shared modules and never import one another: [`flying`] finds
//! and tracks flying objects in 3D scans, [`circles`] maps round obstacles in 2D scans, [`fusion`]
//! tracks targets with LiDAR and radar. [`geometry`], [`estimation`], [`tracking`] and [`util`] are
//! shared.
//!
//! SI units and radians; right-handed frames, x forward, y left, z up; stamps are `i64`
//! nanoseconds; points are `f32`, poses and filter states `f64`.

pub mod circles;
mod error;
pub mod estimation;
pub mod flying;
pub mod fusion;
pub mod geometry;
#[cfg(test)]
mod state_layouts;
pub mod tracking;
pub mod util;

pub use error::Error;
