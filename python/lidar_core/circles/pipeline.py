"""The circle pipeline: 2D scans in, a map of circles with identities out."""

from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from threading import Lock
from typing import TYPE_CHECKING, Any, Self, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core import _core
from lidar_core.arrays import as_finite_rows, as_mask, as_poses, as_rows, as_stamp
from lidar_core.circles.config import CirclesConfig
from lidar_core.circles.estimators.fit_config import FitMethod
from lidar_core.circles.estimators.fitting import Circles
from lidar_core.circles.estimators.network import CircleNetwork
from lidar_core.circles.mapping.map import MapEvents, elements_of
from lidar_core.circles.mapping.map_shapes import shape_elements_of
from lidar_core.circles.preprocess import times
from lidar_core.circles.results import CircleFrame, CirclesHealth
from lidar_core.circles.scan_layout import check_bearings
from lidar_core.circles.scanner import scanner_name
from lidar_core.circles.segmentation import Segments, segments_of
from lidar_core.circles.shapes import Shapes
from lidar_core.config import as_config
from lidar_core.errors import ConfigError, InputError, LimitError, NumericalError
from lidar_core.messages import LaserScan, PosedScan, posed_of, stated_stamp
from lidar_core.objects import CircleElements, ShapeElements
from lidar_core.sensors import LONGEST_2D, far_median
from lidar_core.util.full_state import FullState

if TYPE_CHECKING:
    from lidar_core.sim import SimulatedSweep

Estimator: TypeAlias = Callable[[NDArray[np.float64], NDArray[np.float64], Segments], Circles]
"""Ranges and bearings in the level frame and segments to one circle per segment."""


