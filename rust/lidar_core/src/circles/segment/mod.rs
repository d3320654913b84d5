//! Segmentation: groups of rays that ended on the same object, eq. 6.

pub mod corners;
pub(crate) mod merge;
pub mod parameters;
pub mod segmentation;
pub mod segments;
mod sweep;
