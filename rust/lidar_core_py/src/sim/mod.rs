//! Bindings of the simulator.

pub(crate) mod config;
pub(crate) mod scene;
