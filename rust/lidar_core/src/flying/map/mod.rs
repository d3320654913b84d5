//! The voxel map: states, storage, removal of separate background, files.

pub(crate) mod blocks;
pub mod filter;
pub(crate) mod islands;
pub(crate) mod layers;
pub(crate) mod persist;
pub mod saved_body;
pub mod separate;
pub mod voxel_map;
