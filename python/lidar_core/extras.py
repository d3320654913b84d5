"""Import of optional dependencies, in one place, with an error that gives the cure."""

from importlib import import_module
from typing import Any

from lidar_core.errors import MissingExtraError


def require(module: str, *, extra: str, purpose: str) -> Any:
    """Import `module`, which the extra `extra` brings.

    Raises
    ------
    MissingExtraError
        The module is not installed; the text gives the command that installs it.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingExtraError(
            f"{purpose} needs the package {module.partition('.')[0]!r}: "
            f"pip install 'lidar-core[{extra}]'"
        ) from error
