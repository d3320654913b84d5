//! Visibility of targets: occupied space, rays of a cloud, points in the search regions of tracks.

pub(super) mod occupancy;
pub(super) mod select;
pub(super) mod view;
