"""The semantic map: circles of scans in, elements with identities and velocities out."""

from dataclasses import dataclass
from operator import index
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core import _core
from lidar_core.arrays import as_finite_rows, as_pose, as_rows, as_stamp
from lidar_core.circles.mapping.map_config import CircleMapConfig
from lidar_core.config import as_config
from lidar_core.errors import InputError
from lidar_core.objects import CircleElements
from lidar_core.util.full_state import FullState

_MOST_SENSORS = 2**32


@dataclass(frozen=True, slots=True)
class MapEvents:
    """IDs of the elements that one scan changed, including unconfirmed ones.

    Attributes
    ----------
    is_late : bool
        The scan was older than the newest one.
    elements : ndarray, shape (C,), int64
        Element of every circle of the scan; it may have been merged or removed since.
    born, confirmed, removed : ndarray, shape (K,), int64
        IDs of the elements that this scan created, that are reported from this scan on, and that
        this scan removed.
    merged : ndarray, shape (K, 2), int64
        Pairs of the element that stays and the one that was merged into it; when late scans are
        processed again, only new pairs.
    """

    is_late: bool
    elements: NDArray[np.int64]
    born: NDArray[np.int64]
    confirmed: NDArray[np.int64]
    removed: NDArray[np.int64]
    merged: NDArray[np.int64]


class CircleMap(FullState):
    """Map of circles, fed by the circles of scans; calls may come from several threads.

    Parameters
    ----------
    config : CircleMapConfig
        `CircleMapConfig()` is best mode, `CircleMapConfig.paper()` the filter as published.

    Raises
    ------
    ConfigError
        A parameter is outside its range.

    Notes
    -----
    Source: Sanchez-Lopez et al., sec. V. Modes of motion: Blom & Bar-Shalom, "The interacting
    multiple model algorithm for systems with Markovian switching coefficients", 1988.

    Examples
    --------
    >>> circles = CircleMap()
    >>> for k in range(40):
    ...     x = 3.0 + 0.05 * k
    ...     _ = circles.update([[x, 0.0, 0.3]], [1e-4 * np.eye(3)], np.eye(4), k * 50_000_000)
    >>> elements = circles.map_at(2_000_000_000)
    >>> elements.id.tolist(), elements.center.round(1).tolist(), elements.velocity.round(1).tolist()
    ([0], [[5.0, 0.0]], [[1.0, 0.0]])
    """

    _kind = "CircleMap"
    _config_type = CircleMapConfig

    def __init__(self, config: CircleMapConfig | None = None) -> None:
        self.config = as_config(config, CircleMapConfig)
        self._map = _core.CircleMap(self.config)

    def _state(self) -> tuple[bytes, dict[str, Any]]:
        return self._map.to_state(), {}

    @classmethod
    def _from_state(
        cls, config: CircleMapConfig, core: bytes, extra: dict[str, Any], **options: Any
    ) -> Self:
        made = cls(config, **options)
        made._map = _core.CircleMap.from_state(config, core)
        return made

    def update(
        self,
        circles: ArrayLike,
        covariance: ArrayLike,
        world_from_lidar: ArrayLike,
        stamp_ns: int,
        *,
        pose_covariance: ArrayLike | None = None,
        delays: ArrayLike | None = None,
        scan: tuple[ArrayLike, ArrayLike] | None = None,
        range_limits: tuple[float, float] = (0.0, np.inf),
        sensor: int = 0,
    ) -> MapEvents:
        """Process the circles of one scan. Call it also for a scan without circles.

        Parameters
        ----------
        circles : array_like, shape (C, 3)
            Centre x, y and radius [m] in the level frame: origin at the sensor, z up, x where the
            sensor's x axis points, seen from above. Shape (0, 3) for a scan without circles.
        covariance : array_like, shape (C, 3, 3)
            Covariance of x, y and radius of each circle [m^2], symmetric and positive definite.
        world_from_lidar : array_like, shape (4, 4)
            Pose of the sensor, tilt included.
        stamp_ns : int
            Time of the scan [ns].
        pose_covariance : array_like, shape (6, 6), optional
            Covariance of the pose: translation [m], then the angles alpha, beta, gamma of Rz(gamma)
            Ry(beta) Rx(alpha) [rad].
        delays : array_like, shape (C,), optional
            Time of measurement of each circle after `stamp_ns`, -10 to 10 [s]; `filter` "paper"
            ignores it.
        scan : (ranges, bearings), each of shape (B,), optional
            Ranges [m] and bearings [rad] of the scan in the level frame; +inf for misses, NaN for
            no information. The map finds with it which elements are hidden or out of view, and
            keeps these. Without it every element counts as visible, and one without a circle as
            missed.
        range_limits : (float, float)
            Nearest and farthest range that is measured [m].
        sensor : int
            Number of the sensor, if there are several; their scans may have the same stamp.

        Returns
        -------
        MapEvents

        Raises
        ------
        InputError
            Wrong shape or dtype, a circle, covariance or pose that cannot be used, a stamp that
            was processed or comes later than `config.buffer_time`. The map is unchanged.
        """
        rows = as_finite_rows(circles, name="circles", rows=None, shape=(3,))
        covariances = as_finite_rows(covariance, name="covariance", rows=len(rows), shape=(3, 3))
        doubt = None
        if pose_covariance is not None:
            doubt = as_finite_rows(pose_covariance, name="pose_covariance", rows=6, shape=(6,))
        events = self._map.update(
            rows,
            covariances,
            as_pose(world_from_lidar),
            as_stamp(stamp_ns),
            sensor=_sensor(sensor),
            pose_covariance=doubt,
            delays=(
                None
                if delays is None
                else as_finite_rows(delays, name="delays", rows=len(rows), shape=())
            ),
            view=None if scan is None else _view(scan, range_limits),
        )
        return MapEvents(*events)

    def map_at(self, stamp_ns: int) -> CircleElements:
        """Return the confirmed elements, predicted to any time [ns]; the map does not change."""
        stamp = as_stamp(stamp_ns)
        return elements_of(self._map.map_at(stamp), stamp)

    def reset(self) -> None:
        """Forget all elements; IDs are still not reused."""
        self._map.reset()


