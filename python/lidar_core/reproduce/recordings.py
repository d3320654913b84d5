"""Recordings that items need and the package does not hold."""

import os
from pathlib import Path

from lidar_core.errors import ConfigError

FOLDER = "LIDAR_CORE_DATA"
"""Variable of the environment that names their folder."""


def recording(name: str) -> Path:
    """Return the file `name`, a path within the folder of recordings.

    Raises
    ------
    ConfigError
        The variable is not set, or the file is not there.
    """
    folder = os.environ.get(FOLDER)
    path = Path(folder or ".") / name
    if not folder or not path.is_file():
        raise ConfigError(
            f"{FOLDER}: expected a folder that holds {name}, got {folder or 'nothing'};"
            " docs/reproduction.md says where the file comes from"
        )
    return path


def is_missing(names: tuple[str, ...]) -> bool:
    """Return whether at least one of these recordings cannot be read."""
    try:
        return not all(recording(name) for name in names)
    except ConfigError:
        return True
