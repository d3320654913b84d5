//! One target, seen by LiDAR and radar from a platform that may move.
//!
//! # Source
//! "ctrv-lidar-radar-ekf": Remote Sensing 2023, 15, 3396; equation numbers are the paper's.

pub mod filter;
pub mod models;
pub mod sensors;
pub mod targets;

pub use sensors::measurement::{Measurement, Sensor};
pub use targets::any_filter::{Filter, FusionParameters, Method, Model, Strengths};
pub use targets::many::{Assigned, Association, ManyParameters, ManyTargets, TrackState};
pub use targets::record::{Record, run, run_batch, smooth};
