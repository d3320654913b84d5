//! Flying-object detection and tracking in 3D scans.
//!
//! Source: Vrba, Walter & Saska, "On Onboard LiDAR-based Flying Object Detection".

pub mod analysis;
pub mod beams;
mod beyond;
mod blocks;
mod casting;
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
mod raycast;
mod rule;
pub mod scan;
mod segments;
pub mod sensor;
pub mod separate;
mod shadow;
mod sheet;
mod standing;
pub mod track;
mod update;
mod visibility;
pub mod voxel_map;
pub mod weighting;
mod window;
mod world;
