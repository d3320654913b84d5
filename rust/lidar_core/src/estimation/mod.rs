//! Kalman filtering, chi-square quantiles and association: what all trackers share.

pub mod assignment;
pub mod chi2;
pub mod kalman;
pub mod minimise;
pub mod probability;
pub mod unscented;
