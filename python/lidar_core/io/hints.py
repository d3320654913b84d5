"""Advice for files that are not recordings, from their names and first bytes."""

import os
import shlex
from collections.abc import Iterable
from pathlib import Path

_FIRST = "unpack it first: "
_PACKED = f"compressed; {_FIRST}"
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
    ".bz2": f"{_PACKED}bunzip2 -k FILE",
    ".gz": f"{_PACKED}gunzip -k FILE",
    ".tar": f"an archive; {_FIRST}tar xf FILE",
    ".xz": f"{_PACKED}unxz -k FILE",
    ".zip": f"{_PACKED}unzip FILE",
    ".zst": f"{_PACKED}unzstd FILE",
    ".zstd": f"{_PACKED}unzstd FILE",
}
_ARCHIVE = f"compressed; {_FIRST}tar xf FILE"
_INTO = {"tar": "-C", "unzip": "-d"}
"""Tools that unpack archives of several files, and their options for the folder to fill."""
_LOOKED_AT = 4096  # bytes
POSE_NUMBERS = (8, 12)
"""Numbers in a row of poses: TUM, KITTI."""
RECOVERED = "recovered.npz"
"""File that suggested commands write what is whole of a damaged recording to."""


def recovering(path: Path) -> str:
    """Return the advice for a damaged recording of which parts can be read."""
    command = shlex.join(["lidar-core", "convert", str(path), RECOVERED, "--recover"])
    return f"to save the rest: {command} (in Python: recover=True)"


def unpacker(path: Path) -> str | None:
    """Command that unpacks a file of this name, with FILE for it; None if it is not packed."""
    hint = _ARCHIVE if _is_tar(path) else _HINTS.get(path.suffix.lower(), "")
    return hint.partition(_FIRST)[2] or None


def unpacking(files: Iterable[Path]) -> list[str]:
    """Return commands that unpack the packed files among `files`.

    They unpack into the folder of the file, or into the current one if that is not writable.
    """
    packed = [(file, command.split()) for file in files if (command := unpacker(file))]
    packed.sort(key=lambda one: one[1][0] not in _INTO)  # archives may hold all the scans
    commands = []
    for file, words in packed:
        is_writable, is_archive = os.access(file.parent, os.W_OK), words[0] in _INTO
        into = [_INTO[words[0]], str(file.parent)] if is_archive and is_writable else []
        if is_archive or is_writable:
            commands.append(shlex.join([*words[:-1], str(file), *into]))
        else:  # these tools write beside the file, unless told to print
            commands.append(f"{shlex.join([words[0], '-c', str(file)])} > {shlex.quote(file.stem)}")
    return commands


def _is_tar(path: Path) -> bool:
    """Return whether a name is that of a packed tar archive."""
    is_packed = Path(path.stem).suffix.lower() == ".tar"
    return is_packed or path.suffix.lower() in (".tgz", ".tbz2", ".txz")


def hint_for(path: Path) -> str | None:
    """Advice for a regular file; None if its kind is unknown."""
    suffix = path.suffix.lower()
    if _is_tar(path):
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
