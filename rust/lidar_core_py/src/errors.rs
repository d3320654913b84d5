//! Error of the core -> Python class: one match.

use lidar_core::Error;
use pyo3::exceptions::{PyKeyboardInterrupt, PyOSError};
use pyo3::prelude::*;

mod classes {
    pyo3::import_exception!(lidar_core.errors, InputError);
    pyo3::import_exception!(lidar_core.errors, ConfigError);
    pyo3::import_exception!(lidar_core.errors, FormatError);
    pyo3::import_exception!(lidar_core.errors, LimitError);
    pyo3::import_exception!(lidar_core.errors, NumericalError);
    pyo3::import_exception!(lidar_core.errors, InternalError);
}

/// Reason for which a call from Python is refused.
pub(crate) enum BorderError {
    Core(Error),
    Shape { name: &'static str, expected: &'static str, got: Vec<usize> },
    NotContiguous { name: &'static str },
    Poisoned,
    Forked,
    Python(PyErr),
}

impl From<Error> for BorderError {
    fn from(error: Error) -> Self {
        Self::Core(error)
    }
}

impl From<PyErr> for BorderError {
    fn from(error: PyErr) -> Self {
        Self::Python(error)
    }
}

impl From<BorderError> for PyErr {
    fn from(error: BorderError) -> Self {
        match error {
            BorderError::Core(error) => py_error(error),
            BorderError::Shape { name, expected, got } => classes::InputError::new_err(format!(
                "{name}: expected shape {expected}, got {got:?}"
            )),
            BorderError::NotContiguous { name } => {
                classes::InputError::new_err(format!("{name}: expected a C-contiguous array"))
            }
            BorderError::Poisoned => classes::InternalError::new_err(
                "this object met a bug in lidar_core and refuses further calls; make a new one",
            ),
            BorderError::Forked => classes::InternalError::new_err(
                "this object was made before a fork and its threads are gone; make it in the child",
            ),
            BorderError::Python(error) => error,
        }
    }
}

fn py_error(error: Error) -> PyErr {
    let text = error.to_string();
    match error {
        Error::Parameter { .. } => classes::ConfigError::new_err(text),
        Error::Length { .. }
        | Error::Value { .. }
        | Error::PointOutOfRange { .. }
        | Error::Time { .. } => classes::InputError::new_err(text),
        Error::Limit { .. } | Error::Memory { .. } => classes::LimitError::new_err(text),
        Error::NotPositiveDefinite { .. } => classes::NumericalError::new_err(text),
        Error::Format { .. } => classes::FormatError::new_err(text),
        Error::Interrupted => PyKeyboardInterrupt::new_err(()),
        Error::Io(error) => match error.raw_os_error() {
            Some(code) => PyOSError::new_err((code, text)), // Python picks FileNotFoundError and so on
            None => PyOSError::new_err(text),
        },
        _ => classes::InternalError::new_err(text),
    }
}
