"""Number of threads that this process may use."""

import os
from contextlib import suppress


def all_threads() -> int:
    """Return the number of threads that this process may use."""
    with suppress(AttributeError):  # not on every platform
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
