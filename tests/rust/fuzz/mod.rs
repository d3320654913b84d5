//! One function over bytes per decoder and per group of public functions: `TARGETS`.
//!
//! `cargo test` runs them on the corpus, `make fuzz` guides them by coverage. A body must not
//! panic. Which public function is reached by which target stands in `manifest.toml`; a test
//! fails if one has no entry.

mod circles;
mod estimation;
mod flying;
mod formats;
mod fusion;
mod geometry;
mod input;
mod sim;
mod tracking;

/// A target: bytes, of which any are allowed.
pub type Body = fn(&[u8]);

/// Every target by name.
pub const TARGETS: &[(&str, Body)] = &[
    ("lcvm", formats::lcvm),
    ("state_map", formats::state_map),
    ("state_tracker", formats::state_tracker),
    ("state_detector", formats::state_detector),
    ("state_circle_map", formats::state_circle_map),
    ("state_pipeline", formats::state_pipeline),
    ("state_filter", formats::state_filter),
    ("state_many", formats::state_many),
    ("geometry", geometry::functions),
    ("clusters", geometry::clusters),
    ("estimation", estimation::functions),
    ("assignment", estimation::assignment),
    ("tracking", tracking::functions),
    ("voxel_map", flying::voxel_map),
    ("detector", flying::detector),
    ("rooms", flying::rooms),
    ("tracker", flying::tracker),
    ("flying_functions", flying::functions),
    ("pipeline", circles::pipeline),
    ("circle_functions", circles::functions),
    ("filter", fusion::filter),
    ("many", fusion::many),
    ("fusion_runs", fusion::runs),
    ("scenes", sim::scenes),
    ("sim_functions", sim::functions),
];
