//! Filters of one target: extended, sigma-point, interacting models, the paper's; and the smoother.

pub mod engine;
pub mod imm;
pub mod paper;
pub mod sigma_points;
pub mod smoother;
