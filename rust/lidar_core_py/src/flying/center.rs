//! Bindings of `lidar_core::flying::detect::center`.

use crate::arrays;
use crate::errors::BorderError;
use crate::guard::detached;
use lidar_core::flying::detect::center;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;

/// Centre of a target as arrays: position (3,) [m], covariance (3, 3) [m^2], radius [m].
type CenterArrays<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>, f64);

#[pyfunction]
#[pyo3(signature = (points, sensor_origin, *, passing, range_std))]
pub(crate) fn target_center<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    sensor_origin: [f64; 3],
    passing: PyReadonlyArray2<'py, f64>,
    range_std: f64,
) -> Result<CenterArrays<'py>, BorderError> {
    let points = arrays::rows3("points_world", &points)?;
    let passing = arrays::rows3("passing_directions", &passing)?;
    let found = detached(py, || center::target_center(points, sensor_origin, passing, range_std))?;
    let covariance: Vec<f64> = found.covariance.iter().copied().collect(); // symmetric
    let position: [f64; 3] = found.position.into();
    Ok((
        position.to_vec().into_pyarray(py),
        covariance.into_pyarray(py).reshape([3, 3])?,
        found.radius,
    ))
}
