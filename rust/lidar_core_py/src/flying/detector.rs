//! Bindings of `lidar_core::flying::detector`.

use crate::arrays::{self, Rows3, Threads};
use crate::errors::BorderError;
use crate::flying::config::FlyingConfig;
use crate::flying::tracker::{TrackArrays, track_arrays};
use crate::guard::{Guarded, detached};
use lidar_core::flying::detect::detection::{Detection, Teammate};
use lidar_core::flying::detector::FlyingObjectDetector;
use lidar_core::flying::frame::Frame;
use lidar_core::flying::point_class::numbers_from_classes;
use lidar_core::flying::reporting_gate::ReportingGate;
use lidar_core::flying::scan::prepared::RawScan;
use numpy::{
    IntoPyArray, PyArray1, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyReadonlyArray3,
};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::path::PathBuf;

/// Rays into the sky as arrays: unit directions in the world, and lengths [m].
type SkyRays<'py> = (Rows3<'py, f64>, Bound<'py, PyArray1<f32>>);

/// Detections as arrays: position, covariance, radius, extent, number of points, confidence, time
/// after the scan's stamp [s].
type DetectionArrays<'py> = (
    Rows3<'py, f64>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray1<f64>>,
    Rows3<'py, f64>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
);

#[pyclass(frozen, name = "FlyingObjectDetector", module = "lidar_core._core")]
pub(crate) struct PyFlyingObjectDetector(Guarded<FlyingObjectDetector>);

#[pymethods]
impl PyFlyingObjectDetector {
    #[new]
    #[pyo3(signature = (config, *, threads))]
    fn new(py: Python<'_>, config: FlyingConfig, threads: Threads) -> Result<Self, BorderError> {
        let detector = detached(py, || FlyingObjectDetector::new(config.parameters()?, threads.0))?;
        Ok(Self(Guarded::new(detector)))
    }

    #[staticmethod]
    #[pyo3(signature = (config, state, *, threads))]
    fn from_state(
        py: Python<'_>,
        config: FlyingConfig,
        state: &[u8],
        threads: Threads,
    ) -> Result<Self, BorderError> {
        let detector = detached(py, || {
            FlyingObjectDetector::from_state(config.parameters()?, threads.0, state)
        })?;
        Ok(Self(Guarded::new(detector)))
    }

    fn to_state<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyBytes>, BorderError> {
        Ok(PyBytes::new(py, &self.0.with(py, |detector| detector.to_state())?))
    }

