//! Bindings of the detector of flying objects, its map and its tracker.

pub(crate) mod analysis;
pub(crate) mod center;
pub(crate) mod config;
pub(crate) mod detector;
pub(crate) mod sweep_times;
pub(crate) mod tracker;
pub(crate) mod voxel_map;
