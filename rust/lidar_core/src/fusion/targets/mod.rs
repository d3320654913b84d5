//! Targets over time: one or many, whole recordings, maximum likelihood noise.

pub mod any_filter;
mod company;
mod hypotheses;
pub mod integrated;
pub mod lifecycle;
pub mod many;
pub mod many_parameters;
pub mod near_pairs;
pub mod noise_search;
mod phase;
pub mod record;
pub mod sensor_errors;
pub mod target;
pub mod track;
pub mod tracks;
