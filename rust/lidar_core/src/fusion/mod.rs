//! One target, seen by LiDAR and radar from a platform that may move.
//!
//! # Source
//! "ctrv-lidar-radar-ekf": Remote Sensing 2023, 15, 3396; equation numbers are the paper's.
//!
//! # Example
//! ```
//! use lidar_core::fusion::{Filter, FusionParameters, Measurement, Sensor};
//!
//! let mut filter = Filter::new(&FusionParameters::default())?;
//! for step in 0..20 {
//!     let (stamp_ns, x) = (step * 50_000_000, 2.0 + 0.1 * step as f64); // 2 m/s along x
//!     let measurement = if step % 2 == 0 {
//!         Measurement::new(stamp_ns, Sensor::Lidar, &[x, 0.0], None)?
//!     } else {
//!         Measurement::new(stamp_ns, Sensor::Radar, &[x, 0.0, 2.0], None)?
//!     };
//!     filter.step(&measurement);
//! }
//! let state = filter.output_at(1_000_000_000).map(|output| output.mean[0]);
//! assert!(state.is_some_and(|x| (x - 4.0).abs() < 0.1));
//! # Ok::<(), lidar_core::Error>(())
//! ```

pub mod filter;
pub mod model_list;
pub mod models;
pub mod parameters;
pub mod sensors;
pub mod targets;

pub use model_list::Model;
pub use parameters::{FusionParameters, Method, Strengths};
pub use sensors::measurement::{Measurement, Sensor};
pub use targets::any_filter::Filter;
pub use targets::many::{Assigned, ManyParameters, ManyTargets, TargetAssociation, TrackState};
pub use targets::record::{Record, run, run_batch, smooth};
