"""The flying-object detector: scans in, point classes, detections and tracks out.

Longer than other files: it is one class, and most of it describes inputs and outputs of its
methods.
"""

from dataclasses import asdict, replace
from os import PathLike
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core import _core
from lidar_core.arrays import Points, as_mask, as_points, as_poses, as_real, as_rows, as_stamp
from lidar_core.config import as_config
from lidar_core.errors import ConfigError, InputError
from lidar_core.files import naming
from lidar_core.flying.analysis import as_pose_covariance
from lidar_core.flying.config import FlyingConfig
from lidar_core.flying.results import FlyingFrame, FlyingStatus, Health
from lidar_core.flying.tracker import tracks_from
from lidar_core.messages import PosedScan, Scan, posed_of, stated_stamp
from lidar_core.objects import FlyingDetections, Tracks
from lidar_core.sensors import LONGEST_3D, far_median
from lidar_core.util.full_state import FullState

if TYPE_CHECKING:
    from lidar_core.sim import SimulatedScan


_OPTIONAL = ("no_return", "directions", "point_time_ns", "pose_stamps_ns", "pose_covariance")


class FlyingObjectDetector(FullState):
    """Finds and tracks flying objects in scans of one or several 3D LiDARs.

    Every scan is clustered, each cluster is classified with the map before this scan, the map is
    updated, and clusters surrounded by free space feed the tracker.

    Parameters
    ----------
    config : FlyingConfig
        `FlyingConfig()` is best mode, `FlyingConfig.paper()` the paper with Table II.
    threads : int
        Threads used, >= 1. Results do not depend on it.

    Raises
    ------
    ConfigError
        A parameter is outside its range.

    Notes
    -----
    Source: Vrba, Walter & Saska, "On Onboard LiDAR-based Flying Object Detection", sec. III.
    World coordinates may be far from the origin: inside, coordinates are relative to the first
    pose. Calls from several threads take turns; the GIL is released.
    """

    _kind = "FlyingObjectDetector"
    _config_type = FlyingConfig

    def __init__(self, config: FlyingConfig | None = None, *, threads: int = 1) -> None:
        self.config = as_config(config, FlyingConfig)
        self._threads = threads
        self._detector = _core.FlyingObjectDetector(self.config, threads=threads)
        self._health = Health()
        self._counting = Lock()

    def _state(self) -> tuple[bytes, dict[str, Any]]:
        return self._detector.to_state(), {"health": asdict(self._health)}

    def _options(self) -> dict[str, Any]:
        return {"threads": self._threads}

    @classmethod
    def _from_state(
        cls, config: FlyingConfig, core: bytes, extra: dict[str, Any], **options: Any
    ) -> Self:
        made = cls(config, **options)
        made._detector = _core.FlyingObjectDetector.from_state(config, core, threads=made._threads)
        made._health = Health(**extra["health"])
        return made

    def process(
        self,
        points_lidar: "ArrayLike | PosedScan[Scan] | SimulatedScan",
        world_from_lidar: ArrayLike | None = None,
        stamp_ns: int | None = None,
        *,
        no_return: ArrayLike | None = None,
        directions: ArrayLike | None = None,
        point_time_ns: ArrayLike | None = None,
        pose_stamps_ns: ArrayLike | None = None,
        pose_covariance: ArrayLike | None = None,
        sensor: str | None = None,
    ) -> FlyingFrame:
        """Process one scan: a posed scan, or its arrays.

        Parameters
        ----------
        points_lidar : PosedScan, or array_like, shape (N, 3) or (H, W, 3), float32
            A scan of `lidar_core.io.posed_scans` or of the simulator, with everything that is
            known about it; nothing but `sensor` may be given beside it. Or coordinates [m], lidar
            frame; NaN is no information.
        world_from_lidar : array_like, shape (4, 4) or (K, 4, 4), float64
            Pose of the scan, or a stream of poses with `pose_stamps_ns`: with `point_time_ns`
            every point is then placed by the pose at its own time (deskew).
        stamp_ns : int
            Start of the scan [ns]; must increase per sensor.
        no_return : array_like, shape (N,), bool, optional
            True for rays without return within range. Their directions come from `directions`, or
            from earlier scans of an organised cloud.
        directions : array_like, shape (N, 3), float32, optional
            Unit direction of every ray, lidar frame.
        point_time_ns : array_like, shape (N,), int64, optional
            Absolute time of every point [ns]. Without it, times are estimated where the cloud of
            a moving spinning sensor shows them (`FlyingStatus.point_times`). Times that are all
            equal to the stamp keep the points as they are.
        pose_stamps_ns : array_like, shape (K,), int64, optional
            Time of every pose [ns], increasing.
        pose_covariance : array_like, shape (6, 6), float64, optional
            Covariance of translation [m^2] and of the angles about x, y, z [rad^2] (eq. 38).
        sensor : str, optional
            Name of the LiDAR, if there are several. Default: "lidar", or for a posed scan its topic
            or frame.

        Returns
        -------
        FlyingFrame

        Raises
        ------
        InputError
            Wrong shape, dtype or value, or a stamp that is not newer than the last one of this
            sensor. The detector is unchanged. With `on_bad_scan="count"` no error is raised:
            `rejected` of the frame states the reason.
        LimitError
            The scan alone needs more voxels than the budget of the map allows, or it comes from a
            65th sensor; the detector is unchanged.
        """
        given: dict[str, Any] = {
            "points_lidar": points_lidar,
            "world_from_lidar": world_from_lidar,
            "stamp_ns": stamp_ns,
            "no_return": no_return,
            "directions": directions,
            "point_time_ns": point_time_ns,
            "pose_stamps_ns": pose_stamps_ns,
            "pose_covariance": pose_covariance,
            "sensor": sensor,
        }
        try:
            posed = (
                points_lidar
                if isinstance(points_lidar, PosedScan)
                else posed_of(points_lidar, name="points_lidar")
            )
            stamp, values = self._process(**(given if posed is None else _arrays_of(posed, given)))
        except InputError as error:
            self._count("rejected")
            if self.config.on_bad_scan == "raise":
                raise
            return self._rejected(stated_stamp(points_lidar, stamp_ns), str(error))
        except BaseException:
            self._count("rejected")
            raise
        frame = _frame(stamp, values)
        status = frame.status
        self._count(
            "held" if status.map_pose_mismatch else "processed",
            sky=status.sky,
            sky_share=status.sky_share,
            own_body=status.own_body,
            point_times=status.point_times,
            n_forgotten=values["voxels_forgotten"],
            points=values["points"],
        )
        return frame

    def tracks_at(self, stamp_ns: int, *, confirmed: bool = True) -> Tracks:
        """Return tracks predicted to `stamp_ns` [ns], to compensate latency; nothing changes.

        Parameters
        ----------
        stamp_ns : int
            Time of the states [ns].
        confirmed : bool
            Leave out tracks that are not reported.
        """
        stamp_ns = as_stamp(stamp_ns, name="stamp_ns")
        arrays = self._detector.tracks_at(stamp_ns, confirmed)
        return tracks_from(arrays, stamp_ns, None, confirmed=confirmed)

    def set_teammates(
        self, ids: ArrayLike, positions_world: ArrayLike, *, radius: float = 1.0
    ) -> None:
        """Set known flying objects: from now on they are in `frame.teammates` and not reported.

        Parameters
        ----------
        ids : array_like, shape (K,), int64
            Numbers of the teammates.
        positions_world : array_like, shape (K, 3), float64
            Reported positions of the teammates [m]; call again when they have moved.
        radius : float
            Detections this near are taken for them [m].
        """
        given = ids if np.size(ids) else np.empty(0, np.int64)  # an empty list has no integers
        names = as_rows(given, name="ids", rows=None, shape=(), dtype=np.int64)
        rows = len(names)
        positions = as_rows(
            positions_world, name="positions_world", rows=rows, shape=(3,), dtype=np.float64
        )
        if not np.isfinite(positions).all():
            raise InputError("positions_world: expected finite coordinates, got NaN or infinity")
        reach = as_real(radius, name="radius")
        if reach.ndim or not 0 <= reach < np.inf:
            raise InputError(f"radius: expected a distance >= 0 [m], got {radius!r}")
        self._detector.set_teammates(names, positions, radius=float(reach))

    def set_occupied(self, points_world: ArrayLike) -> None:
        """Make the voxels at these points (N, 3) [m] occupied for good: an a-priori map."""
        self._detector.set_known(_world(points_world), occupied=True)

    def set_free(self, points_world: ArrayLike) -> None:
        """Make the voxels at these points (N, 3) [m] free for good."""
        self._detector.set_known(_world(points_world), occupied=False)

    def state_at(self, points_world: ArrayLike) -> NDArray[np.uint8]:
        """Map state at points (N, 3) [m]: 0 free, 1 uncertain, 2 tentative, 3 occupied."""
        return self._detector.state_at(_world(points_world))

    def occupied_points(self) -> NDArray[np.float64]:
        """Centres of all voxels that are at least tentatively occupied, (N, 3) [m], world frame."""
        return self._detector.occupied_points()

    @property
    def map_memory_bytes(self) -> int:
        """Size of the map in memory [bytes]."""
        return self._detector.map_size()[2]

    @property
    def n_observed(self) -> int:
        """Number of voxels of the map that a point or a ray has touched."""
        return self._detector.map_size()[1]

    def save_map(self, path: str | PathLike[str]) -> None:
        """Write the map to a file that `load_map` and `VoxelMap.load` read.

        The file also contains what the sensors saw of the robot itself, by name of the sensor:
        first of sensors used, then of sensors of a loaded map, 64 in all.
        """
        with naming(path):
            self._detector.save_map(path)

    def load_map(self, path: str | PathLike[str]) -> None:
        """Continue with a map of an earlier run; tracks are dropped.

        A sensor that has not yet detected the robot itself takes it from the file, from its next
        scan on. It drops this within five scans if the returns do not agree: the sensor is mounted
        elsewhere.

        Raises
        ------
        FormatError
            The file is no map, or damaged.
        LimitError
            It is too large.
        ConfigError
            The size of the voxels differs.
        """
        with naming(path):
            self._detector.load_map(path)

    def make_static_map(self) -> None:
        """Keep a map of all static points, without moving objects, from the next scan on.

        Points of moving objects lie at places, up to 45 m away, that rays of earlier or later scans
        have passed. Every scan needs some 0.25 MB for this, up to 256 MB; after that only every
        second scan is kept. The map is computed when it is requested.
        """
        self._detector.make_static_map()

    def static_points(self) -> NDArray[np.float64]:
        """Return static points, (N, 3) [m], world frame.

        Of points within 3 cm of each other, one is kept. Empty without `make_static_map`.
        """
        return self._detector.static_points()

    def save_static_map(self, path: str | PathLike[str]) -> None:
        """Write the static voxels of 0.1 m to a file that `VoxelMap.load` reads.

        Raises
        ------
        ConfigError
            The name does not end in .lcvm, or no scan was processed since `make_static_map`.
        """
        if Path(path).suffix.lower() != ".lcvm":
            raise ConfigError(
                f"path: expected a file that ends in .lcvm, got {path}; write_cloud of"
                " `lidar_core.io` writes static_points() as .pcd or .ply"
            )
        with naming(path):
            self._detector.save_static_map(path)

    def reanchor(self) -> bool:
        """Continue after a jump of the pose (relocalisation, GNSS step).

        The world is shifted so that the last held scan lies at the pose of the scan before it: map
        and tracks keep their place around the robot. False if no scan is held.
        """
        return self._detector.reanchor()

    def reset(self) -> None:
        """Forget map, tracks and poses; track IDs continue, health is kept.

        Learnt properties of the sensors stay until other sensors need their places: 64 are kept.
        """
        self._detector.reset()

    def health(self) -> Health:
        """Return the counts of scans since the start: received = processed + held + rejected."""
        return self._health

    def _process(
        self,
        points_lidar: ArrayLike,
        world_from_lidar: ArrayLike,
        stamp_ns: int,
        no_return: ArrayLike | None,
        directions: ArrayLike | None,
        point_time_ns: ArrayLike | None,
        pose_stamps_ns: ArrayLike | None,
        pose_covariance: ArrayLike | None,
        sensor: str | None,
    ) -> tuple[int, dict[str, Any]]:
        """Check and process a scan; return its stamp and the result of the core."""
        stamp = as_stamp(stamp_ns, name="stamp_ns")
        points = as_points(points_lidar, name="points_lidar")
        poses = as_poses(world_from_lidar, name="world_from_lidar")
        rows, options = len(points), dict[str, Any]()
        if no_return is not None:
            options["no_return"] = as_mask(no_return, name="no_return", rows=rows)
        if directions is not None:
            options["directions"] = as_points(directions, name="directions")
            if len(options["directions"]) != rows:
                shape = options["directions"].shape
                raise InputError(f"directions: expected shape ({rows}, 3), got {shape}")
        if point_time_ns is not None:
            times = as_real(point_time_ns, name="point_time_ns").reshape(-1)
            options["point_time_ns"] = as_rows(
                times, name="point_time_ns", rows=rows, shape=(), dtype=np.int64
            )
        if pose_stamps_ns is not None:
            options["pose_stamps_ns"] = as_rows(
                pose_stamps_ns, name="pose_stamps_ns", rows=None, shape=(), dtype=np.int64
            )
        if pose_covariance is not None:
            options["pose_covariance"] = as_pose_covariance(pose_covariance)
        name = _sensor_name(sensor)
        is_organised = np.ndim(points_lidar) == 3
        options = dict.fromkeys(_OPTIONAL) | options
        values = self._detector.process(
            points, poses, stamp, **options, sensor=name, organised=is_organised
        )
        return stamp, values | {"points": points}

    def _count(
        self, field: str, *, n_forgotten: int = 0, points: Points | None = None, **seen: Any
    ) -> None:
        """Count one more scan as `field` in `health`; `seen` are further values of `health`."""
        fields = ["received", field]
        if points is not None and far_median(points, LONGEST_3D) is not None:
            fields.append("far_scans")
        if points is not None and not _has_a_point(points):
            fields.append("empty_scans")
        with self._counting:
            counts = {name: getattr(self._health, name) + 1 for name in fields}
            counts["n_voxels_forgotten"] = self._health.n_voxels_forgotten + n_forgotten
            self._health = replace(self._health, **counts, **seen)

    def _rejected(self, stamp: int, reason: str) -> FlyingFrame:
        nobody = _detections(_NO_DETECTIONS, stamp)
        return FlyingFrame(
            stamp_ns=stamp,
            point_class=np.empty(0, np.uint8),
            detections=nobody,
            tracks=self.tracks_at(stamp),
            teammate_id=np.empty(0, np.int64),
            teammates=nobody,
            status=FlyingStatus(gate_open=False, reason=f"scan rejected: {reason}"),
            timing_ms={},
            rejected=reason,
        )


