"""Recordings that are one file, or a folder of files of one kind."""

from collections.abc import Sequence
from pathlib import Path

from lidar_core.files import check_regular
from lidar_core.io.files.guard import check_size

MAX_FILE_BYTES = 256 * 2**20
HEAD_BYTES = 4096


def files_of(place: Path, *endings: str) -> list[Path]:
    """The file `place`, or those of the folder `place`, by name; only with one of `endings`.

    Examples
    --------
    >>> len(files_of(Path("a.PCD"), ".pcd")), len(files_of(Path("a.csv"), ".yaml", ".yml"))
    (1, 0)
    """
    found = place.iterdir() if place.is_dir() else [place]
    return sorted(one for one in found if one.suffix.lower() in endings)


def head_of(files: Sequence[Path]) -> bytes:
    """Return the first bytes of the first file; none without a regular file."""
    if not files or not files[0].is_file():
        return b""
    with files[0].open("rb") as file:
        return file.read(HEAD_BYTES)


def check_sizes(place: Path, files: Sequence[Path], *, what: str = "files") -> None:
    """Reject files of a recording that are together too large, or are not regular files.

    Raises
    ------
    LimitError
        More than 256 MiB.
    FileNotFoundError, IsADirectoryError, FormatError
        See `check_regular`.
    """
    size = sum(check_regular(file).stat().st_size for file in files)
    check_size(str(place), size, limit=MAX_FILE_BYTES, key="nothing", what=f"{what} of bytes")
