//! What belongs to what: detections and the tracks that they feed or begin.

mod initiation;
pub(super) mod join;
mod pending;
