//! Belief about the target of a track: whether it exists, and of which kind it is.

pub(super) mod coherence;
pub(super) mod existence;
pub(super) mod kinds;
pub(super) mod standing;
pub(super) mod stood;
pub(super) mod visits;
pub(super) mod weighing;
