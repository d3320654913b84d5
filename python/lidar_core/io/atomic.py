"""Files that are whole or absent: written beside their place, then renamed into it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def temporary_for(path: Path) -> Path:
    """Where to write before `commit`: in the same folder, so that the rename is atomic."""
    return path.with_name(f".{path.name}.{os.getpid()}.tmp")


def commit(temporary: Path, path: Path) -> None:
    """Put a finished temporary file in its place, on the disk and not only in memory."""
    with temporary.open("rb") as file:
        os.fsync(file.fileno())
    temporary.replace(path)
    if os.name == "posix":
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def check_place(path: Path) -> None:
    """Refuse, before any work, a file that could not be put in its place.

    Raises
    ------
    FileNotFoundError
        The folder is missing.
    IsADirectoryError
        A folder is there.
    """
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path.parent}: no such folder, to write {path.name} in")
    if path.is_dir():
        raise IsADirectoryError(f"{path}: expected a file to write, got a folder")


@contextmanager
def written_whole(path: str | Path) -> Iterator[Path]:
    """Temporary path to write to; it becomes `path` if the block ends without an error.

    Raises
    ------
    FileNotFoundError, IsADirectoryError
        It could not become that: see `check_place`.
    """
    place = Path(path)
    check_place(place)
    temporary = temporary_for(place)
    try:
        yield temporary
        commit(temporary, place)
    finally:
        temporary.unlink(missing_ok=True)
