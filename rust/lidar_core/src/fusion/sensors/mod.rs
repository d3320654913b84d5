//! Measurements, and what a sensor would measure of a state.

pub mod measurement;
pub mod observation;
