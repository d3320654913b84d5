//! Bindings of `lidar_core::fusion`.

use crate::arrays::{self, Threads};
use crate::errors::BorderError;
use crate::fusion::config::FusionConfig;
use crate::guard::{Guarded, detached, stoppable};
use lidar_core::Error;
use lidar_core::estimation::minimise::SimplexSearch;
use lidar_core::fusion::filter::engine::{MAX_INNOVATION, Output};
use lidar_core::fusion::sensors::measurement::PolarValues;
use lidar_core::fusion::targets::lifecycle::Outcome;
use lidar_core::fusion::targets::noise_search::{fit, quantities};
use lidar_core::fusion::targets::target::FilterStep;
use lidar_core::fusion::{
    Filter, FusionParameters, Measurement, Record, Sensor, run, run_batch, smooth,
};
use lidar_core::util::budget::check_memory;
use lidar_core::util::threads;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods};
use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

const SENSORS: [(&str, Sensor); 5] = [
    ("lidar", Sensor::Lidar),
    ("radar", Sensor::Radar),
    ("gyro", Sensor::Gyro),
    ("pose", Sensor::Pose),
    ("pose-3d", Sensor::SpacePose),
];

/// Names of the outcomes, in the order of their numbers in arrays.
const OUTCOMES: [(&str, Outcome); 9] = [
    ("updated", Outcome::Updated),
    ("started", Outcome::Started),
    ("restarted", Outcome::Restarted),
    ("told", Outcome::PlatformMotion),
    ("gated", Outcome::Gated),
    ("invalid", Outcome::Invalid),
    ("late", Outcome::Late),
    ("duplicate", Outcome::Duplicate),
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
    #[pyo3(signature = (stamp_ns, sensor, values, *, measures, covariance, seen_from))]
    fn new(
        stamp_ns: i64,
        sensor: &str,
        values: PyReadonlyArray1<'_, f64>,
        measures: Option<[bool; 4]>,
        covariance: Option<PyReadonlyArray1<'_, f64>>,
        seen_from: Option<[f64; 2]>,
    ) -> Result<Self, BorderError> {
        let sensor = arrays::choice("sensor", sensor, &SENSORS)?;
        let values = arrays::flat("values", &values)?;
        let covariance = arrays::maybe_flat("covariance", &covariance)?;
        let made = match measures {
            Some(given) => {
                Measurement::polar(stamp_ns, PolarValues::new(given)?, values, covariance)
            }
            None => Measurement::new(stamp_ns, sensor, values, covariance),
        }?;
        Ok(Self(match seen_from {
            Some(place) => made.with_seen_from(place)?,
            None => made,
        }))
    }
}

#[pyclass(frozen, name = "FusionStep", module = "lidar_core._core")]
pub(crate) struct PyFusionStep(FilterStep);

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
        Some(PyArray1::from_slice(py, self.0.innovation?.recorded()))
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
    use Outcome::{PlatformMotion, Restarted, Started, Updated};
    matches!(outcome, Updated | Started | Restarted | PlatformMotion)
}

fn square<'py>(py: Python<'py>, output: &Output) -> Result<Bound<'py, PyArray2<f64>>, BorderError> {
    let size = output.count;
    let rows = output.covariance[..size].iter().flat_map(|row| &row[..size]);
    let entries: Vec<f64> = rows.copied().collect();
    Ok(entries.into_pyarray(py).reshape([size, size])?)
}

#[pyclass(frozen, name = "TargetFilter", module = "lidar_core._core")]
pub(crate) struct PyTargetFilter {
    filter: Guarded<Filter>,
    parameters: FusionParameters,
}

#[pymethods]
impl PyTargetFilter {
    #[new]
    fn new(py: Python<'_>, config: FusionConfig) -> Result<Self, BorderError> {
        let parameters = config.parameters()?;
        let filter = detached(py, || Filter::new(&parameters))?;
        Ok(Self { filter: Guarded::new(filter), parameters })
    }

    #[staticmethod]
    fn from_state(py: Python<'_>, config: FusionConfig, state: &[u8]) -> Result<Self, BorderError> {
        let parameters = config.parameters()?;
        let filter = detached(py, || Filter::from_state(&parameters, state))?;
        Ok(Self { filter: Guarded::new(filter), parameters })
    }

    fn to_state<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyBytes>, BorderError> {
        let state = self.filter.with(py, |filter| filter.to_state(&self.parameters))?;
        Ok(PyBytes::new(py, &state))
    }

    fn step(
        &self,
        py: Python<'_>,
        measurement: PyRef<'_, PyMeasurement>,
    ) -> Result<PyFusionStep, BorderError> {
        let m = measurement.0;
        let mut step = self.filter.with(py, |filter| Ok(filter.step(&m)))?;
        if step.output.is_none() {
            step.stamp_ns = m.stamp_ns(); // there is no state yet whose time could be told
        }
        Ok(PyFusionStep(step))
    }

