"""How well many targets are tracked, while their scanners see them."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.evaluation import gospa
from lidar_core.fusion.autoferry import DetectionScan
from lidar_core.fusion.many import TargetTracks


@dataclass(frozen=True, slots=True)
class TargetCoverage:
    """How well one target is tracked.

    Attributes
    ----------
    n_scans : int
        Scans in which it is counted: those between detections of it at most `gap` apart.
    share : float
        Of them, with a track within `reach`; NaN without any.
    rmse : float
        Of the nearest track within `reach` [m]; NaN without any.
    n_ids : int
        Tracks that were the nearest.
    n_switches : int
        Times at which another track became the nearest.
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
    """Share of the time for which each target has a track, outside detection gaps.

    Parameters
    ----------
    scans : sequence of DetectionScan
        With truth.
    tracks : sequence of TargetTracks
        After each of them.
    reach : float
        A detection or track at most this far from a target belongs to it [m].
    gap : float
        Scans between two detections further apart than this are left out, as are those before
        the first and after the last [s].
    """
    numbers = sorted({number for scan in scans for number in scan.truth})
    return {number: _coverage(number, scans, tracks, reach, gap) for number in numbers}


def mean_gospa(
    scans: Sequence[DetectionScan], tracks: Sequence[TargetTracks], *, cutoff: float
) -> dict[str, float]:
    """Mean over the scans of GOSPA of order 2, and of its parts [m], [m^2]."""
    parts: list[dict[str, Any]] = []
    for scan, state in zip(scans, tracks, strict=True):
        truth = np.array(list(scan.truth.values())).reshape(-1, 2)
        flat = [np.pad(places, ((0, 0), (0, 1))) for places in (state.position, truth)]
        parts.append(asdict(gospa(*flat, cutoff=cutoff, order=2.0)))
    names = parts[0] if parts else {}
    return {name: float(np.mean([part[name] for part in parts])) for name in names}


def _coverage(
    number: int,
    scans: Sequence[DetectionScan],
    tracks: Sequence[TargetTracks],
    reach: float,
    gap: float,
) -> TargetCoverage:
    counted = _seen_times(number, scans, reach, gap)
    found, errors = [], []
    for scan, state, counts in zip(scans, tracks, counted, strict=True):
        if not counts:
            continue
        distance = np.linalg.norm(state.position - scan.truth[number], axis=1)
        nearest = int(np.argmin(distance)) if len(distance) else -1
        if nearest >= 0 and distance[nearest] <= reach:
            found.append(int(state.id[nearest]))
            errors.append(float(distance[nearest]))
    total = int(counted.sum())
    return TargetCoverage(
        n_scans=total,
        share=len(found) / total if total else float("nan"),
        rmse=float(np.sqrt(np.mean(np.square(errors)))) if errors else float("nan"),
        n_ids=len(set(found)),
        n_switches=sum(a != b for a, b in pairwise(found)),
    )


def _seen_times(
    number: int, scans: Sequence[DetectionScan], reach: float, gap: float
) -> NDArray[np.bool_]:
    """Scans between two detections of a target that are at most `gap` apart."""
    stamps = np.array([scan.stamp_ns for scan in scans], np.int64)
    has_truth = np.array([number in scan.truth for scan in scans], np.bool_)
    hits = [
        row for row, scan in enumerate(scans) if number in scan.truth and any(
            np.linalg.norm(m.values - scan.truth[number]) <= reach for m in scan.measurements
        )
    ]  # fmt: skip
    counted = np.zeros(len(scans), np.bool_)
    for before, after in pairwise(hits):
        if stamps[after] - stamps[before] <= gap * 1e9:
            counted[before : after + 1] = True
    return counted & has_truth
