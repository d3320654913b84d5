//! Bindings of `lidar_sim`.

use crate::arrays::{self, Threads};
use crate::errors::BorderError;
use crate::guard::{Guarded, detached};
use crate::sim::config::{LidarConfig, MotionConfig, ParticlesConfig, SurfaceConfig};
use lidar_core::Error;
use lidar_core::geometry::transform::Transform;
use lidar_core::util::budget::check_memory;
use lidar_core::util::{cancel, threads};
use lidar_sim::air::Particles;
use lidar_sim::mesh::Mesh;
use lidar_sim::scene::{CastRay, Mover, Scene, SceneObject, Sway};
use lidar_sim::shape::Shape;
use lidar_sim::simulate::{self, OWN_LABEL, Task};
use lidar_sim::trajectory::Trajectory;
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use rayon::ThreadPool;
use rayon::prelude::*;
use std::sync::Arc;

/// Memory of a drawn trajectory with all its tries [bytes].
const ROOM_OF_MOTION: usize = 1 << 20;

type Array1<'py, T> = Bound<'py, PyArray1<T>>;
type Rows<'py, T> = Bound<'py, PyArray2<T>>;

#[pyclass(frozen, module = "lidar_core._core")]
pub(crate) struct SimShape(Shape);

#[pymethods]
impl SimShape {
    #[staticmethod]
    fn plane(size: [f64; 2]) -> Result<Self, BorderError> {
        Ok(Self(Shape::plane(size)?))
    }

    #[staticmethod]
    fn cuboid(size: [f64; 3]) -> Result<Self, BorderError> {
        Ok(Self(Shape::cuboid(size)?))
    }

    #[staticmethod]
    fn cylinder(radius: f64, height: f64) -> Result<Self, BorderError> {
        Ok(Self(Shape::cylinder(radius, height)?))
    }

    #[staticmethod]
    fn elliptic_cylinder(half_axes: [f64; 2], height: f64) -> Result<Self, BorderError> {
        Ok(Self(Shape::elliptic_cylinder(half_axes, height)?))
    }

    #[staticmethod]
    fn sphere(radius: f64) -> Result<Self, BorderError> {
        Ok(Self(Shape::sphere(radius)?))
    }

    #[staticmethod]
    fn mesh(
        py: Python<'_>,
        vertices: PyReadonlyArray2<'_, f64>,
        faces: PyReadonlyArray2<'_, u32>,
    ) -> Result<Self, BorderError> {
        let vertices = arrays::rows3("vertices", &vertices)?;
        let faces = arrays::rows3("faces", &faces)?;
        let mesh = detached(py, || Mesh::new(vertices.to_vec(), faces.to_vec()))?;
        Ok(Self(Shape::Mesh(Arc::new(mesh))))
    }

    #[staticmethod]
    fn height_field(
        py: Python<'_>,
        heights: PyReadonlyArray2<'_, f64>,
        cell: f64,
    ) -> Result<Self, BorderError> {
        let columns = heights.shape()[1];
        let heights = arrays::flat("heights", &heights)?;
        let mesh = detached(py, || Mesh::height_field(heights, columns, cell))?;
        Ok(Self(Shape::Mesh(Arc::new(mesh))))
    }

    #[getter]
    fn radius(&self) -> f64 {
        self.0.radius()
    }
}

#[pyclass(frozen, module = "lidar_core._core")]
pub(crate) struct SimTrajectory(Trajectory);

#[pymethods]
impl SimTrajectory {
    #[new]
    fn new(
        stamps_ns: PyReadonlyArray1<'_, i64>,
        poses: PyReadonlyArray3<'_, f64>,
    ) -> Result<Self, BorderError> {
        let stamps_ns = arrays::flat("stamps_ns", &stamps_ns)?.to_vec();
        Ok(Self(Trajectory::new(stamps_ns, transforms(&poses)?)?))
    }

    fn poses_at<'py>(
        &self,
        py: Python<'py>,
        stamps_ns: PyReadonlyArray1<'_, i64>,
    ) -> Result<Bound<'py, PyArray3<f64>>, BorderError> {
        let stamps_ns = arrays::flat("stamps_ns", &stamps_ns)?;
        check_memory("poses", stamps_ns.len(), 2 * size_of::<[f64; 16]>())?;
        let values: Vec<f64> =
            stamps_ns.iter().flat_map(|&stamp| matrix(&self.0.pose_at(stamp))).collect();
        Ok(values.into_pyarray(py).reshape([stamps_ns.len(), 4, 4])?)
    }

    fn velocities_at<'py>(
        &self,
        py: Python<'py>,
        stamps_ns: PyReadonlyArray1<'_, i64>,
    ) -> Result<Rows<'py, f64>, BorderError> {
        let stamps_ns = arrays::flat("stamps_ns", &stamps_ns)?;
        check_memory("velocities", stamps_ns.len(), size_of::<[f64; 3]>())?;
        let rows = stamps_ns.iter().map(|&stamp| self.0.velocity_at(stamp)).collect();
        arrays::rows_into(py, rows)
    }
}

