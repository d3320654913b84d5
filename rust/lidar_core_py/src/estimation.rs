//! Bindings of `lidar_core::estimation`.

use crate::errors::BorderError;
use crate::guard::detached;
use lidar_core::Error;
use lidar_core::estimation::chi2;
use pyo3::prelude::*;

#[pyfunction]
#[pyo3(signature = (probability, *, degrees))]
pub(crate) fn chi2_quantile(
    py: Python<'_>,
    probability: f64,
    degrees: i64,
) -> Result<f64, BorderError> {
    let degrees = u32::try_from(degrees).map_err(|_| Error::Parameter {
        name: "degrees",
        expected: "from 1 to 4294967295",
        got: degrees.to_string(),
    })?;
    detached(py, || chi2::quantile(probability, degrees))
}
