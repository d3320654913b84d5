"""Flight through a simulated situation, and the counts of its results."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidar_core.evaluation import assign
from lidar_core.flying import FlyingConfig, FlyingObjectDetector, Tracks
from lidar_core.reproduce.common import simulator_seed
from lidar_core.reproduce.flying.real_data.scores import FEWEST, GATE, GATE_SDS, START_S
from lidar_core.reproduce.flying.situations.scenes import HEIGHT, scene
from lidar_core.reproduce.jobs import Part
from lidar_core.sim import Simulator

NOBODY = -1
"""Value instead of the ID of a track: the target has no track."""
SOUGHT = 20.0
"""Range in which the default configuration looks for targets [m]."""
APART = 10
"""Scans without returns after which a target comes anew."""


def flight(*, seed: int, number: int, scans: int, name: str) -> Part:
    """Run the detector through one flight.

    Returns
    -------
    part : dict
        Values of every scan and target, (S, T): `hits`, `track` and `any_track` (ID of the flying
        track on it, and of a track of any kind), `error` [m], `nees`, `is_detected`; `place` (S, T,
        3) [m]; values of every scan: `seconds`, `n_flying` (flying tracks); `false`: IDs of false
        flying tracks.
    """
    simulator = Simulator(scene(name, seed, number, scans), seed=simulator_seed(seed, number))
    detector = FlyingObjectDetector(FlyingConfig())
    rows: dict[str, list[NDArray[np.float64]]] = {}
    reported: set[int] = set()
    for step in range(scans):
        made = simulator.scan(step)
        frame = detector.process(made)
        place = made.truth.position.reshape(-1, 3)
        flying = frame.tracks.flying
        reported |= set(flying.id.tolist())
        track, error, nees = _matched(flying, place)
        any_track, _, _ = _matched(frame.tracks, place)
        found = {
            "place": place,
            "hits": made.truth.hits,
            "track": track,
            "any_track": any_track,
            "error": error,
            "nees": nees,
            "is_detected": _near(frame.detections.position, place),
            "n_flying": np.array(len(flying)),
            "seconds": np.array((made.scan.stamp_ns - simulator.scene.start_ns) * 1e-9),
        }
        for key, value in found.items():
            rows.setdefault(key, []).append(np.asarray(value, np.float64))
    part = {key: np.stack(values) for key, values in rows.items()}
    false = sorted(reported - set(part["track"].ravel().astype(int).tolist()))
    return part | {"false": np.array(false, np.int64), "scans": np.array(scans)}


def _matched(
    tracks: Tracks, place: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """ID, error [m] and NEES of the track that is paired with each target, one to one."""
    number = np.full(len(place), float(NOBODY))
    error, nees = np.full((2, len(place)), np.nan)
    offset = place - tracks.position[:, None]
    away = np.linalg.norm(offset, axis=2)
    spread = np.sqrt(np.trace(tracks.covariance[:, :3, :3], axis1=1, axis2=2))
    gate = np.maximum(GATE, GATE_SDS * spread)[:, None]
    for row, target in zip(*assign(np.where(away <= gate, away, np.inf), gate=1e6), strict=True):
        number[target], error[target] = tracks.id[row], away[row, target]
        y, covariance = offset[row, target], tracks.covariance[row, :3, :3]
        nees[target] = y @ np.linalg.solve(covariance, y)
    return number, error, nees


def _near(positions: NDArray[np.float64], place: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return for each target whether a detection is near; a fast one moves within the scan."""
    away = np.linalg.norm(positions[:, None] - place, axis=2)
    reach = 4.0  # at 40 m/s within a scan; nothing else is near
    return np.asarray((away <= reach).any(axis=0), np.bool_)


@dataclass(frozen=True, slots=True)
class Counts:
    """Sums over flights.

    Attributes
    ----------
    due, found : int
        Target scans in which a track is expected, and in which there is one.
    changes : int
        Scans in which the track of a target has another ID than in the scan before.
    errors, nees : ndarray, shape (K,)
        Position errors of the found tracks [m], and their NEES (no unit).
    false : int
        Flying tracks without a target.
    scans : int
    """

    due: int
    found: int
    changes: int
    errors: NDArray[np.float64]
    nees: NDArray[np.float64]
    false: int
    scans: int

    @property
    def recall(self) -> float | None:
        """Share of target scans with a track; None without target scans."""
        return self.found / self.due if self.due else None

    @property
    def error(self) -> float | None:
        """Root mean square of the position errors [m]; None without tracks."""
        return float(np.sqrt(np.mean(self.errors**2))) if len(self.errors) else None


def is_due(part: Part) -> NDArray[np.bool_]:
    """Return in which scans each target must have a track, (S, T)."""
    late = part["seconds"][:, None] >= START_S
    return np.asarray((part["hits"] >= FEWEST) & late, np.bool_)


def counts(parts: Sequence[Part], due: Sequence[NDArray[np.bool_]]) -> Counts:
    """Sum the counts of several flights over the target scans that are `due` in each."""
    found = [mask & (part["track"] != NOBODY) for part, mask in zip(parts, due, strict=True)]
    pairs = list(zip(parts, found, strict=True))
    return Counts(
        due=int(sum(mask.sum() for mask in due)),
        found=int(sum(mask.sum() for mask in found)),
        changes=sum(_changes(part["track"]) for part in parts),
        errors=np.concatenate([part["error"][mask] for part, mask in pairs]),
        nees=np.concatenate([part["nees"][mask] for part, mask in pairs]),
        false=sum(len(part["false"]) for part in parts),
        scans=int(sum(part["scans"] for part in parts)),
    )


def _changes(track: NDArray[np.float64]) -> int:
    """Count how often the track ID of a target changes."""
    of_targets = (column[column != NOBODY] for column in track.T)
    return int(sum((one[1:] != one[:-1]).sum() for one in of_targets))


def passes(part: Part) -> tuple[list[bool], NDArray[np.bool_]]:
    """Return whether each pass has a track by its third detection, and which scans follow it.

    A pass is the time within the scored range; targets turn outside of it. Passes with fewer than
    three detections are left out. The scans, shape (S, T), start with the third detection.
    """
    away = np.linalg.norm(part["place"] - (0.0, 0.0, HEIGHT), axis=2)
    is_seen = (part["hits"] >= FEWEST) & (away <= SOUGHT)
    in_time, due = [], np.zeros(part["hits"].shape, np.bool_)
    for target, column in enumerate(is_seen.T):
        seen = np.flatnonzero(column)
        for run in np.split(seen, np.flatnonzero(np.diff(seen) > APART) + 1):
            detected = run[part["is_detected"][run, target] > 0]
            if len(detected) < 3:
                continue
            third = detected[2]
            in_time.append(bool((part["track"][run[0] : third + 1, target] != NOBODY).any()))
            due[run[run >= third], target] = True
    return in_time, due
