//! Bindings of `lidar_core::flying::track`.

use crate::arrays::{self, Rows3, Threads};
use crate::errors::BorderError;
use crate::guard::{Guarded, detached};
use crate::kinds::{KindArrays, kind_arrays};
use lidar_core::Error;
use lidar_core::flying::track::{
    Ageing, Association, CloudView, Confirmation, Detections, Hiding, MeasurementForm, Merging,
    Motion, NoiseForm, OccupiedPoints, PointCloudTracker, Radius, RadiusForm, Stats, Track,
    TrackerParameters, Visibility,
};
use lidar_core::geometry::cluster::Clustering;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods};
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

/// The fields of `TrackerConfig`.
#[derive(FromPyObject)]
pub(crate) struct TrackerConfig {
    buffer_size: usize,
    cluster_distance: f64,
    max_extent: Option<f64>,
    occupied_distance: f64,
    radius: String,
    radius_scale: f64,
    radius_limits: [f64; 2],
    acceleration_time: Option<f64>,
    process_noise: String,
    process_std: [f64; 3],
    initial_std: [f64; 3],
    measurement: String,
    measurement_std: f64,
    hidden_share: Option<f64>,
    association: String,
    gate_probability: f64,
    clutter_density: f64,
    rejoin_acceleration: Option<f64>,
    split_distance: Option<f64>,
    confirm_hits: u32,
    confirm_window: u32,
    report_existence: Option<f64>,
    merge_distance: Option<f64>,
    ageing: String,
    max_coast: f64,
    report_coast: f64,
}

/// Names of the forms of the association radius in configurations.
const RADIUS_FORMS: [(&str, RadiusForm); 2] =
    [("paper", RadiusForm::Paper), ("sixth-root", RadiusForm::SixthRoot)];
/// Names of the forms of the process noise in configurations.
const NOISE_FORMS: [(&str, NoiseForm); 3] = [
    ("paper", NoiseForm::Paper),
    ("continuous", NoiseForm::Continuous),
    ("adaptive", NoiseForm::Adaptive),
];
/// Names of the forms of the measurement noise in configurations.
const MEASUREMENT_FORMS: [(&str, MeasurementForm); 3] = [
    ("paper", MeasurementForm::Paper),
    ("cluster", MeasurementForm::Cluster),
    ("center", MeasurementForm::Center),
];

impl TrackerConfig {
    fn radius(&self) -> Result<Radius, Error> {
        let [min, max] = self.radius_limits;
        let form = arrays::choice("radius", &self.radius, &RADIUS_FORMS)?;
        Ok(Radius { form, scale: self.radius_scale, min, max })
    }

    fn motion(&self) -> Result<Motion, Error> {
        Ok(Motion {
            acceleration_time: self.acceleration_time,
            unseen_time: self.acceleration_time.and(Motion::default().unseen_time),
            form: arrays::choice("process_noise", &self.process_noise, &NOISE_FORMS)?,
            std: self.process_std,
        })
    }

    fn confirmation(&self) -> Confirmation {
        match self.report_existence {
            Some(report) => Confirmation::Existence { report },
            None => Confirmation::Counts { hits: self.confirm_hits, window: self.confirm_window },
        }
    }

    fn association(&self) -> Result<Association, Error> {
        let Self { gate_probability, clutter_density, .. } = *self;
        let global = Association::Global { gate_probability, clutter_density };
        let known = [("paper", Association::Paper), ("global", global)];
        arrays::choice("association", &self.association, &known)
    }

    fn ageing(&self) -> Result<Ageing, Error> {
        let visible =
            Ageing::Visible { max_coast: self.max_coast, report_coast: self.report_coast };
        arrays::choice("ageing", &self.ageing, &[("paper", Ageing::Paper), ("visible", visible)])
    }

