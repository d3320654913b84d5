//! Measurements and measurement models of the sensors.

pub mod measurement;
pub mod observation;
pub mod sensing;
pub mod sight;
pub mod space;
pub mod told_pose;
