//! What is believed of the target of a track: whether it exists, and what it is.

pub(super) mod existence;