    /// Standard deviations of LiDAR and radar, estimated from the measurements.
    fn sensor_stds<'py>(&self, py: Python<'py>) -> Result<Deviations<'py>, BorderError> {
        let errors = self.filter.with(py, |filter| Ok(filter.errors()))?;
        Ok(deviations(py, errors.variances(&self.parameters.sensing), &self.parameters))
    }

    /// Mean and covariance at a time; None before the target has been seen.
    fn state_at<'py>(
        &self,
        py: Python<'py>,
        stamp_ns: i64,
    ) -> Result<Option<StateArrays<'py>>, BorderError> {
        let Some(output) = self.filter.with(py, |filter| Ok(filter.output_at(stamp_ns)))? else {
            return Ok(None);
        };
        let mean = PyArray1::from_slice(py, &output.mean[..output.count]);
        Ok(Some((mean, square(py, &output)?)))
    }
}

/// Standard deviations of LiDAR and radar: of two and three values in the plane, of three and four
/// in space.
fn deviations<'py>(
    py: Python<'py>,
    (lidar, radar): ([f64; 3], [f64; 4]),
    parameters: &FusionParameters,
) -> Deviations<'py> {
    let (lidar, radar) = (lidar.map(f64::sqrt), radar.map(f64::sqrt));
    let [range, bearing, _, rate] = radar;
    if parameters.is_in_space() {
        return (PyArray1::from_slice(py, &lidar), PyArray1::from_slice(py, &radar));
    }
    (PyArray1::from_slice(py, &lidar[..2]), PyArray1::from_slice(py, &[range, bearing, rate]))
}

/// Recorded innovations, cut to the columns that a filter can fill, and the number of these columns.
pub(crate) fn cut(innovations: Vec<f64>, parameters: &FusionParameters) -> (Vec<f64>, usize) {
    let width = if parameters.is_in_space() { MAX_INNOVATION } else { 3 };
    let rows = innovations.chunks_exact(MAX_INNOVATION);
    (rows.flat_map(|row| &row[..width]).copied().collect(), width)
}

type Deviations<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

type StateArrays<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>);

/// Stamps, numbers of outcomes, states, covariances, innovations, NIS: a row per measurement; then
/// standard deviations of LiDAR and radar as they are estimated at the end.
type RunArrays<'py> = (
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<u8>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
);

/// Measurements of one target.
#[pyclass(frozen, name = "Measurements", module = "lidar_core._core")]
pub(crate) struct PyMeasurements(pub(crate) Vec<Measurement>);

#[pymethods]
impl PyMeasurements {
    #[new]
    fn new(measurements: Vec<PyRef<'_, PyMeasurement>>) -> Self {
        Self(measurements.iter().map(|m| m.0).collect())
    }

    /// Measurements from arrays; rows are cut to the number of values that the sensor of the row
    /// gives.
    #[staticmethod]
    #[pyo3(signature = (stamps_ns, sensors, values, *, counts, covariances))]
    fn from_arrays(
        stamps_ns: PyReadonlyArray1<'_, i64>,
        sensors: PyReadonlyArray1<'_, u8>,
        values: PyReadonlyArray2<'_, f64>,
        counts: PyReadonlyArray1<'_, u8>,
        covariances: PyReadonlyArray2<'_, f64>,
    ) -> Result<Self, BorderError> {
        let stamps_ns = arrays::flat("stamps_ns", &stamps_ns)?;
        check_memory("measurements", stamps_ns.len(), 2 * size_of::<Measurement>())?;
        let sensors = arrays::flat("sensors", &sensors)?;
        let values = arrays::flat("values", &values)?;
        let counts = arrays::flat("counts", &counts)?;
        let covariances = arrays::flat("covariances", &covariances)?;
        let width = values.len().checked_div(stamps_ns.len()).unwrap_or(1).max(1);
        let size = covariances.len().checked_div(stamps_ns.len()).unwrap_or(0).isqrt();
        let noise = covariances.chunks_exact((size * size).max(1));
        let noise = noise.map(Some).chain(std::iter::repeat(None));
        let rows = stamps_ns.iter().zip(sensors).zip(values.chunks_exact(width).zip(counts));
        let made: Result<Vec<Measurement>, Error> = rows
            .zip(noise)
            .map(|(((stamp_ns, sensor), (row, count)), noise)| {
                let named = SENSORS.get(usize::from(*sensor)).ok_or_else(|| Error::Value {
                    name: "sensors",
                    expected: "numbers of sensors",
                    index: 0,
                    got: sensor.to_string(),
                })?;
                let count = usize::from(*count).min(width);
                let plain = Measurement::new(*stamp_ns, named.1, &row[..count], None)?;
                let Some(entries) = noise else { return Ok(plain) };
                let noise = leading(entries, size, plain.noisy());
                Measurement::new(*stamp_ns, named.1, &row[..count], Some(&noise))
            })
            .collect();
        Ok(Self(made?))
    }

