"""Scores of a tracker of many targets, while scanners see the targets."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.evaluation import assign, gospa
from lidar_core.fusion.measurement import measured_place
from lidar_core.fusion.recordings.autoferry import DetectionScan
from lidar_core.objects import TargetTracks


@dataclass(frozen=True, slots=True)
class TargetCoverage:
    """Scores of the track of one target.

    Attributes
    ----------
    n_scans : int
        Scans in which it is counted: those between detections of it at most `gap` apart.
    share : float
        Share of these scans with a track within `reach` that serves no other target; NaN without
        scans.
    rmse : float
        RMS position error of that track [m]; NaN without a track.
    n_ids : int
        Tracks that served it.
    n_switches : int
        Times at which another track began to serve it.
    """

    n_scans: int
    share: float
    rmse: float
    n_ids: int
    n_switches: int


def target_coverage(
    scans: Sequence[DetectionScan],
    tracks: Sequence[TargetTracks],
    *,
    reach: float,
    gap: float,
) -> dict[int, TargetCoverage]:
    """Score for each target how long it has a track of its own, outside detection gaps.

    In every scan, tracks and all targets are paired one to one: as many pairs as possible within
    `reach`, and among those the least sum of distances. So a track between two targets is paired
    with one of them.

    Parameters
    ----------
    scans : sequence of DetectionScan
        Scans with ground truth.
    tracks : sequence of TargetTracks
        Tracks after each scan.
    reach : float
        A detection or track at most this far from a target belongs to it [m].
    gap : float
        Scans between two detections, of any scanner, further apart than this are left out, as are
        those before the first and after the last [s].
    """
    numbers = sorted({number for scan in scans for number in scan.truth})
    pairs = [_paired(scan, state, reach) for scan, state in zip(scans, tracks, strict=True)]
    return {number: _coverage(number, scans, pairs, reach, gap) for number in numbers}


def mean_gospa(
    scans: Sequence[DetectionScan], tracks: Sequence[TargetTracks], *, cutoff: float
) -> dict[str, float]:
    """Mean over the scans of GOSPA of order 2 [m] and of its parts [m^2], by name."""
    return _mean_gospa(scans, [state.position for state in tracks], cutoff)


def empty_gospa(scans: Sequence[DetectionScan], *, cutoff: float) -> dict[str, float]:
    """Return `mean_gospa` of an output without tracks: the limit that a useful score must beat."""
    return _mean_gospa(scans, [np.empty((0, 2))] * len(scans), cutoff)


def _mean_gospa(
    scans: Sequence[DetectionScan], found: Sequence[NDArray[np.float64]], cutoff: float
) -> dict[str, float]:
    parts: list[dict[str, Any]] = []
    for scan, position in zip(scans, found, strict=True):
        truth = np.array(list(scan.truth.values())).reshape(-1, 2)
        flat = [np.pad(places, ((0, 0), (0, 1))) for places in (position, truth)]
        parts.append(asdict(gospa(*flat, cutoff=cutoff, order=2.0)))
    names = parts[0] if parts else {}
    return {name: float(np.mean([part[name] for part in parts])) for name in names}


def _paired(scan: DetectionScan, state: TargetTracks, reach: float) -> dict[int, tuple[int, float]]:
    """Return for every paired target the ID of its track and the distance between both [m]."""
    numbers = list(scan.truth)
    truth = np.array([scan.truth[number] for number in numbers]).reshape(-1, 2)
    distance = np.linalg.norm(state.position[:, None] - truth[None], axis=-1)
    rows, columns = assign(distance, gate=reach)
    return {
        numbers[column]: (int(state.id[row]), float(distance[row, column]))
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
    }


def _coverage(
    number: int,
    scans: Sequence[DetectionScan],
    pairs: Sequence[Mapping[int, tuple[int, float]]],
    reach: float,
    gap: float,
) -> TargetCoverage:
    counted = seen_times(number, scans, reach, gap)
    served = [
        pair[number]
        for pair, counts in zip(pairs, counted, strict=True)
        if counts and number in pair
    ]
    found, errors = [track for track, _ in served], [away for _, away in served]
    total = int(counted.sum())
    return TargetCoverage(
        n_scans=total,
        share=len(found) / total if total else float("nan"),
        rmse=float(np.sqrt(np.mean(np.square(errors)))) if errors else float("nan"),
        n_ids=len(set(found)),
        n_switches=sum(a != b for a, b in pairwise(found)),
    )


def seen_times(
    number: int, scans: Sequence[DetectionScan], reach: float, gap: float
) -> NDArray[np.bool_]:
    """Return which scans lie between two detections of a target at most `gap` [s] apart, (K,)."""
    stamps = np.array([scan.stamp_ns for scan in scans], np.int64)
    has_truth = np.array([number in scan.truth for scan in scans], np.bool_)
    hits = [
        row
        for row, scan in enumerate(scans)
        if number in scan.truth
        and any(
            np.linalg.norm(measured_place(m) - scan.truth[number]) <= reach
            for m in scan.measurements
        )
    ]
    counted = np.zeros(len(scans), np.bool_)
    for before, after in pairwise(hits):
        if stamps[after] - stamps[before] <= gap * 1e9:
            counted[before : after + 1] = True
    return counted & has_truth
