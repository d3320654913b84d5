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

/// Distance by which rays clear voxels beyond the largest range of targets [m], so that the space
/// around a target at that range has been observed.
const RANGE_MARGIN: f64 = 2.0;

/// All parameters of the detector.
#[derive(Clone, Debug, PartialEq)]
pub struct FlyingParameters {
    /// Parameters of the voxel map. The detector sets their `origin`.
    pub map: MapParameters,
    /// Parameters of the clustering of points (eqs 13-15).
    pub clustering: Clustering,
    /// Two points are also in one cluster if the sensor sees the gap between them under at most
    /// this angle [rad]. 0: only the distance counts.
    pub cluster_angle: f64,
    /// If true, the centres of voxels are clustered instead of points.
    pub cluster_voxels: bool,
    /// Parameters of the classification of clusters (sec. III-B).
    pub classify: ClassifyParameters,
    /// Removal of separate voxels (sec. III-D).
    pub separation: Separation,
    /// If true, nothing is removed before some group has enough confident voxels. If false, removal
    /// begins with the first scan.
    pub removal_waits: bool,
    /// Parameters of the seeds of the background.
    pub seed: SeedParameters,
    /// Parameters of single LiDARs, by name.
    pub sensors: BTreeMap<String, SensorParameters>,
    /// Parameters of the LiDARs that `sensors` does not name.
    pub default_sensor: SensorParameters,
    /// Parameters of the tracker (sec. III-F).
    pub tracker: TrackerParameters,
    /// If true, detections are at the estimated centres of targets, else at the centroids of their
    /// points (eq. 19).
    pub centers: bool,
    /// Covariance of poses that come without one, and use of the uncertainty by the map.
    pub pose: PoseParameters,
    /// Standard deviation of ranges [m].
    pub range_std: f64,
    /// Radius of the smallest target that must be visible [m].
    pub target_radius: f64,
    /// Share of free voxels among those with returns above which a scan is held. None: no scan is
    /// held.
    pub mismatch_share: Option<f64>,
    /// Distance from the sensor beyond which the map forgets voxels [m]. None: it forgets none for
    /// this reason.
    pub forget_distance: Option<f64>,
    /// Largest distance up to which the detector searches for targets of one or two returns per
    /// scan, and for targets beyond the range of the map [m]. None: no such search.
    pub few_returns_distance: Option<f64>,
}

/// Parameters of the best mode (not of the paper).
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
    /// Whether points of ground movers get their own class. This needs tracks with kinds, and
    /// classes of all points before the map is updated.
    pub(super) fn tells_movers(&self) -> bool {
        let has_kinds = matches!(self.tracker.confirmation, Confirmation::Existence { .. });
        has_kinds && !self.classify.after_update
    }

    /// Largest distance of targets that no single scan detects [m]. None if there is no search for
    /// them, or if tracks have no probabilities.
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