/// A scan as arrays: points, directions, no return, label and time [ns] of every ray; unoccluded
/// rays of every object.
type ScanArrays<'py> = (
    Rows<'py, f32>,
    Rows<'py, f32>,
    Array1<'py, bool>,
    Array1<'py, i32>,
    Array1<'py, i64>,
    Array1<'py, u32>,
);

/// A 2D sweep as arrays: range [m] and label of every ray; unoccluded rays of every object.
type SweepArrays<'py> = (Array1<'py, f32>, Array1<'py, i32>, Array1<'py, u32>);

#[pyclass(frozen, module = "lidar_core._core")]
pub(crate) struct SimScene(Guarded<(Scene, ThreadPool)>);

#[pymethods]
impl SimScene {
    #[new]
    #[pyo3(signature = (bodies, movers, *, threads, sways=Vec::new(), air=Vec::new(),
        surfaces=Vec::new(), mover_surfaces=Vec::new(), carried=Vec::new()))]
    #[allow(clippy::too_many_arguments)] // of one constructor, by name
    #[allow(clippy::type_complexity)] // a row per body
    fn new(
        py: Python<'_>,
        bodies: Vec<(Py<SimShape>, PyReadonlyArray2<'_, f64>, i32)>,
        movers: Vec<(Py<SimShape>, Py<SimTrajectory>, i32)>,
        threads: Threads,
        sways: Vec<Option<([f64; 3], f64, f64)>>,
        air: Vec<ParticlesConfig>,
        surfaces: Vec<Option<SurfaceConfig>>,
        mover_surfaces: Vec<Option<SurfaceConfig>>,
        carried: Vec<(Py<SimShape>, PyReadonlyArray2<'_, f64>)>,
    ) -> Result<Self, BorderError> {
        let mut standing = Vec::with_capacity(bodies.len());
        let (mut sways, mut surfaces) = (sways.into_iter(), surfaces.into_iter());
        for (shape, pose, label) in &bodies {
            let mut body = body(shape, pose, *label)?;
            let sway = sways.next().flatten();
            body.sway = sway.map(|(reach, rate, phase)| Sway { reach, rate, phase });
            body.surface = surfaces.next().flatten().map(SurfaceConfig::surface);
            standing.push(body);
        }
        let mut surfaces = mover_surfaces.into_iter();
        let moving = movers.iter().map(|(shape, trajectory, label)| Mover {
            shape: shape.get().0.clone(),
            trajectory: trajectory.get().0.clone(),
            surface: surfaces.next().flatten().map(SurfaceConfig::surface),
            label: *label,
        });
        let moving = moving.collect();
        let carried = carried.iter().map(|(shape, pose)| body(shape, pose, OWN_LABEL));
        let carried = carried.collect::<Result<Vec<SceneObject>, BorderError>>()?;
        let air = air.into_iter().map(Particles::from).collect();
        let made = detached(py, || {
            let scene = Scene::new(standing, moving)?.with_air(air)?.with_carried(carried)?;
            Ok((scene, threads::pool(threads.0)?))
        })?;
        Ok(Self(Guarded::new(made)))
    }

    #[pyo3(signature = (lidar, sensor, *, start_ns, scan, seed))]
    fn scan<'py>(
        &self,
        py: Python<'py>,
        lidar: LidarConfig,
        sensor: &Bound<'py, SimTrajectory>,
        start_ns: i64,
        scan: u64,
        seed: u64,
    ) -> Result<ScanArrays<'py>, BorderError> {
        let (lidar, sensor) = (lidar.lidar()?, &sensor.get().0);
        let (made, points, directions) = self.0.with_stoppable(py, |(scene, pool)| {
            let task = Task { scene, lidar: &lidar, sensor, start_ns, scan, seed };
            let made = simulate::scan(pool, &task)?;
            let (points, directions) = pool.install(|| rows(&made));
            Ok((made, points, directions))
        })?;
        let no_return: Vec<bool> =
            made.ranges.iter().map(|&range| range == f64::INFINITY).collect();
        let offsets = &made.sweep.offsets_ns;
        let time_ns = made.sweep.firings.iter();
        let time_ns: Vec<i64> =
            time_ns.map(|&firing| start_ns.saturating_add(offsets[firing as usize])).collect();
        Ok((
            arrays::rows_into(py, points)?,
            arrays::rows_into(py, directions)?,
            no_return.into_pyarray(py),
            made.labels.into_pyarray(py),
            time_ns.into_pyarray(py),
            made.unoccluded.into_pyarray(py),
        ))
    }

    #[pyo3(signature = (lidar, sensor, *, start_ns, scan, seed))]
    fn sweep<'py>(
        &self,
        py: Python<'py>,
        lidar: LidarConfig,
        sensor: &Bound<'py, SimTrajectory>,
        start_ns: i64,
        scan: u64,
        seed: u64,
    ) -> Result<SweepArrays<'py>, BorderError> {
        let (lidar, sensor) = (lidar.lidar()?, &sensor.get().0);
        let made = self.0.with_stoppable(py, |(scene, pool)| {
            let task = Task { scene, lidar: &lidar, sensor, start_ns, scan, seed };
            simulate::scan(pool, &task)
        })?;
        let ranges = made.ranges.iter().map(|&range| range as f32);
        Ok((
            ranges.collect::<Vec<f32>>().into_pyarray(py),
            made.labels.into_pyarray(py),
            made.unoccluded.into_pyarray(py),
        ))
    }

    fn cast<'py>(
        &self,
        py: Python<'py>,
        origins: PyReadonlyArray2<'_, f64>,
        directions: PyReadonlyArray2<'_, f64>,
        range_max: f64,
    ) -> Result<(Array1<'py, f64>, Array1<'py, i32>), BorderError> {
        let origins = arrays::rows3("origins", &origins)?;
        let directions = arrays::rows3("directions", &directions)?;
        let (distances, labels): (Vec<f64>, Vec<i32>) =
            self.0.with_stoppable(py, |(scene, pool)| {
                check_memory("rays", origins.len(), 64)?;
                let watch = cancel::watch();
                let rays = origins.par_iter().zip(directions).with_min_len(1024);
                let meet = |(&origin, &direction): (&[f64; 3], &[f64; 3])| {
                    if watch.is_asked() {
                        return (f64::NAN, simulate::NO_LABEL);
                    }
                    scene
                        .meet(&CastRay { origin, direction }, range_max, 0.0)
                        .map_or((f64::INFINITY, simulate::NO_LABEL), |hit| {
                            (hit.distance, hit.label)
                        })
                };
                let found = pool.install(|| rays.map(meet).unzip());
                watch.check()?;
                Ok(found)
            })?;
        Ok((distances.into_pyarray(py), labels.into_pyarray(py)))
    }

    fn clearance<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'_, f64>,
        limit: f64,
    ) -> Result<Array1<'py, f64>, BorderError> {
        let points = arrays::rows3("points", &points)?;
        let distances = self.0.with_stoppable(py, |(scene, _)| {
            check_memory("clearances", points.len(), 3 * size_of::<f64>())?;
            let watch = cancel::watch();
            let clearance =
                |&point: &[f64; 3]| watch.check().map(|()| scene.clearance(point, limit));
            points.iter().map(clearance).collect::<Result<Vec<f64>, Error>>()
        })?;
        Ok(distances.into_pyarray(py))
    }

    #[pyo3(signature = (config, sensor, *, apart, span_ns, seed))]
    fn random_motion(
        &self,
        py: Python<'_>,
        config: MotionConfig,
        sensor: &Bound<'_, SimTrajectory>,
        apart: Vec<(Py<SimTrajectory>, f64)>,
        span_ns: (i64, i64),
        seed: (u64, u64),
    ) -> Result<SimTrajectory, BorderError> {
        check_memory("a random motion", 1, ROOM_OF_MOTION)?; // its allocations are small
        let apart = apart.iter().map(|(other, least)| (&other.get().0, *least)).collect();
        let motion = config.motion(&sensor.get().0, apart, span_ns, seed);
        Ok(SimTrajectory(self.0.with_stoppable(py, |(scene, _)| motion.trajectory(scene))?))
    }
}

