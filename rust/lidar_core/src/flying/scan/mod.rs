//! Raw scans, their sensors, and the points and rays of a scan in the frame of the map.

pub(crate) mod body;
mod body_voxels;
pub(crate) mod point_poses;
pub mod prepared;
pub(crate) mod raw_scan;
pub mod sensor;
pub(crate) mod sensors;
mod sweep;
pub mod untimed;
