//! Measurements and measurement models of the sensors.

pub mod measurement;
pub mod observation;
