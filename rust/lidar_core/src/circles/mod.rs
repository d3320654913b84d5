//! Round obstacles in 2D scans: from one sweep of ranges to a map of circles with identities.
//!
//! # Source
//! Sanchez-Lopez, Sampedro, Cazzato & Voos, "Deep learning based semantic situation awareness
//! system for multirotor aerial robots using LIDAR", 2019. Equation numbers are the paper's.
//!
//! # Example
//! ```
//! use lidar_core::circles::parameters::PipelineParameters;
//! use lidar_core::circles::pipeline::{CirclePipeline, RawSweep};
//!
//! let parameters = PipelineParameters::default();
//! let scanner = parameters.scanner;
//! let bearing = |ray: usize| scanner.angle_min + scanner.angle_increment * ray as f64;
//! // A post of radius 0.3 m, 4 m ahead; other rays meet nothing.
//! let range = |angle: f64| {
//!     let root = (0.09 - (4.0 * angle.sin()).powi(2)).sqrt();
//!     if angle.abs() > 1.0 || root.is_nan() { f64::INFINITY } else { 4.0 * angle.cos() - root }
//! };
//! let rays = (0..scanner.n_beams).map(bearing);
//! let ranges: Vec<f32> = rays.map(|angle| range(angle) as f32).collect();
//! let at_origin = [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.];
//! let mut pipeline = CirclePipeline::new(parameters)?;
//! for scan in 0..5 {
//!     pipeline.process(&RawSweep {
//!         scanner: "lidar",
//!         stamp_ns: scan * 50_000_000,
//!         ranges: &ranges,
//!         poses: &[at_origin],
//!         pose_stamps_ns: None,
//!         ray_time_ns: None,
//!         pose_covariance: None,
//!     })?;
//! }
//! assert_eq!(pipeline.map_at(200_000_000).len(), 1);
//! # Ok::<(), lidar_core::Error>(())
//! ```

pub mod fit;
pub mod frame;
pub mod map;
mod map_input;
pub mod parameters;
pub mod pipeline;
mod pose_offset;
pub mod preprocess;
mod range_noise;
mod raw_sweep;
mod scanner;
pub mod segment;
pub mod selection;
pub mod shape;
