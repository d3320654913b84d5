//! Bindings of target tracking with LiDAR and radar.

pub(crate) mod config;
pub(crate) mod filter;
pub(crate) mod many;
