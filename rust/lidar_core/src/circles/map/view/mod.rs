//! What a scan shows of a place, and from where.

pub(super) mod earlier;
pub(super) mod level_pose;
pub(super) mod viewpoint;
pub(super) mod visibility;
