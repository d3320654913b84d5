"""Advice for files that are not recordings, from their names and first bytes."""

import shlex
from pathlib import Path

_PACKED = "compressed; unpack it first: "
_TABLE = (
    "a table holds no scans; measurements are for `lidar-core fuse`, and own arrays of scans become"
    " a recording with `lidar_core.io.write_recording`"
)
_HINTS = {
    ".bt": "a map, not a recording: `lidar-core detect --map`, `lidar_core.io.read_cloud`",
    ".csv": _TABLE,
    ".json": "JSON holds no scans; tables of measurements are for `lidar-core fuse`, the metadata"
    " of an Ouster capture is found beside its .pcap or named with metadata=FILE",
    ".lcvm": "a map, not a recording: `lidar-core detect --map`, `lidar_core.io.read_cloud`",
    ".mat": "MATLAB files are not read; save its tables as CSV for `lidar-core fuse`",
    ".parquet": _TABLE,
    ".txt": "text holds no scans; poses are for pose=FILE, measurements of LiDAR and radar (L/R)"
    " for `lidar-core fuse`",
    ".yaml": "not a recording; of a ROS 2 recording open the folder",
    ".bz2": f"{_PACKED}bunzip2 FILE",
    ".gz": f"{_PACKED}gunzip FILE",
    ".tar": "an archive; unpack it first: tar xf FILE",
    ".xz": f"{_PACKED}unxz FILE",
    ".zip": f"{_PACKED}unzip FILE",
    ".zst": f"{_PACKED}unzstd FILE",
    ".zstd": f"{_PACKED}unzstd FILE",
}
_ARCHIVE = "compressed; unpack it first: tar xf FILE"
_LOOKED_AT = 4096  # bytes
POSE_NUMBERS = (8, 12)
"""Numbers in a row of poses: TUM, KITTI."""
RECOVERED = "recovered.npz"
"""File that suggested commands write what is whole of a damaged recording to."""


def recovering(path: Path) -> str:
    """Advice for a damaged recording of which parts can be read."""
    command = shlex.join(["lidar-core", "convert", str(path), RECOVERED, "--recover"])
    return f"to save the rest: {command} (in Python: recover=True)"


def packed_hint(path: Path) -> str | None:
    """Advice for a compressed file; None for others."""
    hint = hint_for(path)
    return hint if hint is not None and hint.startswith(("compressed", "an archive")) else None


def hint_for(path: Path) -> str | None:
    """Advice for a regular file; None if its kind is unknown."""
    suffix = path.suffix.lower()
    if Path(path.stem).suffix.lower() == ".tar" or suffix in (".tgz", ".tbz2", ".txz"):
        return _ARCHIVE
    if suffix in _LOOKERS:
        with path.open("rb") as file:
            head = file.read(_LOOKED_AT).decode("utf-8", "replace")
        found = _LOOKERS[suffix](path, head)
        if found is not None:
            return found
    return _HINTS.get(suffix)


def _of_text(path: Path, head: str) -> str | None:
    rows = (line.partition("#")[0].split() for line in head.splitlines())
    words = next((row for row in rows if row), [])
    if words[:1] in (["L"], ["R"]):
        return f"text holds no scans; measurements are read with: {_fuse(path)}"
    if len(words) in POSE_NUMBERS and all(map(_is_number, words)):
        pose = f"pose={shlex.quote(str(path))}"
        return f"text holds no scans; these are poses, for the recording they belong to: {pose}"
    return None


def _of_json(path: Path, head: str) -> str | None:
    if '"sensorID"' in head:
        return f"JSON holds no scans; detections of Autoferry are read with: {_fuse(path)}"
    return None


def _of_table(path: Path, head: str) -> str | None:
    names = set(head.partition("\n")[0].strip().split(","))
    if "target_id" in names:
        return (
            "a table holds no scans; these are targets, for the run that shall find them:"
            f" {shlex.join(['lidar-core', 'evaluate', 'run/', str(path)])}"
        )
    if {"track_id", "element_id"} & names:
        return f"a table holds no scans; tracks are for: lidar-core evaluate {path} TRUTH"
    return None


def _fuse(path: Path) -> str:
    return shlex.join(["lidar-core", "fuse", str(path), "-o", "run/"])


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


_LOOKERS = {".txt": _of_text, ".json": _of_json, ".csv": _of_table}
