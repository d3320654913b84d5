//! The compiled module `lidar_core._core`: arrays in and out, no algorithms.

mod arrays;
mod circles;
mod defaults;
mod errors;
mod estimation;
mod flying;
mod fusion;
mod geometry;
mod guard;
mod kinds;
mod planted;
mod sim;
mod vector_unit;

#[pyo3::pymodule]
mod _core {
    #[pymodule_export]
    use super::circles::fit::{detect_circles, fit_circles, fit_shapes};
    #[pymodule_export]
    use super::circles::map::PyCircleMap;
    #[pymodule_export]
    use super::circles::misses::PyMisses;
    #[pymodule_export]
    use super::circles::pipeline::{PyCirclePipeline, PyPreparedSweep};
    #[pymodule_export]
    use super::circles::samples::{circle_lattice, make_circle_samples};
    #[pymodule_export]
    use super::circles::stages::{limit_range, project_horizontal, segment_scan};
    #[pymodule_export]
    use super::circles::windows::{circle_windows, circles_from_answers};
    #[pymodule_export]
    use super::defaults::{default_parameters, parameters_of};
    #[pymodule_export]
    use super::estimation::{assign_columns, chi2_quantile};
    #[pymodule_export]
    use super::flying::analysis::{detection_probability, hit_probability, point_covariance};
    #[pymodule_export]
    use super::flying::center::target_center;
    #[pymodule_export]
    use super::flying::detector::PyFlyingObjectDetector;
    #[pymodule_export]
    use super::flying::sweep_times::PySweepTimes;
    #[pymodule_export]
    use super::flying::tracker::PyPointCloudTracker;
    #[pymodule_export]
    use super::flying::voxel_map::PyVoxelMap;
    #[pymodule_export]
    use super::fusion::config::fusion_models;
    #[pymodule_export]
    use super::fusion::filter::{
        PyFusionStep, PyMeasurement, PyMeasurements, PyTargetFilter, fusion_fit_noise,
        fusion_outcomes, fusion_run, fusion_run_batch, fusion_smooth,
    };
    #[pymodule_export]
    use super::fusion::many::PyMultiTargetTracker;
    #[pymodule_export]
    use super::geometry::{cluster_points, traverse};
    #[pymodule_export]
    use super::planted::PyPlantedPanic;
    #[pymodule_export]
    use super::sim::scene::{SimScene, SimShape, SimTrajectory};
    #[pymodule_export]
    use super::vector_unit::{vector_unit, vector_units};

    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        module.add("CIRCLE_CUT_MARGINS", lidar_core::circles::segment::parameters::CUT_MARGINS)
    }
}
