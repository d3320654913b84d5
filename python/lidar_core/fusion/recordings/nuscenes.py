"""Readers of nuScenes: radar sweeps, and JSON of detections or tracks."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lidar_core.errors import FormatError
from lidar_core.fusion.measurement import Measurement
from lidar_core.fusion.recordings.autoferry import DetectionScan
from lidar_core.fusion.recordings.folders import check_sizes, files_of
from lidar_core.io.files.guard import reading
from lidar_core.io.formats.pcd import PcdRecording
from lidar_core.io.options import LONGEST, ReadOptions

PCD = ".pcd"
SWEEP = re.compile(r".*__(?P<channel>\w+?)__(?P<us>\d{10,19})")
"""Name of a sweep: log, channel, and its time in microseconds."""
FIELDS = ("x", "y", "vx", "vy")
VALID = {"invalid_state": (0,), "dyn_prop": tuple(range(7)), "ambig_state": (3,)}
"""Returns that are used, as the devkit of nuScenes does by default."""
LEAST_SCORE = 0.1
"""Boxes with a smaller score are left out: detectors write hundreds of them, nearly all false."""
SAMPLES = "sample.json"


def is_radar_sweep(path: str | Path) -> bool:
    """True if a file, or the first file of a folder, has the name of a radar sweep of nuScenes.

    Examples
    --------
    >>> is_radar_sweep("n015-2018__RADAR_FRONT__1532402927664178.pcd")
    True
    """
    files = files_of(Path(path), PCD)
    return bool(files) and SWEEP.fullmatch(files[0].stem) is not None


def read_nuscenes_radar(path: str | Path) -> list[DetectionScan]:
    """Read radar sweeps of nuScenes.

    Parameters
    ----------
    path : str or Path
        A sweep NAME__CHANNEL__MICROSECONDS.pcd, or a folder of them, also of several channels.

    Returns
    -------
    scans : list of DetectionScan
        Scans by time, including empty ones; `source` is the channel. Range, bearing and range rate
        in the frame of the radar, x ahead and y to the left. Returns that the radar marks as
        invalid or ambiguous are left out.

    Raises
    ------
    FormatError
        A file is no such sweep; the text names the file.
    LimitError
        More than 256 MiB, or a sweep that is too large.
    MissingExtraError
        The extra `io` is not installed.

    Notes
    -----
    The range rate is that of the measured velocity (vx, vy), which is relative to the moving
    radar; vx_comp and vy_comp are not read.

    Source: Caesar et al., "nuScenes: A multimodal dataset for autonomous driving", CVPR 2020.
    """
    place = Path(path)
    files = files_of(place, PCD)
    if not files:
        raise FormatError(
            f"{place}: expected a radar sweep of nuScenes (.pcd), or a folder of them"
        )
    check_sizes(place, files)
    scans = [_sweep(file) for file in files]
    return sorted(scans, key=lambda scan: (scan.stamp_ns, scan.source))


def _sweep(file: Path) -> DetectionScan:
    named = SWEEP.fullmatch(file.stem)
    stamp_ns = 0 if named is None else int(named["us"]) * 1000
    if named is None or stamp_ns > LONGEST * 1e9:
        raise FormatError(f"{file}: expected a name that ends with __CHANNEL__MICROSECONDS.pcd")
    rows = PcdRecording(file, ReadOptions(), [file]).rows(file).reshape(-1)
    there = rows.dtype.names or ()
    missing = [name for name in FIELDS if name not in there]
    if missing:
        listed = ", ".join(there) or "none"
        raise FormatError(f"{file}: no field {missing[0]} among {listed}; no radar sweep")
    wanted = np.ones(len(rows), bool)
    for name, values in VALID.items():
        if name in there:
            wanted &= np.isin(rows[name], values)
    x, y, vx, vy = (rows[name].astype(np.float64) for name in FIELDS)
    far = np.hypot(x, y)
    wanted &= np.isfinite(x + y + vx + vy) & (far > 0)
    rate = (x * vx + y * vy)[wanted] / far[wanted]
    found = np.stack([far[wanted], np.arctan2(y, x)[wanted], rate], axis=1)
    seen = [Measurement(stamp_ns, "radar", values) for values in found]
    return DetectionScan(stamp_ns, named["channel"], seen, np.zeros(2), {})


def read_nuscenes_boxes(path: str | Path) -> list[DetectionScan]:
    """Read results of nuScenes' detection or tracking challenge: places of boxes in the world.

    Parameters
    ----------
    path : str or Path
        NAME.json with `results`: boxes by the token of a sample. The times of samples are those
        of sample.json beside it; where tokens are whole numbers they are times [ns], as
        `lidar_core.io.write_nuscenes` writes.

    Returns
    -------
    scans : list of DetectionScan
        Scans by time, including empty ones; `source` is "lidar". Boxes with a score below 0.1 are
        left out; their size, heading, velocity and class are not read.

    Raises
    ------
    FormatError
        The file does not exist or has no times; the text names sample and box.
    LimitError
        More than 256 MiB.
    """
    place = Path(path)
    results = _json(place)
    if not isinstance(results, Mapping) or not isinstance(results.get("results"), Mapping):
        raise FormatError(f"{place}: expected results of nuScenes: boxes by sample under results")
    boxes = results["results"]
    times = _times(place, boxes)
    scans = []
    for token, listed in boxes.items():
        where = f"{place}, sample {token}"
        if not isinstance(listed, list):
            raise FormatError(f"{where}: expected a list of boxes, got {type(listed).__name__}")
        found = []
        for number, box in enumerate(listed):
            if not isinstance(box, Mapping) or "translation" not in box:
                raise FormatError(
                    f"{where}, box {number + 1}: expected a box with a translation, got {box!r:.60}"
                )
            with reading(f"{where}, box {number + 1}"):
                score = float(box.get("detection_score", box.get("tracking_score", 1.0)))
                at = np.array(box["translation"], np.float64)
            if at.shape != (3,) or not np.isfinite(at).all():
                raise FormatError(
                    f"{where}, box {number + 1}: translation: expected three numbers, got"
                    f" {box['translation']!r}"
                )
            if score >= LEAST_SCORE:
                found.append(Measurement(times[token], "lidar", at[:2]))
        scans.append(DetectionScan(times[token], "lidar", found, np.zeros(2), {}))
    if not scans:
        raise FormatError(f"{place}: results hold no sample")
    return sorted(scans, key=lambda scan: scan.stamp_ns)


def _json(place: Path) -> Any:
    check_sizes(place, [place])
    with reading(str(place)):
        return json.loads(place.read_text("utf-8"))


def _times(place: Path, boxes: Mapping[str, Any]) -> dict[str, int]:
    """Time [ns] of every sample."""
    beside = place.with_name(SAMPLES)
    if beside.is_file():
        with reading(str(beside)):
            times = {one["token"]: int(one["timestamp"]) * 1000 for one in _json(beside)}
        missing = next((token for token in boxes if token not in times), None)
        if missing is not None:
            raise FormatError(f"{place}: sample {missing} is not in {beside.name} beside it")
        return {token: times[token] for token in boxes}
    if all(token.isdecimal() and len(token) < 19 for token in boxes):
        return {token: int(token) for token in boxes}
    raise FormatError(
        f"{place}: the file states no times; put {SAMPLES} of nuScenes' tables (v1.0-trainval)"
        " beside it"
    )


def is_boxes(path: Path) -> bool:
    """Return whether a JSON file contains an object, as results of nuScenes do, and not a list."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(64)
    return head.decode("utf-8-sig", "replace").lstrip().startswith("{")
