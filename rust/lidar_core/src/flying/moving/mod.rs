//! Points of moving objects that do not fly, such as people and cars; and a map without moving
//! objects.

pub(crate) mod free_space;
pub(crate) mod ground_movers;
mod ray_view;
pub(crate) mod static_map;
