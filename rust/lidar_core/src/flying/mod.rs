//! Flying-object detection and tracking in 3D scans.
//!
//! Source: Vrba, Walter & Saska, "On Onboard LiDAR-based Flying Object Detection".

mod blocks;
pub mod classify;
mod group;
pub mod integrate;
mod persist;
mod raycast;
pub mod separate;
mod shadow;
pub mod track;
pub mod voxel_map;
