//! Geometry: voxel lattice, walk of rays, clustering, rigid transforms, motion, and caps on the
//! sphere.

pub mod caps;
pub mod cluster;
pub mod lattice;
pub mod motion;
pub mod transform;
pub mod traverse;
