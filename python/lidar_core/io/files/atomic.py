"""Files that are complete or absent: written beside their place, then renamed into it."""

import os
import re
import shutil
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from lidar_core.files import check_replaceable

_TEMPORARY = re.compile(r"\.(.+)\.([1-9][0-9]{0,9})\.tmp", re.DOTALL)
"""Name of a temporary file: that of the file it becomes, and the number of the process."""


class WrittenInBlock(ABC):
    """A writer for a `with` block: its file is kept, unless an error ends the block.

    Ctrl-C is not an error: everything written before it is kept.
    """

    @abstractmethod
    def close(self, *, keep: bool = True) -> None:
        """Complete the file and put it in its place, or drop it."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close(keep=kind is None or issubclass(kind, KeyboardInterrupt))


def temporary_for(path: Path) -> Path:
    """Temporary path to write to before `commit`, in the same folder so that the rename is atomic.

    Leftovers of a process that has ended, for the same file, are removed.
    """
    remove_stale(path.parent, name=path.name)
    return path.with_name(f".{path.name}.{os.getpid()}.tmp")


def remove_stale(folder: Path, *, name: str | None = None) -> None:
    """Remove temporary files and folders in `folder` whose processes have ended.

    Parameters
    ----------
    folder : Path
        Folder to clean; nothing happens if it does not exist.
    name : str, optional
        Only those for the file of this name.
    """
    if os.name != "posix" or not folder.is_dir():
        return
    for entry in os.scandir(folder):
        found = _TEMPORARY.fullmatch(entry.name)
        if found is None or name not in (None, found[1]) or _lives(int(found[2])):
            continue
        with suppress(FileNotFoundError):  # another command may do the same
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path)
            else:
                Path(entry.path).unlink()


def is_temporary(name: str) -> bool:
    """Return whether `temporary_for` made a file of this name."""
    return _TEMPORARY.fullmatch(name) is not None


def _lives(process: int) -> bool:
    """Return whether a process with this number runs, also one of another user."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True


def commit(temporary: Path, path: Path) -> None:
    """Put a finished temporary file in its place, on the disk and not only in memory.

    Within `synced_together` it is on the disk at the end of that block, within `unsynced` not.
    """
    if _is_unsynced or _waiting is not None:
        temporary.replace(path)
        if _waiting is not None:
            _waiting[path.absolute()] = None
        return
    _sync(temporary)
    temporary.replace(path)
    _sync_folder(path.parent)


@contextmanager
def synced_together() -> Iterator[None]:
    """Write the files of a block to the disk together, at its end.

    For files that matter only when a later file names them: after a loss of power within the block
    they may be empty. An error leaves them as they are. Only one thread of a process may use this.
    """
    global _waiting  # noqa: PLW0603 all writers of the process look at it
    files, _waiting = dict[Path, None](), {}
    try:
        yield
        files = {path: None for path in _waiting if path.is_file()}
    finally:
        _waiting = None
    if _is_unsynced:
        return
    for path in files:
        _sync(path)
    for folder in dict.fromkeys(path.parent for path in files):
        _sync_folder(folder)


_waiting: dict[Path, None] | None = None
"""What `synced_together` has to bring to the disk; None outside of it."""


@contextmanager
def unsynced() -> Iterator[None]:
    """Write the files of the block atomically, but do not wait until they are on the disk.

    For files that are sent to another machine and then removed here: a loss of power also ends the
    process that would send them. Only one thread of a process may use this.
    """
    global _is_unsynced  # noqa: PLW0603 all writers of the process look at it
    before, _is_unsynced = _is_unsynced, True
    try:
        yield
    finally:
        _is_unsynced = before


_is_unsynced = False


def _sync(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())


def _sync_folder(path: Path) -> None:
    if os.name != "posix":
        return
    folder = os.open(path, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def check_place(path: Path) -> None:
    """Refuse, before any work, a file that cannot be written at `path`.

    Raises
    ------
    FileNotFoundError
        The folder is missing.
    PermissionError
        The folder is not writable.
    IsADirectoryError
        The path is a folder.
    """
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path.parent}: no such folder, to write {path.name} in")
    if not os.access(path.parent, os.W_OK):
        raise PermissionError(f"{path.parent}: no permission to write {path.name} there")
    if path.is_dir():
        raise IsADirectoryError(f"{path}: expected a file to write, got a folder")
    check_replaceable(path)


@contextmanager
def written_whole(path: str | Path, *, synced: bool = True) -> Iterator[Path]:
    """Yield a temporary path to write to; it becomes `path` if the block ends without an error.

    Parameters
    ----------
    path : str or Path
        The file.
    synced : bool
        Wait until the file is on the disk. Without it, the file may be empty after a loss of power;
        other readers see it either complete or not at all.

    Raises
    ------
    FileNotFoundError, PermissionError, IsADirectoryError
        The file cannot be written there: see `check_place`.
    """
    place = Path(path)
    check_place(place)
    temporary = temporary_for(place)
    try:
        yield temporary
        if synced:
            commit(temporary, place)
        else:
            temporary.replace(place)
    finally:
        temporary.unlink(missing_ok=True)
