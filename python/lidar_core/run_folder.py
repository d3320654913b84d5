"""The folder that a run writes: complete files, and a note about their origin."""

import csv
import hashlib
import json
import os
import platform
import shutil
import sys
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from shlex import join
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from lidar_core import _core
from lidar_core._core import __version__
from lidar_core.config import Config
from lidar_core.errors import FormatError
from lidar_core.extras import require
from lidar_core.files import check_name, check_regular_or_folder
from lidar_core.io.files.atomic import is_temporary, remove_stale, written_whole

__all__ = [
    "CHECKPOINT",
    "FILES",
    "RUN_FILE",
    "TRACKS_FOLDER",
    "UNFINISHED",
    "RunFolder",
    "build_digest",
    "command_line",
    "fingerprint",
    "is_locked",
    "lock",
    "note_of",
    "remove_checkpoint",
    "table_in",
    "unlock",
]

RUN_FILE = "run.toml"
UNFINISHED = "run.unfinished"
"""File that a run writes first and removes when run.toml is there."""
CHECKPOINT = "run.checkpoint"
"""File of a run that can go on after it was killed; its parts lie beside it."""
FILES = (
    "circles.csv",
    "circles.parquet",
    "detections.csv",
    "detections.parquet",
    "film.gif",
    "film.mp4",
    "map.csv",
    "map.lcvm",
    "map.parquet",
    "picture.png",
    "report.html",
    "run.mcap",
    RUN_FILE,
    "scene.toml",
    "shapes.csv",
    "shapes.parquet",
    "states.csv",
    "states.parquet",
    "summary.json",
    "timing.csv",
    "timing.parquet",
    "tracks.csv",
    "tracks.parquet",
    "truth.csv",
    "truth.parquet",
)
TRACKS_FOLDER = "tracks_tum"


class RunFolder:
    """A folder for the results of one run.

    Parameters
    ----------
    path : Path
        Folder, which `begin` makes if it is missing.
    overwrite : bool
        Replace the results of an earlier run in the folder. Other files are never touched.
    reads : Path, optional
        Recording that the run reads.
    resume : bool
        Continue a run that did not finish.

    Raises
    ------
    InputError
        The name of the folder is not UTF-8.
    FileExistsError
        There is something in it, and `overwrite` is not given, or no run wrote it; or the
        recording lies in it; or the run is complete, and `resume` is given.
    """

    def __init__(
        self, path: Path, *, overwrite: bool, reads: Path | None = None, resume: bool = False
    ) -> None:
        self.path = path
        self._resumes = resume
        check_name(path)
        if not path.exists():
            return
        if not path.is_dir():
            raise FileExistsError(f"{path}: expected a folder, got a file; choose another name")
        if all(is_temporary(one.name) for one in path.iterdir()):
            return
        is_cut = (path / UNFINISHED).exists()
        if not is_cut and not (path / RUN_FILE).exists():
            raise FileExistsError(f"{path}: holds files that no run wrote; choose another folder")
        if is_cut:
            lock(path)  # refuses where the run is still being written
            unlock(path)
        if resume and not is_cut and not (path / CHECKPOINT).exists():
            raise FileExistsError(
                f"{path}: holds a complete run; nothing to resume; a new run needs another folder,"
                " or overwrite=True"
            )
        if not overwrite and not resume:
            told = "a run that did not come to its end" if is_cut else "an earlier run"
            goes_on = ", resume=True goes on" if (path / CHECKPOINT).exists() else ""
            raise FileExistsError(f"{path}: holds {told}; overwrite=True replaces it{goes_on}")
        if reads is not None and reads.resolve().is_relative_to(path.resolve()):
            raise FileExistsError(f"{path}: holds the recording to read; choose another folder")

    def begin(self) -> None:
        """Make the folder, and remove the files of an earlier run, except those that are continued.

        Raises
        ------
        FileExistsError
            Another process is writing a run there.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        lock(self.path)
        remove_stale(self.path)
        # First of all files, and the last to go: by it a run that was killed is known.
        self.write_text(UNFINISHED, f"{command_line()}\n".encode("utf-8", "replace").decode())
        if not self._resumes:
            remove_checkpoint(self.path)
        for name in (RUN_FILE, *FILES):
            (self.path / name).unlink(missing_ok=True)
        shutil.rmtree(self.path / TRACKS_FOLDER, ignore_errors=True)

    def write_text(self, name: str, text: str) -> None:
        """Write a text file atomically."""
        with written_whole(self.path / name) as temporary:
            temporary.write_text(text, encoding="utf-8")

    def write_summary(self, summary: Mapping[str, Any]) -> None:
        """Write summary.json."""
        self.write_text("summary.json", json.dumps(summary, indent=2) + "\n")

    def write_note(
        self, inputs: Mapping[str, Any], config: Mapping[str, Config], **more: Any
    ) -> None:
        """Write run.toml: command, versions, inputs and the whole effective configuration."""
        self.write_text(RUN_FILE, note_of(inputs, config, **more))
        (self.path / UNFINISHED).unlink(missing_ok=True)
        unlock(self.path)

    def write_table(self, name: str, columns: Mapping[str, NDArray[Any] | Sequence[str]]) -> Path:
        """Write columns of equal length as NAME.parquet if pyarrow is installed, else NAME.csv."""
        if find_spec("pyarrow") is None:
            path = self.path / f"{name}.csv"
            with (
                written_whole(path) as temporary,
                temporary.open("w", newline="", encoding="utf-8") as file,
            ):
                writer = csv.writer(file)
                writer.writerow(columns)
                writer.writerows(zip(*map(_plain, columns.values()), strict=True))
            return path
        arrow = require("pyarrow", extra="tables", purpose="writing Parquet")
        parquet = require("pyarrow.parquet", extra="tables", purpose="writing Parquet")
        path = self.path / f"{name}.parquet"
        with written_whole(path) as temporary:
            parquet.write_table(arrow.table(dict(columns)), temporary)
        return path


def remove_checkpoint(folder: Path) -> None:
    """Remove the checkpoint of a run, beginning with the file that names its parts."""
    (folder / CHECKPOINT).unlink(missing_ok=True)
    for part in folder.glob(".checkpoint-*"):
        part.unlink(missing_ok=True)


_LOCKS: dict[Path, int] = {}
"""Folders that this process writes to, open."""


def lock(folder: Path) -> None:
    """Keep other processes from writing a run to `folder`, until `unlock` or the end of this one.

    Systems without such locks run without a lock.

    Raises
    ------
    FileExistsError
        Another process has the lock.
    """
    unlock(folder)
    if os.name != "posix":
        return
    import fcntl

    held = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(held)
        raise FileExistsError(f"{folder}: another run is being written there") from None
    except OSError:  # a file system without locks
        os.close(held)
        return
    _LOCKS[folder.resolve()] = held


def unlock(folder: Path) -> None:
    """Release this process's lock on `folder`."""
    held = _LOCKS.pop(folder.resolve(), None)
    if held is not None:
        os.close(held)


