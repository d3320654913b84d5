//! Bindings of `lidar_core::fusion`.

use crate::arrays;
use crate::errors::BorderError;
use crate::fusion_config::FusionConfig;
use crate::guard::{Guarded, detached};
use lidar_core::fusion::engine::Output;
use lidar_core::fusion::target::{Outcome, Step};
use lidar_core::fusion::{Filter, Measurement, Sensor, run};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1};
use pyo3::prelude::*;

const SENSORS: [(&str, Sensor); 4] = [
    ("lidar", Sensor::Lidar),
    ("radar", Sensor::Radar),
    ("gyro", Sensor::Gyro),
    ("pose", Sensor::Pose),
];

/// In the order of the numbers that arrays have for them.
const OUTCOMES: [(&str, Outcome); 8] = [
    ("updated", Outcome::Updated),
    ("started", Outcome::Started),
    ("restarted", Outcome::Restarted),
    ("told", Outcome::Told),
    ("gated", Outcome::Gated),
    ("invalid", Outcome::Invalid),
    ("late", Outcome::Late),
    ("singular", Outcome::Singular),
];

fn outcome_number(outcome: Outcome) -> usize {
    OUTCOMES.iter().position(|(_, known)| *known == outcome).unwrap_or(OUTCOMES.len())
}

#[pyclass(frozen, name = "Measurement", module = "lidar_core._core")]
pub(crate) struct PyMeasurement(pub(crate) Measurement);

#[pymethods]
impl PyMeasurement {
    #[new]
    #[pyo3(signature = (stamp_ns, sensor, values, *, covariance))]
    fn new(
        stamp_ns: i64,
        sensor: &str,
        values: PyReadonlyArray1<'_, f64>,
        covariance: Option<PyReadonlyArray1<'_, f64>>,
    ) -> Result<Self, BorderError> {
        let sensor = arrays::choice("sensor", sensor, &SENSORS)?;
        let values = arrays::flat("values", &values)?;
        let covariance = arrays::maybe_flat("covariance", &covariance)?;
        Ok(Self(Measurement::new(stamp_ns, sensor, values, covariance)?))
    }
}

#[pyclass(frozen, name = "FusionStep", module = "lidar_core._core")]
pub(crate) struct PyFusionStep(Step);

#[pymethods]
impl PyFusionStep {
    #[getter]
    fn stamp_ns(&self) -> i64 {
        self.0.stamp_ns
    }

    #[getter]
    fn outcome(&self) -> &'static str {
        OUTCOMES.get(outcome_number(self.0.outcome)).map_or("", |(name, _)| name)
    }

    #[getter]
    fn accepted(&self) -> bool {
        accepted(self.0.outcome)
    }

    #[getter]
    fn state<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        let output = self.0.output?;
        Some(PyArray1::from_slice(py, &output.mean[..output.count]))
    }

    #[getter]
    fn covariance<'py>(
        &self,
        py: Python<'py>,
    ) -> Result<Option<Bound<'py, PyArray2<f64>>>, BorderError> {
        self.0.output.map(|output| square(py, &output)).transpose()
    }

    #[getter]
    fn innovation<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        let innovation = self.0.innovation?;
        Some(PyArray1::from_slice(py, &innovation.values[..innovation.count]))
    }

    #[getter]
    fn nis(&self) -> Option<f64> {
        self.0.innovation.map(|innovation| innovation.nis)
    }

    fn __repr__(&self) -> String {
        format!("FusionStep(stamp_ns={}, outcome={:?})", self.0.stamp_ns, self.outcome())
    }
}

fn accepted(outcome: Outcome) -> bool {
    use Outcome::{Restarted, Started, Told, Updated};
    matches!(outcome, Updated | Started | Restarted | Told)
}

fn square<'py>(py: Python<'py>, output: &Output) -> Result<Bound<'py, PyArray2<f64>>, BorderError> {
    let size = output.count;
    let rows = output.covariance[..size].iter().flat_map(|row| &row[..size]);
    let entries: Vec<f64> = rows.copied().collect();
    Ok(entries.into_pyarray(py).reshape([size, size])?)
}

