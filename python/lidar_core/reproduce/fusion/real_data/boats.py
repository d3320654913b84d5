"""Recordings of boats by LiDAR and radar: tracks of many targets against the truth."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import MissingExtraError
from lidar_core.estimation import chi2_quantile
from lidar_core.evaluation import (
    Estimates,
    EvaluationConfig,
    Truth,
    assign,
    nees,
    score_identities,
)
from lidar_core.fusion import (
    DetectionScan,
    MultiTargetConfig,
    MultiTargetTracker,
    TargetTracks,
    empty_gospa,
    mean_gospa,
    read_autoferry,
    target_coverage,
)
from lidar_core.fusion.coverage import seen_times
from lidar_core.fusion.measurement import measured_place
from lidar_core.reproduce.common import in_space
from lidar_core.reproduce.fusion.real_data.bounds import known_share
from lidar_core.reproduce.recordings import recording
from lidar_core.reproduce.types import Row

SCENARIOS = {2: 304, 3: 337, 4: 256, 5: 359, 13: 301, 17: 205}
"""Scans of each recording."""
REACH, GAP, CUTOFF = 15.0, 3.0, 30.0
"""Furthest track, longest detection gap, GOSPA's c [m], [s], [m]."""
REGION = 0.95
PERSISTS, BIN = 10.0, 2.0
"""Another boat: returns near a track in most bins, for longer than this [s]."""
FILLED = 0.8
JOINT_SCANS = (1, 2, 3, 4)
"""Scans with a return of each boat that tell the two apart, where association is by the truth."""


@dataclass(frozen=True, slots=True)
class Matched:
    """Tracks and targets of one scan, paired one to one within `REACH`.

    Attributes
    ----------
    target_of : ndarray, shape (T,), int64
        Number of the target of every track, -1 for none.
    errors : ndarray, shape (T, 2)
        Track minus target [m]; NaN without one.
    """

    target_of: NDArray[np.int64]
    errors: NDArray[np.float64]


def files_of(scenario: int) -> tuple[str, str]:
    """Paths of the detections and of the truth, relative to the folder of recordings."""
    start = f"2d/autoferry/scenario{scenario}/scenario{scenario}"
    return f"{start}_detections.json", f"{start}_groundTruth.json"


def followed(
    scans: Sequence[DetectionScan], config: MultiTargetConfig
) -> tuple[list[TargetTracks], list[TargetTracks]]:
    """Run the tracker; return the reported tracks after each scan, and all hypotheses."""
    tracker, told, held = MultiTargetTracker(config), [], []
    for scan in scans:
        tracker.process(scan.stamp_ns, scan.measurements, source=scan.source)
        told.append(tracker.tracks_at(scan.stamp_ns))
        held.append(tracker.tracks_at(scan.stamp_ns, confirmed=False))
    return told, held


def boat_rows(scenario: int, count: int, config: MultiTargetConfig) -> list[Row]:
    """Scores of the first `count` scans of a scenario."""
    scans = read_autoferry(recording(files_of(scenario)[0]))[:count]
    tracks, held = followed(scans, config)
    matched = [match(*pair) for pair in zip(scans, tracks, strict=True)]
    cover = list(target_coverage(scans, tracks, reach=REACH, gap=GAP).values())
    false = [int((one.target_of < 0).sum()) for one in matched]
    others = on_other_boats(scans, tracks, matched)
    score = mean_gospa(scans, tracks, cutoff=CUTOFF)
    values: dict[tuple[str, str], float | None] = {
        ("scans", "1"): len(scans),
        ("one-to-one share, lesser target", "1"): min((one.share for one in cover), default=None),
        **{
            (f"that share by truth, told apart by {needed} scans", "1"): known_share(
                scans, config, needed=needed, reach=REACH, gap=GAP
            )
            for needed in JOINT_SCANS
        },
        ("id changes, both targets", "1"): sum(one.n_switches for one in cover),
        ("false tracks per scan", "1"): float(np.mean(false)),
        ("of them on other boats per scan", "1"): float(np.mean(others)),
        ("GOSPA", "m"): score["distance"],
        ("GOSPA, empty output", "m"): empty_gospa(scans, cutoff=CUTOFF)["distance"],
        **{(f"GOSPA^2, {part}", "m^2"): score[part] for part in ("localisation", "missed")},
        ("GOSPA^2, false", "m^2"): score["false"],
        **identities(scans, tracks),
        **calibration(tracks, matched),
        ("existence, calibration error", "1"): existence_error(scans, held),
    }
    return [
        Row(f"autoferry {scenario}/{what}", unit, best_mode=_number_or_none(value))
        for (what, unit), value in values.items()
    ]


def match(scan: DetectionScan, tracks: TargetTracks) -> Matched:
    """Pair the tracks of a scan with its targets: as many as possible, then the nearest."""
    numbers = np.array(list(scan.truth), np.int64)
    truth = np.array(list(scan.truth.values())).reshape(-1, 2)
    away = np.linalg.norm(tracks.position[:, None] - truth[None], axis=-1)
    rows, columns = assign(away, gate=REACH)
    target_of = np.full(len(tracks.id), -1)
    errors = np.full((len(tracks.id), 2), np.nan)
    target_of[rows] = numbers[columns]
    errors[rows] = tracks.position[rows] - truth[columns]
    return Matched(target_of, errors)


