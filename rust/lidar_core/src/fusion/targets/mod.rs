//! Targets over time: one or many, whole recordings, noise by maximum likelihood.

pub mod any_filter;
pub mod joint_association;
pub mod lifecycle;
pub mod many;
pub mod noise_search;
pub mod record;
pub mod target;
pub mod tracks;