def elements_of(arrays: tuple[Any, ...], stamp_ns: int) -> CircleElements:
    """Return the confirmed elements of the core's result."""
    number, mean, covariance, age, seen_ns, visible, confirmed, *more = arrays
    person, existence, kinds = more
    mean = mean[confirmed]
    return CircleElements(
        id=number[confirmed],
        center=mean[:, 0:2],
        velocity=mean[:, 2:4],
        radius=mean[:, 4],
        covariance=covariance[confirmed],
        age=age[confirmed],
        seen_ns=seen_ns[confirmed],
        visible=visible[confirmed],
        person_probability=person[confirmed],
        existence=existence[confirmed],
        kind=kinds[0][confirmed],
        kind_probability=kinds[1][confirmed],
        stamp_ns=stamp_ns,
    )


def _view(
    scan: tuple[ArrayLike, ArrayLike], limits: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[float, float]]:
    if not isinstance(scan, tuple | list) or len(scan) != 2:
        raise InputError("scan: expected (ranges, bearings)")
    ranges = as_rows(scan[0], name="ranges", rows=None, shape=(), dtype=np.float64)
    if (ranges < 0).any():
        raise InputError(f"ranges: expected no values < 0 [m], got {ranges[ranges < 0][0]}")
    bearings = as_finite_rows(scan[1], name="bearings", rows=len(ranges), shape=())
    try:
        near, far = (float(limit) for limit in limits)
    except (TypeError, ValueError) as error:
        raise InputError(f"range_limits: expected two numbers [m], got {limits!r}") from error
    if not 0 <= near < far:
        raise InputError(f"range_limits: expected 0 <= nearest < farthest [m], got ({near}, {far})")
    return ranges, bearings, (near, far)


def _sensor(sensor: int) -> int:
    try:
        number = index(sensor)
    except TypeError as error:
        raise InputError(f"sensor: expected an integer, got {type(sensor).__name__}") from error
    if not 0 <= number < _MOST_SENSORS:
        raise InputError(f"sensor: expected 0 to {_MOST_SENSORS - 1}, got {number}")
    return number
