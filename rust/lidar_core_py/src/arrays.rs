//! numpy arrays as slices. Shape and contiguity are checked only here.

use crate::errors::BorderError;
use lidar_core::Error;
use numpy::{
    Element, IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray, PyReadonlyArray1,
    PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods, ndarray::Dimension,
};
use pyo3::exceptions::PyOverflowError;
use pyo3::prelude::*;

/// Borrow an (N, 3) array as rows, without copying.
pub(crate) fn rows3<'a, T: Element>(
    name: &'static str,
    array: &'a PyReadonlyArray2<'_, T>,
) -> Result<&'a [[T; 3]], BorderError> {
    let shape = array.shape();
    if shape[1] != 3 {
        return Err(BorderError::Shape { name, expected: "(N, 3)", got: shape.to_vec() });
    }
    Ok(flat(name, array)?.as_chunks::<3>().0)
}

/// Borrow an optional (N, 3) array as rows; None for None.
pub(crate) fn maybe_rows3<'a, T: Element>(
    name: &'static str,
    array: &'a Option<PyReadonlyArray2<'_, T>>,
) -> Result<Option<&'a [[T; 3]]>, BorderError> {
    array.as_ref().map(|array| rows3(name, array)).transpose()
}

/// Borrow a C-contiguous array of any shape as one slice.
pub(crate) fn flat<'a, T: Element, D: Dimension>(
    name: &'static str,
    array: &'a PyReadonlyArray<'_, T, D>,
) -> Result<&'a [T], BorderError> {
    array.as_slice().map_err(|_| BorderError::NotContiguous { name })
}

/// Borrow an optional one-dimensional array as a slice; None for None.
pub(crate) fn maybe_flat<'a, T: Element>(
    name: &'static str,
    array: &'a Option<PyReadonlyArray1<'_, T>>,
) -> Result<Option<&'a [T]>, BorderError> {
    array.as_ref().map(|array| flat(name, array)).transpose()
}

/// Borrow a (K, 4, 4) array as matrices, each row by row.
pub(crate) fn matrices<'a>(
    name: &'static str,
    array: &'a PyReadonlyArray3<'_, f64>,
) -> Result<&'a [[f64; 16]], BorderError> {
    if array.shape()[1..] != [4, 4] {
        let got = array.shape().to_vec();
        return Err(BorderError::Shape { name, expected: "(K, 4, 4)", got });
    }
    Ok(flat(name, array)?.as_chunks::<16>().0)
}

/// Check a count that Python passed as `i64`.
pub(crate) fn count(name: &'static str, value: i64) -> Result<usize, BorderError> {
    usize::try_from(value).map_err(|_| {
        BorderError::Core(Error::Parameter {
            name,
            expected: "a count >= 0",
            got: value.to_string(),
        })
    })
}

/// A number of threads from Python; invalid and too large values are rejected.
pub(crate) struct Threads(pub(crate) usize);

impl<'py> FromPyObject<'_, 'py> for Threads {
    type Error = BorderError;

    fn extract(value: Borrowed<'_, 'py, PyAny>) -> Result<Self, BorderError> {
        match value.extract::<i64>() {
            Err(error) if error.is_instance_of::<PyOverflowError>(value.py()) => {
                let (expected, got) = ("1 to 256", value.str()?.to_string());
                Err(Error::Parameter { name: "threads", expected, got }.into())
            }
            known => Ok(Self(count("threads", known?)?)),
        }
    }
}

/// An (N, 3) array that Python owns.
pub(crate) type Rows3<'py, T> = Bound<'py, PyArray2<T>>;

/// Move rows out as an (N, 3) array.
pub(crate) fn rows_into<T: Element>(
    py: Python<'_>,
    rows: Vec<[T; 3]>,
) -> Result<Rows3<'_, T>, BorderError> {
    let count = rows.len();
    Ok(rows.into_flattened().into_pyarray(py).reshape([count, 3])?)
}

/// The option value with the name `value`; an error about the parameter `name` if there is none.
pub(crate) fn choice<T: Copy>(
    name: &'static str,
    value: &str,
    choices: &[(&'static str, T)],
) -> Result<T, Error> {
    let found = choices.iter().find(|(known, _)| *known == value);
    found.map(|&(_, choice)| choice).ok_or_else(|| Error::Parameter {
        name,
        expected: "one of the documented names",
        got: value.into(),
    })
}
