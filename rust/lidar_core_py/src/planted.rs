//! Panics on purpose, for every kind of entry into the core: tests check that none escapes.

use crate::errors::BorderError;
use crate::guard::{Guarded, detached, stoppable};
use lidar_core::Error;
use lidar_core::util::threads;
use pyo3::prelude::*;
use rayon::prelude::*;
use std::panic::resume_unwind;

/// An object that counts its calls, and panics when it is told to.
#[pyclass(frozen, name = "PlantedPanic", module = "lidar_core._core")]
pub(crate) struct PyPlantedPanic(Guarded<u64>);

#[pymethods]
impl PyPlantedPanic {
    #[new]
    fn new() -> Self {
        Self(Guarded::new(0))
    }

    /// Panic in a function ("detached", "stoppable", "pool") or on the object ("with",
    /// "`with_stoppable`").
    fn fall(&self, py: Python<'_>, place: &str) -> Result<(), BorderError> {
        match place {
            "detached" => detached(py, planted),
            "stoppable" => stoppable(py, planted),
            "pool" => stoppable(py, || {
                let pool = threads::pool(2)?;
                pool.install(|| (0..64).into_par_iter().try_for_each(|_| planted()))
            }),
            "with" => self.0.with(py, |_| planted()),
            _ => self.0.with_stoppable(py, |_| planted()),
        }
    }

    /// Number of this call.
    fn stand(&self, py: Python<'_>) -> Result<u64, BorderError> {
        self.0.with(py, |count| {
            *count += 1;
            Ok(*count)
        })
    }
}

/// A panic without output on the console.
fn planted() -> Result<(), Error> {
    resume_unwind(Box::new("planted"))
}
