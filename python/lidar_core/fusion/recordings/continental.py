"""Reader of the object and detection lists of Continental radars, as YAML."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.extras import require
from lidar_core.fusion.measurement import MEASURES, Measurement
from lidar_core.fusion.recordings.autoferry import DetectionScan
from lidar_core.fusion.recordings.folders import check_sizes, files_of, head_of
from lidar_core.fusion.recordings.radar_tracks import radar_of_track
from lidar_core.io.files.guard import reading

ENDINGS = (".yaml", ".yml")
LISTS = ("objects", "detections")
METADATA = "metadata.yaml"
"""What a ROS 2 folder holds beside its recording."""


def is_continental(path: str | Path) -> bool:
    """Return whether a YAML file, or the first file of a folder, contains a list of a radar."""
    head = head_of(_files(Path(path))).decode("utf-8", "replace")
    return any(f"\n{name}:" in head for name in LISTS)


def read_continental(path: str | Path) -> list[DetectionScan]:
    """Read detections or tracks of ARS548 and SRR520 radars, scan by scan.

    Parameters
    ----------
    path : str or Path
        A YAML file of messages ContinentalArs548DetectionList, ContinentalArs548ObjectList,
        ContinentalSrr520DetectionList or ContinentalSrr520ObjectList of continental_msgs, with
        one message or several between lines `---`, as `ros2 topic echo` prints them; or a folder
        of such files.

    Returns
    -------
    scans : list of DetectionScan
        Scans by time, including empty ones; `source` is the frame of the radar and the kind of the
        list. Detections have range, bearing, elevation and range rate with standard deviations, as
        far as they are valid; objects have range, bearing and range rate of position and velocity.

    Raises
    ------
    FormatError
        The files have no such lists; the text names file, message, entry and key.
    LimitError
        More than 256 MiB.
    MissingExtraError
        The extra `io` is not installed.

    Notes
    -----
    Angles are counter-clockwise from ahead. Velocities of objects of an ARS548 are relative to the
    radar, as its messages state; those of an SRR520 are over ground, and the velocity of the radar
    is subtracted.
    """
    place = Path(path)
    files = _files(place)
    if not files:
        raise FormatError(f"{place}: expected a YAML file of a radar's lists, or a folder of them")
    check_sizes(place, files, what="object lists")
    scans = [scan for file in files for scan in _scans(file)]
    if not scans:
        raise FormatError(f"{place}: no list of a radar in it")
    return sorted(scans, key=lambda scan: (scan.stamp_ns, scan.source))


def _files(place: Path) -> list[Path]:
    found = files_of(place, *ENDINGS)
    return [one for one in found if one.name != METADATA] if place.is_dir() else found


def _scans(file: Path) -> Iterator[DetectionScan]:
    yaml = require("ruamel.yaml", extra="io", purpose="reading YAML")
    with reading(str(file)):
        messages = list(yaml.YAML(typ="safe").load_all(file.read_text("utf-8")))
    for number, message in enumerate(message for message in messages if message is not None):
        yield _scan(f"{file}, message {number + 1}", message)


def _scan(place: str, message: Any) -> DetectionScan:
    kind = next((k for k in LISTS if isinstance(message, Mapping) and k in message), None)
    if kind is None:
        got = ", ".join(map(str, message)) if isinstance(message, Mapping) else type(message)
        raise FormatError(f"{place}: expected a list of {' or of '.join(LISTS)}, got {got}")
    stamp = _numbers(message, "header.stamp.sec", "header.stamp.nanosec", place=place)
    stamp_ns = int(stamp[0]) * 10**9 + int(stamp[1])
    if (stamp % 1).any() or not -(2**63) <= stamp_ns < 2**63:
        raise FormatError(
            f"{place}: header.stamp: expected whole seconds and nanoseconds within 64 bits, got"
            f" {stamp[0]:g} and {stamp[1]:g}"
        )
    entries = message[kind] or []
    if not isinstance(entries, list):
        raise FormatError(f"{place}: {kind}: expected a list, got {type(entries).__name__}")
    found = []
    for number, entry in enumerate(entries):
        where = f"{place}, {kind} {number + 1}"
        one = _object(stamp_ns, message, entry, where) if kind == "objects" else None
        one = _detection(stamp_ns, entry, where) if kind == "detections" else one
        found += [] if one is None else [one]
    frame = message["header"].get("frame_id", "radar")
    return DetectionScan(stamp_ns, f"{frame} {kind}", found, np.zeros(2), {})


def _numbers(entry: Any, *keys: str, place: str) -> NDArray[np.float64]:
    """Read the finite numbers of an entry under `keys`; a point separates the parts of a key.

    Raises
    ------
    FormatError
        A key is not there, or holds something else.
    """
    found = []
    for key in keys:
        value = entry
        for part in key.split("."):
            if not isinstance(value, Mapping) or part not in value:
                raise FormatError(f"{place}: no key {key}")
            value = value[part]
        is_number = isinstance(value, int | float) and abs(value) < 1e18
        if not is_number:
            raise FormatError(f"{place}: {key}: expected a number, got {value!r}")
        found.append(float(value))
    return np.array(found)


def _detection(stamp_ns: int, entry: Any, place: str) -> Measurement | None:
    """Convert a detection to a measurement; None if the radar marks range or azimuth as invalid."""
    names = {
        "range": ("range", "distance"),
        "bearing": ("azimuth_angle", "azimuth"),
        "elevation": ("elevation_angle", "elevation"),
        "range_rate": ("range_rate", "range_rate"),
    }
    _numbers(entry, "range", "azimuth_angle", place=place)
    there = [
        name
        for name in MEASURES
        if names[name][0] in entry and not entry.get(f"invalid_{names[name][1]}", False)
    ]
    if "range" not in there or "bearing" not in there:
        return None
    keys = [names[name][0] for name in there]
    values = _numbers(entry, *keys, place=place)
    if not values[0] > 0:
        return None
    spread = None
    if all(f"{key}_std" in entry for key in keys):
        stds = _numbers(entry, *(f"{key}_std" for key in keys), place=place)
        spread = np.diag(stds**2) if (stds > 0).all() else None
    return Measurement(stamp_ns, "radar", values, spread, measures=there)


def _object(stamp_ns: int, message: Any, entry: Any, place: str) -> Measurement | None:
    """Convert a tracked object to a measurement; None for an object at the radar itself."""
    if "dist_x" in entry:
        position = _numbers(entry, "dist_x", "dist_y", place=place)
        own = _numbers(message, "ego_vx", place=place)
        velocity = _numbers(entry, "v_abs_x", "v_abs_y", place=place) - [own[0], 0.0]
        place_stds = _numbers(entry, "dist_x_std", "dist_y_std", place=place)
        speed_stds = _numbers(entry, "v_abs_x_std", "v_abs_y_std", place=place)
        across = np.zeros(2)
    else:
        position = _numbers(entry, "position.x", "position.y", place=place)
        velocity = _numbers(entry, "relative_velocity.x", "relative_velocity.y", place=place)
        place_stds = _numbers(entry, "position_std.x", "position_std.y", place=place)
        speed_stds = _numbers(
            entry, "relative_velocity_std.x", "relative_velocity_std.y", place=place
        )
        across = _numbers(
            entry, "position_covariance_xy", "relative_velocity_covariance_xy", place=place
        )
    spreads = []
    for stds, covariance in zip((place_stds, speed_stds), across, strict=True):
        spread = np.diag(stds**2)
        spread[0, 1] = spread[1, 0] = covariance
        spreads.append(spread)
    return radar_of_track(stamp_ns, position, velocity, spreads[0], spreads[1])
