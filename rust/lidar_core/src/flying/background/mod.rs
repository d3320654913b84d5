//! Where background comes from before the map knows it: burn-in, static points, pose jumps.

pub mod burn_in;
pub(crate) mod pose_jump;
pub(crate) mod static_points;
