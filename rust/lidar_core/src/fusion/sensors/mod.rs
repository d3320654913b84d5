//! Measurements and measurement models of the sensors.

pub mod line_of_sight;
pub mod measurement;
pub mod observation;
pub mod plane;
pub mod sensing;
pub mod sight;
pub mod space;
pub mod told_pose;
