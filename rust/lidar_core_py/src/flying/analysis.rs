//! Bindings of `lidar_core::flying::analysis`.

use crate::arrays::{self, Threads};
use crate::errors::BorderError;
use crate::guard::stoppable;
use lidar_core::flying::analysis;
use lidar_core::geometry::lattice::Lattice;
use lidar_core::geometry::transform::Transform;
use numpy::{
    IntoPyArray, PyArray1, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::prelude::*;

#[pyfunction]
#[pyo3(signature = (points, world_from_lidar, *, pose_covariance, range_std))]
pub(crate) fn point_covariance<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f32>,
    world_from_lidar: [[f64; 4]; 4],
    pose_covariance: [[f64; 6]; 6],
    range_std: f64,
) -> Result<Bound<'py, PyArray3<f64>>, BorderError> {
    let points = arrays::rows3("points_lidar", &points)?;
    let pose = Transform {
        rotation: std::array::from_fn(|row| std::array::from_fn(|k| world_from_lidar[row][k])),
        translation: std::array::from_fn(|row| world_from_lidar[row][3]),
    };
    let covariances =
        stoppable(py, || analysis::point_covariance(points, &pose, &pose_covariance, range_std))?;
    let entries: Vec<f64> = covariances.into_flattened().into_flattened();
    Ok(entries.into_pyarray(py).reshape([points.len(), 3, 3])?)
}

#[pyfunction]
#[pyo3(signature = (points, covariance, *, voxel_size, origin, threads))]
pub(crate) fn hit_probability<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    covariance: PyReadonlyArray3<'py, f64>,
    voxel_size: f64,
    origin: [f64; 3],
    threads: Threads,
) -> Result<Bound<'py, PyArray1<f64>>, BorderError> {
    let points = arrays::rows3("points_world", &points)?;
    let name = "covariance";
    if covariance.shape()[1..] != [3, 3] {
        let got = covariance.shape().to_vec();
        return Err(BorderError::Shape { name, expected: "(N, 3, 3)", got });
    }
    let rows = arrays::flat(name, &covariance)?.as_chunks::<3>().0.as_chunks::<3>().0;
    let hits = stoppable(py, || {
        analysis::hit_probability(points, rows, &Lattice::new(voxel_size, origin)?, threads.0)
    })?;
    Ok(hits.into_pyarray(py))
}

#[pyfunction]
#[pyo3(signature = (directions, *, radius, distances, field_of_view, threads))]
pub(crate) fn detection_probability<'py>(
    py: Python<'py>,
    directions: PyReadonlyArray2<'py, f64>,
    radius: f64,
    distances: PyReadonlyArray1<'py, f64>,
    field_of_view: [f64; 2],
    threads: Threads,
) -> Result<Bound<'py, PyArray1<f64>>, BorderError> {
    let directions = arrays::rows3("directions", &directions)?;
    let distances = arrays::flat("distance", &distances)?;
    let shares = stoppable(py, || {
        analysis::detection_probability(directions, radius, distances, field_of_view, threads.0)
    })?;
    Ok(shares.into_pyarray(py))
}
