//! Mechanisms that every tracker needs and no filter contains: search for measurements near a
//! track, probabilities of association, kinds of targets, real noise of sensors.

pub mod echo;
pub mod existence;
pub mod extent;
pub mod joint_association;
pub mod kind;
pub mod near;
pub mod place_trend;
pub(crate) mod resting;
pub mod sensor_noise;
pub mod spread;
pub mod standing_clutter;
pub mod surroundings;
