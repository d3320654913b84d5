//! Association of detections with tracks.

mod initiation;
pub(super) mod join;
pub(super) mod pairs;
mod pending;
