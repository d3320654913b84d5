//! Kinds of targets as arrays.

use crate::errors::BorderError;
use lidar_core::tracking::kind::{KINDS, TrackKind};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;

/// Kinds of tracks as arrays: kind (T,) and probabilities of the kinds (T, 5).
pub(crate) type KindArrays<'py> = (Bound<'py, PyArray1<u8>>, Bound<'py, PyArray2<f64>>);

/// Kind and probabilities of every track, one row each.
pub(crate) fn kind_arrays(
    py: Python<'_>,
    tracks: impl Iterator<Item = (TrackKind, [f64; KINDS])>,
) -> Result<KindArrays<'_>, BorderError> {
    let (kinds, rows): (Vec<u8>, Vec<[f64; KINDS]>) =
        tracks.map(|(kind, probability)| (u8::from(kind), probability)).unzip();
    let count = kinds.len();
    Ok((kinds.into_pyarray(py), rows.into_flattened().into_pyarray(py).reshape([count, KINDS])?))
}