    #[pyo3(signature = (points, world_from_lidar, stamp_ns, *, no_return, directions,
                        point_time_ns, pose_stamps_ns, pose_covariance, sensor, organised))]
    #[allow(clippy::too_many_arguments)] // one call per scan, as the public API has it
    fn process<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'py, f32>,
        world_from_lidar: PyReadonlyArray3<'py, f64>,
        stamp_ns: i64,
        no_return: Option<PyReadonlyArray1<'py, bool>>,
        directions: Option<PyReadonlyArray2<'py, f32>>,
        point_time_ns: Option<PyReadonlyArray1<'py, i64>>,
        pose_stamps_ns: Option<PyReadonlyArray1<'py, i64>>,
        pose_covariance: Option<[[f64; 6]; 6]>,
        sensor: &str,
        organised: bool,
    ) -> Result<Bound<'py, PyDict>, BorderError> {
        let raw = RawScan {
            organised,
            sensor,
            stamp_ns,
            points: arrays::rows3("points", &points)?,
            no_return: arrays::maybe_flat("no_return", &no_return)?,
            directions: arrays::maybe_rows3("directions", &directions)?,
            point_time_ns: arrays::maybe_flat("point_time_ns", &point_time_ns)?,
            poses: arrays::matrices("world_from_lidar", &world_from_lidar)?,
            pose_stamps_ns: arrays::maybe_flat("pose_stamps_ns", &pose_stamps_ns)?,
            pose_covariance,
        };
        let frame = self.0.with_stoppable(py, |detector| detector.process(&raw))?;
        frame_dict(py, frame)
    }

    fn tracks_at<'py>(
        &self,
        py: Python<'py>,
        stamp_ns: i64,
        confirmed: bool,
    ) -> Result<TrackArrays<'py>, BorderError> {
        let tracks = self.0.with(py, |detector| {
            Ok(match confirmed {
                true => detector.tracks_at(stamp_ns),
                false => detector.hypotheses_at(stamp_ns),
            })
        })?;
        track_arrays(py, tracks)
    }

    #[pyo3(signature = (ids, positions, *, radius))]
    fn set_teammates(
        &self,
        py: Python<'_>,
        ids: PyReadonlyArray1<'_, i64>,
        positions: PyReadonlyArray2<'_, f64>,
        radius: f64,
    ) -> Result<(), BorderError> {
        let ids = arrays::flat("ids", &ids)?;
        let positions = arrays::rows3("positions", &positions)?;
        let mates = ids.iter().zip(positions);
        let mates = mates.map(|(&id, &position)| Teammate { id, position, radius }).collect();
        self.0.with(py, |detector| {
            detector.set_teammates(mates);
            Ok(())
        })
    }

    #[pyo3(signature = (points, *, occupied))]
    fn set_known(
        &self,
        py: Python<'_>,
        points: PyReadonlyArray2<'_, f64>,
        occupied: bool,
    ) -> Result<(), BorderError> {
        let points = arrays::rows3("points", &points)?;
        self.0.with(py, |detector| detector.set_known(points, occupied))
    }

    fn state_at<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'_, f64>,
    ) -> Result<Bound<'py, PyArray1<u8>>, BorderError> {
        let points = arrays::rows3("points", &points)?;
        let states =
            self.0.with(py, |detector| Ok(detector.map().states_at(&detector.in_map(points))))?;
        Ok(states.into_pyarray(py))
    }

    /// Centres of all voxels that are at least tentatively occupied, in the world [m].
    fn occupied_points<'py>(&self, py: Python<'py>) -> Result<Rows3<'py, f64>, BorderError> {
        let centers = self.0.with(py, |detector| {
            let (map, world_from_map) = (detector.map(), detector.world_from_map());
            let center = |voxel| world_from_map.apply(map.lattice().center(voxel));
            Ok(map.occupied_voxels().into_iter().map(center).collect())
        })?;
        arrays::rows_into(py, centers)
    }

    /// Rays into the sky that were added to the last scan: unit directions in the world, and the
    /// length that each clears [m].
    fn sky_rays<'py>(&self, py: Python<'py>) -> Result<SkyRays<'py>, BorderError> {
        let (directions, reach): (Vec<_>, Vec<_>) =
            self.0.with(py, |detector| Ok(detector.sky_rays().into_iter().unzip()))?;
        Ok((arrays::rows_into(py, directions)?, reach.into_pyarray(py)))
    }

    fn save_map(&self, py: Python<'_>, path: PathBuf) -> Result<(), BorderError> {
        self.0.with(py, |detector| detector.save_map(&path))
    }

    fn load_map(&self, py: Python<'_>, path: PathBuf) -> Result<(), BorderError> {
        self.0.with(py, |detector| detector.load_map(&path))
    }

    fn make_static_map(&self, py: Python<'_>) -> Result<(), BorderError> {
        self.0.with(py, |detector| {
            detector.make_static_map();
            Ok(())
        })
    }

    /// Points of all static objects, world frame [m].
    fn static_points<'py>(&self, py: Python<'py>) -> Result<Rows3<'py, f64>, BorderError> {
        arrays::rows_into(py, self.0.with_stoppable(py, |detector| detector.static_points())?)
    }

    fn save_static_map(&self, py: Python<'_>, path: PathBuf) -> Result<(), BorderError> {
        self.0.with(py, |detector| detector.save_static_map(&path))
    }

    /// The map as bytes; equal maps give equal bytes.
    fn map_bytes(&self, py: Python<'_>) -> Result<Vec<u8>, BorderError> {
        self.0.with(py, |detector| Ok(detector.map().to_bytes()))
    }

    /// Numbers of voxels stored and observed, and bytes held by the map.
    fn map_size(&self, py: Python<'_>) -> Result<(usize, usize, usize), BorderError> {
        self.0.with(py, |detector| {
            let map = detector.map();
            Ok((map.stored_voxels(), map.observed_voxels(), map.memory_bytes()))
        })
    }

    fn reanchor(&self, py: Python<'_>) -> Result<bool, BorderError> {
        self.0.with(py, |detector| Ok(detector.reanchor()))
    }

    fn reset(&self, py: Python<'_>) -> Result<(), BorderError> {
        self.0.with(py, FlyingObjectDetector::reset)
    }
}

