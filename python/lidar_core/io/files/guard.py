"""Convert exceptions of libraries that read formats, and check sizes before allocation."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager

from pydantic import ValidationError

from lidar_core.errors import FormatError, LidarCoreError, LimitError, without_prefix

_FILES_FAULT = (None, errno.EINVAL, errno.EOVERFLOW)
"""Numbers of an OSError that a broken file causes: bz2 gives none, a seek beyond any file these."""


@contextmanager
def reading(place: str) -> Iterator[None]:
    """Turn any exception of a library that reads `place` into a typed error that names it.

    Raises
    ------
    FormatError
        The library reports an error.
    LimitError
        The library asked for too much memory: a size in the file is wrong, or the machine is too
        small.
    """
    try:
        yield
    except LidarCoreError:
        raise
    except MemoryError as error:
        text = str(error).strip().rstrip(".")
        raise LimitError(
            f"{place}: takes more memory than available" + (f" ({text})" if text else "")
        ) from error
    except Exception as error:
        if isinstance(error, OSError) and error.errno not in _FILES_FAULT:
            raise
        text = _one_line(error) or "no further text"
        raise FormatError(f"{place}: cannot be read: {type(error).__name__}: {text}") from error


def _one_line(error: Exception) -> str:
    """Return the text of an error in one line; of a validation error, its problems."""
    if isinstance(error, ValidationError):
        problems = error.errors(include_url=False, include_context=False)
        return "; ".join(
            f"{'.'.join(map(str, one['loc']))}: {without_prefix(one['msg'])}" for one in problems
        )
    return " ".join(str(error).split()).rstrip(".")


def check_size(place: str, size: int, *, limit: int, key: str, what: str) -> None:
    """Refuse a size that comes from a file before anything is allocated for it.

    Raises
    ------
    LimitError
        `size` is greater than `limit`; the text names the option `key` that raises it.
    """
    if size > limit:
        raise LimitError(f"{place}: {what} of {size}, limit {limit}; raise it with {key}")
