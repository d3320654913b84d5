//! Targets over time: one or many, whole recordings, maximum likelihood noise.

pub mod any_filter;
mod correction;
pub mod lifecycle;
pub mod many;
pub mod noise_search;
mod phase;
pub mod record;
pub mod sensor_errors;
pub mod target;
