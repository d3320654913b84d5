//! Targets over time: one or many, whole recordings, maximum likelihood noise.

pub mod any_filter;
pub mod joint_association;
pub mod lifecycle;
pub mod many;
pub mod noise_search;
pub mod record;
pub mod sensor_errors;
pub mod target;
pub mod tracks;
