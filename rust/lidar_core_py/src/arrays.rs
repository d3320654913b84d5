//! numpy -> slices: the only checks of shape and contiguity on this side of the border.

use crate::errors::BorderError;
use numpy::{
    Element, PyReadonlyArray, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods,
    ndarray::Dimension,
};

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

/// Borrow an optional (N, 3) array as rows.
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

/// Borrow an optional one-dimensional array.
pub(crate) fn maybe_flat<'a, T: Element>(
    name: &'static str,
    array: &'a Option<PyReadonlyArray1<'_, T>>,
) -> Result<Option<&'a [T]>, BorderError> {
    array.as_ref().map(|array| flat(name, array)).transpose()
}

/// A count that crossed as `i64`.
pub(crate) fn count(name: &'static str, value: i64) -> Result<usize, BorderError> {
    usize::try_from(value).map_err(|_| {
        BorderError::Core(lidar_core::Error::Parameter {
            name,
            expected: "a count >= 0",
            got: value.to_string(),
        })
    })
}