def calibration(
    tracks: Sequence[TargetTracks], matched: Sequence[Matched]
) -> dict[tuple[str, str], float | None]:
    """Return by name and unit: RMSE of matched tracks, NEES / 2, share of 95 % regions that hold.

    Empty without matched tracks. The errors include those of the truth: its positions are those
    of an antenna, and up to 0.4 s old.
    """
    errors = np.concatenate([one.errors[one.target_of >= 0] for one in matched])
    spread = [
        state.covariances[one.target_of >= 0, :2, :2]
        for state, one in zip(tracks, matched, strict=True)
    ]
    if not len(errors):
        return {}
    values = nees(errors, np.concatenate(spread))
    return {
        ("RMSE of matched tracks", "m"): float(np.sqrt(np.square(errors).sum(axis=1).mean())),
        ("NEES / 2", "1"): float(values.mean() / 2),
        ("95 % regions hold", "1"): float((values <= chi2_quantile(REGION, degrees=2)).mean()),
    }


def existence_error(scans: Sequence[DetectionScan], held: Sequence[TargetTracks]) -> float | None:
    """Expected calibration error of the hypotheses with p >= .05; None without probabilities.

    A hypothesis is true if it has a target of its own within `REACH`; one of another boat counts
    as false.
    """
    told = np.concatenate([state.existence for state in held])
    is_true = np.concatenate(
        [match(*pair).target_of >= 0 for pair in zip(scans, held, strict=True)]
    )
    rows = told >= 0.05  # not where it is NaN
    if not rows.any():
        return None
    place = np.minimum((told[rows] * 10).astype(np.int64), 9)
    gaps = np.bincount(place, told[rows] - is_true[rows])
    return float(np.abs(gaps).sum() / rows.sum())


def identities(
    scans: Sequence[DetectionScan], tracks: Sequence[TargetTracks]
) -> dict[tuple[str, str], float | None]:
    """Compute MOTA and HOTA, if the library for them is installed.

    Targets count outside detection gaps; scans are distinguished by their number, since two may
    have one stamp.
    """
    numbers = sorted({number for scan in scans for number in scan.truth})
    seen = {number: seen_times(number, scans, REACH, GAP) for number in numbers}
    rows = [(k, n, place) for k, scan in enumerate(scans) for n, place in scan.truth.items()]
    counts = [len(state.id) for state in tracks]
    if not rows or not sum(counts):
        return {}
    truth = Truth(
        np.array([k for k, _, _ in rows]),
        np.array([n for _, n, _ in rows]),
        in_space(np.array([place for _, _, place in rows])),
        np.array([seen[n][k] for k, n, _ in rows]),
    )
    found = Estimates(
        np.repeat(np.arange(len(tracks)), counts),
        in_space(np.concatenate([state.position for state in tracks])),
        np.concatenate([state.id for state in tracks]),
    )
    try:
        scores = score_identities(found, truth, config=EvaluationConfig(gate=REACH))
    except MissingExtraError:
        return {}
    return {} if scores is None else {("MOTA", "1"): scores.mota, ("HOTA", "1"): scores.hota}


def on_other_boats(
    scans: Sequence[DetectionScan], tracks: Sequence[TargetTracks], matched: Sequence[Matched]
) -> list[int]:
    """Count, scan by scan, false tracks that follow returns that persist and move.

    The truth of these recordings contains two boats, but there are others. This rule was set before
    any score was computed. A track follows another boat if it has no target for more than
    `PERSISTS`; if returns lie within `REACH` of it, and of no target, in at least `FILLED` of the
    time; and if the mean of these in the last 4 s is further than `REACH` from that in the first 4
    s.
    """
    spans: dict[int, list[int]] = {}
    for k, (state, one) in enumerate(zip(tracks, matched, strict=True)):
        for number in state.id[one.target_of < 0].tolist():
            spans.setdefault(number, []).append(k)
    counts = [0] * len(scans)
    for number, rows in spans.items():
        if _moves(number, rows, scans, tracks):
            for k in rows:
                counts[k] += 1
    return counts


def _moves(
    number: int, rows: Sequence[int], scans: Sequence[DetectionScan], tracks: Sequence[TargetTracks]
) -> bool:
    """Return whether returns near a track persist and move."""
    times, places = [np.empty(0)], [np.empty((0, 2))]
    for k in rows:
        own = tracks[k].position[tracks[k].id == number]
        near = np.array([measured_place(m) for m in scans[k].measurements]).reshape(-1, 2)
        near = near[np.linalg.norm(near - own, axis=1) <= REACH]
        for place in scans[k].truth.values():
            near = near[np.linalg.norm(near - place, axis=1) > REACH]
        times.append(np.full(len(near), scans[k].stamp_ns * 1e-9))
        places.append(near)
    at, seen = np.concatenate(times), np.concatenate(places)
    first, last = scans[rows[0]].stamp_ns * 1e-9, scans[rows[-1]].stamp_ns * 1e-9
    if last - first <= PERSISTS:
        return False
    bins = np.unique(((at - first) // BIN).astype(np.int64))
    early, late = seen[at <= first + 2 * BIN], seen[at >= last - 2 * BIN]
    if len(bins) < FILLED * np.ceil((last - first) / BIN) or not (len(early) and len(late)):
        return False
    return float(np.linalg.norm(late.mean(axis=0) - early.mean(axis=0))) > REACH


def _number_or_none(value: float | None) -> float | None:
    return None if value is None or np.isnan(value) else float(value)
