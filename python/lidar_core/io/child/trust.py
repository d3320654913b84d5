"""Trusted files, which the libraries of their formats read in this process."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_TRUSTED: ContextVar[bool] = ContextVar("trusted", default=False)
HAS_CHILDREN = os.name == "posix" and sys.platform != "emscripten"
"""Whether readers can run in a child here; elsewhere all files are read in this process."""


@contextmanager
def trusted_files(is_trusted: bool = True) -> Iterator[None]:
    """Read every file in this process that is opened within the block, as `trusted=True` does."""
    before = _TRUSTED.set(is_trusted)
    try:
        yield
    finally:
        _TRUSTED.reset(before)


def is_trusted(given: bool | None) -> bool:
    """Return whether a file is read in this process: `given`, or the enclosing `trusted_files`."""
    return not HAS_CHILDREN or (_TRUSTED.get() if given is None else given)
