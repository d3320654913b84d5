//! Bindings of `lidar_core::circles::preprocess::misses`.

use crate::arrays;
use crate::errors::BorderError;
use crate::guard::Guarded;
use lidar_core::Error;
use lidar_core::circles::preprocess::misses::{Misses, NoReturn};
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;

/// Name in Python of the value that marks a ray without return.
pub(crate) fn no_return_name(value: NoReturn) -> &'static str {
    match value {
        NoReturn::Infinite => "inf",
        NoReturn::Zero => "zero",
        NoReturn::Nan => "nan",
    }
}

#[pyclass(frozen, name = "Misses", module = "lidar_core._core")]
pub(crate) struct PyMisses(Guarded<Misses>);

#[pymethods]
impl PyMisses {
    #[new]
    fn new() -> Self {
        Self(Guarded::new(Misses::default()))
    }

    /// Add a scan to the statistics. Returns its ranges [m], with +inf for a ray without return and
    /// NaN for no information, and the name of the value that marks rays without return.
    #[pyo3(signature = (ranges, *, range_min, range_max, nearest))]
    fn marked<'py>(
        &self,
        py: Python<'py>,
        ranges: PyReadonlyArray1<'py, f32>,
        range_min: f64,
        range_max: f64,
        nearest: f64,
    ) -> Result<(Bound<'py, PyArray1<f64>>, &'static str), BorderError> {
        let ranges = arrays::flat("ranges", &ranges)?;
        let (marked, value) = self.0.with(py, |misses| {
            let limits = [range_min, range_max];
            misses.add(ranges, limits);
            let marked = misses.marked(ranges, limits, nearest);
            Ok::<_, Error>((marked, misses.no_return()))
        })?;
        Ok((marked.into_pyarray(py), no_return_name(value)))
    }
}
