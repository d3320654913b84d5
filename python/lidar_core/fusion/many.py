"""Tracks of many targets, scan by scan."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lidar_core import _core
from lidar_core.arrays import as_stamp
from lidar_core.config import as_config
from lidar_core.errors import FormatError, InputError, LimitError
from lidar_core.fusion.many_config import MultiTargetConfig
from lidar_core.fusion.measurement import Measurement, as_measurements
from lidar_core.fusion.states import state_names, velocities
from lidar_core.messages import ShortRepr
from lidar_core.objects import TargetTracks
from lidar_core.util.full_state import FullState

MAX_SOURCES = 64
"""Scanners that one tracker tells apart."""


@dataclass(frozen=True, slots=True, repr=False)
class ScanResult(ShortRepr):
    """Assignment of the measurements of a scan, one row per measurement.

    Attributes
    ----------
    id : ndarray, shape (K,), int64
        ID of the track of every measurement, confirmed or not; -1 for none. With joint
        probabilities, the track whose probability is above one half.
    innovations : ndarray, shape (K, 3)
        Measured minus expected values of that track; NaN for values that were not compared, and for
        the start of a track.
    nis : ndarray, shape (K,)
        Normalised innovation squared; NaN where nothing was compared.
    """

    id: NDArray[np.int64]
    innovations: NDArray[np.float64]
    nis: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TrackerHealth:
    """Cost of the scans of a tracker.

    Attributes
    ----------
    n_scans : int
        Scans processed; a late one counts those after it again.
    n_predictions : int
        Predictions of a track to the time of a scan: one per track and scan.
    n_pairs : int
        Pairs of a track and a measurement that were compared: only near ones.
    """

    n_scans: int
    n_predictions: int
    n_pairs: int


class MultiTargetTracker(FullState):
    """Tracker of any number of targets that LiDAR and radar measure.

    By default, joint integrated probabilities assign measurements to tracks: every track has a
    probability of existence, which decides when it is reported and when it ends. With the other
    associations, measurements go first to confirmed tracks, and a track is confirmed by the number
    of its measurements. With measurements "pose" in a scan, tracks are in the world.

    Parameters
    ----------
    config : MultiTargetConfig, optional

    Raises
    ------
    ConfigError
        A parameter is outside its range.

    Examples
    --------
    >>> tracker = MultiTargetTracker()
    >>> for k in range(5):
    ...     scan = [Measurement(k * 100_000_000, "lidar", [x, 0.1 * k]) for x in (3.0, 8.0)]
    ...     result = tracker.process(k * 100_000_000, scan, source="lidar")
    >>> result.id.tolist(), tracker.tracks_at(400_000_000).id.tolist()
    ([0, 1], [0, 1])
    """

    _kind = "MultiTargetTracker"
    _config_type = MultiTargetConfig

    def __init__(self, config: MultiTargetConfig | None = None) -> None:
        self.config = as_config(config, MultiTargetConfig)
        self._tracker = _core.MultiTargetTracker(self.config)
        self._sources: dict[str, int] = {}

    def _state(self) -> tuple[bytes, dict[str, Any]]:
        return self._tracker.to_state(), {"sources": list(self._sources)}

    @classmethod
    def _from_state(
        cls, config: MultiTargetConfig, core: bytes, extra: dict[str, Any], **options: Any
    ) -> Self:
        made = cls(config, **options)
        made._tracker = _core.MultiTargetTracker.from_state(config, core)
        names = extra["sources"]
        if (
            not isinstance(names, list)
            or len(names) > MAX_SOURCES
            or len(set(map(str, names))) < len(names)
            or not all(isinstance(name, str) for name in names)
        ):
            raise FormatError(f"byte 12: sources: expected up to {MAX_SOURCES} different names")
        made._sources = {name: number for number, name in enumerate(names)}
        return made

    def process(
        self, stamp_ns: int, measurements: Iterable[Measurement], *, source: str
    ) -> ScanResult:
        """Process the measurements of one scanner at one time; an empty scan is information, too.

        Scans may come late: a scan that is at most `config.target.buffer_time` older than the
        newest is processed at its time, and the scans after it are processed again; tracks keep
        their IDs. A scan that was already processed changes nothing.

        Parameters
        ----------
        stamp_ns : int
            Time of the scan and its measurements [ns].
        measurements : iterable of Measurement
            Measurements of targets, one each, and of the platform's motion.
        source : str
            Name of the scanner. Only scans of scanners that have measured a track count against
            it while it waits for its confirmation.

        Returns
        -------
        ScanResult
            Assignment at the time of this scan; a late scan may change it afterwards.

        Raises
        ------
        InputError
            A scan older than `config.target.buffer_time` allows, a measurement whose time is not
            `stamp_ns`, or an argument of a wrong type.
        LimitError
            More than 2000 measurements, more than 2000 tracks with association nearest or joint,
            more than 64 scanners.
        """
        stamp = as_stamp(stamp_ns)
        if not isinstance(source, str):
            raise InputError(f"source: expected a name, got {type(source).__name__}")
        number = self._sources.get(source, len(self._sources))
        if number >= MAX_SOURCES:
            raise LimitError(
                f"source: expected at most {MAX_SOURCES} scanners, got one more: {source!r}"
            )
        result = self._tracker.process(stamp, number, as_measurements(measurements)._core)
        self._sources[source] = number
        return ScanResult(*result)

    def health(self) -> TrackerHealth:
        """Return the cost of the scans; it starts at zero for a tracker from a saved state."""
        return TrackerHealth(*self._tracker.work())

    def tracks_at(self, stamp_ns: int, *, confirmed: bool = True) -> TargetTracks:
        """Return the tracks, predicted to a time.

        Parameters
        ----------
        stamp_ns : int
            A time before the last measurement of a track gives its state at that measurement [ns].
        confirmed : bool
            Leave out tracks that are not yet reported.
        """
        stamp = as_stamp(stamp_ns)
        arrays = self._tracker.tracks_at(stamp)
        ids, states, covariances, born, seen, hits, is_sure, existence, kinds = arrays
        if not len(ids):
            width = len(state_names(self.config.target))
            states, covariances = np.empty((0, width)), np.empty((0, width, width))
        rows = is_sure if confirmed else np.ones(len(ids), np.bool_)
        return TargetTracks(
            stamp_ns=stamp,
            id=ids[rows],
            states=states[rows],
            covariances=covariances[rows],
            velocity=velocities(states[rows], self.config.target),
            born_ns=born[rows],
            seen_ns=seen[rows],
            hits=hits[rows],
            confirmed=is_sure[rows],
            existence=existence[rows],
            kind=kinds[0][rows],
            kind_probability=kinds[1][rows],
        )
