//! Flying-object detection and tracking in 3D scans.
//!
//! Source: Vrba, Walter & Saska, "On Onboard LiDAR-based Flying Object Detection".
//!
//! # Example
//! ```
//! use lidar_core::flying::detector::FlyingObjectDetector;
//! use lidar_core::flying::parameters::FlyingParameters;
//! use lidar_core::flying::scan::RawScan;
//!
//! let mut detector = FlyingObjectDetector::new(FlyingParameters::default(), 1)?;
//! let at_origin = [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.];
//! let wall: Vec<[f32; 3]> = (0..900).map(|k| [6.0, k as f32 * 0.01 - 4.5, 1.0]).collect();
//! for scan in 0..12 {
//!     let frame = detector.process(&RawScan {
//!         sensor: "lidar",
//!         stamp_ns: scan * 100_000_000,
//!         points: &wall,
//!         poses: &[at_origin],
//!         organised: false,
//!         no_return: None,
//!         directions: None,
//!         point_time_ns: None,
//!         pose_stamps_ns: None,
//!         pose_covariance: None,
//!     })?;
//!     assert!(frame.detections.is_empty() && frame.tracks.is_empty());
//! }
//! # Ok::<(), lidar_core::Error>(())
//! ```

pub mod analysis;
mod beyond;
mod blocks;
mod body;
mod casting;
pub mod center;
pub mod classify;
mod clusters;
mod defaults;
pub mod detection;
pub mod detector;
pub mod filter;
mod flood;
mod follow;
mod found;
pub mod frame;
pub mod gate;
mod group;
pub mod integrate;
mod islands;
mod judged;
mod jump;
mod lanes;
mod layers;
mod mapping;
mod marks;
mod near;
pub mod parameters;
mod persist;
mod plan;
mod poses;
mod raw_scan;
mod raycast;
mod rule;
pub mod scan;
mod segments;
pub mod sensor;
pub mod separate;
mod shadow;
mod sheet;
pub mod sky;
mod standing;
pub mod track;
mod update;
mod visibility;
pub mod voxel_map;
pub mod weighting;
mod window;
mod world;
