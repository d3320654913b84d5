//! Flying-object detection and tracking in 3D scans.
//!
//! Source: Vrba, Walter & Saska, "On Onboard LiDAR-based Flying Object Detection".

pub mod analysis;
pub mod beams;
mod blocks;
pub mod center;
pub mod classify;
mod clusters;
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
mod jump;
mod lanes;
mod marks;
mod near;
pub mod parameters;
mod persist;
mod raycast;
mod rule;
pub mod scan;
pub mod sensor;
pub mod separate;
mod shadow;
mod standing;
pub mod track;
mod visibility;
pub mod voxel_map;
pub mod weighting;
mod window;
mod world;
