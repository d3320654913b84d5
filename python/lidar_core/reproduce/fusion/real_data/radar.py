"""Objects from the radar of a moving car: consistency, and static objects."""

import tarfile
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from lidar_core.fusion import DetectionScan, MultiTargetConfig, MultiTargetTracker, read_delphi
from lidar_core.fusion.places import geographic_poses
from lidar_core.reproduce.recordings import recording
from lidar_core.reproduce.types import Row

DELPHI = "radar/delphi_esr/front_radar_15-19-58_120s.tar.xz"
SCANS = 400
"""Of 2,402 in the recording."""
STANDS = 0.3
"""A measured range rate this near to that of the ground is of something that stands [m/s]."""
ROUNDS = 20


def radar_rows(count: int) -> list[Row]:
    """Scores of the first `count` scans, with the default tracker, in the frame of the radar."""
    scans = objects(count)
    tracker, nis, rates, reported = MultiTargetTracker(MultiTargetConfig()), [], [], []
    for scan in scans:
        result = tracker.process(scan.stamp_ns, scan.measurements, source=scan.source)
        tracks = tracker.tracks_at(scan.stamp_ns)
        nis.append(result.nis)
        reported += tracks.id.tolist()
        stands = standing(scan)
        for number in np.unique(result.id[stands]).tolist():
            (row,) = np.flatnonzero(tracks.id == number)[:1] if number in tracks.id else (None,)
            if row is not None:
                sight = tracks.position[row] / np.linalg.norm(tracks.position[row])
                rates.append(tracks.velocity[row] @ sight - sight @ ground(scan))
    told = np.concatenate(nis)
    compared = told[np.isfinite(told)]
    of_measurements = [m for scan in scans for m in scan.measurements]
    values: dict[tuple[str, str], float] = {
        ("scans", "1"): float(len(scans)),
        ("objects per scan", "1"): len(of_measurements) / len(scans),
        ("tracks", "1"): float(len(set(reported))),
        ("NIS per value", "1"): float(compared.mean() / 3),
        ("what stands, range rate of its track after ego motion, rms", "m/s"): float(
            np.sqrt(np.square(rates).mean())
        ),
        ("alarms", "1"): float(geographic_poses(of_measurements) is not None),
    }
    return [
        Row(f"delphi esr/{what}", unit, best_mode=value) for (what, unit), value in values.items()
    ]


def objects(count: int) -> list[DetectionScan]:
    """The first `count` scans of the recording."""
    with TemporaryDirectory() as folder, tarfile.open(recording(DELPHI)) as archive:
        for member in archive:
            content = archive.extractfile(member) if member.isfile() else None
            if content is not None and member.name.endswith(".csv"):
                (Path(folder) / Path(member.name).name).write_bytes(content.read())
        return read_delphi(folder)[:count]


def ground(scan: DetectionScan) -> NDArray[np.float64]:
    """Return the velocity (2,) of static objects relative to the radar [m/s].

    Most objects are static: the fit to their range rates has weights that fall with the residual.
    """
    sights, rates = _directions_and_rates(scan)
    velocity = np.array([np.median(rates) if len(rates) else 0.0, 0.0])
    for _ in range(ROUNDS if len(rates) > 2 else 0):
        weights = 1 / (1 + np.square((rates - sights @ velocity) / STANDS))
        normal = sights.T @ (weights[:, None] * sights) + 1e-6 * np.eye(2)
        velocity = np.linalg.solve(normal, sights.T @ (weights * rates))
    return velocity


def standing(scan: DetectionScan) -> NDArray[np.bool_]:
    """Return which measurements of a scan belong to static objects."""
    sights, rates = _directions_and_rates(scan)
    return np.asarray(np.abs(rates - sights @ ground(scan)) < STANDS)


def _directions_and_rates(scan: DetectionScan) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Directions (K, 2) and range rates (K,) of a scan."""
    values = np.array([m.values for m in scan.measurements]).reshape(-1, 3)
    return np.stack([np.cos(values[:, 1]), np.sin(values[:, 1])], axis=1), values[:, 2]
