//! What is believed of the target of a track: whether it exists, and what it is.

pub(super) mod existence;
pub(super) mod kinds;
pub(super) mod standing;
pub(super) mod visits;
pub(super) mod weighing;
