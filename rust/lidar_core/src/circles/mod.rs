//! Round obstacles in 2D scans: from one sweep of ranges to a map of circles with identities.
//!
//! # Source
//! Sanchez-Lopez, Sampedro, Cazzato & Voos, "Deep learning based semantic situation awareness
//! system for multirotor aerial robots using LIDAR", 2019. Equation numbers are the paper's.

pub mod fit;
pub mod frame;
pub mod map;
mod map_input;
pub mod pipeline;
pub mod preprocess;
mod raw_sweep;
mod scanner;
pub mod segment;
pub mod selection;
pub mod shape;
