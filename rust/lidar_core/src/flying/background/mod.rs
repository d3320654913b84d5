//! Background before the map knows it: burn-in and how long it takes, static points, pose jumps.

pub mod burn_in;
pub(crate) mod burn_in_time;
pub(crate) mod pose_jump;
pub(crate) mod static_points;
