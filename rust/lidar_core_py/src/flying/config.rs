//! The fields of `FlyingConfig` and its parts that the core reads, by name.

use crate::arrays;
use crate::flying::tracker::TrackerConfig;
use lidar_core::Error;
use lidar_core::flying::background::parameters::SeedParameters;
use lidar_core::flying::classify::parameters::ClassifyParameters;
use lidar_core::flying::integrate::pose_weights::{PoseParameters, PoseWeighting};
use lidar_core::flying::map::parameters::Separation;
use lidar_core::flying::map::parameters::{MapParameters, RayUnit, Rays, Skip};
use lidar_core::flying::parameters::FlyingParameters;
use lidar_core::flying::scan::sensor::SensorParameters;
use lidar_core::flying::sky::{Beams, RayPattern};
use lidar_core::geometry::cluster::Clustering;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::collections::BTreeMap;

#[derive(FromPyObject)]
pub(crate) struct FlyingConfig {
    voxel_map: MapConfig,
    cluster: ClusterConfig,
    classify: ClassifyConfig,
    separate: SeparateConfig,
    seed: SeedConfig,
    sensor: SensorConfig,
    sensors: BTreeMap<String, SensorConfig>,
    tracker: TrackerConfig,
    pose: PoseConfig,
    range_margin: f64,
    position: String,
    range_std: f64,
    mismatch_share: Option<f64>,
    forget_distance: Option<f64>,
    few_returns_distance: Option<f64>,
}

#[derive(FromPyObject)]
struct ClusterConfig {
    max_distance: f64,
    max_angle: f64,
    min_points: usize,
    max_points: Option<usize>,
    of: String,
}

#[derive(FromPyObject)]
pub(crate) struct ClassifyConfig {
    close_distance: f64,
    search_distance: f64,
    search_adds_extent: bool,
    map_state: String,
    border: String,
    shadow: String,
    own_voxels: String,
    max_extent: Option<f64>,
    background_extent: Option<f64>,
    min_points: usize,
    max_distance: Option<f64>,
    group_distance: Option<f64>,
    min_clearance: f64,
    upright_height: Option<f64>,
    follow_tracks: bool,
    fill_pockets: bool,
    search: String,
}

#[derive(FromPyObject)]
struct SeparateConfig {
    max_gap: f64,
    min_confident: usize,
    dilate: bool,
    waits_for_background: bool,
}

#[derive(FromPyObject)]
struct SeedConfig {
    burn_in_scans: u32,
    burn_in_period: Option<f64>,
    burn_in_extent: f64,
    standing_scans: u32,
    ground_height: Option<f64>,
    take_off_height: Option<f64>,
}

#[derive(FromPyObject)]
struct SensorConfig {
    min_range: f64,
    self_box: Option<[[f64; 3]; 2]>,
    blind_sectors: Vec<[f64; 4]>,
    self_mask: Option<Vec<bool>>,
    learn_mask_scans: u32,
    mask_empty_only: bool,
    find_body: bool,
    beam_table: BeamTable,
    known_sensors: Vec<(String, BeamTable)>,
    returns_per_ray: usize,
}

/// Names of the position of a detection in configurations: true if it is the centre of the target.
const POSITIONS: [(&str, bool); 2] = [("paper", false), ("center", true)];

impl FlyingConfig {
    pub(crate) fn parameters(self) -> Result<FlyingParameters, Error> {
        Ok(FlyingParameters {
            map: MapParameters {
                max_range: self.voxel_map.max_range + self.range_margin,
                ..self.voxel_map.parameters([0.0; 3])?
            },
            clustering: self.cluster.clustering(),
            cluster_angle: self.cluster.max_angle,
            cluster_voxels: self.cluster.of == "voxels",
            classify: self.classify.parameters(),
            separation: Separation {
                max_gap: self.separate.max_gap,
                min_confident: self.separate.min_confident,
                dilate: self.separate.dilate,
            },
            removal_waits: self.separate.waits_for_background,
            seed: self.seed.parameters(),
            sensors: self
                .sensors
                .into_iter()
                .map(|(name, sensor)| (name, sensor.parameters()))
                .collect(),
            default_sensor: self.sensor.parameters(),
            tracker: self.tracker.parameters()?,
            centers: arrays::choice("position", &self.position, &POSITIONS)?,
            pose: self.pose.parameters()?,
            range_std: self.range_std,
            mismatch_share: self.mismatch_share,
            forget_distance: self.forget_distance,
            few_returns_distance: self.few_returns_distance,
            ..FlyingParameters::default()
        })
    }
}

