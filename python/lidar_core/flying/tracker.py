"""The multi-target tracker alone: point clouds and detections in, tracks out."""

from base64 import b64decode, b64encode
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core import _core
from lidar_core.arrays import Points, as_points, as_real, as_rows, as_stamp, as_vector
from lidar_core.config import as_config
from lidar_core.errors import FormatError
from lidar_core.flying.results import TrackEvents
from lidar_core.flying.tracker_config import TrackerConfig
from lidar_core.objects import Tracks
from lidar_core.util.full_state import FullState


class PointCloudTracker(FullState):
    """Tracks of flying objects, fed by point clouds and by detections that may come late.

    Every cloud moves all tracks to its time and corrects them with the clusters near them. Every
    detection starts a hypothesis that is brought to the present over the buffered clouds and
    joins a track or becomes one. Coordinates may lie far from the world's origin: inside, they
    are relative to the first point that came.

    Parameters
    ----------
    config : TrackerConfig
        `TrackerConfig()` is best mode, `TrackerConfig.paper()` Algorithm 2 with Table II.
    threads : int
        Threads used, >= 1; results do not depend on it.

    Raises
    ------
    ConfigError
        A parameter is outside its range.

    Notes
    -----
    Source: Vrba et al., sec. III-F and Algorithm 2.

    Examples
    --------
    >>> import numpy as np
    >>> tracker = PointCloudTracker(TrackerConfig())
    >>> for k in range(20):
    ...     target = np.array([[0.3 * k, 0.0, 5.0]])
    ...     _ = tracker.new_point_cloud(target, np.empty((0, 3)), k * 100_000_000)
    ...     _ = tracker.new_detections(target, k * 100_000_000)
    >>> tracks = tracker.tracks_at(2_000_000_000)
    >>> tracks.id.tolist(), tracks.position.round(1).tolist(), tracks.velocity.round().tolist()
    ([0], [[6.0, 0.0, 5.0]], [[3.0, 0.0, 0.0]])
    """

    _kind = "PointCloudTracker"
    _config_type = TrackerConfig

    def __init__(self, config: TrackerConfig | None = None, *, threads: int = 1) -> None:
        self.config = as_config(config, TrackerConfig)
        self._threads = threads
        self._tracker = _core.PointCloudTracker(self.config, threads=threads)
        self._origin: NDArray[np.float64] | None = None
        self._occupied = np.empty((0, 3), np.float32)

    def _state(self) -> tuple[bytes, dict[str, Any]]:
        occupied = np.ascontiguousarray(self._occupied, np.float32).tobytes()
        origin = None if self._origin is None else self._origin.tolist()
        extra = {"origin": origin, "occupied": b64encode(occupied).decode()}
        return self._tracker.to_state(), extra

    def _options(self) -> dict[str, Any]:
        return {"threads": self._threads}

    @classmethod
    def _from_state(
        cls, config: TrackerConfig, core: bytes, extra: dict[str, Any], **options: Any
    ) -> Self:
        made = cls(config, **options)
        made._tracker = _core.PointCloudTracker.from_state(config, core, threads=made._threads)
        try:
            occupied = np.frombuffer(b64decode(extra["occupied"], validate=True), np.float32)
            made._occupied = occupied.reshape(-1, 3)
            if extra["origin"] is not None:
                made._origin = as_vector(extra["origin"], name="origin", size=3)
        except ValueError as error:
            raise FormatError(f"byte 12: the state breaks its format: {error}") from error
        return made

    def new_point_cloud(
        self,
        points_world: ArrayLike,
        occupied_world: ArrayLike,
        stamp_ns: int,
        *,
        sensor_origin: ArrayLike | None = None,
        point_time_ns: ArrayLike | None = None,
    ) -> TrackEvents:
        """Move every track to the cloud's time and correct it with its cluster.

        A cloud older than the newest one is kept for detections that come even later.

        Parameters
        ----------
        points_world : array_like, shape (N, 3) or (H, W, 3)
            The whole scan [m], world frame; entries that are not finite are no information.
        occupied_world : array_like, shape (V, 3)
            Centres of voxels that are at least tentatively occupied [m], world frame. They
            serve the detections of this time, too.
        stamp_ns : int
            Time of the scan [ns].
        sensor_origin : array_like, shape (3,), optional
            Position of the sensor [m], world frame. A track behind nearer points then waits, up to
            `config.max_coast`, instead of growing towards removal.
        point_time_ns : array_like, shape (N,), int64, optional
            Absolute time of every point [ns]: a cluster then counts at the mean time of its
            points (config.measurement "cluster").

        Returns
        -------
        TrackEvents

        Raises
        ------
        InputError
            Wrong shape or dtype; a stamp that was processed, or older than the whole buffer.
            The tracker is unchanged.

        Notes
        -----
        Source: Vrba et al., Algorithm 2, lines 8-18.
        """
        stamp = as_stamp(stamp_ns)
        origin = self._origin if self._origin is not None else first_finite(points_world)
        points = local(points_world, origin, name="points_world")
        occupied = local(occupied_world, origin, name="occupied_world")
        sensor = None
        if sensor_origin is not None:
            sensor = as_vector(sensor_origin, name="sensor_origin", size=3)
            sensor = sensor if origin is None else sensor - origin
        delays = _delays(point_time_ns, "point_time_ns", len(points), stamp)
        events = self._tracker.new_point_cloud(
            points,
            occupied,
            stamp,
            sensor_origin=sensor,
            delays=None if delays is None else delays.astype(np.float32),
        )
        self._origin = origin
        self._occupied = occupied
        return TrackEvents(*events)

    def new_detections(
        self,
        positions: ArrayLike,
        stamp_ns: int,
        *,
        covariance: ArrayLike | None = None,
        extent: ArrayLike | None = None,
        time_ns: ArrayLike | None = None,
    ) -> TrackEvents:
        """Process a set of detections, which may be older than the clouds.

        Hand over empty sets as well: confirmation counts sets.

        Parameters
        ----------
        positions : array_like, shape (M, 3)
            Positions [m], world frame, finite.
        stamp_ns : int
            Time the detections describe [ns].
        covariance : array_like, shape (M, 3, 3), optional
            Covariances of the positions [m^2]; without them `config.initial_std` applies.
        extent : array_like, shape (M, 3), optional
            Sides of their bounding boxes [m].
        time_ns : array_like, shape (M,), int64, optional
            Time of measurement of each position [ns], within 10 s of `stamp_ns`, the default.

        Returns
        -------
        TrackEvents

        Raises
        ------
        InputError
            Wrong shape or dtype, an entry that is not finite, or a matrix that is no
            covariance. The tracker is unchanged.

        Notes
        -----
        Source: Vrba et al., Algorithm 2, lines 19-32.
        """
        stamp = as_stamp(stamp_ns)
        rows = as_rows(positions, name="positions", rows=None, shape=(3,), dtype=np.float64)
        origin = self._origin if self._origin is not None else first_finite(rows)
        events = self._tracker.new_detections(
            rows if origin is None else rows - origin,
            self._occupied,
            stamp,
            covariance=_optional(covariance, "covariance", len(rows), (3, 3)),
            extent=_optional(extent, "extent", len(rows), (3,)),
            delay=_delays(time_ns, "time_ns", len(rows), stamp),
        )
        self._origin = origin
        return TrackEvents(*events)

    def tracks_at(self, stamp_ns: int, *, confirmed: bool = True) -> Tracks:
        """Return the tracks, predicted to any time; nothing changes.

        Parameters
        ----------
        stamp_ns : int
            Time of the states [ns].
        confirmed : bool
            Leave out tracks that are not reported.
        """
        stamp = as_stamp(stamp_ns)
        arrays = self._tracker.tracks_at(stamp)
        return tracks_from(arrays, stamp, self._origin, confirmed=confirmed)

    def reset(self) -> None:
        """Forget all tracks and clouds; IDs are still not reused."""
        self._tracker.reset()
        self._origin = None
        self._occupied = np.empty((0, 3), np.float32)


