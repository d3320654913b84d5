//! Bindings of `lidar_core::circles::fit`.

use crate::arrays::{self, Rows3};
use crate::circles::config::{FitConfig, ScannerConfig};
use crate::errors::BorderError;
use crate::guard::stoppable;
use lidar_core::Error;
use lidar_core::circles::fit::Fitter;
use lidar_core::circles::fit::circle::CircleEstimate;
use lidar_core::circles::preprocess::polar_scan::PolarScan;
use lidar_core::circles::segment::segments::{Segments, Side};
use lidar_core::circles::shape::{ShapeEstimate, ShapeFitter, ShapeKind};
use lidar_core::util::budget::check_memory;
use lidar_core::util::cancel;
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;

/// Circles as arrays: centre x, y and radius (C, 3) [m], covariance (C, 3, 3) [m^2], number of hits
/// (C,), true for fallbacks (C,).
pub(crate) type CircleArrays<'py> = (
    Rows3<'py, f64>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<bool>>,
);

/// Rays, starts and sides of `Segments`, as arrays from Python.
type SegmentArrays<'py> =
    (PyReadonlyArray1<'py, u32>, PyReadonlyArray1<'py, i64>, PyReadonlyArray2<'py, u8>);

/// Memory that a ray may take: range, bearing and number, each copied [bytes].
const ROOM_OF_RAY: usize = 64;
/// Memory that a circle may take, with its arrays for the caller [bytes].
const ROOM_OF_CIRCLE: usize = size_of::<CircleEstimate>() + 256;

#[pyfunction]
#[pyo3(signature = (ranges, bearings, *, config, scanner))]
pub(crate) fn detect_circles<'py>(
    py: Python<'py>,
    ranges: PyReadonlyArray2<'py, f32>,
    bearings: PyReadonlyArray1<'py, f64>,
    config: FitConfig,
    scanner: ScannerConfig,
) -> Result<CircleArrays<'py>, BorderError> {
    let beams = ranges.shape()[1];
    let (ranges, bearings) =
        (arrays::flat("ranges_batch", &ranges)?, arrays::flat("bearings", &bearings)?);
    let found = stoppable(py, || {
        let mut fitter = Fitter::new(config.parameters(&scanner)?)?;
        let mut scan = PolarScan { ranges: Vec::new(), bearings: bearings.to_vec() };
        let rows = ranges.len() / beams.max(1);
        check_memory("sweeps", rows, ROOM_OF_CIRCLE)?;
        let mut circles = Vec::with_capacity(rows);
        for row in ranges.chunks_exact(beams.max(1)) {
            cancel::check()?;
            scan.ranges.clear();
            scan.ranges.extend(row.iter().map(|&range| f64::from(range)));
            circles.push(fitter.fit_row(&scan)?);
        }
        Ok(circles)
    })?;
    circle_arrays(py, &found)
}

#[pyfunction]
#[pyo3(signature = (ranges, bearings, segments, *, config, scanner))]
pub(crate) fn fit_circles<'py>(
    py: Python<'py>,
    ranges: PyReadonlyArray1<'py, f64>,
    bearings: PyReadonlyArray1<'py, f64>,
    segments: SegmentArrays<'py>,
    config: FitConfig,
    scanner: ScannerConfig,
) -> Result<CircleArrays<'py>, BorderError> {
    let (scan, segments) = read_scan(&ranges, &bearings, &segments)?;
    let found = stoppable(py, || {
        let mut fitter = Fitter::new(config.parameters(&scanner)?)?;
        let mut circles = Vec::with_capacity(segments.len());
        fitter.fit(&scan, &segments, &mut circles)?;
        Ok(circles.into_iter().map(Some).collect::<Vec<_>>())
    })?;
    circle_arrays(py, &found)
}

/// Shapes as arrays: kind (S,), parameters (S, 5), covariance (S, 5, 5), misfit (S,), number of
/// hits (S,).
pub(crate) type ShapeArrays<'py> = (
    Bound<'py, PyArray1<u8>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<i64>>,
);

#[pyfunction]
#[pyo3(signature = (ranges, bearings, segments, *, config, scanner))]
pub(crate) fn fit_shapes<'py>(
    py: Python<'py>,
    ranges: PyReadonlyArray1<'py, f64>,
    bearings: PyReadonlyArray1<'py, f64>,
    segments: SegmentArrays<'py>,
    config: FitConfig,
    scanner: ScannerConfig,
) -> Result<ShapeArrays<'py>, BorderError> {
    let (scan, segments) = read_scan(&ranges, &bearings, &segments)?;
    let found = stoppable(py, || {
        let mut fitter = ShapeFitter::new(config.parameters(&scanner)?)?;
        let mut shapes = Vec::with_capacity(segments.len());
        fitter.fit(&scan, &segments, &mut shapes)?;
        Ok(shapes)
    })?;
    shape_arrays(py, &found)
}

