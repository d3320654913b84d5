//! Lattice, ray walk, clustering, rigid transforms and caps on the sphere.

pub mod caps;
pub mod cluster;
pub mod lattice;
pub mod sight;
pub mod transform;
pub mod traverse;
