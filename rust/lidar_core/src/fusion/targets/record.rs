//! Filter runs over whole recordings, for one or many targets, with the results as columns.

use super::any_filter::Filter;
use super::lifecycle::Outcome;
use super::sensor_errors::SensorErrors;
use super::target::{FilterStep, MeasurementResult};
use crate::Error;
use crate::error::require;
use crate::fusion::filter::engine::{Innovation, MAX_INNOVATION, Output};
use crate::fusion::filter::smoother::{RunRow, smoothed};
use crate::fusion::model_list::Model;
use crate::fusion::parameters::{FusionParameters, Method};
use crate::fusion::sensors::measurement::Measurement;
use crate::util::budget::check_memory;
use crate::util::cancel;
use rayon::ThreadPool;
use rayon::prelude::*;
use std::borrow::Cow;

/// Record of a filter, with one row per measurement.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Record {
    /// Number of states; zero if the target was never seen.
    pub states: usize,
    /// Times [ns].
    pub stamps_ns: Vec<i64>,
    /// Outcomes of the measurements.
    pub outcomes: Vec<Outcome>,
    /// Means, row by row; NaN before the target has been seen.
    pub means: Vec<f64>,
    /// Covariances, row by row.
    pub covariances: Vec<f64>,
    /// Innovations, four values per row; NaN for values that were not compared.
    pub innovations: Vec<f64>,
    /// NIS; NaN if nothing was compared.
    pub nis: Vec<f64>,
    /// Variances of the sensors as they are estimated at the end: of x, y and z of the LiDAR; of
    /// range, bearing, elevation and range rate of the radar.
    pub variances: ([f64; 3], [f64; 4]),
}

/// Largest memory of a row of a run, with a copy for the caller [bytes].
const ROOM_OF_ROW: usize = 2 * (size_of::<Output>() + 64);
/// Memory that a row of a smoothed run may take [bytes]: it keeps all states until the last is
/// known.
const ROOM_OF_SMOOTHED_ROW: usize =
    size_of::<RunRow>() + size_of::<FilterStep>() + 2 * size_of::<Output>() + ROOM_OF_ROW;

impl Record {
    fn with_capacity(rows: usize) -> Self {
        Self {
            states: 0,
            stamps_ns: Vec::with_capacity(rows),
            outcomes: Vec::with_capacity(rows),
            means: Vec::new(),
            covariances: Vec::new(),
            innovations: Vec::with_capacity(MAX_INNOVATION * rows),
            nis: Vec::with_capacity(rows),
            variances: ([0.0; 3], [0.0; 4]),
        }
    }

    /// Add a row.
    pub fn push(
        &mut self,
        stamp_ns: i64,
        (outcome, innovation): MeasurementResult,
        output: Option<&Output>,
    ) {
        if let (0, Some(output)) = (self.states, output) {
            self.see(output.count);
        }
        self.stamps_ns.push(stamp_ns);
        self.outcomes.push(outcome);
        self.push_state(output);
        self.innovations.extend_from_slice(&padded(innovation.as_ref()));
        self.nis.push(innovation.map_or(f64::NAN, |innovation| innovation.nis));
    }

    /// Fill the rows before the first state, once the number of states is known.
    fn see(&mut self, states: usize) {
        self.states = states;
        let rows = self.stamps_ns.len();
        let room = self.nis.capacity().max(rows);
        self.means.reserve(room * states);
        self.covariances.reserve(room * states * states);
        self.means.resize(rows * states, f64::NAN);
        self.covariances.resize(rows * states * states, f64::NAN);
    }

    fn push_state(&mut self, output: Option<&Output>) {
        let size = self.states;
        let Some(output) = output else {
            self.means.resize(self.means.len() + size, f64::NAN);
            self.covariances.resize(self.covariances.len() + size * size, f64::NAN);
            return;
        };
        self.means.extend_from_slice(&output.mean[..size]);
        for row in &output.covariance[..size] {
            self.covariances.extend_from_slice(&row[..size]);
        }
    }
}

/// Recorded values of an innovation, then NaN; all NaN without an innovation.
#[must_use]
pub fn padded(innovation: Option<&Innovation>) -> [f64; MAX_INNOVATION] {
    let mut values = [f64::NAN; MAX_INNOVATION];
    if let Some(innovation) = innovation {
        let compared = innovation.recorded();
        values[..compared.len()].copy_from_slice(compared);
    }
    values
}

