//! Round obstacles in 2D scans: from one sweep of ranges to a map of circles with identities.
//!
//! # Source
//! Sanchez-Lopez, Sampedro, Cazzato & Voos, "Deep learning based semantic situation awareness
//! system for multirotor aerial robots using LIDAR", 2019. Equation numbers are the paper's.

pub mod bodies;
mod channel;
pub mod circle;
pub mod corner;
pub mod fit;
pub mod frame;
pub mod map;
mod merge;
mod parts;
pub mod pipeline;
pub mod polar;
pub mod preprocess;
pub mod segment;
pub mod segments;
pub mod shape;
pub mod sweep;
pub mod window;
