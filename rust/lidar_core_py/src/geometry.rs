//! Bindings of `lidar_core::geometry`.

use crate::arrays;
use crate::errors::BorderError;
use crate::guard::{detached, stoppable};
use lidar_core::geometry::cluster::Clustering;
use lidar_core::geometry::cluster::angular_gap::{AngularGap, label_seen};
use lidar_core::geometry::lattice::Lattice;
use lidar_core::geometry::traverse as core_traverse;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;
use std::ops::ControlFlow;

type Traversal<'py> = (Bound<'py, PyArray2<i32>>, Bound<'py, PyArray1<f64>>);

#[pyfunction]
#[pyo3(signature = (start, end, *, voxel_size, origin))]
pub(crate) fn traverse<'py>(
    py: Python<'py>,
    start: [f64; 3],
    end: [f64; 3],
    voxel_size: f64,
    origin: [f64; 3],
) -> Result<Traversal<'py>, BorderError> {
    let (voxels, lengths) = detached(py, || {
        let lattice = Lattice::new(voxel_size, origin)?;
        let (mut voxels, mut lengths) = (Vec::new(), Vec::new());
        core_traverse::traverse(&lattice, start, end, |voxel, length| {
            voxels.push(voxel);
            lengths.push(length);
            ControlFlow::Continue(())
        })?;
        Ok((voxels, lengths))
    })?;
    Ok((arrays::rows_into(py, voxels)?, lengths.into_pyarray(py)))
}

#[pyfunction]
#[pyo3(signature = (points, *, max_distance, min_points, max_points, max_angle, origin))]
pub(crate) fn cluster_points<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f32>,
    max_distance: f64,
    min_points: i64,
    max_points: Option<i64>,
    max_angle: f64,
    origin: [f64; 3],
) -> Result<Bound<'py, PyArray1<i32>>, BorderError> {
    let points = arrays::rows3("points", &points)?;
    let min_points = arrays::count("min_points", min_points)?;
    let max_points = max_points.map(|most| arrays::count("max_points", most)).transpose()?;
    let clustering = Clustering { max_distance, min_points, max_points };
    let labels =
        stoppable(py, || label_seen(points, &AngularGap { origin, max_angle }, &clustering, None))?;
    Ok(labels.into_pyarray(py))
}
