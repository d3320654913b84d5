//! Runs over whole recordings, one or many, as columns.

use super::any_filter::{Filter, FusionParameters, smooth_into};
use super::lifecycle::Outcome;
use super::target::Taken;
use crate::Error;
use crate::fusion::filter::engine::{Innovation, Output};
use crate::fusion::sensors::measurement::Measurement;
use rayon::ThreadPool;
use rayon::prelude::*;
use std::borrow::Cow;

/// What a filter said: one row per measurement.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Record {
    /// Number of states; zero where the target was never seen.
    pub states: usize,
    /// Times [ns].
    pub stamps_ns: Vec<i64>,
    /// What became of the measurements.
    pub outcomes: Vec<Outcome>,
    /// Means, row after row; NaN before the target has been seen.
    pub means: Vec<f64>,
    /// Covariances, row after row.
    pub covariances: Vec<f64>,
    /// Three values a row; NaN beyond those that were compared.
    pub innovations: Vec<f64>,
    /// NaN where nothing was compared.
    pub nis: Vec<f64>,
}

impl Record {
    fn with_capacity(rows: usize) -> Self {
        Self {
            states: 0,
            stamps_ns: Vec::with_capacity(rows),
            outcomes: Vec::with_capacity(rows),
            means: Vec::new(),
            covariances: Vec::new(),
            innovations: Vec::with_capacity(3 * rows),
            nis: Vec::with_capacity(rows),
        }
    }

    /// Add a row.
    pub fn push(&mut self, stamp_ns: i64, (outcome, innovation): Taken, output: Option<&Output>) {
        if let (0, Some(output)) = (self.states, output) {
            self.see(output.count);
        }
        self.stamps_ns.push(stamp_ns);
        self.outcomes.push(outcome);
        self.push_state(output);
        self.innovations.extend_from_slice(&padded(innovation.as_ref()));
        self.nis.push(innovation.map_or(f64::NAN, |innovation| innovation.nis));
    }

    /// Now that the number of states is known: rows that came before have no state.
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

/// The values that were compared, then NaN.
#[must_use]
pub fn padded(innovation: Option<&Innovation>) -> [f64; 3] {
    let mut values = [f64::NAN; 3];
    if let Some(Innovation { values: compared, count, .. }) = innovation {
        let count = (*count).min(3);
        values[..count].copy_from_slice(&compared[..count]);
    }
    values
}

/// Filter measurements in the order of their stamps; those of one stamp keep their order.
///
/// # Errors
/// As [`Filter::new`].
pub fn run(parameters: &FusionParameters, measurements: &[Measurement]) -> Result<Record, Error> {
    let mut filter = Filter::new(&parameters.without_buffer())?;
    let mut record = Record::with_capacity(measurements.len());
    for m in in_order(measurements).iter() {
        let taken = filter.take(m);
        record.push(filter.stamp_ns(), taken, filter.output().as_ref());
    }
    Ok(record)
}

/// As [`run`] for many targets at once. The result does not depend on the number of threads.
///
/// # Errors
/// As [`Filter::new`].
pub fn run_batch(
    pool: &ThreadPool,
    parameters: &FusionParameters,
    targets: &[&[Measurement]],
) -> Result<Vec<Record>, Error> {
    Filter::new(parameters)?;
    let records: Vec<Result<Record, Error>> =
        pool.install(|| targets.par_iter().map(|target| run(parameters, target)).collect());
    records.into_iter().collect()
}

/// As [`run`], then every state given the measurements up to `lag_ns` after it, or all.
///
/// # Errors
/// As [`Filter::new`], and for a model or method whose past cannot be smoothed.
pub fn smooth(
    parameters: &FusionParameters,
    measurements: &[Measurement],
    lag_ns: Option<i64>,
) -> Result<Record, Error> {
    let mut record = Record::with_capacity(measurements.len());
    let sorted = in_order(measurements);
    smooth_into(parameters, &sorted, lag_ns, |step| {
        record.push(step.stamp_ns, (step.outcome, step.innovation), step.output.as_ref());
    })?;
    Ok(record)
}

/// Measurements by their stamps; those of one stamp keep their order.
#[must_use]
pub fn in_order(measurements: &[Measurement]) -> Cow<'_, [Measurement]> {
    if measurements.is_sorted_by_key(Measurement::stamp_ns) {
        return Cow::Borrowed(measurements);
    }
    let mut sorted = measurements.to_vec();
    sorted.sort_by_key(Measurement::stamp_ns);
    Cow::Owned(sorted)
}
