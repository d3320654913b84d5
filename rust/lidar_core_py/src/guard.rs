//! Entry into the core: the GIL is released, a panic is caught once, a broken object is retired.

use crate::errors::BorderError;
use lidar_core::Error;
use pyo3::prelude::*;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;

/// Run `work` without the GIL.
pub(crate) fn detached<T: Send>(
    py: Python<'_>,
    work: impl FnOnce() -> Result<T, Error> + Send,
) -> Result<T, BorderError> {
    match py.detach(|| catch_unwind(AssertUnwindSafe(work))) {
        Ok(result) => result.map_err(BorderError::Core),
        Err(_) => Err(BorderError::Poisoned),
    }
}

/// A core object behind a lock: calls from several threads take turns.
pub(crate) struct Guarded<T> {
    inner: Mutex<T>,
    process: u32,
}

impl<T: Send> Guarded<T> {
    pub(crate) fn new(inner: T) -> Self {
        Self { inner: Mutex::new(inner), process: std::process::id() }
    }

    /// Run `work` on the object, without the GIL. A panic poisons the lock for good.
    pub(crate) fn with<R: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut T) -> Result<R, Error> + Send,
    ) -> Result<R, BorderError> {
        if self.process != std::process::id() {
            return Err(BorderError::Forked);
        }
        let outcome = py.detach(|| {
            catch_unwind(AssertUnwindSafe(|| match self.inner.lock() {
                Ok(mut object) => Some(work(&mut object)),
                Err(_) => None,
            }))
        });
        match outcome {
            Ok(Some(result)) => result.map_err(BorderError::Core),
            Ok(None) | Err(_) => Err(BorderError::Poisoned),
        }
    }
}

/// A closure for long core loops: false once Python wants to handle a signal.
pub(crate) fn keep_going() -> bool {
    Python::attach(|py| py.check_signals().is_ok())
}
