//! Motion models: the states of each and their change with time.

pub mod cartesian;
pub mod drone;
pub mod heading;
pub mod motion;
pub mod platform;
pub mod space;
pub mod space_pose;
pub mod standing;
pub mod state_conversion;
pub mod turn;
pub mod world;
