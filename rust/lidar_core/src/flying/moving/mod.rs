//! Points of moving objects that do not fly, such as people and cars; and a map without moving
//! objects.

mod arrivals;
mod entered;
mod free_space;
pub(crate) mod ground_movers;
mod past_hits;
mod ray_view;
pub(crate) mod static_map;
mod stay;
pub(crate) mod things;
