"""Filter of one target that processes one measurement at a time."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lidar_core import _core
from lidar_core.arrays import as_stamp
from lidar_core.config import as_config
from lidar_core.errors import InputError
from lidar_core.fusion.config import FusionConfig
from lidar_core.fusion.measurement import Measurement
from lidar_core.fusion.states import told_stds
from lidar_core.util.full_state import FullState


@dataclass(frozen=True, slots=True)
class FilterHealth:
    """Noise of the sensors, as configured and as estimated from the measurements.

    Attributes
    ----------
    lidar_std, lidar_std_estimated : ndarray, shape (2,), or (3,) in space
        Standard deviations of x, y (and z) [m].
    radar_std, radar_std_estimated : ndarray, shape (3,), or (4,) in space
        Standard deviations of range [m], bearing (and elevation) [rad] and range rate [m/s].
    """

    lidar_std: NDArray[np.float64]
    lidar_std_estimated: NDArray[np.float64]
    radar_std: NDArray[np.float64]
    radar_std_estimated: NDArray[np.float64]


class TargetFilter(FullState):
    """Position and motion of one target.

    The state is in the frame of the sensor if the sensor stands still or the model moves it
    (ctrv-drone). It is in the world after a measurement "pose", or "pose-3d" for a model in space.
    The model names the states and their order: x, y, z, vx, vy, vz of cv-3d; these and ax, ay, az
    of ca-3d; x, y, z, horizontal speed, heading, turn rate and vertical speed of ctrv-3d.

    Parameters
    ----------
    config : FusionConfig, optional

    Raises
    ------
    ConfigError
        A parameter is outside its range.

    Examples
    --------
    >>> flt = TargetFilter(FusionConfig(model="cv"))
    >>> for k in range(20):
    ...     step = flt.step(Measurement(k * 50_000_000, "lidar", [0.1 * k, 2.0]))
    >>> step.accepted, step.state.round(1).tolist()
    (True, [1.9, 2.0, 2.0, 0.0])
    """

    _kind = "TargetFilter"
    _config_type = FusionConfig

    def __init__(self, config: FusionConfig | None = None) -> None:
        self.config = as_config(config, FusionConfig)
        self._filter = _core.TargetFilter(self.config)

    def step(self, measurement: Measurement) -> _core.FusionStep:
        """Process one measurement.

        Parameters
        ----------
        measurement : Measurement

        Returns
        -------
        step : FusionStep
            `stamp_ns`: time of the state, or of the measurement before the target was seen [ns];
            `state` (n,) and `covariance` (n, n) after the step, None before the target was seen;
            `innovation` (k,) and `nis`, None if nothing was compared; `accepted`; and `outcome`:
            "updated", "started", "restarted" (the filter had lost the target), "told" (motion of
            the platform), "gated", "invalid", "late" (older than `config.buffer_time` allows),
            "duplicate", "singular" (a covariance could not be factorised). After the last four the
            filter is unchanged; after "gated" it is only predicted. A late measurement within the
            buffer is processed at its own time: `innovation` then belongs to that time, the state
            to the newest.

            "invalid" means that the filter cannot use the values: one is not finite, a range is 0
            or less, no value says anything about the state (an elevation alone in the plane, or a
            target straight overhead), or there is no state yet and the measurement has no position
            to start from (a range or a bearing alone; in space, one without a height). The next
            measurements are processed as if it had not come.

        Raises
        ------
        InputError
            The argument is not a `Measurement`.
        """
        if not isinstance(measurement, Measurement):
            raise InputError(
                f"measurement: expected a Measurement, got {type(measurement).__name__}"
            )
        return self._filter.step(measurement._core)

    def _state(self) -> tuple[bytes, dict[str, Any]]:
        return self._filter.to_state(), {}

    @classmethod
    def _from_state(
        cls, config: FusionConfig, core: bytes, extra: dict[str, Any], **options: Any
    ) -> Self:
        made = cls(config, **options)
        made._filter = _core.TargetFilter.from_state(config, core)
        return made

    def health(self) -> FilterHealth:
        """Return the noise of the sensors as configured and as estimated.

        A value without evidence, because all measurements have a covariance, is the configured one.
        """
        lidar, radar = self._filter.sensor_stds()
        configured = told_stds(self.config)
        return FilterHealth(configured[0], lidar, configured[1], radar)

    def state_at(self, stamp_ns: int) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Return mean (n,) and covariance (n, n), predicted to a time; the filter does not change.

        None before the target has been seen; a time before the last measurement gives the state
        at that measurement.
        """
        return self._filter.state_at(as_stamp(stamp_ns))
