//! A 2D scan: rays without return, polar form, poses of the scanner, range limitation, projection
//! to the horizontal plane.

pub mod misses;
pub mod polar_scan;
pub mod projection;
pub mod sweep_poses;
