//! Filters of one target: linearised, sigma points, several models, the one of the paper, smoothing.

pub mod engine;
pub mod imm;
pub mod paper;
pub mod sigma_points;
pub mod smoother;
