//! Seeded scenes shared by the benches, files of them, and the plain kernels that serve as yardsticks.

pub mod files;
pub mod reference;

use lidar_core::Error;
use lidar_core::flying::background::burn_in::SeedParameters;
use lidar_core::flying::classify::classifier::ClassifyParameters;
use lidar_core::flying::integrate::integrator::{BACKGROUND, ClassifiedScan, INVALID, Origins};
use lidar_core::flying::integrate::pose_weights::PoseParameters;
use lidar_core::flying::map::separate::Separation;
use lidar_core::flying::map::voxel_map::{MapParameters, RayUnit, Rays};
use lidar_core::flying::parameters::FlyingParameters;
use lidar_core::flying::scan::prepared::RawScan;
use lidar_core::flying::scan::sensor::SensorParameters;
use lidar_core::flying::sky::Beams;
use lidar_core::flying::track::{
    Ageing, Association, Confirmation, Hiding, MeasurementForm, Merging, Motion, NoiseForm, Radius,
    RadiusForm, TrackerParameters,
};
use lidar_core::geometry::cluster::Clustering;
use lidar_core::util::threads;
use lidar_sim::scenes::performance;
use std::collections::BTreeMap;

/// Rays clear up to here [m].
pub const MAX_RANGE: f64 = 20.0;
/// Edge of a voxel [m].
pub const VOXEL_SIZE: f64 = 0.25;

/// One scan of a scene: 128 x 1024 rays.
pub struct Scan {
    /// Start of all rays [m], world frame.
    pub origin: [f64; 3],
    /// Unit directions; the sensor does not turn.
    pub directions: Vec<[f32; 3]>,
    /// Ends of the rays [m], world frame; NaN without return.
    pub world: Vec<[f32; 3]>,
    /// The same in the LiDAR's frame.
    pub local: Vec<[f32; 3]>,
    /// Rays that met nothing.
    pub no_return: Vec<bool>,
    /// Background where there is a point.
    pub class: Vec<u8>,
    /// `world_from_lidar`, row-major.
    pub pose: [f64; 16],
}

impl Scan {
    /// The scan whose rays go from `origin` along `directions` and end at `world`, or never (NaN).
    #[must_use]
    pub fn new(origin: [f64; 3], directions: Vec<[f32; 3]>, world: Vec<[f32; 3]>) -> Self {
        let [x, y, z] = origin;
        let local = world
            .iter()
            .map(|end| std::array::from_fn(|axis| (f64::from(end[axis]) - origin[axis]) as f32));
        let met: Vec<bool> = world.iter().map(|end| end[0].is_finite()).collect();
        Self {
            origin,
            local: local.collect(),
            no_return: met.iter().map(|&met| !met).collect(),
            class: met.iter().map(|&met| if met { BACKGROUND } else { INVALID }).collect(),
            pose: [1.0, 0.0, 0.0, x, 0.0, 1.0, 0.0, y, 0.0, 0.0, 1.0, z, 0.0, 0.0, 0.0, 1.0],
            directions,
            world,
        }
    }

    /// The scan with every point as background.
    #[must_use]
    pub fn classified(&self) -> ClassifiedScan<'_> {
        ClassifiedScan {
            points: &self.world,
            class: &self.class,
            origins: Origins::One(self.origin),
            directions: Some(&self.directions),
            no_return: Some(&self.no_return),
            no_ray: None,
            reach: None,
            pose_error: None,
        }
    }

    /// The scan as a sensor delivers it.
    #[must_use]
    pub fn raw(&self, stamp_ns: i64) -> RawScan<'_> {
        RawScan {
            organised: true,
            sensor: "lidar",
            stamp_ns,
            points: &self.local,
            no_return: Some(&self.no_return),
            directions: Some(&self.directions),
            point_time_ns: None,
            poses: std::slice::from_ref(&self.pose),
            pose_stamps_ns: None,
            pose_covariance: None,
        }
    }

    /// Points with a return.
    #[must_use]
    pub fn returns(&self) -> Vec<[f32; 3]> {
        self.world.iter().copied().filter(|point| point[0].is_finite()).collect()
    }
}

/// The first `count` scans of scene 1 (sensor 10 m above a street) or 2 (3 m).
///
/// # Errors
/// Of the simulator.
pub fn street(number: u32, count: u64) -> Result<Vec<Scan>, Error> {
    let scene = performance(number)?;
    let pool = threads::pool(2)?;
    (0..count)
        .map(|index| {
            let scan = scene.scan(&pool, index)?;
            Ok(from_ranges(scan.origin, &scan.directions, &scan.ranges))
        })
        .collect()
}

/// Scans by their name: of both scenes, and of a real LiDAR where the variable `LIDAR_CORE_SCANS`
/// names a folder of them.
///
/// # Errors
/// Of the simulator or the file system.
pub fn all(count: u64) -> Result<Vec<(String, Vec<Scan>)>, Error> {
    let mut found = Vec::new();
    for number in [1, 2] {
        found.push((format!("scene_{number}"), street(number, count)?));
    }
    if let Some(folder) = std::env::var_os("LIDAR_CORE_SCANS") {
        found.push(("recorded".to_owned(), files::read(folder.as_ref()).map_err(Error::Io)?));
    }
    Ok(found)
}

