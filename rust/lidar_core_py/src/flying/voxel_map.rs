//! Bindings of `lidar_core::flying::map::voxel_map`.

use crate::arrays::{self, Rows3, Threads};
use crate::errors::BorderError;
use crate::flying::config::{ClassifyConfig, MapConfig, map_values};
use crate::guard::{Guarded, detached};
use lidar_core::Error;
use lidar_core::flying::classify::classifier::classify_clusters;
use lidar_core::flying::integrate::classified_scan::{ClassifiedScan, IntegrateStats, Origins};
use lidar_core::flying::integrate::integrator::Integrator;
use lidar_core::flying::map::parameters::Separation;
use lidar_core::flying::map::voxel_map::VoxelMap;
use lidar_core::flying::point_class::{classes_from_numbers, numbers_from_classes};
use lidar_core::util::budget::check_memory;
use lidar_core::util::threads::Workers;
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::path::PathBuf;

/// Statistics of an integration: number of points per class; entries skipped, rays, rays without
/// return; visits, and of these those that were skipped; voxels, of these those that changed, and
/// voxels forgotten.
type Stats = ([usize; 3], [usize; 3], [u64; 2], [usize; 3]);

#[pyclass(frozen, name = "VoxelMap", module = "lidar_core._core")]
pub(crate) struct PyVoxelMap(Guarded<MapWithThreads>);

/// A map, and the stage that updates it.
struct MapWithThreads {
    map: VoxelMap,
    integrator: Integrator,
    workers: Workers,
}

impl MapWithThreads {
    fn new(map: VoxelMap, threads: Threads) -> Result<Self, Error> {
        let workers = Workers::new(threads.0)?;
        Ok(Self { map, integrator: Integrator::on(workers.clone()), workers })
    }
}

#[pymethods]
impl PyVoxelMap {
    #[new]
    #[pyo3(signature = (config, *, threads, origin))]
    fn new(
        py: Python<'_>,
        config: MapConfig,
        threads: Threads,
        origin: [f64; 3],
    ) -> Result<Self, BorderError> {
        let map = detached(py, || {
            MapWithThreads::new(VoxelMap::new(config.parameters(origin)?)?, threads)
        })?;
        Ok(Self(Guarded::new(map)))
    }

    #[pyo3(signature = (points, point_class, sensor_origin, *, ray_directions, no_return))]
    fn integrate(
        &self,
        py: Python<'_>,
        points: PyReadonlyArray2<'_, f32>,
        point_class: PyReadonlyArray1<'_, u8>,
        sensor_origin: PyReadonlyArray2<'_, f64>,
        ray_directions: Option<PyReadonlyArray2<'_, f32>>,
        no_return: Option<PyReadonlyArray1<'_, bool>>,
    ) -> Result<Stats, BorderError> {
        let origins = arrays::rows3("sensor_origin", &sensor_origin)?;
        let numbers = arrays::flat("point_class", &point_class)?;
        let scan = ClassifiedScan {
            points: arrays::rows3("points", &points)?,
            class: &[],
            origins: if let [origin] = origins {
                Origins::One(*origin)
            } else {
                Origins::Each(origins)
            },
            directions: arrays::maybe_rows3("ray_directions", &ray_directions)?,
            no_return: arrays::maybe_flat("no_return", &no_return)?,
            no_ray: None,
            reach: None,
            pose_error: None,
        };
        let stats: IntegrateStats = self.0.with_stoppable(py, |this| {
            let classes = classes_from_numbers(numbers)?;
            this.integrator.integrate(&mut this.map, &ClassifiedScan { class: &classes, ..scan })
        })?;
        Ok((
            stats.points,
            [stats.skipped, stats.rays, stats.no_return_rays],
            [stats.visits, stats.visits_skipped],
            [stats.voxels, stats.voxels_changed, stats.voxels_forgotten],
        ))
    }

