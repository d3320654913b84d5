//! Bindings of `lidar_core::geometry`.

use crate::errors::BorderError;
use crate::guard::detached;
use lidar_core::geometry::lattice::Lattice;
use lidar_core::geometry::traverse as core_traverse;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
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
            voxels.extend(voxel);
            lengths.push(length);
            ControlFlow::Continue(())
        })?;
        Ok((voxels, lengths))
    })?;
    let rows = lengths.len();
    Ok((voxels.into_pyarray(py).reshape([rows, 3])?, lengths.into_pyarray(py)))
}
