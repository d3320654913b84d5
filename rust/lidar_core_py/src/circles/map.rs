//! Bindings of `lidar_core::circles::map`.

use crate::arrays;
use crate::circles::fit::kind_number;
use crate::errors::BorderError;
use crate::guard::{Guarded, detached};
use lidar_core::Error;
use lidar_core::circles::fit::circle::{Circle, CircleEstimate};
use lidar_core::circles::map::{
    CircleMap, CircleMapParameters, CircleScan, ElementFilter, Independent, Joint, Limits,
    LineRules, MapElement, MapShape, MapStats, MotionMode, PoseCovariance, ScanWithLimits,
    Standing,
};
use lidar_core::circles::preprocess::polar_scan::PolarScan;
use lidar_core::geometry::transform::Transform;
use lidar_core::tracking::kind::KINDS;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyUntypedArrayMethods};
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

/// The fields of `CircleMapConfig`.
#[derive(FromPyObject)]
pub(crate) struct CircleMapConfig {
    filter: String,
    gate_probability: f64,
    initial_speed: f64,
    modes: Vec<(f64, f64, f64)>,
    standing_share: f64,
    standing_time: f64,
    moving_time: f64,
    standing_noise: f64,
    start_speed: f64,
    radius_noise: f64,
    turn_noise: f64,
    merge_gap: f64,
    report_existence: f64,
    max_position_std: f64,
    max_coast: Option<f64>,
    buffer_time: f64,
    line_noise: f64,
    line_std: f64,
    velocity_step: f64,
    max_eigenvalue: f64,
}

impl CircleMapConfig {
    pub(crate) fn parameters(&self) -> Result<CircleMapParameters, Error> {
        let joint =
            Joint { velocity_step: self.velocity_step, max_eigenvalue: self.max_eigenvalue };
        let filter = match arrays::choice("filter", &self.filter, &FILTERS)? {
            Kind::Paper => ElementFilter::Paper(joint),
            Kind::Independent => ElementFilter::Independent(self.independent()),
        };
        let Self { gate_probability, initial_speed, .. } = *self;
        Ok(CircleMapParameters { filter, gate_probability, initial_speed })
    }

    fn independent(&self) -> Independent {
        let own = Independent::default();
        let mode = |&(density, weight, duration): &_| MotionMode { density, weight, duration };
        Independent {
            modes: self.modes.iter().map(mode).collect(),
            standing: Standing {
                share: self.standing_share,
                duration: self.standing_time,
                moving: self.moving_time,
                density: self.standing_noise,
                start_speed: self.start_speed,
                ..own.standing
            },
            radius_density: self.radius_noise,
            turn_density: self.turn_noise,
            merge_gap: self.merge_gap,
            report_existence: self.report_existence,
            limits: Limits { position: self.max_position_std, ..own.limits },
            coast: self.max_coast,
            buffer_time: self.buffer_time,
            lines: LineRules { density: self.line_noise, std: self.line_std, ..own.lines },
            ..own
        }
    }
}

#[derive(Clone, Copy)]
enum Kind {
    Paper,
    Independent,
}

/// Names of the filters in configurations.
const FILTERS: [(&str, Kind); 2] = [("paper", Kind::Paper), ("independent", Kind::Independent)];

pub(crate) type Numbers<'py> = Bound<'py, PyArray1<i64>>;

/// Events of an update as arrays: true for a late scan; element ID of every circle; IDs of new,
/// confirmed and removed elements; ID pairs of merged elements.
pub(crate) type Events<'py> =
    (bool, Numbers<'py>, Numbers<'py>, Numbers<'py>, Numbers<'py>, Bound<'py, PyArray2<i64>>);

/// Elements of the map as arrays: ID, mean (M, 5), covariance (M, 5, 5), age [s], time of the last
/// measurement [ns], visible, confirmed, probability of a person, of existence, kind and
/// probabilities of kinds (M, 5).
pub(crate) type Elements<'py> = (
    Numbers<'py>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray1<f64>>,
    Numbers<'py>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    (Bound<'py, PyArray1<u8>>, Bound<'py, PyArray2<f64>>),
);

/// Other shapes of the map as arrays: ID, kind, mean (K, 7), covariance (K, 7, 7), both ends of a
/// line (K, 2, 2) or NaN, age [s], time of the last measurement [ns], visible, confirmed.
pub(crate) type MapShapes<'py> = (
    Numbers<'py>,
    Bound<'py, PyArray1<u8>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray1<f64>>,
    Numbers<'py>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<bool>>,
);