#[pyclass(frozen, name = "TargetFilter", module = "lidar_core._core")]
pub(crate) struct PyTargetFilter(Guarded<Filter>);

#[pymethods]
impl PyTargetFilter {
    #[new]
    fn new(py: Python<'_>, config: FusionConfig) -> Result<Self, BorderError> {
        let filter = detached(py, || Filter::new(&config.parameters()?))?;
        Ok(Self(Guarded::new(filter)))
    }

    fn step(
        &self,
        py: Python<'_>,
        measurement: PyRef<'_, PyMeasurement>,
    ) -> Result<PyFusionStep, BorderError> {
        let m = measurement.0;
        Ok(PyFusionStep(self.0.with(py, |filter| Ok(filter.step(&m)))?))
    }

    /// Mean and covariance at a time; none before the target has been seen.
    fn state_at<'py>(
        &self,
        py: Python<'py>,
        stamp_ns: i64,
    ) -> Result<Option<StateArrays<'py>>, BorderError> {
        let Some(output) = self.0.with(py, |filter| Ok(filter.output_at(stamp_ns)))? else {
            return Ok(None);
        };
        let mean = PyArray1::from_slice(py, &output.mean[..output.count]);
        Ok(Some((mean, square(py, &output)?)))
    }
}

type StateArrays<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>);

/// Stamps, numbers of outcomes, states, covariances, innovations, NIS: a row per measurement.
type RunArrays<'py> = (
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<u8>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
);

#[pyfunction]
pub(crate) fn fusion_run<'py>(
    py: Python<'py>,
    config: FusionConfig,
    measurements: Vec<PyRef<'py, PyMeasurement>>,
) -> Result<RunArrays<'py>, BorderError> {
    let measurements: Vec<Measurement> = measurements.iter().map(|m| m.0).collect();
    let steps = detached(py, || run(&config.parameters()?, &measurements))?;
    run_arrays(py, &steps)
}

fn run_arrays<'py>(py: Python<'py>, steps: &[Step]) -> Result<RunArrays<'py>, BorderError> {
    let size = steps.iter().find_map(|step| step.output).map_or(0, |output| output.count);
    let (rows, mut states, mut covariances) = (steps.len(), Vec::new(), Vec::new());
    let (mut innovations, mut nis) = (Vec::new(), Vec::new());
    for step in steps {
        match &step.output {
            None => {
                states.resize(states.len() + size, f64::NAN);
                covariances.resize(covariances.len() + size * size, f64::NAN);
            }
            Some(output) => {
                states.extend_from_slice(&output.mean[..size]);
                output.covariance[..size].iter().for_each(|r| covariances.extend(&r[..size]));
            }
        }
        let mut values = [f64::NAN; 3];
        if let Some(innovation) = step.innovation {
            let count = innovation.count;
            values[..count].copy_from_slice(&innovation.values[..count]);
        }
        innovations.extend(values);
        nis.push(step.innovation.map_or(f64::NAN, |innovation| innovation.nis));
    }
    let stamps: Vec<i64> = steps.iter().map(|step| step.stamp_ns).collect();
    let outcomes: Vec<u8> = steps.iter().map(|step| outcome_number(step.outcome) as u8).collect();
    Ok((
        stamps.into_pyarray(py),
        outcomes.into_pyarray(py),
        states.into_pyarray(py).reshape([rows, size])?,
        covariances.into_pyarray(py).reshape([rows, size, size])?,
        innovations.into_pyarray(py).reshape([rows, 3])?,
        nis.into_pyarray(py),
    ))
}

/// Names of outcomes, in the order of their numbers.
#[pyfunction]
pub(crate) fn fusion_outcomes() -> Vec<&'static str> {
    OUTCOMES.iter().map(|(name, _)| *name).collect()
}
