//! Bindings of `lidar_core::fusion::targets::many`.

use crate::arrays;
use crate::errors::BorderError;
use crate::fusion::config::FusionConfig;
use crate::fusion::filter::{PyMeasurements, cut};
use crate::guard::{Guarded, detached};
use crate::kinds::{KindArrays, kind_arrays};
use lidar_core::Error;
use lidar_core::fusion::targets::many::{ExistenceParameters, MAX_SOURCES, TrackingWork};
use lidar_core::fusion::targets::record::padded;
use lidar_core::fusion::{
    Assigned, FusionParameters, ManyParameters, ManyTargets, TargetAssociation, TrackState,
};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

/// The fields of `MultiTargetConfig`.
#[derive(FromPyObject)]
pub(crate) struct MultiTargetConfig {
    target: FusionConfig,
    confirm_hits: u32,
    confirm_window: u32,
    max_coast: f64,
    max_position_std: f64,
    birth_distance: f64,
    report_speed: f64,
    association: String,
    detection_probability: f64,
    clutter: [f64; 2],
    report_existence: f64,
}

impl MultiTargetConfig {
    pub(crate) fn parameters(&self) -> Result<ManyParameters, Error> {
        let clutter = self.clutter;
        let joint = TargetAssociation::Joint { detection: self.detection_probability, clutter };
        let integrated = TargetAssociation::Integrated(ExistenceParameters {
            detection: self.detection_probability,
            clutter,
            report: self.report_existence,
        });
        let nearest = TargetAssociation::Nearest;
        let associations = [("integrated", integrated), ("nearest", nearest), ("joint", joint)];
        Ok(ManyParameters {
            filter: self.target.parameters()?,
            confirm_hits: self.confirm_hits,
            confirm_window: self.confirm_window,
            max_coast: self.max_coast,
            max_position_std: self.max_position_std,
            birth_distance: self.birth_distance,
            report_speed: self.report_speed,
            association: arrays::choice("association", &self.association, &associations)?,
        })
    }
}

#[pyclass(frozen, name = "MultiTargetTracker", module = "lidar_core._core")]
pub(crate) struct PyMultiTargetTracker(Guarded<ManyTargets>);

/// Result of a scan as arrays, a row per measurement: ID of the track (-1 for none), innovation,
/// NIS.
type ScanArrays<'py> =
    (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>);

/// Tracks as arrays: IDs, states, covariances, times of the first and the last measurement [ns],
/// counts of measurements, confirmed, probabilities of existence, kinds.
type TrackArrays<'py> = (
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<f64>>,
    KindArrays<'py>,
);

#[pymethods]
impl PyMultiTargetTracker {
    #[new]
    fn new(py: Python<'_>, config: MultiTargetConfig) -> Result<Self, BorderError> {
        let tracker = detached(py, || ManyTargets::new(&config.parameters()?))?;
        Ok(Self(Guarded::new(tracker)))
    }

    #[staticmethod]
    fn from_state(
        py: Python<'_>,
        config: MultiTargetConfig,
        state: &[u8],
    ) -> Result<Self, BorderError> {
        let tracker = detached(py, || ManyTargets::from_state(&config.parameters()?, state))?;
        Ok(Self(Guarded::new(tracker)))
    }

    fn to_state<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyBytes>, BorderError> {
        Ok(PyBytes::new(py, &self.0.with(py, |tracker| tracker.to_state())?))
    }

    fn process<'py>(
        &self,
        py: Python<'py>,
        stamp_ns: i64,
        source: i64,
        measurements: PyRef<'py, PyMeasurements>,
    ) -> Result<ScanArrays<'py>, BorderError> {
        let source = u8::try_from(source).unwrap_or(MAX_SOURCES);
        let scan = &measurements.0;
        let (assigned, parameters) = self.0.with(py, |tracker| {
            Ok((tracker.process(stamp_ns, source, scan)?, tracker.parameters().filter))
        })?;
        scan_arrays(py, &assigned, &parameters)
    }

    /// Counts of scans, of predictions of tracks, and of compared pairs so far.
    fn work(&self, py: Python<'_>) -> Result<(u64, u64, u64), BorderError> {
        self.0.with(py, |tracker| {
            let TrackingWork { scans, predictions, pairs } = tracker.work();
            Ok((scans, predictions, pairs))
        })
    }

    fn tracks_at<'py>(
        &self,
        py: Python<'py>,
        stamp_ns: i64,
    ) -> Result<TrackArrays<'py>, BorderError> {
        track_arrays(py, &self.0.with(py, |tracker| Ok(tracker.tracks_at(stamp_ns)))?)
    }
}

fn scan_arrays<'py>(
    py: Python<'py>,
    assigned: &[Assigned],
    parameters: &FusionParameters,
) -> Result<ScanArrays<'py>, BorderError> {
    let numbers: Vec<i64> = assigned.iter().map(|one| one.id.unwrap_or(-1)).collect();
    let innovations = assigned.iter().flat_map(|one| padded(one.innovation.as_ref()));
    let (innovations, width) = cut(innovations.collect(), parameters);
    let nis = assigned.iter().map(|one| one.innovation.map_or(f64::NAN, |y| y.nis));
    Ok((
        numbers.into_pyarray(py),
        innovations.into_pyarray(py).reshape([assigned.len(), width])?,
        nis.collect::<Vec<f64>>().into_pyarray(py),
    ))
}

fn track_arrays<'py>(
    py: Python<'py>,
    tracks: &[TrackState],
) -> Result<TrackArrays<'py>, BorderError> {
    let (count, size) = (tracks.len(), tracks.first().map_or(0, |track| track.output.count));
    let numbers = |value: fn(&TrackState) -> i64| {
        tracks.iter().map(value).collect::<Vec<i64>>().into_pyarray(py)
    };
    let means = tracks.iter().flat_map(|track| &track.output.mean[..size]);
    let rows = tracks.iter().flat_map(|track| &track.output.covariance[..size]);
    let entries = rows.flat_map(|row| &row[..size]);
    Ok((
        numbers(|track| track.id),
        means.copied().collect::<Vec<f64>>().into_pyarray(py).reshape([count, size])?,
        entries.copied().collect::<Vec<f64>>().into_pyarray(py).reshape([count, size, size])?,
        numbers(|track| track.born_ns),
        numbers(|track| track.seen_ns),
        numbers(|track| i64::from(track.hits)),
        tracks.iter().map(|track| track.confirmed).collect::<Vec<bool>>().into_pyarray(py),
        tracks
            .iter()
            .map(|track| track.existence.unwrap_or(f64::NAN))
            .collect::<Vec<f64>>()
            .into_pyarray(py),
        kind_arrays(py, tracks.iter().map(|track| (track.kind, track.kind_probability)))?,
    ))
}