/// Filter measurements in the order of their stamps; those of one stamp keep their order.
///
/// # Errors
/// Errors of [`Filter::new`], [`Error::Memory`], [`Error::Interrupted`].
pub fn run(parameters: &FusionParameters, measurements: &[Measurement]) -> Result<Record, Error> {
    let mut filter = Filter::new(&parameters.without_buffer())?;
    check_memory("a run", measurements.len(), ROOM_OF_ROW)?;
    let mut record = Record::with_capacity(measurements.len());
    let watch = cancel::watch();
    for m in in_order(measurements).iter() {
        watch.check()?; // one load, beside matrices
        let taken = filter.take(m);
        record.push(filter.stamp_ns(), taken, filter.output().as_ref());
    }
    record.variances = filter.errors().variances(&parameters.sensing);
    Ok(record)
}

/// Like [`run`], for many targets at once. The result does not depend on the number of threads.
///
/// # Errors
/// Errors of [`Filter::new`].
pub fn run_batch(
    pool: &ThreadPool,
    parameters: &FusionParameters,
    targets: &[&[Measurement]],
) -> Result<Vec<Record>, Error> {
    Filter::new(parameters)?;
    let rows = targets.iter().map(|target| target.len()).sum();
    check_memory("runs", rows, ROOM_OF_ROW)?; // of all: they are kept until the last has ended
    let watch = cancel::watch();
    let of_target = |target: &&[Measurement]| watch.run(|| run(parameters, target));
    let records: Vec<Result<Record, Error>> =
        pool.install(|| targets.par_iter().map(of_target).collect());
    records.into_iter().collect()
}

/// Like [`run`], with every state smoothed by the measurements up to `lag_ns` after it, or by all.
///
/// # Errors
/// Errors of [`Filter::new`], and an error for a model or method that cannot be smoothed.
pub fn smooth(
    parameters: &FusionParameters,
    measurements: &[Measurement],
    lag_ns: Option<i64>,
) -> Result<Record, Error> {
    check_memory("a smoothed run", measurements.len(), ROOM_OF_SMOOTHED_ROW)?;
    let mut record = Record::with_capacity(measurements.len());
    let sorted = in_order(measurements);
    let errors = smooth_into(parameters, &sorted, lag_ns, |step| {
        record.push(step.stamp_ns, (step.outcome, step.innovation), step.output.as_ref());
    })?;
    record.variances = errors.variances(&parameters.sensing);
    Ok(record)
}

/// Measurements ordered by stamp; those of one stamp keep their order.
#[must_use]
pub fn in_order(measurements: &[Measurement]) -> Cow<'_, [Measurement]> {
    if measurements.is_sorted_by_key(Measurement::stamp_ns) {
        return Cow::Borrowed(measurements);
    }
    let mut sorted = measurements.to_vec();
    sorted.sort_by_key(Measurement::stamp_ns);
    Cow::Owned(sorted)
}

/// Visit the steps of measurements that are in order, each state smoothed with the measurements up
/// to `lag_ns` after it, or with all. Returns the noise of the sensors at the end.
///
/// # Errors
/// Errors of [`Filter::new`], and an error for a model or method that cannot be smoothed.
fn smooth_into(
    parameters: &FusionParameters,
    measurements: &[Measurement],
    lag_ns: Option<i64>,
    mut visit: impl FnMut(&FilterStep),
) -> Result<SensorErrors, Error> {
    let smooths = !matches!(parameters.model, Model::Paper(_));
    require(smooths, "model", "one that can be smoothed", "\"paper\"")?;
    let smooths = !matches!(parameters.method, Method::Interacting { .. });
    require(smooths, "method", "one that can be smoothed", "\"imm\"")?;
    let mut filter = Filter::new(&parameters.without_buffer())?;
    let count = measurements.len();
    let (mut rows, mut steps) = (Vec::with_capacity(count), Vec::with_capacity(count));
    for m in measurements {
        cancel::check()?;
        let link = filter.link(m.stamp_ns());
        let before = filter.output();
        let step = filter.step(m);
        let link = match step.outcome {
            Outcome::Started | Outcome::Restarted => None,
            Outcome::Updated | Outcome::Gated | Outcome::PlatformMotion => {
                let factor = filter.looseness();
                link.zip(before).map(|(link, before)| link.loosened(&before, factor))
            }
            _ => link.zip(before).map(|(link, before)| link.standing(&before)),
        };
        rows.push(RunRow { stamp_ns: step.stamp_ns, output: step.output, link });
        steps.push(step);
    }
    for (step, output) in steps.iter().zip(smoothed(&rows, lag_ns)) {
        visit(&FilterStep { output, ..*step });
    }
    Ok(filter.errors())
}
