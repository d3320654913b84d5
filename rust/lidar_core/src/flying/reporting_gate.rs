//! Gate of the detector: whether the detections of a scan are reported. It is not the validation
//! gate of a tracker, which limits the measurements that a track may use.

use std::fmt;

/// Whether the detections of a scan are reported, or the reason why not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReportingGate {
    /// Detections are reported.
    Open,
    /// The burn-in is not over: no detections are reported.
    BurnIn {
        /// Number of scans of the burn-in so far, including this one.
        scans: u32,
        /// Estimated number of scans of the burn-in.
        of: u32,
    },
    /// No group of occupied voxels has enough confident ones yet: there is no background.
    NoBackground {
        /// Number of confidently occupied voxels that one group must have.
        needed: usize,
    },
    /// Most returns contradict the map: the pose has jumped, or the map is of another place. The
    /// scan is held.
    PoseMismatch {
        /// Share of free voxels among the observed voxels with returns, per mille.
        per_mille: u32,
    },
}

impl fmt::Display for ReportingGate {
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
