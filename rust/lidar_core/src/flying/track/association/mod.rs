//! Association of detections with tracks.

mod initiation;
pub(super) mod join;
mod pending;