/// Number of a kind of shape in the enumeration `ShapeKind` of Python.
pub(crate) fn kind_number(kind: ShapeKind) -> u8 {
    match kind {
        ShapeKind::Circle => 0,
        ShapeKind::Ellipse => 1,
        ShapeKind::Rectangle => 2,
        ShapeKind::Line => 3,
    }
}

pub(crate) fn shape_arrays<'py>(
    py: Python<'py>,
    shapes: &[ShapeEstimate],
) -> Result<ShapeArrays<'py>, BorderError> {
    let count = shapes.len();
    let kinds = shapes.iter().map(|shape| kind_number(shape.kind));
    let parameters: Vec<f64> = shapes.iter().flat_map(|shape| shape.parameters).collect();
    let covariance: Vec<f64> =
        shapes.iter().flat_map(|shape| shape.covariance.into_iter().flatten()).collect();
    let misfit: Vec<f64> = shapes.iter().map(|shape| shape.misfit).collect();
    let hits: Vec<i64> = shapes.iter().map(|shape| shape.n_hits as i64).collect();
    Ok((
        kinds.collect::<Vec<u8>>().into_pyarray(py),
        parameters.into_pyarray(py).reshape([count, 5])?,
        covariance.into_pyarray(py).reshape([count, 5, 5])?,
        misfit.into_pyarray(py),
        hits.into_pyarray(py),
    ))
}

/// A scan, and its segments without their labels.
fn read_scan(
    ranges: &PyReadonlyArray1<'_, f64>,
    bearings: &PyReadonlyArray1<'_, f64>,
    segments: &SegmentArrays<'_>,
) -> Result<(PolarScan, Segments), BorderError> {
    let ranges = arrays::flat("ranges", ranges)?;
    let bearings = arrays::flat("bearings", bearings)?;
    check_memory("a sweep", ranges.len().max(bearings.len()), ROOM_OF_RAY)?;
    let (ranges, bearings) = (ranges.to_vec(), bearings.to_vec());
    Ok((PolarScan { ranges, bearings }, read_segments(segments)?))
}

/// Segments without their labels.
fn read_segments((rays, starts, sides): &SegmentArrays<'_>) -> Result<Segments, BorderError> {
    if sides.shape()[1] != 2 {
        let got = sides.shape().to_vec();
        return Err(BorderError::Shape { name: "segments.sides", expected: "(S, 2)", got });
    }
    let starts = arrays::flat("segments.starts", starts)?;
    check_memory("segments", starts.len().max(sides.len()), ROOM_OF_CIRCLE)?;
    let codes = arrays::flat("segments.sides", sides)?;
    let side = |&code: &u8| match code {
        0 => Ok(Side::Free),
        1 => Ok(Side::Occluded),
        2 => Ok(Side::FieldEdge),
        3 => Ok(Side::RangeCut),
        _ => {
            let (name, expected) = ("segments.sides", "0 to 3");
            Err(Error::Value { name, expected, index: 0, got: code.to_string() })
        }
    };
    let sides: Result<Vec<Side>, Error> = codes.iter().map(side).collect();
    Ok(Segments {
        labels: Vec::new(),
        rays: arrays::flat("segments.rays", rays)?.to_vec(),
        starts: starts.iter().map(|&start| usize::try_from(start).unwrap_or(usize::MAX)).collect(),
        sides: sides?.as_chunks::<2>().0.to_vec(),
    })
}

/// Circles as arrays; NaN and no hits where there is none.
pub(crate) fn circle_arrays<'py>(
    py: Python<'py>,
    circles: &[Option<CircleEstimate>],
) -> Result<CircleArrays<'py>, BorderError> {
    let parameters = circles.iter().map(|known| match known {
        Some(CircleEstimate { circle, .. }) => [circle.center[0], circle.center[1], circle.radius],
        None => [f64::NAN; 3],
    });
    let covariance = circles.iter().flat_map(|known| {
        known.map_or([f64::NAN; 9], |circle| {
            let rows = circle.covariance;
            std::array::from_fn(|index| rows[index / 3][index % 3])
        })
    });
    let hits = circles.iter().map(|known| known.map_or(0, |circle| circle.n_hits as i64));
    let flags = circles.iter().map(|known| known.is_some_and(|circle| circle.is_fallback));
    let covariance: Vec<f64> = covariance.collect();
    Ok((
        arrays::rows_into(py, parameters.collect())?,
        covariance.into_pyarray(py).reshape([circles.len(), 3, 3])?,
        hits.collect::<Vec<i64>>().into_pyarray(py),
        flags.collect::<Vec<bool>>().into_pyarray(py),
    ))
}
