//! Bindings of round obstacles: stages, pipeline, map, samples for training.

pub(crate) mod config;
pub(crate) mod fit;
pub(crate) mod map;
pub(crate) mod misses;
pub(crate) mod pipeline;
pub(crate) mod samples;
pub(crate) mod stages;
pub(crate) mod windows;
