//! Bindings of `lidar_core::circles::pipeline`.

use crate::arrays;
use crate::circles::config::{FitConfig, ScannerConfig, SegmentConfig, ShapeConfig};
use crate::circles::fit::{CircleArrays, circle_arrays, shape_arrays};
use crate::circles::map::{
    CircleMapConfig, Elements, MapShapes, element_arrays, estimates, event_arrays, map_shape_arrays,
};
use crate::circles::misses::no_return_name;
use crate::circles::stages::{LevelArrays, PROJECTIONS, SegmentArrays, segment_arrays};
use crate::errors::BorderError;
use crate::guard::{Guarded, detached};
use lidar_core::Error;
use lidar_core::circles::fit::circle::CircleEstimate;
use lidar_core::circles::frame::{CircleFrame, PreparedSweep};
use lidar_core::circles::parameters::PipelineParameters;
use lidar_core::circles::pipeline::{CirclePipeline, RawSweep};
use lidar_core::circles::preprocess::projection::LevelScan;
use numpy::{
    IntoPyArray, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::collections::BTreeMap;

/// The fields of `CirclesConfig` that the core reads.
#[derive(FromPyObject)]
pub(crate) struct CirclesConfig {
    scanner: ScannerConfig,
    scanners: BTreeMap<String, ScannerConfig>,
    preprocess: PreprocessConfig,
    segment: SegmentConfig,
    max_deviation: f64,
    shapes: ShapeConfig,
    map: CircleMapConfig,
}

#[derive(FromPyObject)]
struct PreprocessConfig {
    planes: Vec<[f64; 4]>,
    projection: String,
}

impl CirclesConfig {
    pub(crate) fn parameters(self, fit: &FitConfig) -> Result<PipelineParameters, Error> {
        let scanners = self.scanners.iter();
        Ok(PipelineParameters {
            scanner: self.scanner.parameters(),
            scanners: scanners.map(|(name, one)| (name.clone(), one.parameters())).collect(),
            projection: arrays::choice("projection", &self.preprocess.projection, &PROJECTIONS)?,
            planes: self.preprocess.planes,
            segment: self.segment.parameters(&self.scanner)?,
            fit: fit.parameters(&self.scanner)?,
            max_deviation: self.max_deviation,
            shapes: self.shapes.parameters(),
            map: self.map.parameters()?,
        })
    }
}

/// A sweep whose circles are still to be estimated.
#[pyclass(frozen, name = "PreparedSweep", module = "lidar_core._core")]
pub(crate) struct PyPreparedSweep(PreparedSweep);

#[pymethods]
impl PyPreparedSweep {
    /// The level scan: ranges [m], bearings [rad], heights [m].
    fn scan<'py>(&self, py: Python<'py>) -> LevelArrays<'py> {
        level_arrays(py, self.0.level.clone())
    }

    fn segments<'py>(&self, py: Python<'py>) -> Result<SegmentArrays<'py>, BorderError> {
        segment_arrays(py, self.0.segments.clone())
    }
}

/// One sweep as arrays that are borrowed from Python.
struct SweepArrays<'py> {
    ranges: PyReadonlyArray1<'py, f32>,
    world_from_lidar: PyReadonlyArray3<'py, f64>,
    pose_covariance: Option<[[f64; 6]; 6]>,
    ray_time_ns: Option<PyReadonlyArray1<'py, i64>>,
    pose_stamps_ns: Option<PyReadonlyArray1<'py, i64>>,
}

impl SweepArrays<'_> {
    fn sweep<'a>(&'a self, scanner: &'a str, stamp_ns: i64) -> Result<RawSweep<'a>, BorderError> {
        Ok(RawSweep {
            scanner,
            stamp_ns,
            ranges: arrays::flat("ranges", &self.ranges)?,
            poses: arrays::matrices("world_from_lidar", &self.world_from_lidar)?,
            pose_stamps_ns: arrays::maybe_flat("pose_stamps_ns", &self.pose_stamps_ns)?,
            ray_time_ns: arrays::maybe_flat("ray_time_ns", &self.ray_time_ns)?,
            pose_covariance: self.pose_covariance,
        })
    }
}