impl ClusterConfig {
    fn clustering(&self) -> Clustering {
        Clustering {
            max_distance: self.max_distance,
            min_points: self.min_points,
            max_points: self.max_points,
        }
    }
}

impl SeedConfig {
    fn parameters(&self) -> SeedParameters {
        SeedParameters {
            burn_in_scans: self.burn_in_scans,
            burn_in_period: self.burn_in_period,
            burn_in_extent: self.burn_in_extent,
            standing_scans: self.standing_scans,
            ground_height: self.ground_height,
            take_off_height: self.take_off_height,
            ..SeedParameters::default()
        }
    }
}

#[derive(FromPyObject)]
struct PoseConfig {
    position_std: [f64; 3],
    angle_std: [f64; 3],
    weighting: String,
    end_sigmas: f64,
}

impl PoseConfig {
    fn parameters(self) -> Result<PoseParameters, Error> {
        let weightings = [
            ("off", None),
            ("ends", Some(PoseWeighting::Ends)),
            ("spread", Some(PoseWeighting::Spread)),
        ];
        Ok(PoseParameters {
            position_std: self.position_std,
            angle_std: self.angle_std,
            weighting: arrays::choice("pose.weighting", &self.weighting, &weightings)?,
            end_sigmas: self.end_sigmas,
        })
    }
}

impl ClassifyConfig {
    pub(crate) fn parameters(self) -> ClassifyParameters {
        ClassifyParameters {
            close_distance: self.close_distance,
            search_distance: self.search_distance,
            search_adds_extent: self.search_adds_extent,
            after_update: self.map_state == "after_update",
            open_border: self.border == "open",
            own_shadow: self.shadow == "own",
            expand_own: self.own_voxels == "expanded",
            max_extent: self.max_extent,
            background_extent: self.background_extent,
            min_points: self.min_points,
            max_distance: self.max_distance,
            group_distance: self.group_distance,
            min_clearance: self.min_clearance,
            upright_height: self.upright_height,
            follow_tracks: self.follow_tracks,
            fill_pockets: self.fill_pockets,
            skips_explained: self.search == "explained",
        }
    }
}

/// `SensorConfig.beam_table`: kind, angles, number of rays.
type BeamTable = (String, Vec<f64>, usize);

/// Rays of a beam table; None for a table that names no angles.
fn beam_rays((kind, angles, count): &BeamTable) -> Option<RayPattern> {
    match (kind.as_str(), angles.as_slice()) {
        ("rows", elevations) => {
            Some(RayPattern::Rows { elevations: elevations.to_vec(), columns: *count })
        }
        ("view", &[low, high, azimuth]) => {
            Some(RayPattern::FieldOfView { elevation: [low, high], azimuth, rays: *count })
        }
        _ => None,
    }
}

impl SensorConfig {
    fn parameters(self) -> SensorParameters {
        SensorParameters {
            min_range: self.min_range,
            self_box: self.self_box,
            blind_sectors: self.blind_sectors,
            self_mask: self.self_mask,
            learn_mask_scans: self.learn_mask_scans,
            mask_empty_only: self.mask_empty_only,
            beams: match beam_rays(&self.beam_table) {
                Some(rays) => Beams::Known(rays),
                None if self.beam_table.0 == "learnt" => Beams::Learnt,
                None => Beams::Given,
            },
            known_sensors: self
                .known_sensors
                .iter()
                .filter_map(|(name, table)| Some((name.clone(), beam_rays(table)?)))
                .collect(),
            find_body: self.find_body,
            returns_per_ray: self.returns_per_ray,
            ..SensorParameters::default()
        }
    }
}

