//! Seeded scenes shared by the benches, files of them, and the plain kernels that serve as yardsticks.

pub mod figures;
pub mod files;
pub mod reference;

use lidar_core::Error;
use lidar_core::flying::integrate::classified_scan::{ClassifiedScan, Origins};
use lidar_core::flying::point_class::PointClass;
use lidar_core::flying::scan::prepared::RawScan;
use lidar_core::util::threads;
use lidar_sim::scenes::performance;

/// Rays of the yardsticks clear up to here, as those of a map by default [m].
pub const MAX_RANGE: f64 = 20.0;
/// Edge of a voxel of the yardsticks, as that of a map by default [m].
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
    pub class: Vec<PointClass>,
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
            class: met
                .iter()
                .map(|&met| if met { PointClass::Background } else { PointClass::Invalid })
                .collect(),
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
