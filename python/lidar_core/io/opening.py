"""Selection of the reader for a path, by its content if possible, otherwise by its name."""

import os
from itertools import islice
from pathlib import Path
from typing import Any

from lidar_core.errors import FormatError, did_you_mean
from lidar_core.files import check_regular, check_regular_or_folder
from lidar_core.io.chain import ChainedRecording
from lidar_core.io.child.recording import ChildRecording
from lidar_core.io.child.trust import is_trusted
from lidar_core.io.files.beginnings import likeness
from lidar_core.io.hints import hint_for, unpacker, unpacking
from lidar_core.io.options import ReadOptions
from lidar_core.io.readers import (
    READERS,
    Reader,
    known_formats,
    owner_of,
    reader_of,
    suffix_of,
)
from lidar_core.io.recording import Recording
from lidar_core.io.restamped import RestampedRecording

HOME = "lidar_core.io.formats."
"""Modules of the readers whose libraries a child uses; those of plugins it may not know."""
MOST_FOLDERS = 12
"""Folders that are named where one without a recording was given."""
MOST_FILES = 5_000
"""Files that are looked at for each of these folders, by their names."""
MOST_COMMANDS = 4
"""Commands to unpack files that are told."""


def open_recording(
    path: str | Path,
    options: ReadOptions | None = None,
    *,
    trusted: bool | None = None,
    **values: Any,
) -> Recording:
    """Open a recording of any supported format.

    Parameters
    ----------
    path : str or Path
        File or folder.
    options : ReadOptions, optional
        Options for reading it.
    trusted : bool, optional
        True parses the file in this process. False parses formats of third-party libraries in a
        child process with limits on memory and processor time: a file that crashes a library then
        causes an error. The default is False, or True within `lidar_core.io.trusted_files`.
    **values
        Single fields of `ReadOptions`; they override `options`.

    Returns
    -------
    recording : Recording
        Iterates over `Scan` and `Pose` in time order; a context manager.

    Raises
    ------
    FormatError
        Unknown or broken format; the text names the file and the problem.
    LimitError
        A record is larger than the options allow.
    MissingExtraError
        The format needs a package that is not installed.
    FileNotFoundError
        There is no such file.

    Examples
    --------
    >>> with open_recording("flight.mcap") as recording:  # doctest: +SKIP
    ...     scans = [message for message in recording if isinstance(message, Scan)]
    """
    given = options.model_dump() if options is not None else {}
    chosen = ReadOptions(**(given | values))
    place = Path(path)
    if not place.exists():
        near = did_you_mean(place.name, _names_beside(place))
        raise FileNotFoundError(f"{place}: no such file or folder{near}")
    if chosen.metadata is not None:
        check_regular(chosen.metadata)
    if not is_trusted(trusted) and _is_foreign(place, chosen):
        return ChildRecording(place, chosen)
    if chosen.stamps != "own":
        own = open_recording(place, chosen, trusted=True, stamps="own")
        return RestampedRecording(own, chosen)
    if check_regular_or_folder(place).is_dir():
        return _open_folder(place, chosen)
    if place.stat().st_size == 0:
        raise FormatError(f"{place}: the file is empty")
    return _open_file(place, chosen)


def _is_foreign(path: Path, options: ReadOptions) -> bool:
    """Return whether a third-party library would parse one of these files."""
    if path.is_dir():
        inner = [path, *(path / name for one in READERS.parts() for name in one.subfolders)]
        files = [file for folder in inner if folder.is_dir() for file in folder.iterdir()]
    elif check_regular(path).stat().st_size:
        files = [path]
    else:
        return False
    owners = {owner_of(end) for end in map(suffix_of, files) if end is not None}
    if path.is_file() and (reader := reader_of(path, options)) is not None:
        owners = {reader}
    return any(one.extra is not None and one.module.startswith(HOME) for one in owners)


