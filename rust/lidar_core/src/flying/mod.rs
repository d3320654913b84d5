//! Flying-object detection and tracking in 3D scans.
//!
//! Source: Vrba, Walter & Saska, "On Onboard LiDAR-based Flying Object Detection".

pub mod analysis;
pub mod background;
pub mod classify;
pub mod detect;
pub mod detector;
pub mod frame;
pub mod integrate;
pub mod map;
mod mapping;
pub mod parameters;
pub mod scan;
pub mod sky;
pub mod track;
mod world;