#[pyclass(frozen, name = "CirclePipeline", module = "lidar_core._core")]
pub(crate) struct PyCirclePipeline(Guarded<CirclePipeline>);

#[pymethods]
impl PyCirclePipeline {
    #[new]
    #[pyo3(signature = (config, *, fit))]
    fn new(py: Python<'_>, config: CirclesConfig, fit: FitConfig) -> Result<Self, BorderError> {
        let pipeline = detached(py, || CirclePipeline::new(config.parameters(&fit)?))?;
        Ok(Self(Guarded::new(pipeline)))
    }

    #[staticmethod]
    #[pyo3(signature = (config, state, *, fit))]
    fn from_state(
        py: Python<'_>,
        config: CirclesConfig,
        state: &[u8],
        fit: FitConfig,
    ) -> Result<Self, BorderError> {
        let parameters = config.parameters(&fit)?;
        let pipeline = detached(py, || CirclePipeline::from_state(parameters, state))?;
        Ok(Self(Guarded::new(pipeline)))
    }

    fn to_state<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyBytes>, BorderError> {
        Ok(PyBytes::new(py, &self.0.with(py, |pipeline| pipeline.to_state())?))
    }

    #[pyo3(signature = (ranges, world_from_lidar, *, stamp_ns, scanner, pose_covariance,
                        ray_time_ns, pose_stamps_ns))]
    #[allow(clippy::too_many_arguments)] // one call per scan, as the public API has it
    fn process<'py>(
        &self,
        py: Python<'py>,
        ranges: PyReadonlyArray1<'py, f32>,
        world_from_lidar: PyReadonlyArray3<'py, f64>,
        stamp_ns: i64,
        scanner: &str,
        pose_covariance: Option<[[f64; 6]; 6]>,
        ray_time_ns: Option<PyReadonlyArray1<'py, i64>>,
        pose_stamps_ns: Option<PyReadonlyArray1<'py, i64>>,
    ) -> Result<Bound<'py, PyDict>, BorderError> {
        let arrays =
            SweepArrays { ranges, world_from_lidar, pose_covariance, ray_time_ns, pose_stamps_ns };
        let sweep = arrays.sweep(scanner, stamp_ns)?;
        let frame = self.0.with(py, |pipeline| pipeline.process(&sweep))?;
        frame_dict(py, frame)
    }

    #[pyo3(signature = (ranges, world_from_lidar, *, stamp_ns, scanner, pose_covariance,
                        ray_time_ns, pose_stamps_ns))]
    #[allow(clippy::too_many_arguments)] // as `process`
    fn prepare<'py>(
        &self,
        py: Python<'py>,
        ranges: PyReadonlyArray1<'py, f32>,
        world_from_lidar: PyReadonlyArray3<'py, f64>,
        stamp_ns: i64,
        scanner: &str,
        pose_covariance: Option<[[f64; 6]; 6]>,
        ray_time_ns: Option<PyReadonlyArray1<'py, i64>>,
        pose_stamps_ns: Option<PyReadonlyArray1<'py, i64>>,
    ) -> Result<PyPreparedSweep, BorderError> {
        let arrays =
            SweepArrays { ranges, world_from_lidar, pose_covariance, ray_time_ns, pose_stamps_ns };
        let sweep = arrays.sweep(scanner, stamp_ns)?;
        Ok(PyPreparedSweep(self.0.with(py, |pipeline| pipeline.prepare(&sweep))?))
    }

    fn integrate<'py>(
        &self,
        py: Python<'py>,
        prepared: &PyPreparedSweep,
        circles: PyReadonlyArray2<'py, f64>,
        covariance: PyReadonlyArray3<'py, f64>,
        n_hits: PyReadonlyArray1<'py, i64>,
        is_fallback: PyReadonlyArray1<'py, bool>,
    ) -> Result<Bound<'py, PyDict>, BorderError> {
        let mut circles = estimates(&circles, &covariance)?;
        let expected = circles.len();
        for (name, got) in [("n_hits", n_hits.len()), ("is_fallback", is_fallback.len())] {
            if got != expected {
                return Err(Error::Length { name, expected, got }.into());
            }
        }
        let hits = arrays::flat("n_hits", &n_hits)?.iter();
        let flags = arrays::flat("is_fallback", &is_fallback)?.iter();
        for ((circle, &hits), &is_fallback) in circles.iter_mut().zip(hits).zip(flags) {
            circle.n_hits = arrays::count("n_hits", hits)?;
            circle.is_fallback = is_fallback;
        }
        let prepared = prepared.0.clone();
        let frame = self.0.with(py, |pipeline| pipeline.integrate(prepared, circles))?;
        frame_dict(py, frame)
    }

    fn map_at<'py>(&self, py: Python<'py>, stamp_ns: i64) -> Result<Elements<'py>, BorderError> {
        element_arrays(py, &self.0.with(py, |pipeline| Ok(pipeline.map_at(stamp_ns)))?)
    }

    fn shapes_at<'py>(
        &self,
        py: Python<'py>,
        stamp_ns: i64,
    ) -> Result<MapShapes<'py>, BorderError> {
        map_shape_arrays(py, &self.0.with(py, |pipeline| Ok(pipeline.shapes_at(stamp_ns)))?)
    }

    fn reset(&self, py: Python<'_>) -> Result<(), BorderError> {
        self.0.with(py, |pipeline| {
            pipeline.reset();
            Ok(())
        })
    }
}

