//! The voxel map: states, storage, removal of separate groups of voxels, files.

pub(crate) mod block_shape;
pub(crate) mod blocks;
pub(crate) mod changes;
pub mod filter;
pub(crate) mod full_state;
pub(crate) mod inert;
pub(crate) mod islands;
pub(crate) mod layers;
pub(crate) mod local_map;
pub mod parameters;
pub(crate) mod persist;
pub(crate) mod reader;
pub mod saved_body;
pub(crate) mod separate;
pub mod voxel_map;