class CirclePipeline(FullState):
    """Maps round obstacles with one or several 2D LiDARs.

    Every scan is limited to the operating volume, projected into the horizontal plane and
    segmented. A circle and the shape are estimated per segment. Round and nearly round objects
    enter the map. Scans of several LiDARs, distinguished by name, enter one map.

    Parameters
    ----------
    config : CirclesConfig
        `CirclesConfig()` is best mode, `CirclesConfig.paper()` the paper.
    estimator : callable, optional
        Replaces `config.detector`: it gets ranges (B,), bearings (B,) and `Segments` in the level
        frame, and returns `Circles`, one per segment.
    allow_untrusted : bool
        Run a `config.detector` that is an ONNX file neither shipped nor exported by this user. A
        configuration file cannot set this.

    Raises
    ------
    ConfigError
        A parameter is outside its range, a model is not trusted, the network of `config.detector`
        was trained for another scanner, or `estimator` cannot be called.

    Notes
    -----
    Source: Sanchez-Lopez et al., 2019. Calls from several threads take turns; the GIL is released.

    Examples
    --------
    >>> from lidar_core.circles import CirclePipeline, CirclesConfig, Scanner
    >>> scanner = Scanner(-0.5, 0.005, 201, 0.1, 10.0)
    >>> miss = np.sin(scanner.bearings()) * 4.0  # a circle of 0.3 m at (4, 0)
    >>> root = np.sqrt(np.maximum(0.3**2 - miss**2, 0))
    >>> seen = np.where(abs(miss) < 0.3, np.cos(scanner.bearings()) * 4.0 - root, np.inf)
    >>> pipeline = CirclePipeline(CirclesConfig(scanner=scanner))
    >>> for k in range(5):
    ...     frame = pipeline.process(seen, np.eye(4), k * 50_000_000)
    >>> found = pipeline.map_at(200_000_000)
    >>> found.id.tolist(), abs(found.center.round(2)).tolist(), found.radius.round(2).tolist()
    ([0], [[4.0, 0.0]], [0.3])
    """

    _kind = "CirclePipeline"
    _config_type = CirclesConfig

    def __init__(
        self,
        config: CirclesConfig | None = None,
        *,
        estimator: Estimator | None = None,
        allow_untrusted: bool = False,
    ) -> None:
        self.config = as_config(config, CirclesConfig)
        if estimator is not None and not callable(estimator):
            raise ConfigError(
                "estimator: expected a function of ranges, bearings and segments, got"
                f" {type(estimator).__name__}"
            )
        fit, detector = self.config.fit, self.config.detector
        self._network: CircleNetwork | None = None
        if detector in get_args(FitMethod):
            fit = fit.load(fit.model_dump() | {"method": detector})
        elif estimator is None:
            self._network = CircleNetwork(detector, allow_untrusted=allow_untrusted)
            self._network.check_scanner(self.config.scanner, "scanner")
            for name, scanner in self.config.scanners.items():
                self._network.check_scanner(scanner, f"scanners.{name}")
        self._fit = fit
        self._pipeline = _core.CirclePipeline(self.config, fit=fit)
        self._estimator = estimator
        self._allow_untrusted = allow_untrusted
        self._health = CirclesHealth()
        self._counting = Lock()

    def _state(self) -> tuple[bytes, dict[str, Any]]:
        return self._pipeline.to_state(), {
            "health": asdict(self._health),
            "has_estimator": self._estimator is not None,
        }

    def _options(self) -> dict[str, Any]:
        return {"estimator": self._estimator, "allow_untrusted": self._allow_untrusted}

    @classmethod
    def _from_state(
        cls, config: CirclesConfig, core: bytes, extra: dict[str, Any], **options: Any
    ) -> Self:
        if extra["has_estimator"] and options.get("estimator") is None:
            raise ConfigError(
                "estimator: the saved pipeline had its own estimator; pass it again: load(path,"
                " estimator=...)"
            )
        made = cls(config, **options)
        made._pipeline = _core.CirclePipeline.from_state(config, core, fit=made._fit)
        made._health = CirclesHealth(**extra["health"])
        return made

    def process(
        self,
        ranges: "ArrayLike | PosedScan[LaserScan] | SimulatedSweep",
        world_from_lidar: ArrayLike | None = None,
        stamp_ns: int | None = None,
        *,
        ray_time_ns: ArrayLike | None = None,
        pose_stamps_ns: ArrayLike | None = None,
        pose_covariance: ArrayLike | None = None,
        scanner: str | None = None,
    ) -> CircleFrame:
        """Process one scan: a posed scan, or its arrays.

        Parameters
        ----------
        ranges : PosedScan, or array_like, shape (n_beams,), float32
            A scan of `lidar_core.io.posed_laser_scans` or of the simulator, with everything that
            is known about it; nothing but `scanner` may be given beside it. Its bearings have to be
            those of `config.scanner`; a scanner in `config.scanners` overrides what the scan
            states. Or range of every ray
            [m]; +inf is a miss, NaN no information. What is nearer than the scanner's `range_min`
            is no information, what is not nearer than `range_max` a miss. A driver that gives zero
            or NaN for a miss is recognised by its scans (see `CirclesHealth.no_return`); NaN on
            rays that never had a range stays no information.
        world_from_lidar : array_like, shape (4, 4) or (K, 4, 4), float64
            Pose of the scanner, tilt included, or a stream of poses with `pose_stamps_ns`: with
            `ray_time_ns` the motion during the sweep is taken out.
        stamp_ns : int
            Time of the scan [ns].
        ray_time_ns : array_like, shape (n_beams,), int64, optional
            Absolute time of every ray [ns].
        pose_stamps_ns : array_like, shape (K,), int64, optional
            Time of every pose [ns], increasing.
        pose_covariance : array_like, shape (6, 6), float64, optional
            Covariance of translation [m^2] and of the angles about x, y, z [rad^2].
        scanner : str, optional
            Name of the LiDAR, if there are several. Default: "lidar", or for a posed scan its topic
            or frame.

        Returns
        -------
        CircleFrame

        Raises
        ------
        InputError
            Wrong shape, dtype or value, bearings of a posed scan that are not those of
            `config.scanner`, a scan plane within 1.1 degrees of the vertical, or a stamp that was
            processed or comes later than `config.map.buffer_time`. The map is unchanged.
        LimitError
            Too many objects; the map is unchanged.
        NumericalError
            A covariance that cannot be used; the map is unchanged.

        With `on_bad_scan="count"` none of these is raised: the frame says in `rejected` what was
        wrong, and `health` counts it.
        """
        self._count("received")
        given: dict[str, Any] = {
            "ranges": ranges,
            "world_from_lidar": world_from_lidar,
            "stamp_ns": stamp_ns,
            "ray_time_ns": ray_time_ns,
            "pose_stamps_ns": pose_stamps_ns,
            "pose_covariance": pose_covariance,
            "scanner": scanner,
        }
        try:
            posed = posed_of(ranges, name="ranges")
            if posed is not None:
                given = _arrays_of(posed, given, self.config)
            frame = self._process(**given)
        except (InputError, LimitError, NumericalError) as error:
            reason = str(error)
            self._count("rejected", reason)
            if self.config.on_bad_scan == "raise":
                raise
            return self._rejected(
                stated_stamp(ranges, stamp_ns), given["scanner"] or "lidar", reason
            )
        except BaseException as error:
            self._count("rejected", type(error).__name__)
            raise
        self._count("processed")
        return frame

    def _note(self, values: dict[str, Any], rays: NDArray[np.float32]) -> None:
        """Update `health` with the properties of the scanner that a scan shows."""
        is_far = far_median(rays, LONGEST_2D) is not None
        with self._counting:
            self._health = replace(
                self._health,
                range_std_estimated=values["range_std"],
                pose_offset_s=values["pose_offset"],
                no_return=values["no_return"],
                stuck_poses=self._health.stuck_poses + int(values["stuck_pose"]),
                far_scans=self._health.far_scans + int(is_far),
            )

    def map_at(self, stamp_ns: int) -> CircleElements:
        """Return the confirmed elements, predicted to any time [ns]; the map does not change."""
        stamp = as_stamp(stamp_ns)
        return elements_of(self._pipeline.map_at(stamp), stamp)

    def shapes_at(self, stamp_ns: int) -> ShapeElements:
        """Return confirmed elements other than circles, predicted to any time [ns]."""
        stamp = as_stamp(stamp_ns)
        return shape_elements_of(self._pipeline.shapes_at(stamp), stamp)

    def reset(self) -> None:
        """Forget the map; IDs of elements are still not reused, health is kept."""
        self._pipeline.reset()

    def health(self) -> CirclesHealth:
        """Return counts of scans since the start, and estimated properties of the scanner."""
        return self._health

    def _process(
        self,
        ranges: ArrayLike,
        world_from_lidar: ArrayLike,
        stamp_ns: int,
        ray_time_ns: ArrayLike | None,
        pose_stamps_ns: ArrayLike | None,
        pose_covariance: ArrayLike | None,
        scanner: str | None,
    ) -> CircleFrame:
        scanner = "lidar" if scanner is None else scanner
        rays = as_rows(ranges, name="ranges", rows=None, shape=(), dtype=np.float32)
        if not isinstance(scanner, str):
            raise InputError(f"scanner: expected a name, got {type(scanner).__name__}")
        stamp = as_stamp(stamp_ns)
        doubt = None
        if pose_covariance is not None:
            doubt = as_finite_rows(pose_covariance, name="pose_covariance", rows=6, shape=(6,))
        given = times(len(rays), stamp, ray_time_ns, pose_stamps_ns)
        sweep = (rays, as_poses(world_from_lidar))
        options = {"pose_covariance": doubt, "scanner": scanner, **given}
        estimator = self._estimator or self._by_network(scanner)
        if estimator is None:
            values = self._pipeline.process(*sweep, **options)
        else:
            prepared = self._pipeline.prepare(*sweep, **options)
            segments = segments_of(prepared.segments())
            found = estimator(*prepared.scan()[:2], segments)
            values = self._pipeline.integrate(prepared, *_rows(found, len(segments)))
        self._note(values, rays)
        return _frame(stamp, scanner, values)

    def _by_network(self, scanner: str) -> Estimator | None:
        """Return the network of `config.detector` for one of the LiDARs; None if it is a fit."""
        if self._network is None:
            return None
        limits = self.config.scanners.get(scanner, self.config.scanner)
        return partial(self._network.of_segments, config=self.config.fit, scanner=limits)

    def _count(self, name: str, reason: str | None = None) -> None:
        with self._counting:
            self._health = self._health.one_more(name, reason)

    def _rejected(self, stamp: int, scanner: Any, reason: str) -> CircleFrame:
        rays, numbers = np.empty(0), np.empty(0, np.int64)
        nobody = Circles(np.empty((0, 3)), np.empty((0, 3, 3)), numbers)
        segments = Segments(
            labels=np.empty(0, np.int32),
            sides=np.empty((0, 2), np.uint8),
            rays=np.empty(0, np.uint32),
            starts=np.zeros(1, np.int64),
        )
        return CircleFrame(
            stamp_ns=stamp,
            scanner=str(scanner),
            ranges=rays,
            bearings=rays,
            heights=rays,
            segments=segments,
            circles=nobody,
            circles_world=nobody,
            time_ns=numbers,
            shapes=Shapes(
                np.empty(0, np.uint8), np.empty((0, 5)), np.empty((0, 5, 5)), rays, numbers
            ),
            element=numbers,
            too_near=np.empty(0, np.bool_),
            line=numbers,
            map=self.map_at(stamp),
            map_shapes=self.shapes_at(stamp),
            events=MapEvents(False, numbers, numbers, numbers, numbers, np.empty((0, 2), np.int64)),
            rejected=reason,
        )


