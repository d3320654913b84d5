//! Where a target can be seen: occupied space, sight of a cloud, points in the regions of tracks.

pub(super) mod occupancy;
pub(super) mod select;
pub(super) mod view;
