"""Upper bound for trackers on a recording of boats, from association by the truth."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from lidar_core.evaluation import assign
from lidar_core.fusion import DetectionScan, Measurement, MultiTargetConfig, TargetFilter
from lidar_core.fusion.coverage import seen_times
from lidar_core.fusion.measurement import measured_place


def known_share(
    scans: Sequence[DetectionScan],
    config: MultiTargetConfig,
    *,
    needed: int,
    reach: float,
    gap: float,
) -> float | None:
    """Return the share of time in which the worst target is tracked if association is perfect.

    The truth then assigns every return to its target. Only scans with a return of each target
    show that there are several. So until there were `needed` such scans, only one track is
    reported. It takes the return that is nearest to it. The share counts as in
    `target_coverage`; None without targets.
    """
    numbers = sorted({number for scan in scans for number in scan.truth})
    seen = {number: seen_times(number, scans, reach, gap) for number in numbers}
    single, own = _Track(config), {number: _Track(config) for number in numbers}
    joint, found = 0, dict.fromkeys(numbers, 0)
    for row, scan in enumerate(scans):
        given, near = _returns(scan, reach)
        joint += len(given) == len(numbers)
        single.take(scan, _nearest(near, single.place(scan.stamp_ns)))
        for number, track in own.items():
            track.take(scan, given.get(number) if joint else None)
        reported = list(own.values()) if joint >= needed else [single]
        served = _served(scan, reported, reach)
        for number in numbers:
            found[number] += bool(seen[number][row]) and number in served
    counts = {number: int(seen[number].sum()) for number in numbers}
    return min((found[n] / counts[n] for n in numbers if counts[n]), default=None)


class _Track:
    """Filter of one target that restarts after `max_coast` without a return."""

    def __init__(self, config: MultiTargetConfig) -> None:
        self._max_coast_ns = config.max_coast * 1e9
        self._config = config.target.model_copy(
            update={"gate_probability": None, "loss_ratio": None, "sensor_noise": "configured"}
        )
        self._filter, self._seen_ns = TargetFilter(self._config), 0

    def take(self, scan: DetectionScan, m: Measurement | None) -> None:
        if scan.stamp_ns - self._seen_ns > self._max_coast_ns:
            self._filter = TargetFilter(self._config)
        if m is not None:
            self._filter.step(m)
            self._seen_ns = scan.stamp_ns

    def place(self, stamp_ns: int) -> NDArray[np.float64] | None:
        state = self._filter.state_at(stamp_ns)
        return None if state is None else state[0][:2]


def _returns(
    scan: DetectionScan, reach: float
) -> tuple[Mapping[int, Measurement], Sequence[Measurement]]:
    """Return the measurement of each target, paired one to one, and all within `reach` [m]."""
    numbers = list(scan.truth)
    places = np.array([measured_place(m) for m in scan.measurements]).reshape(-1, 2)
    away = _distances(places, scan)
    rows, columns = assign(away, gate=reach)
    given = {
        numbers[column]: scan.measurements[row]
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
    }
    near = np.flatnonzero((away <= reach).any(axis=1))
    return given, [scan.measurements[row] for row in near.tolist()]


def _nearest(
    returns: Sequence[Measurement], place: NDArray[np.float64] | None
) -> Measurement | None:
    if not returns or place is None:
        return returns[0] if returns else None
    return min(returns, key=lambda m: float(np.linalg.norm(measured_place(m) - place)))


def _served(scan: DetectionScan, tracks: Sequence[_Track], reach: float) -> set[int]:
    """Numbers of the targets that are paired with a track, one to one, within `reach` [m]."""
    places = [track.place(scan.stamp_ns) for track in tracks]
    known = np.array([place for place in places if place is not None]).reshape(-1, 2)
    _, columns = assign(_distances(known, scan), gate=reach)
    numbers = list(scan.truth)
    return {numbers[column] for column in columns.tolist()}


def _distances(places: NDArray[np.float64], scan: DetectionScan) -> NDArray[np.float64]:
    truth = np.array(list(scan.truth.values())).reshape(-1, 2)
    away: NDArray[np.float64] = np.linalg.norm(places[:, None] - truth[None], axis=-1)
    return away
