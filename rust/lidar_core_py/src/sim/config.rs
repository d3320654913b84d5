//! Configuration of the simulator from Python -> parameters of `lidar_sim`.

use crate::arrays;
use crate::errors::BorderError;
use lidar_sim::air::Particles;
use lidar_sim::motion::{Near, RandomMotion};
use lidar_sim::ray_patterns::{Beam, Lidar, Pattern};
use lidar_sim::scene::BoundingBox;
use lidar_sim::surface::Surface;
use lidar_sim::trajectory::Trajectory;
use pyo3::prelude::*;

/// The fields of `LidarModel` that the core reads.
#[derive(FromPyObject)]
pub(crate) struct LidarConfig {
    pattern: PatternConfig,
    scan_rate: f64,
    snapshot: bool,
    range_min: f64,
    range_max: f64,
    range_std: f64,
    dropout: f64,
    beam: Option<BeamConfig>,
}

/// The fields of `Beam` that the core reads.
#[derive(FromPyObject)]
struct BeamConfig {
    half_width: f64,
    lines: i64,
    echo_length: f64,
}

#[derive(FromPyObject)]
enum PatternConfig {
    Spinning { elevations_deg: Vec<f64>, columns: i64, azimuth_start: f64, azimuth_per_scan: f64 },
    Rosette { rays: i64, elevation_deg: [f64; 2], azimuth_half_deg: Option<f64> },
    Planar { beams: i64, angle_min: f64, angle_increment: f64, time_increment_ns: i64 },
}

impl BeamConfig {
    fn beam(&self) -> Result<Beam, BorderError> {
        let lines = arrays::count("lines", self.lines)?;
        Ok(Beam { half_width: self.half_width, lines, echo_length: self.echo_length })
    }
}

impl PatternConfig {
    fn pattern(self) -> Result<Pattern, BorderError> {
        Ok(match self {
            Self::Spinning { elevations_deg, columns, azimuth_start, azimuth_per_scan } => {
                Pattern::Spinning {
                    elevations: elevations_deg.into_iter().map(f64::to_radians).collect(),
                    columns: arrays::count("columns", columns)?,
                    azimuth_start,
                    azimuth_per_scan,
                }
            }
            Self::Rosette { rays, elevation_deg, azimuth_half_deg } => Pattern::Rosette {
                rays: arrays::count("rays", rays)?,
                elevation: elevation_deg.map(f64::to_radians),
                azimuth_half: azimuth_half_deg.map(f64::to_radians),
            },
            Self::Planar { beams, angle_min, angle_increment, time_increment_ns } => {
                let rays = arrays::count("beams", beams)?;
                Pattern::Planar { rays, angle_min, angle_increment, time_increment_ns }
            }
        })
    }
}

impl LidarConfig {
    pub(crate) fn lidar(self) -> Result<Lidar, BorderError> {
        Ok(Lidar {
            pattern: self.pattern.pattern()?,
            period_ns: (1e9 / self.scan_rate).round() as i64,
            snapshot: self.snapshot,
            range_min: self.range_min,
            range_max: self.range_max,
            range_std: self.range_std,
            dropout: self.dropout,
            beam: self.beam.as_ref().map(BeamConfig::beam).transpose()?,
        })
    }
}

/// The fields of `RandomMotion` that the core reads.
#[derive(FromPyObject)]
pub(crate) struct MotionConfig {
    box_min: [f64; 3],
    box_max: [f64; 3],
    speed_max: f64,
    acceleration_max: f64,
    clearance: f64,
    sensor_distance: Option<[f64; 2]>,
    sensor_elevation_deg: [f64; 2],
}

impl MotionConfig {
    /// `apart` are the trajectories to stay away from, with the least distances.
    pub(crate) fn motion<'a>(
        self,
        sensor: &'a Trajectory,
        apart: Vec<(&'a Trajectory, f64)>,
        span_ns: (i64, i64),
        seed: (u64, u64),
    ) -> RandomMotion<'a> {
        RandomMotion {
            bounds: BoundingBox { min: self.box_min, max: self.box_max },
            speed_max: self.speed_max,
            acceleration_max: self.acceleration_max,
            clearance: self.clearance,
            apart,
            near: self.sensor_distance.map(|distance| Near {
                sensor,
                distance,
                elevation: self.sensor_elevation_deg.map(f64::to_radians),
            }),
            span_ns,
            seed,
        }
    }
}

/// The fields of `Surface`.
#[derive(FromPyObject)]
pub(crate) struct SurfaceConfig {
    reflectivity: f64,
    mirror: f64,
    clear: f64,
}

impl SurfaceConfig {
    pub(crate) fn surface(self) -> Surface {
        Surface { reflectivity: self.reflectivity, mirror: self.mirror, clear: self.clear }
    }
}

/// The fields of `Rain`, `Dust` and `Fog`.
#[derive(FromPyObject)]
pub(crate) enum ParticlesConfig {
    Rain { density: f64, drop_size: f64 },
    Dust { center: [f64; 3], velocity: [f64; 3], radius: f64, growth: f64, free_path: f64 },
    Fog { extinction: f64, speckle: f64 },
}

impl From<ParticlesConfig> for Particles {
    fn from(config: ParticlesConfig) -> Self {
        match config {
            ParticlesConfig::Rain { density, drop_size } => Self::Rain { density, size: drop_size },
            ParticlesConfig::Dust { center, velocity, radius, growth, free_path } => {
                Self::Dust { center, velocity, radius, growth, free_path }
            }
            ParticlesConfig::Fog { extinction, speckle } => Self::Fog { extinction, speckle },
        }
    }
}
