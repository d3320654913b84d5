//! Points of what moves but does not fly: people, cars; and a map without all that moved.

pub(crate) mod free_space;
pub(crate) mod ground_movers;
mod ray_view;
pub(crate) mod static_map;