def tracks_from(
    arrays: tuple[Any, ...],
    stamp_ns: int,
    origin: NDArray[np.float64] | None,
    *,
    confirmed: bool = True,
) -> Tracks:
    """Convert tracks of the core to the world's origin; `confirmed`: only reported ones."""
    number, mean, covariance, extent, n_detections, age, reported, existence, kinds = arrays
    if not confirmed:
        reported = np.ones_like(reported)
    mean = mean[reported]
    position = mean[:, 0:3] if origin is None else mean[:, 0:3] + origin
    return Tracks(
        id=number[reported],
        position=position,
        velocity=mean[:, 3:6],
        acceleration=mean[:, 6:9],
        covariance=covariance[reported],
        extent=extent[reported],
        n_detections=n_detections[reported],
        age=age[reported],
        existence=existence[reported],
        kind=kinds[0][reported],
        kind_probability=kinds[1][reported],
        stamp_ns=stamp_ns,
    )


def first_finite(points: ArrayLike) -> NDArray[np.float64] | None:
    """Return the first finite point, rounded to whole metres; None without one."""
    array = as_real(points, name="points")
    if array.ndim not in (2, 3) or array.shape[-1] != 3:
        return None
    rows = array.reshape(-1, 3)
    finite = np.isfinite(rows).all(axis=1)
    return np.round(rows[np.argmax(finite)].astype(np.float64)) if finite.any() else None


def local(points: ArrayLike, origin: NDArray[np.float64] | None, *, name: str) -> Points:
    """Return points relative to `origin`, subtracted before float64 becomes float32."""
    array = as_real(points, name=name)
    if origin is not None and array.shape[-1:] == (3,):
        array = array.astype(np.float64) - origin
    return as_points(array, name=name)


def _delays(
    time_ns: ArrayLike | None, name: str, rows: int, stamp_ns: int
) -> NDArray[np.float64] | None:
    """Convert absolute times [ns] to times after the stamp [s]; None without times."""
    if time_ns is None:
        return None
    times = as_real(time_ns, name=name).reshape(-1)
    return (as_rows(times, name=name, rows=rows, shape=(), dtype=np.int64) - stamp_ns) * 1e-9


def _optional(
    values: ArrayLike | None, name: str, rows: int, shape: tuple[int, ...]
) -> NDArray[np.float64] | None:
    if values is None:
        return None
    return as_rows(values, name=name, rows=rows, shape=shape, dtype=np.float64)
