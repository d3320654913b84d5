//! The vector unit that kernels use.

use crate::errors::BorderError;
use lidar_core::util::vector_unit::{available, used};
use pyo3::prelude::*;

/// Name of the vector unit in use.
#[pyfunction]
pub(crate) fn vector_unit() -> Result<&'static str, BorderError> {
    Ok(used()?)
}

/// Names of the vector units of this CPU, the best last.
#[pyfunction]
pub(crate) fn vector_units() -> Vec<&'static str> {
    available()
}