    pub(crate) fn parameters(&self) -> Result<TrackerParameters, Error> {
        Ok(TrackerParameters {
            buffer_size: self.buffer_size,
            clustering: Clustering { max_distance: self.cluster_distance, ..Clustering::default() },
            max_extent: self.max_extent,
            occupied_distance: self.occupied_distance,
            radius: self.radius()?,
            motion: self.motion()?,
            initial_std: self.initial_std,
            measurement: arrays::choice("measurement", &self.measurement, &MEASUREMENT_FORMS)?,
            measurement_std: self.measurement_std,
            hiding: self.hidden_share.map(|share| Hiding { share, ..Hiding::default() }),
            association: self.association()?,
            rejoin_acceleration: self.rejoin_acceleration,
            split_distance: self.split_distance,
            confirmation: self.confirmation(),
            merging: self.merge_distance.map(|distance| Merging { distance, ..Merging::default() }),
            ageing: self.ageing()?,
        })
    }
}

type Numbers<'py> = Bound<'py, PyArray1<i64>>;

/// Events of an update as arrays: true for a late cloud; IDs of corrected, new, confirmed and
/// removed tracks; ID pairs of merged tracks; count of rejected measurements.
type Events<'py> = (
    bool,
    Numbers<'py>,
    Numbers<'py>,
    Numbers<'py>,
    Numbers<'py>,
    Bound<'py, PyArray2<i64>>,
    usize,
);

/// Tracks as arrays: ID, mean (T, 9), covariance (T, 9, 9), extent (T, 3) [m], count of detections,
/// age [s], reported, existence, kinds.
pub(crate) type TrackArrays<'py> = (
    Numbers<'py>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray3<f64>>,
    Rows3<'py, f64>,
    Numbers<'py>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<f64>>,
    KindArrays<'py>,
);

#[pyclass(frozen, name = "PointCloudTracker", module = "lidar_core._core")]
pub(crate) struct PyPointCloudTracker(Guarded<PointCloudTracker>);

#[pymethods]
impl PyPointCloudTracker {
    #[new]
    #[pyo3(signature = (config, *, threads))]
    fn new(py: Python<'_>, config: TrackerConfig, threads: Threads) -> Result<Self, BorderError> {
        let tracker = detached(py, || PointCloudTracker::new(config.parameters()?, threads.0))?;
        Ok(Self(Guarded::new(tracker)))
    }

    #[staticmethod]
    #[pyo3(signature = (config, state, *, threads))]
    fn from_state(
        py: Python<'_>,
        config: TrackerConfig,
        state: &[u8],
        threads: Threads,
    ) -> Result<Self, BorderError> {
        let tracker =
            detached(py, || PointCloudTracker::from_state(config.parameters()?, threads.0, state))?;
        Ok(Self(Guarded::new(tracker)))
    }

    fn to_state<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyBytes>, BorderError> {
        Ok(PyBytes::new(py, &self.0.with(py, |tracker| tracker.to_state())?))
    }