/// A scan as arrays from Python: ranges [m], bearings [rad], and the limits of the ranges [m].
type ViewArrays<'py> = (PyReadonlyArray1<'py, f64>, PyReadonlyArray1<'py, f64>, (f64, f64));

#[pyclass(frozen, name = "CircleMap", module = "lidar_core._core")]
pub(crate) struct PyCircleMap(Guarded<CircleMap>);

#[pymethods]
impl PyCircleMap {
    #[new]
    fn new(py: Python<'_>, config: CircleMapConfig) -> Result<Self, BorderError> {
        let map = detached(py, || CircleMap::new(config.parameters()?))?;
        Ok(Self(Guarded::new(map)))
    }

    #[staticmethod]
    fn from_state(
        py: Python<'_>,
        config: CircleMapConfig,
        state: &[u8],
    ) -> Result<Self, BorderError> {
        let map = detached(py, || CircleMap::from_state(config.parameters()?, state))?;
        Ok(Self(Guarded::new(map)))
    }

    fn to_state<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyBytes>, BorderError> {
        Ok(PyBytes::new(py, &self.0.with(py, |map| map.to_state())?))
    }

    #[pyo3(signature = (circles, covariance, world_from_lidar, stamp_ns, *, sensor, pose_covariance,
                        delays, view))]
    #[allow(clippy::too_many_arguments)] // one call per scan, as the public API has it
    fn update<'py>(
        &self,
        py: Python<'py>,
        circles: PyReadonlyArray2<'py, f64>,
        covariance: PyReadonlyArray3<'py, f64>,
        world_from_lidar: PyReadonlyArray2<'py, f64>,
        stamp_ns: i64,
        sensor: u32,
        pose_covariance: Option<PyReadonlyArray2<'py, f64>>,
        delays: Option<PyReadonlyArray1<'py, f64>>,
        view: Option<ViewArrays<'py>>,
    ) -> Result<Events<'py>, BorderError> {
        // Longer than other functions: one argument per array of the public call.
        let estimates = estimates(&circles, &covariance)?;
        let pose: [f64; 16] = square("world_from_lidar", &world_from_lidar)?;
        let doubt =
            pose_covariance.map(|rows| square::<36>("pose_covariance", &rows)).transpose()?;
        let doubt: Option<PoseCovariance> =
            doubt.map(|values| std::array::from_fn(|i| std::array::from_fn(|j| values[6 * i + j])));
        let delays = arrays::maybe_flat("delays", &delays)?;
        let scan = view.as_ref().map(polar_scan).transpose()?;
        let stats = self.0.with(py, |map| {
            map.update(&CircleScan {
                stamp_ns,
                sensor,
                world_from_lidar: &Transform::from_matrix(&pose),
                pose_covariance: doubt.as_ref(),
                estimates: &estimates,
                delays,
                outlines: &[],
                points: None,
                covered: None,
                lines: &[],
                view: scan.as_ref().map(|(scan, (range_min, range_max))| ScanWithLimits {
                    scan,
                    range_min: *range_min,
                    range_max: *range_max,
                }),
            })
        })?;
        event_arrays(py, stats)
    }

    fn map_at<'py>(&self, py: Python<'py>, stamp_ns: i64) -> Result<Elements<'py>, BorderError> {
        element_arrays(py, &self.0.with(py, |map| Ok(map.map_at(stamp_ns)))?)
    }

    fn reset(&self, py: Python<'_>) -> Result<(), BorderError> {
        self.0.with(py, |map| {
            map.reset();
            Ok(())
        })
    }
}

pub(crate) fn estimates(
    circles: &PyReadonlyArray2<'_, f64>,
    covariance: &PyReadonlyArray3<'_, f64>,
) -> Result<Vec<CircleEstimate>, BorderError> {
    let rows = arrays::rows3("circles", circles)?;
    if covariance.shape() != [rows.len(), 3, 3] {
        let got = covariance.shape().to_vec();
        return Err(BorderError::Shape { name: "covariance", expected: "(C, 3, 3)", got });
    }
    let covariances = arrays::flat("covariance", covariance)?.as_chunks::<3>().0.as_chunks::<3>().0;
    let both = rows.iter().zip(covariances);
    Ok(both
        .map(|(&[x, y, radius], &covariance)| CircleEstimate {
            circle: Circle { center: [x, y], radius },
            covariance,
            n_hits: 0,
            is_fallback: false,
        })
        .collect())
}