fn from_ranges(origin: [f64; 3], directions: &[[f64; 3]], ranges: &[f64]) -> Scan {
    let rays = directions.iter().zip(ranges);
    let ends = rays.map(|(direction, &range)| {
        if range.is_finite() {
            std::array::from_fn(|axis| (origin[axis] + range * direction[axis]) as f32)
        } else {
            [f32::NAN; 3]
        }
    });
    let narrow = directions.iter().map(|direction| direction.map(|value| value as f32));
    Scan::new(origin, narrow.collect(), ends.collect())
}

/// Map of Table II.
#[must_use]
pub fn map_parameters() -> MapParameters {
    MapParameters {
        voxel_size: VOXEL_SIZE,
        origin: [0.0; 3],
        g_occ: 0.0,
        g_unk: -740.0,
        g_free: -1000.0,
        initial: -740.0,
        thresholds: [-750.0, -300.0, -0.1],
        extra_thresholds: Vec::new(),
        max_range: MAX_RANGE,
        end_margin: 0.0,
        rays: Rays::All,
        ray_unit: RayUnit::Edges,
        ray_gain: 1.0,
        bounds: None,
        max_voxels: 200_000_000,
    }
}

/// Clusters of Table II.
pub const CLUSTERING: Clustering =
    Clustering { max_distance: 0.25, min_points: 1, max_points: None };
/// Separation of Table II.
pub const SEPARATION: Separation = Separation { max_gap: 0.8, min_confident: 24, dilate: false };

/// Classification in best mode.
#[must_use]
pub fn classify_parameters() -> ClassifyParameters {
    ClassifyParameters {
        close_distance: 0.7,
        search_distance: 3.0,
        search_adds_extent: false,
        after_update: false,
        open_border: true,
        own_shadow: true,
        expand_own: true,
        max_extent: Some(1.5),
        background_extent: Some(3.0),
        min_points: 3,
        max_distance: Some(20.0),
        group_distance: Some(0.7),
        min_clearance: 0.625,
        upright_height: Some(1.2),
        follow_tracks: true,
        fill_pockets: false,
    }
}

/// The whole detector in best mode.
#[must_use]
pub fn flying_parameters() -> FlyingParameters {
    FlyingParameters {
        map: map_parameters(),
        clustering: CLUSTERING,
        cluster_angle: 0.0125,
        cluster_voxels: false,
        classify: classify_parameters(),
        separation: SEPARATION,
        removal_waits: true,
        seed: SeedParameters {
            burn_in_scans: 4,
            burn_in_period: None,
            burn_in_extent: 1.0,
            standing_scans: 0,
            standing_shift: 0.04,
            standing_track_distance: 0.5,
            ground_height: None,
            take_off_height: None,
        },
        sensors: BTreeMap::new(),
        default_sensor: SensorParameters {
            min_range: 0.3,
            self_box: None,
            blind_sectors: Vec::new(),
            self_mask: None,
            learn_mask_scans: 0,
            learn_mask_range: 1.0,
            mask_empty_only: false,
            beams: Beams::Learnt,
            known_sensors: Vec::new(),
            find_body: true,
            returns_per_ray: 1,
        },
        tracker: tracker_parameters(),
        centers: true,
        pose: PoseParameters {
            position_std: [0.0; 3],
            angle_std: [0.0; 3],
            weighting: None,
            end_sigmas: 0.0,
        },
        range_std: 0.03,
        target_radius: 0.325,
        mismatch_share: Some(0.5),
        forget_distance: None,
    }
}

/// Tracker in best mode.
#[must_use]
pub fn tracker_parameters() -> TrackerParameters {
    TrackerParameters {
        buffer_size: 10,
        clustering: CLUSTERING,
        max_extent: Some(1.5),
        occupied_distance: 0.7,
        occupied_adds_extent: false,
        radius: Radius { form: RadiusForm::SixthRoot, scale: 1.22, min: 1.5, max: 3.0 },
        motion: Motion {
            acceleration_time: Some(1.0),
            unseen_time: Some(0.3),
            form: NoiseForm::Continuous,
            std: [0.0, 0.1, 4.0],
        },
        initial_std: [0.3, 4.0, 3.0],
        measurement: MeasurementForm::Center,
        measurement_std: 0.07,
        hiding: Some(Hiding { share: 0.75, time: 2.0 }),
        association: Association::Global { gate_probability: 0.9999, clutter_density: 1e-5 },
        rejoin_acceleration: Some(2.0),
        split_distance: Some(0.8),
        confirmation: Confirmation { hits: 3, window: 10, doubt: None },
        merging: Some(Merging { distance: 0.3, speed: 1.0 }),
        ageing: Ageing::Visible { max_coast: 3.0, report_coast: 0.3 },
    }
}
