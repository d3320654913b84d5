//! Bindings of `lidar_core::flying::scan::untimed`.

use crate::arrays;
use crate::errors::BorderError;
use crate::guard::Guarded;
use lidar_core::flying::scan::untimed::SweepTimes;
use lidar_core::geometry::transform::Transform;
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

#[pyclass(frozen, name = "SweepTimes", module = "lidar_core._core")]
pub(crate) struct PySweepTimes(Guarded<SweepTimes>);

#[pymethods]
impl PySweepTimes {
    #[new]
    fn new() -> Self {
        Self(Guarded::new(SweepTimes::default()))
    }

    /// Part of the scan that was over at every point, 0 to 1. None if the clouds do not show it.
    fn parts<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'py, f32>,
        motion: [[f64; 4]; 4],
    ) -> Result<Option<Bound<'py, PyArray1<f64>>>, BorderError> {
        let points = arrays::rows3("points", &points)?;
        let motion = Transform::from_matrix(&std::array::from_fn(|at| motion[at / 4][at % 4]));
        let parts = self.0.with(py, |times| times.parts(points, &motion))?;
        Ok(parts.map(|parts| parts.into_pyarray(py)))
    }
}
