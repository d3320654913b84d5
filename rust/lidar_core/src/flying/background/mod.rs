//! Background before the map knows it: burn-in, static points, and jumps of the pose.

pub(crate) mod burn_in;
pub mod parameters;
pub(crate) mod pose_jump;
pub(crate) mod static_points;
