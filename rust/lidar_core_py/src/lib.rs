//! The compiled module `lidar_core._core`: arrays in and out, no algorithms.

mod analysis;
mod arrays;
mod center;
mod circle_fit;
mod circle_map;
mod circle_pipeline;
mod circle_samples;
mod circle_windows;
mod circles;
mod circles_config;
mod defaults;
mod errors;
mod estimation;
mod flying;
mod flying_config;
mod fusion;
mod fusion_config;
mod fusion_many;
mod geometry;
mod guard;
mod sim;
mod sim_config;
mod tracker;
mod voxel_map;

#[pyo3::pymodule]
mod _core {
    #[pymodule_export]
    use super::analysis::{detection_probability, hit_probability, point_covariance};
    #[pymodule_export]
    use super::center::target_center;
    #[pymodule_export]
    use super::circle_fit::{detect_circles, fit_circles, fit_shapes};
    #[pymodule_export]
    use super::circle_map::PyCircleMap;
    #[pymodule_export]
    use super::circle_pipeline::{PyCirclePipeline, PyPreparedSweep};
    #[pymodule_export]
    use super::circle_samples::{circle_lattice, make_circle_samples};
    #[pymodule_export]
    use super::circle_windows::{circle_windows, circles_from_answers};
    #[pymodule_export]
    use super::circles::{limit_range, project_horizontal, segment_scan};
    #[pymodule_export]
    use super::defaults::{default_parameters, parameters_of};
    #[pymodule_export]
    use super::estimation::{assign_columns, chi2_quantile};
    #[pymodule_export]
    use super::flying::PyFlyingObjectDetector;
    #[pymodule_export]
    use super::fusion::{
        PyFusionStep, PyMeasurement, PyMeasurements, PyTargetFilter, fusion_fit_noise,
        fusion_outcomes, fusion_run, fusion_run_batch, fusion_smooth,
    };
    #[pymodule_export]
    use super::fusion_many::PyMultiTargetTracker;
    #[pymodule_export]
    use super::geometry::{cluster_points, traverse};
    #[pymodule_export]
    use super::sim::{SimScene, SimShape, SimTrajectory};
    #[pymodule_export]
    use super::tracker::PyPointCloudTracker;
    #[pymodule_export]
    use super::voxel_map::PyVoxelMap;

    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
