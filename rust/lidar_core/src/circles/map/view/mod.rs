//! Viewpoint of a scan, and the visibility of a place from it.

pub(super) mod earlier;
pub(super) mod level_pose;
mod piece;
mod slip;
pub(super) mod surface;
pub(super) mod viewpoint;
pub(super) mod visibility;
