//! Belief about the target of a track: probability of its existence, and of its kinds.

pub(super) mod existence;
pub(super) mod kinds;
pub(super) mod standing;
pub(super) mod stood;
pub(super) mod visits;
pub(super) mod weighing;
