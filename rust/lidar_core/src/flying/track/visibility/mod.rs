//! Visibility of targets: occupied space, rays of a cloud, points in the regions of tracks.

pub(super) mod occupancy;
pub(super) mod select;
pub(super) mod view;
