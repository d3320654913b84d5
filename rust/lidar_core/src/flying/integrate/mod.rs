//! Update of the map by a scan: rays are cast through blocks, voxels get marks, and each voxel is
//! updated once.

pub(crate) mod accumulate;
pub(crate) mod block_update;
pub(crate) mod bundle;
pub mod classified_scan;
pub(crate) mod cube_map;
mod eye_view;
pub mod integrator;
pub(crate) mod plan;
pub mod pose_weights;
pub(crate) mod ray_lanes;
pub(crate) mod ray_segments;
#[cfg(test)]
mod skip_tests;
pub(crate) mod stretches;
pub(crate) mod voxel_update;
pub(crate) mod walk;