def _arrays_of(
    posed: PosedScan[Any], given: dict[str, Any], config: CirclesConfig
) -> dict[str, Any]:
    """Convert a posed scan to the arguments of `process`."""
    beside = [name for name, value in given.items() if value is not None]
    if set(beside) - {"ranges", "scanner"}:
        raise InputError(
            f"{beside[1]}: a posed scan holds it already; only `scanner` may be given as well"
        )
    scan, stamps = posed.scan, posed.pose_stamps_ns
    if not isinstance(scan, LaserScan):
        raise InputError(f"scan: expected a LaserScan, got {type(scan).__name__}")
    rays = np.arange(np.size(scan.ranges), dtype=np.int64)
    name = given["scanner"] or scanner_name(posed.sensor, len(rays), config.scanners)
    # A scanner that is named in `scanners` overrides what its scans state.
    if not isinstance(name, str) or name not in config.scanners:
        check_bearings(scan, config.scanner)
    return {
        "ranges": scan.ranges,
        "world_from_lidar": posed.world_from_lidar,
        "stamp_ns": scan.stamp_ns,
        "ray_time_ns": None if stamps is None else scan.stamp_ns + scan.time_increment_ns * rays,
        "pose_stamps_ns": stamps,
        "pose_covariance": posed.pose_covariance,
        "scanner": name,
    }