_NO_DETECTIONS = (
    np.empty((0, 3)),
    np.empty((0, 3, 3)),
    np.empty(0),
    np.empty((0, 3)),
    np.empty(0, np.int64),
    np.empty(0),
    np.empty(0),
)


def _frame(stamp_ns: int, values: dict[str, Any]) -> FlyingFrame:
    return FlyingFrame(
        stamp_ns=stamp_ns,
        point_class=values["point_class"],
        detections=_detections(values["detections"], stamp_ns),
        tracks=tracks_from(values["tracks"], stamp_ns, None),
        teammate_id=values["teammate_ids"],
        teammates=_detections(values["teammates"], stamp_ns),
        status=FlyingStatus(
            gate_open=values["gate_open"],
            reason=values["gate_reason"],
            map_pose_mismatch=values["map_pose_mismatch"],
            sky=values["sky"],
            sky_share=values["sky_share"],
            n_sky_rays=values["sky_rays"],
            point_times=values["point_times"],
            own_body=values["own_body"],
            own_body_is_decided=values["own_body_is_decided"],
        ),
        timing_ms=values["timing_ms"],
        n_rays=values["rays"],
        n_visits=values["visits"],
        own_rows=values["own_rows"],
    )


def _detections(arrays: tuple[NDArray[Any], ...], stamp_ns: int) -> FlyingDetections:
    position, covariance, radius, extent, n_points, confidence, delay = arrays
    time_ns = stamp_ns + np.round(delay * 1e9).astype(np.int64)
    return FlyingDetections(position, covariance, radius, extent, n_points, confidence, time_ns)


