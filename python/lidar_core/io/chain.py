"""Recordings that consist of several files, read as one."""

import heapq
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

from lidar_core.io.options import ReadOptions
from lidar_core.io.recording import Recording
from lidar_core.io.records import Findings, Record, Topic

Opener: TypeAlias = Callable[[Path, ReadOptions], Recording]


class ChainedRecording(Recording):
    """A folder of recordings of one format, merged by time.

    Parameters
    ----------
    path : Path
        The folder.
    options : ReadOptions
        Options for reading the files.
    files : list of Path
        The recordings in it.
    opened : callable
        Function that opens one of the files.
    """

    def __init__(self, path: Path, options: ReadOptions, files: list[Path], opened: Opener) -> None:
        super().__init__(path, options)
        self._stack = ExitStack()
        with ExitStack() as stack:
            self._parts = [stack.enter_context(opened(file, options)) for file in files]
            self._stack = stack.pop_all()
        self.format = f"folder of {self._parts[0].format}"
        self.has_arrivals = all(part.has_arrivals for part in self._parts)

    def topics(self) -> list[Topic]:
        """Streams of all files, by name and kind, with their messages added up.

        The kind tells scans from poses where streams share a name, or have none.
        """
        merged: dict[tuple[str, str], Topic] = {}
        for topic in (topic for part in self._parts for topic in part.topics()):
            key = topic.name, topic.kind
            before = merged.get(key)
            known = topic.count is not None and (before is None or before.count is not None)
            count = (topic.count or 0) + (before.count or 0 if before else 0) if known else None
            merged[key] = replace(topic, count=count)
        return [merged[key] for key in sorted(merged)]

    def noticed(self) -> Findings:
        """Findings of all files so far: detected conventions and skipped messages."""
        merged = Findings()
        for found in (part.noticed() for part in self._parts):
            merged.point_time |= found.point_time
            merged.no_return |= found.no_return
            merged.rejected += found.rejected
            for text in found.notes:
                merged.note(text)
        return merged

    def records(self, kinds: frozenset[str] | None = None) -> Iterator[Record]:
        """Records of all files in time order."""
        parts = [part.records(kinds) for part in self._parts]
        yield from heapq.merge(*parts, key=lambda record: record.time_ns)

    def close(self) -> None:
        """Close every file."""
        self._stack.close()