def _frame(stamp_ns: int, scanner: str, values: dict[str, Any]) -> CircleFrame:
    ranges, bearings, heights = values["level"]
    return CircleFrame(
        stamp_ns=stamp_ns,
        scanner=scanner,
        ranges=ranges,
        bearings=bearings,
        heights=heights,
        segments=segments_of(values["segments"]),
        circles=Circles(*values["circles"]),
        circles_world=Circles(*values["circles_world"]),
        time_ns=values["time_ns"],
        shapes=Shapes(*values["shapes"]),
        element=values["element"],
        too_near=values["too_near"],
        line=values["line"],
        map=elements_of(values["map"], stamp_ns),
        map_shapes=shape_elements_of(values["map_shapes"], stamp_ns),
        events=MapEvents(*values["events"]),
        stuck_pose=values["stuck_pose"],
        timing_ms=values["timing_ms"],
    )


def _rows(
    circles: Circles, count: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.bool_]]:
    """Check the result of an estimator and return its arrays."""
    if not isinstance(circles, Circles):
        raise InputError(f"estimator: expected Circles, got {type(circles).__name__}")
    return (
        as_finite_rows(circles.parameters, name="circles", rows=count, shape=(3,)),
        as_finite_rows(circles.covariance, name="covariance", rows=count, shape=(3, 3)),
        as_rows(circles.n_hits, name="n_hits", rows=count, shape=(), dtype=np.int64),
        as_mask(circles.is_fallback, name="is_fallback", rows=count),
    )
