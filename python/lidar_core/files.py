"""Safe access to files that a user names: regular files only, and text of limited length."""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path

from lidar_core.errors import FormatError, InputError, LimitError

__all__ = [
    "MOST_TEXT_BYTES",
    "check_name",
    "check_regular",
    "check_regular_or_folder",
    "check_replaceable",
    "naming",
    "read_text",
    "read_whole",
]

MOST_TEXT_BYTES = 4 * 2**20
"""Largest configuration or note that is read. Source: limits table of SECURITY.md."""
_KINDS = {
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def check_regular(path: str | Path) -> Path:
    """Return `path` if it is a regular file: a pipe blocks its reader, a device may never end.

    Raises
    ------
    FileNotFoundError
        Nothing is there.
    IsADirectoryError
        A folder is there.
    FormatError
        A pipe, a device or a socket is there.
    """
    place = Path(path)
    try:
        mode = place.stat().st_mode
    except FileNotFoundError:
        raise FileNotFoundError(f"{place}: No such file or directory") from None
    except ValueError as error:  # a zero byte in the name
        raise FormatError(f"{str(path)!r}: expected the name of a file: {error}") from error
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(f"{place}: expected a file, got a folder")
    _refuse_special(place, mode)
    return place


def check_regular_or_folder(path: str | Path) -> Path:
    """Return `path` if it is a regular file or a folder; errors as of `check_regular`."""
    place = Path(path)
    if not place.exists():
        raise FileNotFoundError(f"{place}: no such file or folder")
    return place if place.is_dir() else check_regular(place)


def check_name(path: Path) -> None:
    """Reject a file name that is not UTF-8: run notes and tables could not contain it.

    Raises
    ------
    InputError
        The name is not UTF-8.
    """
    try:
        str(path).encode("utf-8")
    except UnicodeEncodeError:
        got = ascii(os.fsencode(path))
        raise InputError(f"expected a file name in UTF-8, got {got}; choose another name") from None


def check_replaceable(path: str | Path) -> None:
    """Refuse to write to a pipe, a device or a socket, because the new file would replace it.

    Raises
    ------
    FormatError
        A pipe, a device or a socket is there.
    InputError
        The name is no UTF-8.
    """
    place = Path(path)
    check_name(place)
    if place.exists():
        mode = place.stat().st_mode
        if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
            raise FormatError(f"{place}: expected a file to write, got {_KINDS[stat.S_IFMT(mode)]}")


def read_whole(path: str | Path, *, limit: int = MOST_TEXT_BYTES) -> bytes:
    """Read the content of a regular file.

    Raises
    ------
    LimitError
        The file is longer than `limit` bytes, or than the free memory.
    FileNotFoundError, IsADirectoryError, FormatError
        See `check_regular`.
    """
    place = check_regular(path)
    # Without O_NONBLOCK a pipe that took the file's place since would block here.
    descriptor = os.open(
        place, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    )
    with open(descriptor, "rb") as file:
        mode = os.fstat(descriptor)
        _refuse_special(place, mode.st_mode)
        # read() takes memory for all that it is asked for: the size of the file, never the limit.
        try:
            content = file.read(min(mode.st_size, limit) + 1)
        except MemoryError as error:
            raise LimitError(f"{place}: not enough memory to read {mode.st_size} bytes") from error
    if len(content) > limit:
        raise LimitError(f"{place}: more than {limit} bytes, the limit of such a file")
    return content


def read_text(path: str | Path, *, limit: int = MOST_TEXT_BYTES) -> str:
    """Read the text of a regular file, which must be UTF-8.

    Raises
    ------
    FormatError
        It is no UTF-8.
    LimitError, FileNotFoundError, IsADirectoryError
        See `read_whole`.
    """
    try:
        return read_whole(path, limit=limit).decode("utf-8")
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: expected text in UTF-8: {error}") from error


def _refuse_special(place: Path, mode: int) -> None:
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "something else")
        raise FormatError(
            f"{place}: expected a regular file, got {kind}; save its data to a file first"
        )


@contextmanager
def naming(path: str | PathLike[str]) -> Iterator[None]:
    """Add the name of a file to errors that the block raises about it."""
    name = os.fspath(path)
    try:
        yield
    except FormatError as error:
        raise FormatError(f"{name}: {error}") from error
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, os.strerror(error.errno), name) from error


def __dir__() -> list[str]:
    return __all__
