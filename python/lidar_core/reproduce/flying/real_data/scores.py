"""Scores of targets in runs over scans of real sensors or of simulated drivers."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lidar_core.evaluation import assign
from lidar_core.reproduce.common import share
from lidar_core.reproduce.flying.real_data.reported import false_tracks
from lidar_core.reproduce.jobs import Part

FEWEST = 3
"""Returns from which on a target has to be found."""
START_S = 1.1
"""Targets have to be found from here on, counted from the first scan [s]."""
GATE, GATE_SDS = 0.5, 3.0
"""A track this far from a target is its own: the larger of both [m], [standard deviations]."""


def matches(part: Part) -> NDArray[np.int64]:
    """Row of the track of every target in every scan, (S, T); -1 for none."""
    found = np.full(part["hits"].shape, -1, np.int64)
    for scan in range(len(found)):
        rows = np.flatnonzero(part["scan"] == scan)
        away = np.linalg.norm(part["position"][rows, None] - part["place"][scan], axis=2)
        gate = np.maximum(GATE, GATE_SDS * part["std"][rows])[:, None]
        of_rows, of_targets = assign(np.where(away <= gate, away, np.inf), gate=1e6)
        found[scan, of_targets] = rows[of_rows]
    return found


def scores(parts: Sequence[Part], names: Sequence[str]) -> list[tuple[str, str, float | None]]:
    """Return the scores of runs: recall in all and per target, track errors, false tracks.

    Parameters
    ----------
    parts : sequence of dict
        Runs: the columns of `Reported`, and `place` (S, T, 3), `hits` (S, T), `seconds` (S,).
    names : sequence of str
        Names of the T targets.

    Returns
    -------
    list of tuple
        Name, unit and value; None if no target had to be found.
    """
    is_due, is_found, is_open, along, across, false = [], [], [], [], [], 0
    for part in parts:
        partner = matches(part)
        due = (part["hits"] >= FEWEST) & (part["seconds"][:, None] >= START_S)
        is_due.append(due)
        is_found.append(due & (partner >= 0))
        is_open.append(np.broadcast_to(part["gate_open"][:, None], due.shape))
        false += len(false_tracks(part, part["id"][partner[partner >= 0]].tolist()))
        scan, target = np.nonzero(is_found[-1])
        sight = part["place"][scan, target] - part["sensor"][scan]
        sight /= np.linalg.norm(sight, axis=1)[:, None]
        error = part["position"][partner[scan, target]] - part["place"][scan, target]
        ahead = np.sum(error * sight, axis=1)
        along.append(ahead)
        across.append(np.linalg.norm(error - ahead[:, None] * sight, axis=1))
    due, found = np.concatenate(is_due).sum(axis=0), np.concatenate(is_found).sum(axis=0)
    ready = np.concatenate(is_open) & np.concatenate(is_due)
    after = (np.concatenate(is_found) & ready).sum()
    ahead, aside = np.concatenate(along), np.concatenate(across)
    shapes = [
        (f"recall, {name}", "1", share(found[column], due[column]))
        for column, name in enumerate(names)
    ]
    count = sum((part["hits"] > 0).any(axis=0).sum() for part in parts)
    return [
        ("targets", "1", float(count)),
        ("target scans", "1", float(due.sum())),
        ("recall", "1", share(found.sum(), due.sum())),
        *shapes,
        ("recall, after the burn-in", "1", share(after, ready.sum())),
        ("error", "m", _rms(np.hypot(ahead, aside))),
        ("error, along the line of sight", "m", _rms(ahead)),
        ("error, across it", "m", _rms(aside)),
        ("false_tracks, with targets", "1", float(false)),
    ]


def _rms(values: NDArray[np.float64]) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None
