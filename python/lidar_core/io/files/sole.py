"""Lock that lets one writer at a time change a group of files."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shlex import join

LARGEST = 4096
"""Bytes that are read of what another process says of itself."""


@contextmanager
def sole_writer(path: Path) -> Iterator[None]:
    """Lock the files that belong to `path` against other writers until the block ends.

    Files that differ only in their endings belong together: NAME.npz, NAME.mcap and NAME.truth.csv.
    The lock is a system lock on `.NAME.lock`. It disappears with its process, so a killed process
    blocks nobody. Systems and file systems without such locks run without a lock.

    Raises
    ------
    FileExistsError
        Another process is writing there; the text names it.
    """
    place = path.with_name(f".{path.with_suffix('').name}.lock")
    held = _lock(place, path)
    try:
        yield
    finally:
        if held is not None:
            place.unlink(missing_ok=True)
            os.close(held)


def _lock(place: Path, path: Path) -> int | None:
    """Open and lock the lock file; None on systems or folders without locks."""
    if os.name != "posix" or not os.access(place.parent, os.W_OK):
        return None  # who may not write there is told so by what writes
    import fcntl

    while True:
        held = os.open(place, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            other = os.pread(held, LARGEST, 0).decode("utf-8", "replace").strip()
            os.close(held)
            raise FileExistsError(
                f"{path}: {other or 'another process'} is writing there; wait until it ends, or"
                " choose another output"
            ) from None
        except OSError:  # a file system without locks
            os.close(held)
            place.unlink(missing_ok=True)
            return None
        if _is_there(place, held):
            os.truncate(held, 0)
            command = join(["lidar-core", *sys.argv[1:]])
            told = f"process {os.getpid()} ({command})"
            os.pwrite(held, told.encode("utf-8", "backslashreplace"), 0)
            return held
        os.close(held)  # its owner took it away between opening and locking


def _is_there(place: Path, held: int) -> bool:
    """Return whether the open file still has this name."""
    try:
        named = place.stat()
    except FileNotFoundError:
        return False
    return os.path.samestat(named, os.fstat(held))
