"""Folders of this machine that batches pass files through, on their way to an address."""

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lidar_core.run_folder import lock, unlock

PREFIX = "lidar-core-batch-"
YOUNG_S = 60.0
"""A folder this young may belong to a batch that has not locked it yet [s]."""


@contextmanager
def passage() -> Iterator[Path]:
    """A folder that is gone after the block; those that killed batches have left go first.

    They hold recordings, so that disks would fill up where batches are killed again and again.
    """
    remove_abandoned(Path(tempfile.gettempdir()))
    with tempfile.TemporaryDirectory(prefix=PREFIX) as folder:
        place = Path(folder)
        lock(place)
        try:
            yield place
        finally:
            unlock(place)


def remove_abandoned(places: Path) -> None:
    """Remove the folders of batches in `places` that no process holds, as far as they are ours."""
    if os.name != "posix":  # no locks tell which batches still run
        return
    for one in places.glob(f"{PREFIX}*"):
        try:
            found = one.lstat()
            is_young = time.time() - found.st_mtime < YOUNG_S
            if found.st_uid != os.getuid() or is_young or one.is_symlink() or not one.is_dir():
                continue
            lock(one)
        except OSError:  # held by a batch that runs, or removed by another one
            continue
        shutil.rmtree(one, ignore_errors=True)
        unlock(one)
