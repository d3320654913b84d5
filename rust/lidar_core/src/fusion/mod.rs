//! One target, seen by LiDAR and radar from a platform that may move.
//!
//! # Source
//! "ctrv-lidar-radar-ekf": Remote Sensing 2023, 15, 3396; equation numbers are the paper's.

pub mod cartesian;
pub mod drone;
pub mod engine;
pub mod exchange;
pub mod filter;
pub mod heading;
pub mod imm;
pub mod joint;
pub mod life;
pub mod likelihood;
pub mod many;
pub mod measurement;
pub mod motion;
pub mod paper;
pub mod platform;
pub mod record;
pub mod sensors;
pub mod sigma;
pub mod smooth;
pub mod target;
pub mod tracks;
pub mod turn;

pub use filter::{Filter, FusionParameters, Method, Model, Strengths};
pub use many::{Assigned, Association, ManyParameters, ManyTargets, TrackState};
pub use measurement::{Measurement, Sensor};
pub use record::{Record, run, run_batch, smooth};
