//! Lattice, ray walk, clustering, rigid transforms, motion and caps on the sphere.

pub mod caps;
pub mod cluster;
mod cubes;
pub mod gaps;
mod keys;
pub mod lattice;
pub mod motion;
mod octants;
pub mod transform;
pub mod traverse;
