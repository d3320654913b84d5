//! Parameters of a tracker of many targets.

use crate::fusion::model_list::{Model, switches};
use crate::fusion::models::motion::Prior;
use crate::fusion::parameters::{FusionParameters, Method, Strengths};
use crate::fusion::targets::lifecycle::LifecycleRules;

/// Largest number of tracks at a time, and of measurements in a scan.
pub const MAX_TARGETS: usize = 2_000;
/// Initial value of the probability that a measurement which no track explains comes from a new
/// target; later learnt from scans.
pub(super) const SHARE: f64 = 0.05;

/// All parameters of a tracker of many targets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ManyParameters {
    /// Parameters of the filter of each track. Its gate decides which measurements may belong to a
    /// track, its buffer how late a scan may come.
    pub filter: FusionParameters,
    /// A track is confirmed if this many of the last `confirm_window` scans measured it.
    pub confirm_hits: u32,
    /// Number of last scans that decide whether a track is confirmed, at most 64.
    pub confirm_window: u32,
    /// Longest time without a measurement after which a track is deleted [s].
    pub max_coast: f64,
    /// Largest standard deviation of the position in one axis before a track is deleted [m].
    pub max_position_std: f64,
    /// Least distance of a new track from a track measured by the same scan [m].
    pub birth_distance: f64,
    /// Mean speed over the last 15 s below which a track is not reported [m/s].
    pub report_speed: f64,
    /// Association of measurements with tracks.
    pub association: TargetAssociation,
}

/// Association with probabilities of existence; the filter mixes three models: at rest, constant
/// velocity, changing velocity.
impl Default for ManyParameters {
    fn default() -> Self {
        Self {
            filter: FusionParameters {
                method: Method::Interacting {
                    models: switches(&[Model::ConstantVelocity, Model::Standing]),
                    sojourn: 2.0,
                    quiet: Some(0.1),
                },
                strengths: Strengths { acceleration: 1.0, ..Strengths::default() },
                prior: Prior { speed: 225.0, ..Prior::default() },
                life: LifecycleRules { start_rows: 1, ..LifecycleRules::default() },
                ..FusionParameters::default()
            },
            confirm_hits: 3,
            confirm_window: 5,
            max_coast: 2.0,
            max_position_std: 5.0,
            birth_distance: 0.0,
            report_speed: 0.0,
            association: TargetAssociation::Integrated(ExistenceParameters::default()),
        }
    }
}

/// Association of measurements with tracks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TargetAssociation {
    /// Global nearest neighbour: each measurement belongs to one track or to none.
    Nearest,
    /// Joint probabilistic data association: see
    /// [`probabilities`](crate::tracking::joint_association::probabilities).
    Joint {
        /// Probability that a scan measures a target.
        detection: f64,
        /// Density of clutter of LiDAR [1/m^2] and of radar [1/(m rad m/s)].
        clutter: [f64; 2],
    },
    /// Joint integrated probabilistic data association: see
    /// [`associate`](crate::tracking::existence::associate). Every track has a probability of
    /// existence, on which report and end depend instead of counts and ages.
    Integrated(ExistenceParameters),
}

/// Joint probabilities of existence, with clutter of 1 in 1000 m^2 (LiDAR) and 1e-3 / (m rad m/s)
/// (radar).
impl TargetAssociation {
    /// Joint probabilistic data association with the defaults of the Python package.
    #[must_use]
    pub fn joint() -> Self {
        Self::Joint { detection: 0.9, clutter: [1e-3, 1e-3] }
    }
}

/// Parameters of probabilities of existence. Properties of a scanner are learnt; these are the
/// initial values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExistenceParameters {
    /// Probability that a scan measures a target.
    pub detection: f64,
    /// Density of clutter of LiDAR [1/m^2] and of radar [1/(m rad m/s)].
    pub clutter: [f64; 2],
    /// Probability of existence from which on a track is reported.
    pub report: f64,
}

/// Defaults of the Python package; the density of clutter is learnt.
impl Default for ExistenceParameters {
    fn default() -> Self {
        Self { detection: 0.9, clutter: [1e-3, 1e-3], report: 0.95 }
    }
}
