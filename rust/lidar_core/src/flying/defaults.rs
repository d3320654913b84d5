//! Parameters of the detector that ship, and those of the paper.
//!
//! These are the only literals of a configuration in Rust. A test holds them against the models of
//! the Python package, which document each value.

use super::background::parameters::SeedParameters;
use super::classify::classifier::ClassifyParameters;
use super::integrate::pose_weights::{PoseParameters, PoseWeighting};
use super::map::parameters::Separation;
use super::map::parameters::{MapParameters, RayUnit, Rays, Skip};
use super::parameters::FlyingParameters;
use super::scan::sensor::SensorParameters;
use super::sky::Beams;
use super::track::{
    Ageing, Association, Confirmation, Hiding, MeasurementForm, Merging, Motion, NoiseForm, Radius,
    RadiusForm, TrackerParameters,
};
use crate::geometry::cluster::Clustering;
use std::collections::BTreeMap;

/// Rays clear this much further than the range in which targets are sought, so that what is around
/// a target at that range has been observed [m].
const RANGE_MARGIN: f64 = 2.0;

/// Table II; the unit of the ray weight is the voxel's edge.
impl Default for MapParameters {
    fn default() -> Self {
        Self {
            voxel_size: 0.25,
            origin: [0.0; 3],
            g_occ: 0.0,
            g_unk: -740.0,
            g_free: -1000.0,
            initial: -740.0,
            thresholds: [-750.0, -300.0, -0.1],
            extra_thresholds: Vec::new(),
            max_range: 20.0,
            end_margin: 0.0,
            rays: Rays::All,
            skip: Skip::Saturated,
            settles: true,
            ray_unit: RayUnit::Edges,
            ray_gain: 1.0,
            bounds: None,
            max_voxels: 200_000_000,
        }
    }
}

impl MapParameters {
    /// Table II; the unit of the ray weight is the metre, as in the paper's text.
    #[must_use]
    pub fn paper() -> Self {
        Self { ray_unit: RayUnit::Metres, settles: false, ..Self::default() }
    }
}

/// Table II.
impl Default for Clustering {
    fn default() -> Self {
        Self { max_distance: 0.25, min_points: 1, max_points: None }
    }
}

/// Best mode.
impl Default for ClassifyParameters {
    fn default() -> Self {
        Self {
            close_distance: 0.7,
            search_distance: 3.0,
            search_adds_extent: false,
            after_update: false,
            open_border: true,
            own_shadow: true,
            expand_own: true,
            max_extent: Some(2.5),
            background_extent: Some(3.5),
            min_points: 3,
            max_distance: Some(20.0),
            group_distance: Some(0.7),
            min_clearance: 0.625,
            upright_height: Some(1.2),
            follow_tracks: true,
            fill_pockets: false,
            skips_explained: true,
        }
    }
}

impl ClassifyParameters {
    /// Rules A, B and C as published, without gates.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            open_border: false,
            own_shadow: false,
            expand_own: false,
            max_extent: None,
            background_extent: None,
            min_points: 1,
            max_distance: None,
            group_distance: None,
            min_clearance: 0.0,
            upright_height: None,
            follow_tracks: false,
            ..Self::default()
        }
    }
}

/// Table II; d_sep is not in it and comes from the authors' code.
impl Default for Separation {
    fn default() -> Self {
        Self { max_gap: 0.8, min_confident: 24, dilate: false }
    }
}

/// Best mode.
impl Default for SeedParameters {
    fn default() -> Self {
        Self {
            burn_in_scans: 10,
            burn_in_period: Some(0.1),
            burn_in_extent: 2.5,
            standing_scans: 5,
            standing_shift: 0.04,
            standing_track_distance: 0.5,
            ground_height: None,
            take_off_height: None,
        }
    }
}

impl SeedParameters {
    /// A burn-in for targets of the paper's size: the paper does not state the source of the first
    /// background.
    #[must_use]
    pub fn paper() -> Self {
        Self { burn_in_period: None, burn_in_extent: 1.0, standing_scans: 0, ..Self::default() }
    }
}

