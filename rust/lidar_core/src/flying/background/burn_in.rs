//! Source of the first background, and the time from which detections may be trusted.
//!
//! No voxel starts occupied and points become background only near occupied voxels, so without a
//! seed nothing is ever background and nothing is ever detected. The paper is silent about it.

use super::burn_in_time::BurnIn;
use crate::flying::map::voxel_map::VoxelMap;
use std::fmt;

/// Seeds of the background.
#[derive(Clone, Debug, PartialEq)]
pub struct SeedParameters {
    /// Scans of the burn-in, 0 for none.
    pub burn_in_scans: u32,
    /// Time between two scans for which `burn_in_scans` is meant [s]: other sensors take as many scans
    /// as fit into the same time, at least 3. None counts scans whatever their rate.
    pub burn_in_period: Option<f64>,
    /// During the burn-in larger clusters are background [m].
    pub burn_in_extent: f64,
    /// Voxels that held points in so many scans of the burn-in are background, 0 for none.
    pub standing_scans: u32,
    /// Largest shift of a voxel's points between the halves of the burn-in that counts as standing [m].
    pub standing_shift: f64,
    /// Tracks this far from their start protect their surroundings from becoming background [m].
    pub standing_track_distance: f64,
    /// Clusters that reach down to this height are background, world frame [m].
    pub ground_height: Option<f64>,
    /// Height of the sensor above ground in the first scan: the voxel there is seeded [m].
    pub take_off_height: Option<f64>,
}

/// State of reporting: detections are reported, or the reason why not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gate {
    /// Detections are reported.
    Open,
    /// The burn-in is not over.
    BurnIn {
        /// Scans so far, this one included.
        scans: u32,
        /// Scans in all.
        of: u32,
    },
    /// No group of occupied voxels holds enough confident ones yet.
    NoBackground {
        /// Confidently occupied voxels that one group must hold.
        needed: usize,
    },
    /// Most returns contradict the map: the pose has jumped, or the map is of another place.
    PoseMismatch {
        /// Returns in free voxels, of 1000 in observed ones.
        per_mille: u32,
    },
}

impl fmt::Display for Gate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Open => f.write_str("open"),
            Self::BurnIn { scans, of } => write!(f, "burn-in: scan {scans} of {of}"),
            Self::NoBackground { needed } => write!(
                f,
                "no background: no group of occupied voxels holds {needed} confident ones yet; see \
                 the `seed` options, and `separate.waits_for_background` for sparse sensors"
            ),
            Self::PoseMismatch { per_mille } => write!(
                f,
                "map_pose_mismatch: {}.{} % of the returns lie in free space; the scan was held; \
                 call reanchor() or reset()",
                per_mille / 10,
                per_mille % 10
            ),
        }
    }
}

impl SeedParameters {
    /// Largest cluster that is not background during the burn-in, and always `otherwise`.
    pub(crate) fn background_extent(
        &self,
        burn_in: &BurnIn,
        otherwise: Option<f64>,
    ) -> Option<f64> {
        if !burn_in.is_over(self) {
            return Some(
                otherwise.map_or(self.burn_in_extent, |limit| limit.min(self.burn_in_extent)),
            );
        }
        otherwise
    }

    /// Gate of a scan, given the burn-in without it and with it.
    pub(crate) fn gate(
        &self,
        before: &BurnIn,
        with_it: &BurnIn,
        map: &VoxelMap,
        needed: usize,
    ) -> Gate {
        if !before.is_over(self) {
            Gate::BurnIn { scans: with_it.scans(), of: with_it.length(self) }
        } else if map.has_background() {
            Gate::Open
        } else {
            Gate::NoBackground { needed }
        }
    }

    /// The place on the ground below the first position of the sensor, as a range finder would
    /// see it: two readings make its voxel tentatively occupied.
    pub(crate) fn take_off_ground(&self, [x, y, z]: [f64; 3]) -> Option<[[f32; 3]; 2]> {
        let height = self.take_off_height?;
        Some([[x, y, z - height].map(|value| value as f32); 2])
    }
}