def is_locked(folder: Path) -> bool:
    """Return whether any process has the lock of `folder`; True if that cannot be determined."""
    if os.name != "posix" or folder.resolve() in _LOCKS:
        return True
    import fcntl

    tried = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(tried, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # held, or a file system without locks
        return True
    finally:
        os.close(tried)
    return False


def note_of(inputs: Mapping[str, Any], config: Mapping[str, Config], **more: Any) -> str:
    """Return a note about results in TOML: command, versions, inputs, configuration."""
    note = {
        "command": command_line(),
        **more,
        "versions": {
            "lidar_core": __version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "platform": platform.platform(),
        },
        "input": dict(inputs),
        "config": {name: tomllib.loads(model.to_toml()) for name, model in config.items()},
    }
    # Names of files that are no UTF-8 stand with question marks: TOML holds nothing else.
    return tomli_w.dumps(note).encode("utf-8", "replace").decode("utf-8")


def command_line() -> str:
    """Return the running command in the syntax of a shell."""
    return join(["lidar-core", *sys.argv[1:]])


def table_in(folder: Path, name: str) -> Path | None:
    """Return the table NAME of a run folder in either format; None without one."""
    places = (folder / f"{name}{suffix}" for suffix in (".parquet", ".csv"))
    return next((place for place in places if place.is_file()), None)


def fingerprint(path: Path) -> dict[str, Any]:
    """Return path, size and SHA-256 of a file, or of all files of a folder by name."""
    is_folder = check_regular_or_folder(path).is_dir()
    files = [path] if not is_folder else sorted(file for file in path.rglob("*") if file.is_file())
    if not files:
        raise FormatError(f"{path}: the folder is empty")
    digest, size = hashlib.sha256(), 0
    for file in files:
        with file.open("rb") as content:
            one = hashlib.file_digest(content, "sha256")
        size += file.stat().st_size
        if not is_folder:
            digest = one
            continue
        digest.update(f"{one.hexdigest()}  {file.relative_to(path).as_posix()}\n".encode())
    return {"path": str(path), "bytes": size, "sha256": digest.hexdigest()}


@cache
def build_digest() -> str:
    """Return a digest of the core and of the package: other builds may give other results."""
    digest = hashlib.sha256(Path(_core.__file__).read_bytes())
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _plain(column: NDArray[Any] | Sequence[str]) -> list[Any]:
    return column.tolist() if isinstance(column, np.ndarray) else list(column)


def __dir__() -> list[str]:
    return __all__
