//! Viewpoint of a scan: pose, time and view.

use super::level_pose::LevelPose;
use super::visibility::SortedView;
use serde::{Deserialize, Serialize};

/// Viewpoint of a scan: pose, time, sensor, and the sorted scan for visibility tests.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(in crate::circles::map) struct Viewpoint {
    pub(in crate::circles::map) stamp_ns: i64,
    pub(in crate::circles::map) sensor: u32,
    pub(in crate::circles::map) pose: LevelPose,
    pub(in crate::circles::map) view: Option<SortedView>,
}

impl Viewpoint {
    /// Key for the order of scans: stamp [ns] and index of the sensor.
    pub(in crate::circles::map) fn key(&self) -> (i64, u32) {
        (self.stamp_ns, self.sensor)
    }
}
