//! Estimation tools shared by all trackers: Kalman and unscented filters, chi-square gates,
//! assignment.

pub mod assignment;
pub mod chi2;
pub mod jitter;
pub mod kalman;
pub mod minimise;
pub mod probability;
mod quadrature;
pub mod unscented;
