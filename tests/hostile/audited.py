"""`python -m hostile.audited`: what readers do besides reading, as the interpreter reports it.

Every generated file that no library with code of its own reads is read twice, so that the second
time nothing is imported. Then code that was made from text, a process, a socket, a pickle, or a
file elsewhere is a finding.
"""

import os
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

from hostile.__main__ import _trusted, warm_up
from hostile.entries import Entry, run_folder
from hostile.seeds import Seed, seeds_of
from lidar_core.errors import LidarCoreError

FORBIDDEN = (
    *("exec", "pickle.", "marshal.loads", "socket.", "subprocess.", "ctypes.dlopen", "urllib."),
    *("os.exec", "os.fork", "os.posix_spawn", "os.spawn", "os.startfile", "os.system", "pty."),
)
"""Beginnings of events."""
OF_LIBRARIES = (".bag", ".db3", ".mcap", ".zstd")
"""Endings of ROS, whose library makes code from definitions of messages, in a child."""


class Watch:
    """Notes events of the interpreter while it reads below `place`."""

    def __init__(self) -> None:
        self.place: Path | None = None
        self.found: set[str] = set()
        sys.addaudithook(self._see)

    def _see(self, event: str, values: tuple[object, ...]) -> None:
        if self.place is None:
            return
        if event.startswith(FORBIDDEN):
            self.found.add(f"{event} {str(values)[:120]}")
        elif event == "open" and isinstance(values[0], str | bytes | os.PathLike):
            name = os.path.abspath(os.fsdecode(values[0]))
            if not name.startswith((str(self.place), sys.prefix, sys.base_prefix, os.devnull)):
                self.found.add(f"open {name}")


def read(seed: Seed, entry: Entry, folder: Path, watch: Watch) -> set[str]:
    """Read a file twice; what happened the second time."""
    folder.mkdir()
    for name, data in {**seed.beside, seed.name: seed.data}.items():
        (folder / name).write_bytes(data)
    for place in (None, folder):
        watch.place, watch.found = place, set()
        with suppress(LidarCoreError):  # of readers for which it is no file
            _trusted(entry, folder / seed.name)
        watch.place = None
    return watch.found


def main() -> int:
    warm_up()
    watch, count, bad = Watch(), 0, 0
    with tempfile.TemporaryDirectory() as place:
        found = seeds_of(Path(place) / "seeds", None)
        for ending, seeds in found.items():
            if ending in OF_LIBRARIES:
                continue
            for seed in seeds:
                for entry in {*seed.entries} - {run_folder}:  # which writes a report
                    count += 1
                    for event in read(seed, entry, Path(place) / f"{count}", watch):
                        bad += 1
                        print(f"{seed.name} by {entry.__name__}: {event}")
    print(f"{count} reads, {bad} findings")
    return 1 if bad or not count else 0


if __name__ == "__main__":
    sys.exit(main())