fn frame_dict(py: Python<'_>, frame: Frame) -> Result<Bound<'_, PyDict>, BorderError> {
    let values = PyDict::new(py);
    values.set_item("point_class", numbers_from_classes(frame.point_class).into_pyarray(py))?;
    values.set_item("detections", detection_arrays(py, &frame.detections)?)?;
    let (ids, mates): (Vec<i64>, Vec<Detection>) = frame.teammates.into_iter().unzip();
    values.set_item("teammate_ids", ids.into_pyarray(py))?;
    values.set_item("teammates", detection_arrays(py, &mates)?)?;
    values.set_item("tracks", track_arrays(py, frame.tracks)?)?;
    values.set_item("gate_open", frame.gate == ReportingGate::Open)?;
    values.set_item("gate_reason", frame.gate.to_string())?;
    values
        .set_item("map_pose_mismatch", matches!(frame.gate, ReportingGate::PoseMismatch { .. }))?;
    values.set_item("sky", frame.sky.name())?;
    values.set_item("sky_share", frame.sky_share)?;
    values.set_item("sky_rays", frame.sky_rays)?;
    values.set_item("point_times", frame.point_times.name())?;
    values.set_item("own_body", frame.own_body)?;
    let own_rows: Vec<i64> = frame.own_rows.into_iter().map(i64::from).collect();
    values.set_item("own_rows", own_rows.into_pyarray(py))?;
    values.set_item("own_body_is_decided", frame.own_body_is_decided)?;
    let stats = frame.integrated.unwrap_or_default();
    values.set_item("rays", stats.rays)?;
    values.set_item("visits", stats.visits)?;
    values.set_item("voxels_forgotten", stats.voxels_forgotten)?;
    let timing = frame.timing;
    let stages = [
        ("prepare", timing.prepare),
        ("cluster", timing.cluster),
        ("classify", timing.classify),
        ("integrate", timing.integrate),
        ("separate", timing.separate),
        ("track", timing.track),
    ];
    let timing_ms = PyDict::new(py);
    for (stage, milliseconds) in stages {
        timing_ms.set_item(stage, milliseconds)?;
    }
    values.set_item("timing_ms", timing_ms)?;
    Ok(values)
}

fn detection_arrays<'py>(
    py: Python<'py>,
    detections: &[Detection],
) -> Result<DetectionArrays<'py>, BorderError> {
    let count = detections.len();
    let column = |value: fn(&Detection) -> f64| -> Bound<'py, PyArray1<f64>> {
        detections.iter().map(value).collect::<Vec<_>>().into_pyarray(py)
    };
    let covariances: Vec<f64> =
        detections.iter().flat_map(|found| found.covariance.into_iter().flatten()).collect();
    Ok((
        arrays::rows_into(py, detections.iter().map(|found| found.position).collect())?,
        covariances.into_pyarray(py).reshape([count, 3, 3])?,
        column(|found| found.radius),
        arrays::rows_into(py, detections.iter().map(|found| found.extent).collect())?,
        detections.iter().map(|found| found.n_points as i64).collect::<Vec<_>>().into_pyarray(py),
        column(|found| found.confidence),
        column(|found| found.delay),
    ))
}
