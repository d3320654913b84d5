//! Background before the map knows it: burn-in and how long it takes, static points, pose jumps.

pub(crate) mod burn_in;
pub mod parameters;
pub(crate) mod pose_jump;
pub(crate) mod static_points;
