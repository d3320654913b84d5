//! All parameters of the detector.

use super::background::parameters::SeedParameters;
use super::classify::flood::{check_steps, search_radius};
use super::classify::parameters::ClassifyParameters;
use super::integrate::pose_weights::PoseParameters;
use super::map::parameters::MapParameters;
use super::map::parameters::Separation;
use super::scan::sensor::SensorParameters;
use super::track::{Confirmation, TrackerParameters};
use crate::Error;
use crate::geometry::cluster::Clustering;
use crate::geometry::cluster::angular_gap::{AngularGap, label_seen};
use std::collections::BTreeMap;

/// Rays clear this much further than the range in which targets are sought, so that what is around
/// a target at that range has been observed [m].
const RANGE_MARGIN: f64 = 2.0;

/// All parameters of the detector.
#[derive(Clone, Debug, PartialEq)]
pub struct FlyingParameters {
    /// Parameters of the map. The detector sets the origin.
    pub map: MapParameters,
    /// Parameters of the clustering of points (eqs 13-15).
    pub clustering: Clustering,
    /// Gaps that the sensor sees under this angle are inside a cluster too [rad].
    pub cluster_angle: f64,
    /// Centres of voxels are clustered instead of points.
    pub cluster_voxels: bool,
    /// Parameters of the classification of clusters (sec. III-B).
    pub classify: ClassifyParameters,
    /// Removal of separate voxels (sec. III-D).
    pub separation: Separation,
    /// Nothing is removed before some group holds enough confident voxels; otherwise removal
    /// begins with the first scan.
    pub removal_waits: bool,
    /// Parameters of the seeds of the background.
    pub seed: SeedParameters,
    /// LiDARs by name; `default_sensor` for the others.
    pub sensors: BTreeMap<String, SensorParameters>,
    /// LiDARs that `sensors` does not name.
    pub default_sensor: SensorParameters,
    /// Parameters of the tracker (sec. III-F).
    pub tracker: TrackerParameters,
    /// Detections are centres of targets, not centroids of their points (eq. 19).
    pub centers: bool,
    /// Covariance of poses that have none, and handling of uncertain poses by the map.
    pub pose: PoseParameters,
    /// Range noise [m].
    pub range_std: f64,
    /// The smallest target that must be seen [m]: radius.
    pub target_radius: f64,
    /// Share of returns in free space above which a scan is held; None never holds one.
    pub mismatch_share: Option<f64>,
    /// Distance from the sensor beyond which the map forgets voxels [m].
    pub forget_distance: Option<f64>,
    /// Largest distance in which targets of one or two returns per scan, and targets beyond the map, are sought
    /// [m]; None: none are.
    pub few_returns_distance: Option<f64>,
}

/// Best mode.
impl Default for FlyingParameters {
    fn default() -> Self {
        let map = MapParameters::default();
        Self {
            map: MapParameters { max_range: map.max_range + RANGE_MARGIN, ..map },
            clustering: Clustering::default(),
            cluster_angle: 0.02,
            cluster_voxels: false,
            classify: ClassifyParameters::default(),
            separation: Separation::default(),
            removal_waits: true,
            seed: SeedParameters::default(),
            sensors: BTreeMap::new(),
            default_sensor: SensorParameters::default(),
            tracker: TrackerParameters::default(),
            centers: true,
            pose: PoseParameters::default(),
            range_std: 0.03,
            target_radius: 0.325,
            mismatch_share: Some(0.5),
            forget_distance: None,
            few_returns_distance: Some(100.0),
        }
    }
}

impl FlyingParameters {
    /// The algorithms as published, with the parameters of Table II.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            map: MapParameters::paper(),
            cluster_angle: 0.0,
            classify: ClassifyParameters::paper(),
            seed: SeedParameters::paper(),
            default_sensor: SensorParameters::paper(),
            tracker: TrackerParameters::paper(),
            centers: false,
            pose: PoseParameters::paper(),
            mismatch_share: None,
            few_returns_distance: None,
            ..Self::default()
        }
    }
}

impl FlyingParameters {
    /// Whether points of ground movers have a class of their own: where tracks have kinds, and every
    /// point has its class before the map is updated.
    pub(super) fn tells_movers(&self) -> bool {
        let has_kinds = matches!(self.tracker.confirmation, Confirmation::Existence { .. });
        has_kinds && !self.classify.after_update
    }

    /// Largest distance of targets that no single scan detects [m]; None where tracks have no probabilities.
    pub(super) fn few_returns(&self) -> Option<f64> {
        let has_kinds = matches!(self.tracker.confirmation, Confirmation::Existence { .. });
        self.few_returns_distance.filter(|_| has_kinds)
    }

    /// Check that the parameters of all stages fit together.
    ///
    /// # Errors
    /// [`Error::Parameter`] for values that cannot work together.
    pub(super) fn check(&self) -> Result<(), Error> {
        let voxel_size = self.map.voxel_size;
        self.separation.check(voxel_size)?;
        search_radius(self.classify.search_distance, voxel_size)?;
        check_steps("close_distance", self.classify.close_distance, voxel_size)?;
        let gap = AngularGap { origin: [0.0; 3], max_angle: self.cluster_angle };
        label_seen(&[], &gap, &self.clustering, None).map(drop)
    }
}
