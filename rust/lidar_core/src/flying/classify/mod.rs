//! Classification of the points of a scan: rules A, B and C of the paper, and additions of the best
//! mode.

pub mod classifier;
pub(crate) mod clusters;
pub(crate) mod expected;
pub(crate) mod explained;
pub(crate) mod flood;
pub(crate) mod grouping;
pub(crate) mod may_fly;
pub(crate) mod occupied_nearby;
pub mod parameters;
pub(crate) mod pockets;
pub(crate) mod scan_classifier;
pub(crate) mod shadow;
pub(crate) mod standing;

#[cfg(test)]
mod tests;
