"""The voxel map: occupancy of the environment with an exponential update."""

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core import _core
from lidar_core.arrays import Points, as_mask, as_points, as_real, as_rows, as_vector
from lidar_core.config import as_config
from lidar_core.errors import InputError
from lidar_core.files import naming
from lidar_core.flying.config import ClassifyConfig, VoxelMapConfig
from lidar_core.messages import PointClass
from lidar_core.util.full_state import FullState, is_full_state


@dataclass(frozen=True, slots=True)
class IntegrateStats:
    """Counts of the update of the map by one scan.

    Attributes
    ----------
    n_background, n_flying, n_unknown : int
        Points used, by class.
    n_skipped : int
        Entries without information: class 0, not finite, or no direction.
    n_rays, n_no_return_rays : int
        Number of rays; number of those without return.
    n_visits : int
        Voxels crossed by rays, each crossing counted.
    n_visits_skipped : int
        Number of these crossings that rays passed in one step; see `VoxelMapConfig.skip`.
    n_voxels : int
        Number of voxels with points or visited by rays, without those that were passed: with `skip`
        "none" all voxels along the rays.
    n_voxels_changed : int
        Voxels whose value is another one than before; the same number for every `skip`.
    n_voxels_forgotten : int
        Observed voxels that the map forgot, those farthest from the scan first, to stay within
        `VoxelMapConfig.max_voxels`.
    """

    n_background: int
    n_flying: int
    n_unknown: int
    n_skipped: int
    n_rays: int
    n_no_return_rays: int
    n_visits: int
    n_visits_skipped: int
    n_voxels: int
    n_voxels_changed: int
    n_voxels_forgotten: int