fn square<const N: usize>(
    name: &'static str,
    array: &PyReadonlyArray2<'_, f64>,
) -> Result<[f64; N], BorderError> {
    let values = arrays::flat(name, array)?;
    values.try_into().map_err(|_| BorderError::Shape {
        name,
        expected: "a square matrix",
        got: array.shape().to_vec(),
    })
}

fn polar_scan(
    (ranges, bearings, limits): &ViewArrays<'_>,
) -> Result<(PolarScan, (f64, f64)), BorderError> {
    let scan = PolarScan {
        ranges: arrays::flat("ranges", ranges)?.to_vec(),
        bearings: arrays::flat("bearings", bearings)?.to_vec(),
    };
    Ok((scan, *limits))
}

pub(crate) fn event_arrays(py: Python<'_>, stats: MapStats) -> Result<Events<'_>, BorderError> {
    let pairs = stats.merged.len();
    Ok((
        stats.late,
        stats.elements.into_pyarray(py),
        stats.born.into_pyarray(py),
        stats.confirmed.into_pyarray(py),
        stats.removed.into_pyarray(py),
        stats.merged.into_flattened().into_pyarray(py).reshape([pairs, 2])?,
    ))
}

pub(crate) fn element_arrays<'py>(
    py: Python<'py>,
    all: &[MapElement],
) -> Result<Elements<'py>, BorderError> {
    let count = all.len();
    let numbers = |value: fn(&MapElement) -> i64| all.iter().map(value).collect::<Vec<i64>>();
    let flags = |value: fn(&MapElement) -> bool| all.iter().map(value).collect::<Vec<bool>>();
    let kinds: Vec<u8> = all.iter().map(|element| u8::from(element.kind)).collect();
    let likely: Vec<f64> = all.iter().flat_map(|element| element.kinds).collect();
    let means: Vec<f64> = all.iter().flat_map(|element| element.state.mean.data.0[0]).collect();
    let covariances: Vec<f64> = all
        .iter()
        .flat_map(|element| element.state.covariance.data.0.into_iter().flatten()) // symmetric
        .collect();
    Ok((
        numbers(|element| element.id).into_pyarray(py),
        means.into_pyarray(py).reshape([count, 5])?,
        covariances.into_pyarray(py).reshape([count, 5, 5])?,
        all.iter().map(|element| element.age).collect::<Vec<f64>>().into_pyarray(py),
        numbers(|element| element.seen_ns).into_pyarray(py),
        flags(|element| element.visible).into_pyarray(py),
        flags(|element| element.confirmed).into_pyarray(py),
        all.iter().map(|element| element.person).collect::<Vec<f64>>().into_pyarray(py),
        all.iter().map(|element| element.existence).collect::<Vec<f64>>().into_pyarray(py),
        (kinds.into_pyarray(py), likely.into_pyarray(py).reshape([count, KINDS])?),
    ))
}

pub(crate) fn map_shape_arrays<'py>(
    py: Python<'py>,
    all: &[MapShape],
) -> Result<MapShapes<'py>, BorderError> {
    let count = all.len();
    let numbers = |value: fn(&MapShape) -> i64| all.iter().map(value).collect::<Vec<i64>>();
    let flags = |value: fn(&MapShape) -> bool| all.iter().map(value).collect::<Vec<bool>>();
    let kinds: Vec<u8> = all.iter().map(|shape| kind_number(shape.kind)).collect();
    let means: Vec<f64> = all.iter().flat_map(|shape| shape.state.mean.data.0[0]).collect();
    let covariances: Vec<f64> = all
        .iter()
        .flat_map(|shape| shape.state.covariance.data.0.into_iter().flatten()) // symmetric
        .collect();
    let none = [[f64::NAN; 2]; 2];
    let ends: Vec<f64> =
        all.iter().flat_map(|shape| shape.ends.unwrap_or(none).into_iter().flatten()).collect();
    Ok((
        numbers(|shape| shape.id).into_pyarray(py),
        kinds.into_pyarray(py),
        means.into_pyarray(py).reshape([count, 7])?,
        covariances.into_pyarray(py).reshape([count, 7, 7])?,
        ends.into_pyarray(py).reshape([count, 2, 2])?,
        all.iter().map(|shape| shape.age).collect::<Vec<f64>>().into_pyarray(py),
        numbers(|shape| shape.seen_ns).into_pyarray(py),
        flags(|shape| shape.visible).into_pyarray(py),
        flags(|shape| shape.confirmed).into_pyarray(py),
    ))
}
