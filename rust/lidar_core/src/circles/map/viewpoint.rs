//! Viewpoint of a scan: pose, time and view.

use super::level_pose::LevelPose;
use super::visibility::SortedView;
use serde::{Deserialize, Serialize};

/// Viewpoint of a scan: pose, time, sensor, and the view for questions of visibility.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Viewpoint {
    pub(super) stamp_ns: i64,
    pub(super) sensor: u32,
    pub(super) pose: LevelPose,
    pub(super) view: Option<SortedView>,
}

impl Viewpoint {
    /// Key for the order of scans.
    pub(super) fn key(&self) -> (i64, u32) {
        (self.stamp_ns, self.sensor)
    }
}