fn frame_dict(py: Python<'_>, frame: CircleFrame) -> Result<Bound<'_, PyDict>, BorderError> {
    let values = PyDict::new(py);
    let numbers = |elements: &[Option<i64>]| -> Vec<i64> {
        elements.iter().map(|element| element.unwrap_or(-1)).collect()
    };
    values.set_item("level", level_arrays(py, frame.level))?;
    values.set_item("segments", segment_arrays(py, frame.segments)?)?;
    values.set_item("circles", all_circles(py, &frame.circles)?)?;
    values.set_item("circles_world", all_circles(py, &frame.circles_world)?)?;
    values.set_item("time_ns", frame.times_ns.into_pyarray(py))?;
    values.set_item("shapes", shape_arrays(py, &frame.shapes)?)?;
    values.set_item("element", numbers(&frame.elements).into_pyarray(py))?;
    values.set_item("too_near", frame.too_near.into_pyarray(py))?;
    values.set_item("line", numbers(&frame.lines).into_pyarray(py))?;
    values.set_item("map", element_arrays(py, &frame.map)?)?;
    values.set_item("map_shapes", map_shape_arrays(py, &frame.map_shapes)?)?;
    values.set_item("stuck_pose", frame.stats.stuck_pose)?;
    values.set_item("events", event_arrays(py, frame.stats)?)?;
    values.set_item("range_std", frame.range_std)?;
    values.set_item("pose_offset", frame.pose_offset)?;
    values.set_item("no_return", no_return_name(frame.no_return))?;
    let timing_ms = PyDict::new(py);
    let timing = frame.timing;
    for (stage, milliseconds) in [
        ("prepare", timing.prepare),
        ("segment", timing.segment),
        ("fit", timing.fit),
        ("map", timing.map),
    ] {
        timing_ms.set_item(stage, milliseconds)?;
    }
    values.set_item("timing_ms", timing_ms)?;
    Ok(values)
}

fn all_circles<'py>(
    py: Python<'py>,
    circles: &[CircleEstimate],
) -> Result<CircleArrays<'py>, BorderError> {
    circle_arrays(py, &circles.iter().copied().map(Some).collect::<Vec<_>>())
}

fn level_arrays(py: Python<'_>, level: LevelScan) -> LevelArrays<'_> {
    let LevelScan { scan, heights } = level;
    (scan.ranges.into_pyarray(py), scan.bearings.into_pyarray(py), heights.into_pyarray(py))
}