class VoxelMap(FullState):
    """Occupancy of voxels with an exponential filter, for a world without fixed bounds.

    Every voxel holds one value G(v); its state is free, uncertain, tentatively occupied or
    confidently occupied (Vrba et al., eqs 6-12). Memory grows with what was observed, up to
    `config.max_voxels`: then the map forgets what is farthest from the scan that needs room,
    except permanent voxels. Results do not depend on the order of points, rays or threads.

    Parameters
    ----------
    config : VoxelMapConfig
        Sizes, levels and thresholds.
    threads : int
        Threads used by `integrate`, >= 1.
    origin : array_like, shape (3,)
        World coordinates of the reference point of stored coordinates [m]. Choose it near the data
        if they are far from the world's origin, for example with UTM: float64 coordinates then stay
        exact.

    Raises
    ------
    ConfigError
        A parameter is outside its range.
    """

    _kind = "VoxelMap"
    _config_type = VoxelMapConfig

    def __init__(
        self,
        config: VoxelMapConfig | None = None,
        *,
        threads: int = 1,
        origin: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        self.config = as_config(config, VoxelMapConfig)
        self.origin = as_vector(origin, name="origin", size=3)
        self._threads = threads
        self._map = _core.VoxelMap(self.config, threads=threads, origin=self.origin)

    def _state(self) -> tuple[bytes, dict[str, Any]]:
        return self._map.to_state(), {}

    def _options(self) -> dict[str, Any]:
        return {"threads": self._threads}

    @classmethod
    def _from_state(
        cls, config: VoxelMapConfig, core: bytes, extra: dict[str, Any], **options: Any
    ) -> Self:
        threads = options.get("threads", 1)
        return cls._of(config, _core.VoxelMap.from_state(core, threads=threads), threads)

    @classmethod
    def _of(cls, config: VoxelMapConfig, known: "_core.VoxelMap", threads: int) -> Self:
        made = cls.__new__(cls)
        made.config, made._map, made._threads = config, known, threads
        made.origin = np.array(known.origin())
        return made

    def integrate(
        self,
        points_world: ArrayLike,
        point_class: ArrayLike,
        sensor_origin: ArrayLike,
        *,
        ray_directions: ArrayLike | None = None,
        no_return: ArrayLike | None = None,
    ) -> IntegrateStats:
        """Update the map with one classified scan.

        A voxel that holds points is pulled, once per point, towards the level of its strongest
        class: background, then flying (which sets it outright), then unknown. Any other voxel is
        pulled towards free by the summed length of the rays inside it.

        Parameters
        ----------
        points_world : array_like, shape (N, 3), float32
            Ends of the rays [m], world frame. Entries that are not finite are skipped.
        point_class : array_like, shape (N,), uint8
            A `PointClass` each: INVALID is skipped and casts no ray, MOVING
            counts as UNKNOWN.
        sensor_origin : array_like, shape (3,) or (N, 3), float64
            Position of the sensor [m], world frame.
        ray_directions : array_like, shape (N, 3), float32, optional
            Direction of every ray, world frame. Needed where `no_return` is set.
        no_return : array_like, shape (N,), bool, optional
            Rays that met nothing: they clear up to `config.max_range`.

        Returns
        -------
        IntegrateStats

        Raises
        ------
        InputError
            Wrong shape, dtype or class; the map is unchanged.
        LimitError
            The scan alone, with the permanent voxels, needs more than `config.max_voxels`; the
            map is unchanged.

        Notes
        -----
        Source: Vrba et al., eqs 8-12 and 16-22.
        """
        points = self._local(points_world)
        origins = as_real(sensor_origin, name="sensor_origin").astype(np.float64)
        if origins.shape not in {(3,), (len(points), 3)}:
            raise InputError(
                f"sensor_origin: expected shape (3,) or ({len(points)}, 3), got {origins.shape}"
            )
        if not np.isfinite(origins).all():
            raise InputError("sensor_origin: expected finite coordinates, got NaN or infinity")
        classes = _as_classes(point_class)
        points_of, rays, visits, voxels = self._map.integrate(
            points,
            as_rows(classes, name="point_class", rows=len(points), shape=(), dtype=np.uint8),
            np.ascontiguousarray(origins.reshape(-1, 3) - self.origin),
            ray_directions=(
                None if ray_directions is None else as_points(ray_directions, name="ray_directions")
            ),
            no_return=(
                None
                if no_return is None
                else as_mask(no_return, name="no_return", rows=len(points))
            ),
        )
        return IntegrateStats(*points_of, *rays, *visits, *voxels)

    def state_at(self, points_world: ArrayLike) -> NDArray[np.uint8]:
        """State of the voxel at every point, (N,) uint8.

        0 free, 1 uncertain (also: never observed), 2 tentatively occupied, 3 confidently
        occupied; in general the number of thresholds at or below G (eqs 6-7).
        """
        return self._map.state_at(self._local(points_world))

    def values_at(self, points_world: ArrayLike) -> NDArray[np.float32]:
        """Value G of the voxel at every point, (N,) float32, no unit; +-inf is permanent."""
        return self._map.values_at(self._local(points_world))

    def set_occupied(self, points_world: ArrayLike) -> None:
        """Make the voxels at these points occupied for good (sec. III-E)."""
        self._map.set_occupied(self._local(points_world))

    def set_free(self, points_world: ArrayLike) -> None:
        """Make the voxels at these points free for good (sec. III-E)."""
        self._map.set_free(self._local(points_world))

    def is_floating(self, points_world: ArrayLike, *, search_distance: float) -> bool:
        """True if a cluster of points is surrounded by free voxels (Algorithm 1).

        Parameters
        ----------
        points_world : array_like, shape (N, 3), float32
            Points of one cluster [m], world frame.
        search_distance : float
            A path of uncertain voxels this long (L1) from a point's voxel is a way out [m].
        """
        return self._map.is_floating(self._local(points_world), search_distance=search_distance)

    def remove_separate(self, *, max_gap: float, min_confident: int) -> int:
        """Pull groups of occupied voxels without enough confident ones once towards free.

        Parameters
        ----------
        max_gap : float
            Largest distance between the centres of neighbours in a group [m], d_sep.
        min_confident : int
            Groups with fewer confidently occupied voxels are separate, n_conf,min.

        Returns
        -------
        int
            Voxels changed.

        Notes
        -----
        Source: Vrba et al., sec. III-D. Only groups that changed since the last call are
        looked at; the result is that of looking at all.
        """
        return self._map.remove_separate(max_gap=max_gap, min_confident=min_confident)

    def classify(
        self,
        points_world: ArrayLike,
        labels: ArrayLike,
        sensor_origin: ArrayLike,
        *,
        config: ClassifyConfig | None = None,
    ) -> NDArray[np.uint8]:
        """Return the class of every cluster of a labelled cloud; the map does not change.

        Parameters
        ----------
        points_world : array_like, shape (N, 3), float32
            Points [m], world frame.
        labels : array_like, shape (N,), int32
            Number of each point's cluster as from `cluster_points`; -1 for none.
        sensor_origin : array_like, shape (3,), float64
            Position of the sensor [m].
        config : ClassifyConfig, optional
            Rules; best mode by default.

        Returns
        -------
        ndarray, shape (K,), uint8
            1 background, 2 flying, 3 unknown for the clusters 0..K-1.

        Notes
        -----
        Source: Vrba et al., sec. III-B.
        """
        points = self._local(points_world)
        numbers = as_rows(labels, name="labels", rows=len(points), shape=(), dtype=np.int32)
        origin = as_vector(sensor_origin, name="sensor_origin", size=3) - self.origin
        rules = as_config(config, ClassifyConfig)
        return self._map.classify(points, numbers, origin, config=rules)

    def occupied_points(self) -> NDArray[np.float64]:
        """Centres of all voxels that are at least tentatively occupied, (N, 3) [m], world frame."""
        return self._map.occupied_points() + self.origin

    @property
    def n_stored(self) -> int:
        """Number of voxels in memory."""
        return self._map.size()[0]

    @property
    def n_observed(self) -> int:
        """Number of voxels that a point or a ray has touched."""
        return self._map.size()[1]

    @property
    def memory_bytes(self) -> int:
        """Size of the stored voxels and their index [bytes]."""
        return self._map.size()[2]

    def save(self, path: str | PathLike[str], *, full: bool = False) -> None:
        """Write the map to a file atomically.

        Parameters
        ----------
        path : str or path-like
        full : bool
            True writes the whole state: the loaded map continues with bit-identical results.
            False writes a map file, which `FlyingObjectDetector.load_map` and other readers
            understand; the next `remove_separate` of the loaded map looks at all groups.

        Raises
        ------
        OSError
            The file cannot be written; a previous one is intact.
        """
        if full:
            super().save(Path(path))
            return
        with naming(path):
            self._map.save(path)

    @classmethod
    def load(  # type: ignore[override]  # a map has this option only
        cls, path: str | PathLike[str], *, threads: int = 1
    ) -> Self:
        """Read a map written by `save`, a map file or a whole state.

        Raises
        ------
        FormatError
            The file is no map, damaged, cut off, or of another version; names the byte.
        OSError
            The file cannot be read.
        """
        if is_full_state(path):
            return super().load(Path(path), threads=threads)
        with naming(path):
            loaded = _core.VoxelMap.load(path, threads=threads)
        return cls._of(VoxelMapConfig.load(loaded.parameters()), loaded, threads)

    def _local(self, points: ArrayLike) -> Points:
        """Return points relative to the map's origin, subtracted before float64 becomes float32."""
        if self.origin.any():
            points = as_real(points, name="points").astype(np.float64)
            if points.shape[-1:] == (3,):
                points = points - self.origin
        return as_points(points)


def _as_classes(point_class: ArrayLike) -> NDArray[Any]:
    """Return checked classes of points; the map takes MOVING as UNKNOWN."""
    classes = as_real(point_class, name="point_class")
    if not classes.size:  # an empty list has no integers
        return classes.astype(np.uint8)
    if classes.dtype.kind == "f" or classes.min() < 0 or classes.max() > max(PointClass):
        known = ", ".join(f"{one.value} {one.name.lower()}" for one in PointClass)
        raise InputError(f"point_class: expected integers {known}")
    if classes.max() == PointClass.MOVING:
        return np.asarray(np.minimum(classes, PointClass.UNKNOWN))
    return classes
