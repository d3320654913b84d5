//! Detections from flying clusters: centre, covariance, visibility, input to the tracker.

pub mod center;
pub mod detection;
pub(crate) mod detections;
mod filled;
pub(crate) mod follow_up;
pub(crate) mod hole;
mod near_ground;
pub(crate) mod parts;
mod ray_groups;
pub(crate) mod surroundings;
pub(crate) mod visibility;
