"""Recall, precision, position errors, false tracks, changes of identity."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core.arrays import as_mask, as_real, as_rows
from lidar_core.config import as_config
from lidar_core.errors import InputError
from lidar_core.evaluation.assignment import Matches, match
from lidar_core.evaluation.config import EvaluationConfig
from lidar_core.evaluation.types import DetectionScores, Estimates, TrackScores, Truth


def eligible(
    position: ArrayLike,
    hits: ArrayLike,
    sensor_position: ArrayLike,
    *,
    config: EvaluationConfig | None = None,
) -> NDArray[np.bool_]:
    """Which targets have to be found: near enough, and hit by enough rays.

    Parameters
    ----------
    position : array_like, shape (T, 3), float64
        Centres of the targets [m].
    hits : array_like, shape (T,), int64
        Points on each target in this scan.
    sensor_position : array_like, shape (3,) or (T, 3), float64
        Where the sensor was [m], same frame.
    config : EvaluationConfig, optional
        `max_distance` and `min_hits`.

    Returns
    -------
    is_eligible : ndarray, shape (T,), bool
    """
    config = as_config(config, EvaluationConfig)
    centres = as_rows(position, name="position", rows=None, shape=(3,), dtype=np.float64)
    points = as_rows(hits, name="hits", rows=len(centres), shape=(), dtype=np.int64)
    sensors = as_real(sensor_position, name="sensor_position")
    if sensors.shape not in {(3,), centres.shape}:
        raise InputError(
            f"sensor_position: expected shape (3,) or {centres.shape}, got {sensors.shape}"
        )
    is_near: NDArray[np.bool_] = np.linalg.norm(centres - sensors, axis=-1) <= config.max_distance
    return is_near & (points >= config.min_hits)


def score_detections(
    detections: Estimates, truth: Truth, *, config: EvaluationConfig | None = None
) -> DetectionScores:
    """Score detections scan by scan; the assignment is optimal within the gate.

    All targets take part in the assignment; only eligible ones count for recall and errors, so
    that a detection of a target that need not be found is neither false nor a merit.

    Raises
    ------
    InputError
        Tables whose columns differ in length.
    """
    return DetectionScores(**_tally(detections, truth, as_config(config, EvaluationConfig)).base())


def score_tracks(
    tracks: Estimates, truth: Truth, *, config: EvaluationConfig | None = None
) -> TrackScores:
    """Score tracks as `score_detections` does, and their identities.

    Raises
    ------
    InputError
        Tables whose columns differ in length, or tracks without numbers.
    """
    if tracks.id is None:
        raise InputError("tracks.id: expected the number of every track, got None")
    tally = _tally(tracks, truth, as_config(config, EvaluationConfig))
    return TrackScores(
        **tally.base(),
        track_ids=tuple(np.unique(tracks.id).tolist()),
        false_ids=tuple(sorted(tally.false_ids)),
        n_switches=tally.n_switches,
        first_delay=tally.first_delays(),
        longest_gap={
            target: max((after - before for before, after in gaps), default=0) * 1e-9
            for target, gaps in sorted(tally.gaps.items())
        },
    )


@dataclass(frozen=True, slots=True)
class _OneScan:
    stamp_ns: int
    truth_id: NDArray[np.int64]
    is_eligible: NDArray[np.bool_]
    track_id: NDArray[np.int64] | None
    matches: Matches


@dataclass(slots=True)
class _Tally:
    """Counts over the scans seen so far."""

    n_scans: int = 0
    n_estimates: int = 0
    n_matched: int = 0
    n_false: int = 0
    errors: list[float] = field(default_factory=list)
    recall_at: list[tuple[int, int, int]] = field(default_factory=list)  # stamp, found, eligible
    false_ids: set[int] = field(default_factory=set)
    n_switches: int = 0
    track_of: dict[int, int] = field(default_factory=dict)
    first_eligible: dict[int, int] = field(default_factory=dict)
    first_found: dict[int, int] = field(default_factory=dict)
    open_since: dict[int, int] = field(default_factory=dict)
    gaps: dict[int, list[tuple[int, int]]] = field(default_factory=dict)

    def see(self, scan: _OneScan, gate: float) -> None:
        matches = scan.matches
        is_false = matches.nearest > gate
        self.n_scans += 1
        self.n_estimates += len(is_false)
        self.n_matched += len(matches.target)
        self.n_false += int(is_false.sum())
        found = scan.is_eligible[matches.target]
        self.errors += matches.distance[found].tolist()
        if scan.is_eligible.any():
            self.recall_at.append((scan.stamp_ns, int(found.sum()), int(scan.is_eligible.sum())))
        if scan.track_id is not None:
            self.false_ids.update(scan.track_id[is_false].tolist())
            self._see_identities(scan, scan.track_id)

    def _see_identities(self, scan: _OneScan, track_id: NDArray[np.int64]) -> None:
        matches = scan.matches
        pairs = zip(
            scan.truth_id[matches.target].tolist(), track_id[matches.estimate].tolist(), strict=True
        )
        tracked = dict(pairs)
        for target, track in tracked.items():
            self.n_switches += self.track_of.get(target, track) != track
            self.track_of[target] = track
        for target, counts in zip(scan.truth_id.tolist(), scan.is_eligible.tolist(), strict=True):
            if counts:
                self.first_eligible.setdefault(target, scan.stamp_ns)
                self.gaps.setdefault(target, [])
            if target in tracked and target in self.first_eligible:
                self.first_found.setdefault(target, scan.stamp_ns)
            self._see_gap(target, scan.stamp_ns, counts=counts, is_tracked=target in tracked)

    def _see_gap(self, target: int, stamp_ns: int, *, counts: bool, is_tracked: bool) -> None:
        if counts and not is_tracked:
            self.open_since.setdefault(target, stamp_ns)
        if target in self.open_since and (counts or is_tracked):
            self.gaps[target].append((self.open_since[target], stamp_ns))
        if is_tracked or not counts:
            self.open_since.pop(target, None)

    def first_delays(self) -> dict[int, float | None]:
        found = self.first_found
        return {
            target: (found[target] - since) * 1e-9 if target in found else None
            for target, since in sorted(self.first_eligible.items())
        }

    def base(self) -> dict[str, Any]:
        """Fields of `DetectionScores`."""
        errors = np.array(self.errors)
        stamps, found, wanted = np.array(self.recall_at, np.int64).reshape(-1, 3).T
        n_found, n_eligible = int(found.sum()), int(wanted.sum())
        return {
            "n_scans": self.n_scans,
            "n_eligible": n_eligible,
            "n_found": n_found,
            "n_estimates": self.n_estimates,
            "n_matched": self.n_matched,
            "n_duplicate": self.n_estimates - self.n_matched - self.n_false,
            "n_false": self.n_false,
            "recall": n_found / n_eligible if n_eligible else None,
            "precision": self.n_matched / self.n_estimates if self.n_estimates else None,
            "mean_error": float(errors.mean()) if len(errors) else None,
            "rmse": float(np.sqrt(np.mean(errors**2))) if len(errors) else None,
            "max_error": float(errors.max()) if len(errors) else None,
            "stamp_ns": stamps,
            "recall_at": found / wanted,
        }


def _tally(estimates: Estimates, truth: Truth, config: EvaluationConfig) -> _Tally:
    tally = _Tally()
    for scan in _scans(estimates, truth, config.gate):
        tally.see(scan, config.gate)
    return tally


def _scans(estimates: Estimates, truth: Truth, gate: float) -> Iterator[_OneScan]:
    """Scans by time, each with its targets, estimates and their assignment."""
    when = as_rows(truth.stamp_ns, name="truth.stamp_ns", rows=None, shape=(), dtype=np.int64)
    known = len(when)
    names = as_rows(truth.id, name="truth.id", rows=known, shape=(), dtype=np.int64)
    places = as_rows(truth.position, name="truth.position", rows=known, shape=(3,), dtype=float)
    counts = as_mask(truth.is_eligible, name="truth.is_eligible", rows=known)
    seen = as_rows(estimates.stamp_ns, name="stamp_ns", rows=None, shape=(), dtype=np.int64)
    found = as_rows(estimates.position, name="position", rows=len(seen), shape=(3,), dtype=float)
    numbers = estimates.id
    if numbers is not None:
        numbers = as_rows(numbers, name="id", rows=len(seen), shape=(), dtype=np.int64)
    for stamp_ns in np.unique(np.concatenate([when, seen])).tolist():
        here, there = np.flatnonzero(when == stamp_ns), np.flatnonzero(seen == stamp_ns)
        yield _OneScan(
            stamp_ns=stamp_ns,
            truth_id=names[here],
            is_eligible=counts[here],
            track_id=None if numbers is None else numbers[there],
            matches=match(found[there], places[here], gate=gate),
        )