/// Points (NaN where there is none) and directions in the LiDAR's frame.
fn rows(made: &simulate::SimulatedScan) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let rays = made.ranges.par_iter().zip(&made.sweep.directions).with_min_len(4096);
    rays.map(|(&range, direction)| {
        let range = if range.is_finite() { range } else { f64::NAN };
        (direction.map(|part| (range * part) as f32), direction.map(|part| part as f32))
    })
    .unzip()
}

fn body(
    shape: &Py<SimShape>,
    pose: &PyReadonlyArray2<'_, f64>,
    label: i32,
) -> Result<SceneObject, BorderError> {
    let values = arrays::flat("pose", pose)?;
    let world_from_shape = transform(values.as_chunks::<16>().0.first())?;
    Ok(SceneObject {
        shape: shape.get().0.clone(),
        world_from_shape,
        sway: None,
        surface: None,
        label,
    })
}

fn transforms(poses: &PyReadonlyArray3<'_, f64>) -> Result<Vec<Transform>, BorderError> {
    if poses.shape()[1..] != [4, 4] {
        let got = poses.shape().to_vec();
        return Err(BorderError::Shape { name: "poses", expected: "(K, 4, 4)", got });
    }
    let matrices = arrays::flat("poses", poses)?.as_chunks::<16>().0;
    Ok(matrices.iter().map(Transform::from_matrix).collect())
}

fn transform(matrix: Option<&[f64; 16]>) -> Result<Transform, Error> {
    matrix.map(Transform::from_matrix).ok_or(Error::Length { name: "pose", expected: 4, got: 0 })
}

fn matrix(pose: &Transform) -> [f64; 16] {
    let mut values = [0.0; 16];
    for (row, turn) in pose.rotation.iter().enumerate() {
        values[4 * row..4 * row + 3].copy_from_slice(turn);
        values[4 * row + 3] = pose.translation[row];
    }
    values[15] = 1.0;
    values
}
