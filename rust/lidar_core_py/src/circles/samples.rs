//! Bindings of `lidar_sim::circle_samples`.

use crate::arrays::{self, Rows3, Threads};
use crate::errors::BorderError;
use crate::guard::stoppable;
use lidar_core::Error;
use lidar_core::circles::segment::parameters::CUT_MARGINS;
use lidar_core::util::threads;
use lidar_sim::circle_beams::Beams;
use lidar_sim::circle_samples::{self, Disturbance, Samples, Source};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;

/// Rays of a scanner from the attributes of its Python model.
fn beams_of(scanner: &Bound<'_, PyAny>) -> PyResult<Beams> {
    Ok(Beams {
        angle_min: scanner.getattr("angle_min")?.extract()?,
        angle_increment: scanner.getattr("angle_increment")?.extract()?,
        n_beams: scanner.getattr("n_beams")?.extract()?,
        range_limits: [
            scanner.getattr("range_min")?.extract()?,
            scanner.getattr("range_max")?.extract()?,
        ],
    })
}

/// Disturbances of samples from the attributes of a Python dataset model.
fn disturbance_of(config: &Bound<'_, PyAny>) -> PyResult<Disturbance> {
    Ok(Disturbance {
        range_std: config.getattr("range_std")?.extract()?,
        beam_half_width: config.getattr("beam_half_width")?.extract()?,
        occluded_share: config.getattr("occluded_share")?.extract()?,
        mixed_share: config.getattr("mixed_share")?.extract()?,
        cut_margins: CUT_MARGINS,
    })
}

#[pyfunction]
#[pyo3(signature = (scanner, *, reach, spacing, radius_steps, radius_step))]
pub(crate) fn circle_lattice<'py>(
    py: Python<'py>,
    scanner: &Bound<'py, PyAny>,
    reach: f64,
    spacing: f64,
    radius_steps: (u32, u32),
    radius_step: f64,
) -> Result<Rows3<'py, f64>, BorderError> {
    let beams = beams_of(scanner)?;
    let radii = radius_steps.0..=radius_steps.1;
    let circles =
        stoppable(py, || circle_samples::lattice(&beams, reach, spacing, radii, radius_step))?;
    arrays::rows_into(py, circles)
}

/// Samples as arrays: circles, noise of the ranges, beam width, first ray, number of rays, sides,
/// ranges.
type Arrays<'py> = (
    Rows3<'py, f32>,
    Bound<'py, PyArray1<f32>>,
    Bound<'py, PyArray1<f32>>,
    Bound<'py, PyArray1<u32>>,
    Bound<'py, PyArray1<u32>>,
    Bound<'py, PyArray2<u8>>,
    Bound<'py, PyArray1<f32>>,
);

#[pyfunction]
#[pyo3(signature = (config, *, circles, draws, seed, start, count, threads))]
#[allow(clippy::too_many_arguments)] // one per keyword
pub(crate) fn make_circle_samples<'py>(
    py: Python<'py>,
    config: &Bound<'py, PyAny>,
    circles: Option<PyReadonlyArray2<'py, f64>>,
    draws: u64,
    seed: u64,
    start: u64,
    count: u64,
    threads: Threads,
) -> Result<Arrays<'py>, BorderError> {
    let beams = beams_of(&config.getattr("scanner")?)?;
    let disturbance = disturbance_of(config)?;
    let (reach, radius) =
        (config.getattr("reach")?.extract()?, config.getattr("radius")?.extract()?);
    let source = match &circles {
        Some(circles) => Source::Given(arrays::rows3("circles", circles)?, draws),
        None => Source::Drawn { reach, radius },
    };
    let numbers = start..start.checked_add(count).ok_or_else(|| Error::Limit {
        what: format!("samples from {start} on"),
        limit: u64::MAX,
        key: "choose smaller numbers",
    })?;
    let samples = stoppable(py, || {
        let pool = threads::pool(threads.0)?;
        circle_samples::make(&pool, &beams, source, &disturbance, seed, numbers)
    })?;
    arrays_of(py, samples)
}

fn arrays_of(py: Python<'_>, samples: Samples) -> Result<Arrays<'_>, BorderError> {
    let sides = samples.sides.into_flattened().into_pyarray(py);
    let count = samples.circles.len();
    Ok((
        arrays::rows_into(py, samples.circles)?,
        samples.range_std.into_pyarray(py),
        samples.beam_half_width.into_pyarray(py),
        samples.first_ray.into_pyarray(py),
        samples.n_rays.into_pyarray(py),
        sides.reshape([count, 2])?,
        samples.ranges.into_pyarray(py),
    ))
}