/// The fields of `VoxelMapConfig` that the core reads.
#[derive(FromPyObject)]
pub(crate) struct MapConfig {
    voxel_size: f64,
    g_occ: f32,
    g_unk: f32,
    g_free: f32,
    initial: f32,
    threshold_uncertain: f32,
    threshold_tentative: f32,
    threshold_confident: f32,
    extra_thresholds: Vec<f32>,
    max_range: f64,
    end_margin: f64,
    rays: String,
    skip: String,
    saturation: String,
    ray_unit: String,
    ray_gain: f64,
    bounds: Option<[[f64; 3]; 2]>,
    max_voxels: u64,
}

/// Names of the options that select which rays are cast.
const RAYS: [(&str, Rays); 2] = [("all", Rays::All), ("one_per_end", Rays::OnePerEnd)];

/// Names of the options that select which voxels rays skip.
const SKIPS: [(&str, Skip); 2] = [("saturated", Skip::Saturated), ("none", Skip::Nothing)];

/// Names of the options for values close to `g_free`: true if they become `g_free`.
const SATURATIONS: [(&str, bool); 2] = [("settled", true), ("paper", false)];

/// Names of the units of the ray weight.
const RAY_UNITS: [(&str, RayUnit); 3] =
    [("edges", RayUnit::Edges), ("metres", RayUnit::Metres), ("diagonals", RayUnit::Diagonals)];

impl MapConfig {
    pub(crate) fn parameters(self, origin: [f64; 3]) -> Result<MapParameters, Error> {
        Ok(MapParameters {
            voxel_size: self.voxel_size,
            origin,
            g_occ: self.g_occ,
            g_unk: self.g_unk,
            g_free: self.g_free,
            initial: self.initial,
            thresholds: [
                self.threshold_uncertain,
                self.threshold_tentative,
                self.threshold_confident,
            ],
            extra_thresholds: self.extra_thresholds,
            max_range: self.max_range,
            end_margin: self.end_margin,
            rays: arrays::choice("rays", &self.rays, &RAYS)?,
            skip: arrays::choice("skip", &self.skip, &SKIPS)?,
            settles: arrays::choice("saturation", &self.saturation, &SATURATIONS)?,
            ray_unit: arrays::choice("ray_unit", &self.ray_unit, &RAY_UNITS)?,
            ray_gain: self.ray_gain,
            bounds: self.bounds,
            max_voxels: self.max_voxels,
        })
    }
}

/// Values of `VoxelMapConfig` that a map knows, by name: what `MapConfig::parameters` has read. A saved map
/// states how it was made, and Python makes its configuration from this.
pub(crate) fn map_values(py: Python<'_>, p: MapParameters) -> PyResult<Bound<'_, PyDict>> {
    let values = PyDict::new(py);
    values.set_item("voxel_size", p.voxel_size)?;
    values.set_item("max_range", p.max_range)?;
    values.set_item("end_margin", p.end_margin)?;
    values.set_item("ray_gain", p.ray_gain)?;
    let rays = RAYS.iter().find(|(_, rays)| *rays == p.rays).map(|(name, _)| *name);
    values.set_item("rays", rays)?;
    let unit = RAY_UNITS.iter().find(|(_, unit)| *unit == p.ray_unit).map(|(name, _)| *name);
    values.set_item("ray_unit", unit)?;
    let saturation = SATURATIONS.iter().find(|(_, settles)| *settles == p.settles);
    values.set_item("saturation", saturation.map(|(name, _)| *name))?;
    let levels = [
        ("g_occ", p.g_occ),
        ("g_unk", p.g_unk),
        ("g_free", p.g_free),
        ("initial", p.initial),
        ("threshold_uncertain", p.thresholds[0]),
        ("threshold_tentative", p.thresholds[1]),
        ("threshold_confident", p.thresholds[2]),
    ];
    for (name, value) in levels {
        values.set_item(name, as_written(value))?;
    }
    let extra: Vec<f64> = p.extra_thresholds.into_iter().map(as_written).collect();
    values.set_item("extra_thresholds", extra)?;
    values.set_item("bounds", p.bounds)?;
    values.set_item("max_voxels", p.max_voxels)?;
    Ok(values)
}

/// The float64 with the shortest decimal form that rounds to the float32 `value`: -0.1f32 gives
/// -0.1.
fn as_written(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(f64::from(value))
}
