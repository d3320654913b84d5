"""Scores of detections and of tracks."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core.arrays import as_finite_rows, as_real, as_rows
from lidar_core.config import as_config
from lidar_core.errors import InputError
from lidar_core.evaluation.bins import bin_of, norms
from lidar_core.evaluation.config import EvaluationConfig
from lidar_core.evaluation.matching.pairing import (
    Pairing,
    checked_estimates,
    checked_truth,
    counting,
    distances_at,
    errors_of,
    numbers_of,
    pair,
    rows_of,
    scans,
)
from lidar_core.evaluation.metric import Of, Paired, metrics_of
from lidar_core.evaluation.metrics.consistency import Consistency, consistency, nees
from lidar_core.evaluation.metrics.continuity import continuity, switches
from lidar_core.evaluation.metrics.set_distance import set_distances
from lidar_core.evaluation.spread import Spread
from lidar_core.evaluation.types import (
    DetectionScores,
    DistanceScores,
    Estimates,
    SetScores,
    TrackScores,
    Truth,
)

ORDER = 2.0
"""Order p of OSPA and GOSPA (no unit). Source: Rahmathullah et al., 2017."""


def eligible(
    position: ArrayLike,
    hits: ArrayLike,
    sensor_position: ArrayLike,
    *,
    config: EvaluationConfig | None = None,
) -> NDArray[np.bool_]:
    """Return the targets that are required: near enough, and hit by enough rays.

    Parameters
    ----------
    position : array_like, shape (T, 3), float64
        Centres of the targets [m].
    hits : array_like, shape (T,), int64
        Points on each target in this scan.
    sensor_position : array_like, shape (3,) or (T, 3), float64
        Position of the sensor [m], same frame.
    config : EvaluationConfig, optional
        `max_distance` and `min_hits`.

    Returns
    -------
    is_eligible : ndarray, shape (T,), bool

    Raises
    ------
    InputError
        Wrong shape or dtype, or a number that is not finite.
    """
    config = as_config(config, EvaluationConfig)
    centres = as_finite_rows(position, name="position", rows=None, shape=(3,))
    points = as_rows(hits, name="hits", rows=len(centres), shape=(), dtype=np.int64)
    sensors = as_real(sensor_position, name="sensor_position")
    if sensors.shape not in {(3,), centres.shape}:
        raise InputError(
            f"sensor_position: expected shape (3,) or {centres.shape}, got {sensors.shape}"
        )
    if not np.isfinite(sensors).all():
        raise InputError("sensor_position: expected finite values")
    is_near: NDArray[np.bool_] = norms(centres - sensors) <= config.max_distance
    return is_near & (points >= config.min_hits)


def score_detections(
    detections: Estimates, truth: Truth, *, config: EvaluationConfig | None = None
) -> DetectionScores:
    """Score detections scan by scan; the assignment is optimal within the gate.

    All targets take part in the assignment; only eligible targets count for recall and errors. So a
    detection of a target that need not be found counts neither as false nor as correct.

    Raises
    ------
    InputError
        Tables whose columns differ in length, or that hold an object twice at one time.
    """
    config = as_config(config, EvaluationConfig)
    detections, truth = checked_estimates(detections), checked_truth(truth)
    pairing = pair(detections, truth, config=config)
    return DetectionScores(**_common(detections, truth, pairing, config, "detections"))


def score_tracks(
    tracks: Estimates, truth: Truth, *, config: EvaluationConfig | None = None
) -> TrackScores:
    """Score tracks as `score_detections` does, and their identities.

    Raises
    ------
    InputError
        Tables whose columns differ in length, or tracks without IDs.
    """
    config = as_config(config, EvaluationConfig)
    tracks = checked_estimates(tracks)
    numbers, truth = numbers_of(tracks), checked_truth(truth)
    pairing = pair(tracks, truth, config=config)
    common = _common(tracks, truth, pairing, config, "tracks")
    false_ids = np.unique(numbers[pairing.nearest > config.gate]).tolist()
    duration = common["duration"]
    return TrackScores(
        **common,
        track_ids=tuple(np.unique(numbers).tolist()),
        false_ids=tuple(false_ids),
        false_tracks_per_minute=60 * len(false_ids) / duration if duration else None,
        n_switches=switches(truth, pairing, numbers),
        state_nees=_state_nees(tracks, truth, pairing, config),
    )


def _common(
    estimates: Estimates, truth: Truth, pairing: Pairing, config: EvaluationConfig, of: Of
) -> dict[str, Any]:
    """Compute the fields of `DetectionScores`, by name."""
    steady = continuity(truth, pairing)
    return {
        **_counts(estimates, truth, pairing, config),
        **_errors(estimates, truth, pairing),
        "over_distance": _over_distance(estimates, truth, pairing, config),
        "sets": _set_scores(estimates, truth, pairing, config),
        "position_nees": _position_nees(estimates, truth, pairing, config),
        "first_delay": steady.first_delay,
        "longest_gap": steady.longest_gap,
        "n_fragmentations": steady.n_fragmentations,
        "metrics": metrics_of(Paired(estimates, truth, pairing, config), of),
    }


def _counts(
    estimates: Estimates, truth: Truth, pairing: Pairing, config: EvaluationConfig
) -> dict[str, Any]:
    stamps = np.union1d(estimates.stamp_ns, truth.stamp_ns)
    wanted = truth.stamp_ns[truth.is_eligible]
    when, n_wanted = np.unique(wanted, return_counts=True)
    n_found = np.bincount(np.searchsorted(when, truth.stamp_ns[pairing.found]), minlength=len(when))
    n_estimates, n_matched = len(estimates.stamp_ns), int((pairing.target_of >= 0).sum())
    n_false = int((pairing.nearest > config.gate).sum())
    return {
        "n_scans": len(stamps),
        "duration": _duration(stamps),
        "n_eligible": len(wanted),
        "n_found": len(pairing.found),
        "n_estimates": n_estimates,
        "n_matched": n_matched,
        "n_duplicate": n_estimates - n_matched - n_false,
        "n_false": n_false,
        "recall": _ratio(len(pairing.found), len(wanted)),
        "precision": _ratio(n_matched, n_estimates),
        "stamp_ns": when,
        "recall_at": n_found / n_wanted,
    }


def _duration(stamps: NDArray[np.int64]) -> float:
    """Time from the first to the last scan, plus one median interval for the last one [s]."""
    steps = np.diff(stamps)
    return float(steps.sum() + np.median(steps)) * 1e-9 if len(steps) else 0.0


def _errors(estimates: Estimates, truth: Truth, pairing: Pairing) -> dict[str, Spread | None]:
    rows = pairing.found
    away = errors_of(estimates, truth, pairing)
    radial = across = velocity = radius = None
    if truth.sensor is not None:
        sight = truth.position[rows] - truth.sensor[rows]
        length = norms(sight)
        known = length > 0
        sight, seen = sight[known] / length[known, None], away[known]
        along = np.sum(seen * sight, axis=1)
        radial, across = Spread.of(along), Spread.of(norms(seen - along[:, None] * sight))
    if truth.velocity is not None and estimates.velocity is not None:
        change = estimates.velocity[pairing.estimate_of[rows]] - truth.velocity[rows]
        velocity = Spread.of(norms(change))
    if truth.radius is not None and estimates.radius is not None:
        difference = estimates.radius[pairing.estimate_of[rows]] - truth.radius[rows]
        radius = Spread.of(difference[~np.isnan(difference)])
    return {
        "position_error": Spread.of(norms(away)),
        "radial_error": radial,
        "across_error": across,
        "velocity_error": velocity,
        "radius_error": radius,
    }


def _over_distance(
    estimates: Estimates, truth: Truth, pairing: Pairing, config: EvaluationConfig
) -> tuple[DistanceScores, ...]:
    """Scores by distance from the sensor: that of the target, or that of the estimate.

    Recall and errors use the distance of the target, precision that of the estimate. Empty without
    positions of the sensor.
    """
    if truth.sensor is None:
        return ()
    edges = np.array(config.distance_edges)
    group = bin_of(norms(truth.position - truth.sensor), edges)
    away = norms(estimates.position - _sensor_at(estimates.stamp_ns, truth))
    group_of_estimate = bin_of(away, edges)
    rows = pairing.found
    error = norms(errors_of(estimates, truth, pairing))
    result = []
    for number, (near, far) in enumerate(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)):
        here = group_of_estimate == number
        n_eligible = int((truth.is_eligible & (group == number)).sum())
        found, n_estimates = group[rows] == number, int(here.sum())
        n_found, n_matched = int(found.sum()), int((pairing.target_of[here] >= 0).sum())
        if n_eligible or n_estimates:
            ratios = _ratio(n_found, n_eligible), _ratio(n_matched, n_estimates)
            counts = n_eligible, n_found, n_estimates, n_matched
            result.append(DistanceScores(near, far, *counts, *ratios, Spread.of(error[found])))
    return tuple(result)


def _sensor_at(stamps: NDArray[np.int64], truth: Truth) -> NDArray[np.float64]:
    """Positions of the sensor at these times; NaN where the ground truth has none."""
    places = np.full((len(stamps), 3), np.nan)
    if truth.sensor is not None and len(truth.stamp_ns):
        when, first = np.unique(truth.stamp_ns, return_index=True)
        row = np.minimum(np.searchsorted(when, stamps), len(when) - 1)
        known = when[row] == stamps
        places[known] = truth.sensor[first[row[known]]]
    return places


def _set_scores(
    estimates: Estimates, truth: Truth, pairing: Pairing, config: EvaluationConfig
) -> SetScores | None:
    counts = counting(pairing, truth.is_eligible, config.gate)
    estimates, truth = rows_of(estimates, counts), rows_of(truth, truth.is_eligible)
    rows = []
    for here, there in scans(estimates, truth):
        table = distances_at(estimates, here, truth, there)
        distance, parts = set_distances(table, cutoff=config.gate, order=ORDER)
        rows.append((distance, parts.distance, parts.localisation, parts.missed, parts.false))
    return SetScores(len(rows), *np.mean(rows, axis=0).tolist()) if rows else None


def _position_nees(
    estimates: Estimates, truth: Truth, pairing: Pairing, config: EvaluationConfig
) -> Consistency | None:
    if estimates.covariance is None:
        return None
    partners = pairing.estimate_of[pairing.found]
    away = errors_of(estimates, truth, pairing)
    axes = _axes(estimates.covariance)
    values = nees(away[:, :axes], estimates.covariance[partners][:, :axes, :axes])
    return consistency(values, degrees=axes, config=config)


def _axes(covariance: NDArray[np.float64]) -> int:
    """Number of axes of a position: two in a plane, else three."""
    return 2 if covariance.shape[1] in (2, 4) else 3


def _state_nees(
    tracks: Estimates, truth: Truth, pairing: Pairing, config: EvaluationConfig
) -> Consistency | None:
    covariance = tracks.covariance
    if covariance is None or covariance.shape[1] not in (4, 6):
        return None
    if tracks.velocity is None or truth.velocity is None:
        return None
    rows = pairing.found
    partners = pairing.estimate_of[rows]
    place = errors_of(tracks, truth, pairing)
    speed = tracks.velocity[partners] - truth.velocity[rows]
    axes = _axes(covariance)
    away = np.concatenate([place[:, :axes], speed[:, :axes]], axis=1)
    return consistency(nees(away, covariance[partners]), degrees=2 * axes, config=config)


def _ratio(part: int, whole: int) -> float | None:
    return part / whole if whole else None