/// Best mode: rays without return and the robot itself are found from the returns.
impl Default for SensorParameters {
    fn default() -> Self {
        Self {
            min_range: 0.3,
            self_box: None,
            blind_sectors: Vec::new(),
            self_mask: None,
            learn_mask_scans: 10,
            learn_mask_range: 1.0,
            mask_empty_only: false,
            beams: Beams::Learnt,
            known_sensors: Vec::new(),
            find_body: true,
            returns_per_ray: 1,
        }
    }
}

impl SensorParameters {
    /// Every return is used, however near, and nothing is looked for.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            min_range: 0.0,
            learn_mask_scans: 0,
            beams: Beams::Given,
            find_body: false,
            ..Self::default()
        }
    }
}

/// Poses without a covariance are taken for certain; where one is given, rays end earlier.
impl Default for PoseParameters {
    fn default() -> Self {
        Self {
            position_std: [0.0; 3],
            angle_std: [0.0; 3],
            weighting: Some(PoseWeighting::Ends),
            end_sigmas: 3.0,
        }
    }
}

impl PoseParameters {
    /// The map is updated with poses that count as certain.
    #[must_use]
    pub fn paper() -> Self {
        Self { weighting: None, ..Self::default() }
    }
}

/// Targets accelerate for about a second; what is not seen for long rather goes straight on.
impl Default for Motion {
    fn default() -> Self {
        Self {
            acceleration_time: Some(1.0),
            unseen_time: Some(0.3),
            form: NoiseForm::Adaptive,
            std: [0.0, 0.1, 4.0],
        }
    }
}

/// Two seconds are long beside the time between two scans, and short beside a change of distance
/// that changes the visible size.
impl Default for Hiding {
    fn default() -> Self {
        Self { share: 0.75, time: 2.0 }
    }
}

/// Two targets that fly past each other differ by more than 1 m/s.
impl Default for Merging {
    fn default() -> Self {
        Self { distance: 0.3, speed: 1.0 }
    }
}

/// Best mode.
impl Default for TrackerParameters {
    fn default() -> Self {
        Self {
            buffer_size: 10,
            clustering: Clustering { max_distance: 0.5, ..Clustering::default() },
            max_extent: Some(2.5),
            occupied_distance: 0.7,
            radius: Radius { form: RadiusForm::SixthRoot, scale: 1.22, min: 1.5, max: 3.0 },
            motion: Motion::default(),
            initial_std: [0.3, 4.0, 3.0],
            measurement: MeasurementForm::Center,
            measurement_std: 0.07,
            hiding: Some(Hiding::default()),
            association: Association::Global { gate_probability: 0.9999, clutter_density: 1e-5 },
            rejoin_acceleration: Some(2.0),
            split_distance: Some(0.8),
            confirmation: Confirmation::Existence { report: 0.9 },
            merging: Some(Merging::default()),
            ageing: Ageing::Visible { max_coast: 3.0, report_coast: 0.5 },
        }
    }
}

impl TrackerParameters {
    /// Algorithm 2 with the values of Table II.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            clustering: Clustering::default(),
            max_extent: None,
            occupied_distance: 1.0,
            radius: Radius { form: RadiusForm::Paper, scale: 0.5, ..Self::default().radius },
            motion: Motion {
                acceleration_time: None,
                unseen_time: None,
                form: NoiseForm::Paper,
                std: [0.5, 0.5, 0.1],
            },
            initial_std: [0.5, 3.0, 3.0],
            measurement: MeasurementForm::Paper,
            measurement_std: 1.0,
            hiding: None,
            association: Association::Paper,
            rejoin_acceleration: None,
            split_distance: None,
            confirmation: Confirmation::Counts { hits: 1, window: 1 },
            merging: None,
            ageing: Ageing::Paper,
            ..Self::default()
        }
    }
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
            ..Self::default()
        }
    }
}