    #[pyo3(signature = (points, occupied, stamp_ns, *, sensor_origin, delays))]
    fn new_point_cloud<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'py, f32>,
        occupied: PyReadonlyArray2<'py, f32>,
        stamp_ns: i64,
        sensor_origin: Option<[f64; 3]>,
        delays: Option<PyReadonlyArray1<'py, f32>>,
    ) -> Result<Events<'py>, BorderError> {
        let points = arrays::rows3("points", &points)?;
        let occupied = arrays::rows3("occupied", &occupied)?;
        let delays = arrays::maybe_flat("delays", &delays)?;
        let stats = self.0.with(py, |tracker| {
            let occupied = OccupiedPoints::new(occupied, tracker.parameters().occupied_distance);
            let view = sensor_origin.map(|origin| CloudView { points, origin });
            let visibility = view.as_ref().map(|view| view as &dyn Visibility);
            tracker.new_point_cloud(points, delays, &occupied, visibility, stamp_ns)
        })?;
        events(py, stats)
    }

    #[pyo3(signature = (positions, occupied, stamp_ns, *, covariance, extent, delay))]
    #[allow(clippy::too_many_arguments)] // one call per set, as the public API has it
    fn new_detections<'py>(
        &self,
        py: Python<'py>,
        positions: PyReadonlyArray2<'py, f64>,
        occupied: PyReadonlyArray2<'py, f32>,
        stamp_ns: i64,
        covariance: Option<PyReadonlyArray3<'py, f64>>,
        extent: Option<PyReadonlyArray2<'py, f64>>,
        delay: Option<PyReadonlyArray1<'py, f64>>,
    ) -> Result<Events<'py>, BorderError> {
        let covariance = covariance.as_ref().map(covariances).transpose()?;
        let detections = Detections {
            stamp_ns,
            positions: arrays::rows3("positions", &positions)?,
            covariance,
            extent: arrays::maybe_rows3("extent", &extent)?,
            delay: arrays::maybe_flat("delay", &delay)?,
            confidence: None,
            is_joined: None,
            is_among_surfaces: None,
            shape: None,
        };
        let occupied = arrays::rows3("occupied", &occupied)?;
        let stats = self.0.with(py, |tracker| {
            let occupied = OccupiedPoints::new(occupied, tracker.parameters().occupied_distance);
            tracker.new_detections(&detections, &occupied)
        })?;
        events(py, stats)
    }

    fn tracks_at<'py>(
        &self,
        py: Python<'py>,
        stamp_ns: i64,
    ) -> Result<TrackArrays<'py>, BorderError> {
        track_arrays(py, self.0.with(py, |tracker| Ok(tracker.tracks_at(stamp_ns)))?)
    }

    fn reset(&self, py: Python<'_>) -> Result<(), BorderError> {
        self.0.with(py, |tracker| {
            tracker.reset();
            Ok(())
        })
    }
}

fn covariances<'a>(
    array: &'a PyReadonlyArray3<'_, f64>,
) -> Result<&'a [[[f64; 3]; 3]], BorderError> {
    use numpy::PyUntypedArrayMethods;
    if array.shape()[1..] != [3, 3] {
        return Err(BorderError::Shape {
            name: "covariance",
            expected: "(M, 3, 3)",
            got: array.shape().to_vec(),
        });
    }
    Ok(arrays::flat("covariance", array)?.as_chunks::<3>().0.as_chunks::<3>().0)
}

fn events(py: Python<'_>, stats: Stats) -> Result<Events<'_>, BorderError> {
    let pairs = stats.merged.len();
    Ok((
        stats.late,
        stats.corrected.into_pyarray(py),
        stats.born.into_pyarray(py),
        stats.confirmed.into_pyarray(py),
        stats.removed.into_pyarray(py),
        stats.merged.into_flattened().into_pyarray(py).reshape([pairs, 2])?,
        stats.rejected,
    ))
}

/// Tracks as arrays, one row each.
pub(crate) fn track_arrays(
    py: Python<'_>,
    tracks: Vec<Track>,
) -> Result<TrackArrays<'_>, BorderError> {
    let count = tracks.len();
    let column = |value: fn(&Track) -> i64| tracks.iter().map(value).collect::<Vec<i64>>();
    let means: Vec<f64> = tracks.iter().flat_map(|track| track.state.mean.data.0[0]).collect();
    let covariances: Vec<f64> = tracks
        .iter()
        .flat_map(|track| track.state.covariance.data.0.into_iter().flatten()) // symmetric
        .collect();
    Ok((
        column(|track| track.id).into_pyarray(py),
        means.into_pyarray(py).reshape([count, 9])?,
        covariances.into_pyarray(py).reshape([count, 9, 9])?,
        arrays::rows_into(py, tracks.iter().map(|track| track.extent).collect())?,
        column(|track| i64::from(track.n_detections)).into_pyarray(py),
        tracks.iter().map(|track| track.age).collect::<Vec<f64>>().into_pyarray(py),
        tracks.iter().map(|track| track.reported).collect::<Vec<bool>>().into_pyarray(py),
        tracks.iter().map(|track| track.existence).collect::<Vec<f64>>().into_pyarray(py),
        kind_arrays(py, tracks.iter().map(|track| (track.kind, track.kind_probability)))?,
    ))
}