def _names_beside(path: Path) -> list[str]:
    """Names of other files in the folder in which a file was expected."""
    return [file.name for file in path.parent.iterdir()] if path.parent.is_dir() else []


def _open_file(path: Path, options: ReadOptions) -> Recording:
    reader = reader_of(path, options)
    if reader is not None:
        return reader.opened(path, options, [path])
    if (hint := hint_for(path)) is not None:
        raise FormatError(f"{path}: {hint}")
    raise FormatError(
        f"{path}: unknown format {path.suffix.lower()!r}{likeness(path)};"
        f" readable are: {known_formats()}"
    )


def _open_folder(path: Path, options: ReadOptions) -> Recording:
    files = sorted(file for file in path.iterdir() if file.is_file())
    held = _readers_of(files)
    marked = [one for one in held if one.marker is not None and (path / one.marker).exists()]
    if marked:  # files of one recording come before single ones
        held = {one: held[one] for one in sorted(marked, key=lambda one: one.folder != "together")}
    elif len(held) > 1:
        listed = ", ".join(
            f"{len(found)} of {' or '.join(one.suffixes)}" for one, found in held.items()
        )
        raise FormatError(
            f"{path}: several kinds of recordings in this folder: {listed}; name one"
            " file, or a folder with one kind"
        )
    if not held:
        return _open_subfolder(path, files, options)
    reader, found = next(iter(held.items()))
    if reader.folder == "together":
        return reader.opened(path, options, found)
    if len(found) == 1:
        return _open_file(found[0], options)
    if reader.folder == "merged":
        return ChainedRecording(path, options, found, _open_file)
    listed = ", ".join(file.name for file in found)
    raise FormatError(f"{path}: several recordings in this folder; name one of {listed}")


def _readers_of(files: list[Path]) -> dict[Reader, list[Path]]:
    """Group files by the reader of their endings, in the order of the readers."""
    held: dict[Reader, list[Path]] = {}
    for file in files:
        suffix = suffix_of(file)
        if suffix is not None:
            held.setdefault(owner_of(suffix), []).append(file)
    return {one: held[one] for one in READERS.parts() if one in held}


def _open_subfolder(path: Path, files: list[Path], options: ReadOptions) -> Recording:
    """Open the scans in the subfolders where their format has them, as KITTI does."""
    for reader in READERS.parts():
        for inner in reader.subfolders:
            below = sorted(path.glob(f"{inner}/*"))
            scans = [file for file in below if file.name.lower().endswith(reader.suffixes)]
            if scans:
                return reader.opened(path, options, scans)
    found = ", ".join(sorted({file.suffix or file.name for file in files})) or "no files"
    raise FormatError(f"{path}: no recording in this folder, found {found}; {_advice(path, files)}")


def _advice(path: Path, files: list[Path]) -> str:
    """Advice for a folder without a recording: unpack archives, or name one of its folders."""
    packed = unpacking(files)
    named = packed[:MOST_COMMANDS]
    more = [f"{len(packed) - MOST_COMMANDS} more"] if len(packed) > MOST_COMMANDS else []
    told = [f"unpack first: {'; '.join(named + more)}"] if packed else []
    if folders := _folders_to_name(path):
        told.append(f"name one of the folders in it: {', '.join(folders)}")
    return "; or ".join(told) or f"readable are: {known_formats()}"


def _folders_to_name(path: Path) -> list[str]:
    """Names of the subfolders that contain, at any depth, files to read or to unpack."""
    names = sorted(one.name for one in path.iterdir() if one.is_dir())
    return [name for name in names if _holds_any(path / name)][:MOST_FOLDERS]


def _holds_any(folder: Path) -> bool:
    """Return whether one of the first files in or below a folder can be read or unpacked."""
    below = (Path(place, name) for place, _, names in os.walk(folder) for name in names)
    regular = (file for file in islice(below, MOST_FILES) if file.is_file())
    return any(suffix_of(file) is not None or unpacker(file) for file in regular)
