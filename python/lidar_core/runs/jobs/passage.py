"""Temporary folders of this machine for files that batches send to an address."""

import os
import shutil
import socket
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

from lidar_core.run_folder import is_locked, lock, unlock

PREFIX = f"lidar-core-batch-{quote(socket.gethostname(), safe='')}-"
"""Names of such folders begin so. Workers on other machines make a folder of the same name there,
without a lock: the name of the machine that runs the batch keeps these from being removed."""
YOUNG_S = 60.0
"""A folder this young may belong to a batch that has not locked it yet [s]."""


@contextmanager
def passage() -> Iterator[Path]:
    """Make a folder for the block and remove it afterwards; first remove those of killed batches.

    Such folders hold recordings and would fill the disk if batches are killed repeatedly.
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
    """Remove folders of batches in `places` that belong to this user and that no process holds."""
    if os.name != "posix":  # no locks tell which batches still run
        return
    for one in places.glob(f"{PREFIX}*"):
        try:
            found = one.lstat()
            is_young = time.time() - found.st_mtime < YOUNG_S
            is_ours = found.st_uid == os.getuid() and not one.is_symlink() and one.is_dir()
            if is_young or not is_ours or is_locked(one):
                continue
        except OSError:  # removed by another batch
            continue
        shutil.rmtree(one, ignore_errors=True)
