//! Lattice, ray walk, clustering and rigid transforms.

pub mod cluster;
pub mod lattice;
pub mod sight;
pub mod transform;
pub mod traverse;