def _has_a_point(points: Points) -> bool:
    """Return whether any row is finite; a sample suffices unless the cloud is nearly empty."""
    sample = points[:: max(1, len(points) // 1000)]
    return any(bool(np.isfinite(rows).all(axis=1).any()) for rows in (sample, points))


def _world(points: ArrayLike) -> NDArray[np.float64]:
    rows = as_rows(points, name="points_world", rows=None, shape=(3,), dtype=np.float64)
    if not np.isfinite(rows).all():
        raise InputError("points_world: expected finite coordinates, got NaN or infinity")
    return rows


def _sensor_name(sensor: str | None) -> str:
    name = "lidar" if sensor is None else sensor
    if not isinstance(name, str):
        raise InputError(f"sensor: expected a name, got {type(name).__name__}")
    if not name.isprintable():  # halves of characters, too, which no file and no log can hold
        raise InputError(f"sensor: expected a name that can be printed, got {name!a}")
    return name


def _arrays_of(posed: PosedScan[Any], given: dict[str, Any]) -> dict[str, Any]:
    """Convert a posed scan to the arguments of `process`."""
    beside = [name for name, value in given.items() if value is not None]
    if set(beside) - {"points_lidar", "sensor"}:
        raise InputError(
            f"{beside[1]}: a posed scan holds it already; only `sensor` may be given as well"
        )
    scan = posed.scan
    if not isinstance(scan, Scan):
        raise InputError(f"scan: expected a Scan, got {type(scan).__name__}")
    return {
        "points_lidar": scan.points,
        "world_from_lidar": posed.world_from_lidar,
        "stamp_ns": scan.stamp_ns,
        "no_return": scan.no_return,
        "directions": scan.directions,
        "point_time_ns": scan.point_time_ns,
        "pose_stamps_ns": posed.pose_stamps_ns,
        "pose_covariance": posed.pose_covariance,
        "sensor": given["sensor"] or scan.topic or scan.frame_id,
    }