    fn __len__(&self) -> usize {
        self.0.len()
    }
}

/// The first `count` rows and columns of a matrix of `size`.
fn leading(entries: &[f64], size: usize, count: usize) -> Vec<f64> {
    let count = count.min(size);
    entries.chunks_exact(size).take(count).flat_map(|row| &row[..count]).copied().collect()
}

#[pyfunction]
pub(crate) fn fusion_run<'py>(
    py: Python<'py>,
    config: FusionConfig,
    measurements: PyRef<'py, PyMeasurements>,
) -> Result<RunArrays<'py>, BorderError> {
    let (measurements, parameters) = (&measurements.0, config.parameters()?);
    run_arrays(py, stoppable(py, || run(&parameters, measurements))?, &parameters)
}

#[pyfunction]
#[pyo3(signature = (config, measurements, *, lag_ns))]
pub(crate) fn fusion_smooth<'py>(
    py: Python<'py>,
    config: FusionConfig,
    measurements: PyRef<'py, PyMeasurements>,
    lag_ns: Option<i64>,
) -> Result<RunArrays<'py>, BorderError> {
    let (measurements, parameters) = (&measurements.0, config.parameters()?);
    run_arrays(py, stoppable(py, || smooth(&parameters, measurements, lag_ns))?, &parameters)
}

#[pyfunction]
#[pyo3(signature = (config, targets, *, threads))]
pub(crate) fn fusion_run_batch<'py>(
    py: Python<'py>,
    config: FusionConfig,
    targets: Vec<PyRef<'py, PyMeasurements>>,
    threads: Threads,
) -> Result<Vec<RunArrays<'py>>, BorderError> {
    let targets: Vec<&[Measurement]> = targets.iter().map(|target| &target.0[..]).collect();
    let parameters = config.parameters()?;
    let records = stoppable(py, || run_batch(&threads::pool(threads.0)?, &parameters, &targets))?;
    records.into_iter().map(|record| run_arrays(py, record, &parameters)).collect()
}

/// Noise that makes measurements most likely: acceleration, jerk, turn; standard deviations of
/// LiDAR and radar; log likelihood.
type Fitted<'py> = ([f64; 3], Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>, f64);

#[pyfunction]
#[pyo3(signature = (config, targets, *, sensors, least_rate, evaluations))]
pub(crate) fn fusion_fit_noise<'py>(
    py: Python<'py>,
    config: FusionConfig,
    targets: Vec<PyRef<'py, PyMeasurements>>,
    sensors: bool,
    least_rate: f64,
    evaluations: i64,
) -> Result<Fitted<'py>, BorderError> {
    let rows = targets.iter().map(|target| target.0.len()).sum();
    check_memory("measurements", rows, 2 * size_of::<Measurement>())?;
    let targets: Vec<Vec<Measurement>> = targets.iter().map(|target| target.0.clone()).collect();
    let evaluations = arrays::count("evaluations", evaluations)?;
    let search = SimplexSearch { step: 0.5, tolerance: 1e-6, evaluations };
    let (best, likelihood) = stoppable(py, || {
        let start = config.parameters()?;
        let fitted = quantities(&start, &targets, sensors);
        fit(&start, &targets, &fitted, least_rate, &search)
    })?;
    let (noise, sensing) = (best.strengths, best.sensing);
    let (lidar, radar) = deviations(py, (sensing.lidar, sensing.radar), &best);
    Ok(([noise.acceleration, noise.jerk, noise.turn], lidar, radar, likelihood))
}

fn run_arrays<'py>(
    py: Python<'py>,
    record: Record,
    parameters: &FusionParameters,
) -> Result<RunArrays<'py>, BorderError> {
    let (lidar, radar) = deviations(py, record.variances, parameters);
    let (innovations, width) = cut(record.innovations, parameters);
    let (rows, size) = (record.stamps_ns.len(), record.states);
    let numbers = record.outcomes.iter().map(|outcome| outcome_number(*outcome) as u8);
    let outcomes: Vec<u8> = numbers.collect();
    Ok((
        record.stamps_ns.into_pyarray(py),
        outcomes.into_pyarray(py),
        record.means.into_pyarray(py).reshape([rows, size])?,
        record.covariances.into_pyarray(py).reshape([rows, size, size])?,
        innovations.into_pyarray(py).reshape([rows, width])?,
        record.nis.into_pyarray(py),
        lidar,
        radar,
    ))
}

/// Names of outcomes, in the order of their numbers.
#[pyfunction]
pub(crate) fn fusion_outcomes() -> Vec<&'static str> {
    OUTCOMES.iter().map(|(name, _)| *name).collect()
}
