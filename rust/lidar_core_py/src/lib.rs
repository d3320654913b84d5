//! The compiled module `lidar_core._core`: arrays in and out, no algorithms.

mod arrays;
mod errors;
mod geometry;
mod guard;

#[pyo3::pymodule]
mod _core {
    #[pymodule_export]
    use super::geometry::traverse;

    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