    fn state_at<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'_, f32>,
    ) -> Result<Bound<'py, PyArray1<u8>>, BorderError> {
        let points = arrays::rows3("points", &points)?;
        let states = self.with_map(py, |map| {
            check_memory("states", points.len(), 1)?;
            Ok(map.states_at(points))
        })?;
        Ok(states.into_pyarray(py))
    }

    fn values_at<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'_, f32>,
    ) -> Result<Bound<'py, PyArray1<f32>>, BorderError> {
        let points = arrays::rows3("points", &points)?;
        let values = self.with_map(py, |map| {
            check_memory("values", points.len(), size_of::<f32>())?;
            Ok(map.values_at(points))
        })?;
        Ok(values.into_pyarray(py))
    }

    fn set_occupied(
        &self,
        py: Python<'_>,
        points: PyReadonlyArray2<'_, f32>,
    ) -> Result<(), BorderError> {
        let points = arrays::rows3("points", &points)?;
        self.with_map(py, |map| map.set_occupied(points))
    }

    fn set_free(
        &self,
        py: Python<'_>,
        points: PyReadonlyArray2<'_, f32>,
    ) -> Result<(), BorderError> {
        let points = arrays::rows3("points", &points)?;
        self.with_map(py, |map| map.set_free(points))
    }

    #[pyo3(signature = (points, *, search_distance))]
    fn is_floating(
        &self,
        py: Python<'_>,
        points: PyReadonlyArray2<'_, f32>,
        search_distance: f64,
    ) -> Result<bool, BorderError> {
        let points = arrays::rows3("points", &points)?;
        self.with_map(py, |map| map.is_floating(points, search_distance))
    }

    #[pyo3(signature = (*, max_gap, min_confident))]
    fn remove_separate(
        &self,
        py: Python<'_>,
        max_gap: f64,
        min_confident: i64,
    ) -> Result<usize, BorderError> {
        let min_confident = arrays::count("min_confident", min_confident)?;
        self.with_map(py, |map| {
            map.remove_separate(Separation { max_gap, min_confident, dilate: false })
        })
    }

    #[pyo3(signature = (points, labels, sensor_origin, *, config))]
    fn classify<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'_, f32>,
        labels: PyReadonlyArray1<'_, i32>,
        sensor_origin: [f64; 3],
        config: ClassifyConfig,
    ) -> Result<Bound<'py, PyArray1<u8>>, BorderError> {
        let points = arrays::rows3("points", &points)?;
        let labels = arrays::flat("labels", &labels)?;
        let parameters = config.parameters();
        let classes = self.0.with_stoppable(py, |MapWithThreads { map, workers, .. }| {
            classify_clusters(map, points, labels, sensor_origin, &parameters, workers)
        })?;
        Ok(numbers_from_classes(classes).into_pyarray(py))
    }

    /// Centres of all voxels that are at least tentatively occupied, (N, 3) [m].
    fn occupied_points<'py>(&self, py: Python<'py>) -> Result<Rows3<'py, f64>, BorderError> {
        let centers = self.with_map(py, |map| Ok(centers(map)))?;
        arrays::rows_into(py, centers)
    }

    fn save(&self, py: Python<'_>, path: PathBuf) -> Result<(), BorderError> {
        self.with_map(py, |map| map.save(&path))
    }

    #[staticmethod]
    #[pyo3(signature = (path, *, threads))]
    fn load(py: Python<'_>, path: PathBuf, threads: Threads) -> Result<Self, BorderError> {
        Ok(Self(Guarded::new(detached(py, || {
            MapWithThreads::new(VoxelMap::load(&path)?, threads)
        })?)))
    }

    #[staticmethod]
    #[pyo3(signature = (state, *, threads))]
    fn from_state(py: Python<'_>, state: &[u8], threads: Threads) -> Result<Self, BorderError> {
        Ok(Self(Guarded::new(detached(py, || {
            MapWithThreads::new(VoxelMap::from_state(state)?, threads)
        })?)))
    }

    /// The whole state, with the history of changes.
    fn to_state<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyBytes>, BorderError> {
        Ok(PyBytes::new(py, &self.with_map(py, |map| map.to_state())?))
    }

    /// The map as bytes; equal maps give equal bytes.
    fn to_bytes(&self, py: Python<'_>) -> Result<Vec<u8>, BorderError> {
        self.with_map(py, |map| {
            check_memory("the bytes of a map", map.memory_bytes(), 2)?;
            Ok(map.to_bytes())
        })
    }

    /// World coordinates of the point that the map's coordinates are relative to.
    fn origin(&self, py: Python<'_>) -> Result<[f64; 3], BorderError> {
        self.with_map(py, |map| Ok(map.parameters().origin))
    }

    /// Values of the configuration with which the map was made, by name.
    fn parameters<'py>(
        &self,
        py: Python<'py>,
    ) -> Result<Bound<'py, pyo3::types::PyDict>, BorderError> {
        let parameters = self.with_map(py, |map| Ok(map.parameters().clone()))?;
        Ok(map_values(py, parameters)?)
    }

    /// Numbers of voxels stored and observed, and bytes held by the map.
    fn size(&self, py: Python<'_>) -> Result<(usize, usize, usize), BorderError> {
        self.with_map(py, |map| {
            Ok((map.stored_voxels(), map.observed_voxels(), map.memory_bytes()))
        })
    }
}

impl PyVoxelMap {
    fn with_map<R: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut VoxelMap) -> Result<R, Error> + Send,
    ) -> Result<R, BorderError> {
        self.0.with(py, |this| work(&mut this.map))
    }
}

fn centers(map: &VoxelMap) -> Vec<[f64; 3]> {
    map.occupied_voxels().into_iter().map(|voxel| map.lattice().center(voxel)).collect()
}
