//! Where and when a scan was made.

use super::level_pose::LevelPose;
use super::visibility::SortedView;
use serde::{Deserialize, Serialize};

/// Where and when a scan was made, and what it can be asked.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Viewpoint {
    pub(super) stamp_ns: i64,
    pub(super) sensor: u32,
    pub(super) pose: LevelPose,
    pub(super) view: Option<SortedView>,
}

impl Viewpoint {
    /// Place in the order of scans.
    pub(super) fn key(&self) -> (i64, u32) {
        (self.stamp_ns, self.sensor)
    }
}
