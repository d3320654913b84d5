"""Limits of a reader in a child process: memory, processor time, files that it writes."""

import os
import time
from pathlib import Path

MEMORY = 2 * 2**30
"""Memory of its own: heap, stacks, arrays; files that it maps do not count [bytes]."""
CPU = 10
"""Processor time from one answer to the next [s], and beside it one second for every `CPU_BYTES`
of the files: an index of a large recording takes time."""
CPU_BYTES = 16 * 2**20
CLOCK = 600
"""Longest wait for an answer [s]."""


def limit_child(most_written: int) -> None:
    """Limit this process; Linux counts memory as above, other systems may not."""
    import resource  # Windows has none, and reads in the caller's process

    for kind, value in (
        (resource.RLIMIT_DATA, MEMORY),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, most_written),
    ):
        hard = resource.getrlimit(kind)[1]
        most = value if hard == resource.RLIM_INFINITY else min(value, hard)
        resource.setrlimit(kind, (most, hard))


def allow_cpu(seconds: int) -> None:
    """Allow this process `seconds` [s] more processor time; then the system ends it."""
    import resource

    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    most = int(time.process_time()) + 1 + seconds
    soft = most if hard == resource.RLIM_INFINITY else min(most, hard)
    resource.setrlimit(resource.RLIMIT_CPU, (soft, hard))


def cpu_for(path: Path) -> int:
    """Processor time allowed for one answer about a file or folder [s]."""
    try:
        files = [path] if path.is_file() else list(os.scandir(path))
        size = sum(file.stat().st_size for file in files)
    except OSError:
        size = 0
    return CPU + size // CPU_BYTES
