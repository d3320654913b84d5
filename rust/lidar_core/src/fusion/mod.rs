//! One target, seen by LiDAR and radar from a platform that may move.
//!
//! # Source
//! "ctrv-lidar-radar-ekf": Remote Sensing 2023, 15, 3396; equation numbers are the paper's.

pub mod cartesian;
pub mod drone;
pub mod engine;
pub mod filter;
pub mod heading;
pub mod measurement;
pub mod motion;
pub mod platform;
pub mod sensors;
pub mod target;
pub mod turn;

pub use filter::{Filter, FusionParameters, Method, Model, Strengths, run};
pub use measurement::{Measurement, Sensor};
