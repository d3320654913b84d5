//! Flying-object detection and tracking in 3D scans.
//!
//! Source: Vrba, Walter & Saska, "On Onboard LiDAR-based Flying Object Detection".
//!
//! # Example
//! ```
//! use lidar_core::flying::detector::FlyingObjectDetector;
//! use lidar_core::flying::parameters::FlyingParameters;
//! use lidar_core::flying::scan::prepared::RawScan;
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
pub mod background;
pub mod classify;
pub mod detect;
pub mod detector;
pub mod frame;
mod full_state;
pub mod integrate;
mod large_targets;
pub mod map;
pub mod moving;
pub mod parameters;
pub mod point_class;
pub mod reporting_gate;
pub mod scan;
pub mod sky;
pub mod track;
pub(crate) mod track_before_detect;
