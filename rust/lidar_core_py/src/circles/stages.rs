//! Bindings of `lidar_core::circles`: preprocessing and segmentation of a scan.

use crate::arrays;
use crate::circles::config::{ScannerConfig, SegmentConfig};
use crate::errors::BorderError;
use crate::guard::detached;
use lidar_core::Error;
use lidar_core::circles::preprocess::polar_scan::PolarScan;
use lidar_core::circles::preprocess::projection::{self, Projection};
use lidar_core::circles::preprocess::sweep_poses::SweepPoses;
use lidar_core::circles::segment::segmentation::segment;
use lidar_core::circles::segment::segments::{Segments, Side};
use lidar_core::geometry::motion::ScanPoses;
use lidar_core::util::budget::check_memory;
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::prelude::*;

type Column<'py, T> = Bound<'py, PyArray1<T>>;

/// A level scan as arrays: ranges [m], bearings [rad], heights above the scanner [m].
pub(crate) type LevelArrays<'py> = (Column<'py, f64>, Column<'py, f64>, Column<'py, f64>);

/// Segments as arrays: labels, rays, starts, sides.
pub(crate) type SegmentArrays<'py> =
    (Column<'py, i32>, Column<'py, u32>, Column<'py, i64>, Bound<'py, PyArray2<u8>>);

/// Names of the projections in configurations.
pub(crate) const PROJECTIONS: [(&str, Projection); 2] =
    [("exact", Projection::Exact), ("paper", Projection::Paper)];

/// Memory that a ray may take in one stage, with its arrays for the caller [bytes].
const ROOM_OF_RAY: usize = 256;

#[pyfunction]
#[pyo3(signature = (ranges, bearings, world_from_lidar, *, planes, stamp_ns, ray_time_ns,
                    pose_stamps_ns))]
#[allow(clippy::too_many_arguments)] // one scan with its times
pub(crate) fn limit_range<'py>(
    py: Python<'py>,
    ranges: PyReadonlyArray1<'py, f64>,
    bearings: PyReadonlyArray1<'py, f64>,
    world_from_lidar: PyReadonlyArray3<'py, f64>,
    planes: PyReadonlyArray2<'py, f64>,
    stamp_ns: i64,
    ray_time_ns: Option<PyReadonlyArray1<'py, i64>>,
    pose_stamps_ns: Option<PyReadonlyArray1<'py, i64>>,
) -> Result<Column<'py, f64>, BorderError> {
    let name = "planes";
    if planes.shape()[1] != 4 {
        let got = planes.shape().to_vec();
        return Err(BorderError::Shape { name, expected: "(P, 4)", got });
    }
    let planes = arrays::flat(name, &planes)?.as_chunks::<4>().0;
    let (ranges, bearings) = scan_slices(&ranges, &bearings)?;
    let poses = arrays::matrices("world_from_lidar", &world_from_lidar)?;
    let stamps = arrays::maybe_flat("pose_stamps_ns", &pose_stamps_ns)?;
    let times = arrays::maybe_flat("ray_time_ns", &ray_time_ns)?;
    let limited = detached(py, || {
        let sweep = SweepPoses::new(&ScanPoses::new(poses, stamps)?, stamp_ns, times)?;
        projection::limit_range(ranges, &projection::directions(bearings), &sweep, planes)
    })?;
    Ok(limited.into_pyarray(py))
}

#[pyfunction]
#[pyo3(signature = (ranges, bearings, world_from_lidar, *, mode, stamp_ns, ray_time_ns,
                    pose_stamps_ns))]
#[allow(clippy::too_many_arguments)] // one scan with its times
pub(crate) fn project_horizontal<'py>(
    py: Python<'py>,
    ranges: PyReadonlyArray1<'py, f64>,
    bearings: PyReadonlyArray1<'py, f64>,
    world_from_lidar: PyReadonlyArray3<'py, f64>,
    mode: &str,
    stamp_ns: i64,
    ray_time_ns: Option<PyReadonlyArray1<'py, i64>>,
    pose_stamps_ns: Option<PyReadonlyArray1<'py, i64>>,
) -> Result<LevelArrays<'py>, BorderError> {
    let mode = arrays::choice("mode", mode, &PROJECTIONS)?;
    let (ranges, bearings) = scan_slices(&ranges, &bearings)?;
    let poses = arrays::matrices("world_from_lidar", &world_from_lidar)?;
    let stamps = arrays::maybe_flat("pose_stamps_ns", &pose_stamps_ns)?;
    let times = arrays::maybe_flat("ray_time_ns", &ray_time_ns)?;
    let level = detached(py, || {
        let sweep = SweepPoses::new(&ScanPoses::new(poses, stamps)?, stamp_ns, times)?;
        let raw = PolarScan { ranges: ranges.to_vec(), bearings: bearings.to_vec() };
        projection::project(&raw, &projection::directions(bearings), &sweep, mode)
    })?;
    let PolarScan { ranges, bearings } = level.scan;
    Ok((ranges.into_pyarray(py), bearings.into_pyarray(py), level.heights.into_pyarray(py)))
}

#[pyfunction]
#[pyo3(signature = (ranges, bearings, *, config, scanner))]
pub(crate) fn segment_scan<'py>(
    py: Python<'py>,
    ranges: PyReadonlyArray1<'py, f64>,
    bearings: PyReadonlyArray1<'py, f64>,
    config: SegmentConfig,
    scanner: ScannerConfig,
) -> Result<SegmentArrays<'py>, BorderError> {
    let (ranges, bearings) = scan_slices(&ranges, &bearings)?;
    let parameters = config.parameters(&scanner)?;
    let segments = detached(py, || {
        let scan = PolarScan { ranges: ranges.to_vec(), bearings: bearings.to_vec() };
        segment(&scan, None, &parameters)
    })?;
    segment_arrays(py, segments)
}

/// Segments as arrays for Python.
pub(crate) fn segment_arrays(
    py: Python<'_>,
    segments: Segments,
) -> Result<SegmentArrays<'_>, BorderError> {
    let count = segments.len();
    let code = |side: &Side| match side {
        Side::Free => 0,
        Side::Occluded => 1,
        Side::FieldEdge => 2,
        Side::RangeCut => 3,
    };
    let sides: Vec<u8> = segments.sides.as_flattened().iter().map(code).collect();
    let starts: Vec<i64> = segments.starts.iter().map(|&start| start as i64).collect();
    Ok((
        segments.labels.into_pyarray(py),
        segments.rays.into_pyarray(py),
        starts.into_pyarray(py),
        sides.into_pyarray(py).reshape([count, 2])?,
    ))
}

fn scan_slices<'a>(
    ranges: &'a PyReadonlyArray1<'_, f64>,
    bearings: &'a PyReadonlyArray1<'_, f64>,
) -> Result<(&'a [f64], &'a [f64]), BorderError> {
    let (ranges, bearings) = (arrays::flat("ranges", ranges)?, arrays::flat("bearings", bearings)?);
    if ranges.len() != bearings.len() {
        let (expected, got) = (bearings.len(), ranges.len());
        return Err(Error::Length { name: "ranges", expected, got }.into());
    }
    check_memory("a sweep", ranges.len(), ROOM_OF_RAY)?;
    Ok((ranges, bearings))
}
