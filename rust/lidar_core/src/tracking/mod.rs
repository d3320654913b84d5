//! Mechanisms that every tracker needs and no filter has: which measurements are near a track, how
//! probable each is its own, what a track follows, how noisy a sensor really is.

pub mod echo;
pub mod existence;
pub mod extent;
pub mod joint_association;
pub mod kind;
pub mod near;
pub mod place_trend;
pub mod sensor_noise;
pub mod spread;
pub mod standing_clutter;
pub mod surroundings;
