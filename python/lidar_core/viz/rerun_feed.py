"""Bytes of a rerun recording, from a file or a stream, for pages that connect at any time."""

from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Condition
from typing import TypeAlias

BLOCK_BYTES = 2**20
WAKE_S = 1.0  # how soon a page that nobody writes to notices the end
Feed: TypeAlias = Callable[[], Iterator[bytes]]
"""Function that gives each page the blocks of a recording; the blocks may have no end."""


def file_feed(recording: Path) -> Feed:
    """Return a feed of the blocks of a file."""

    def blocks() -> Iterator[bytes]:
        with recording.open("rb") as file:
            while block := file.read(BLOCK_BYTES):
                yield block

    return blocks


class LiveFeed:
    """A stream without end, of which the newest blocks are kept for pages that are opened later.

    Parameters
    ----------
    begin : bytes
        First data for every page, whenever it is opened.
    max_bytes : int
        Size of the blocks that are kept; the oldest ones are dropped. A slower page misses them
        too.
    """

    def __init__(self, begin: bytes, *, max_bytes: int) -> None:
        self._begin, self._max_bytes = begin, max_bytes
        self._kept: deque[bytes] = deque()
        self._bytes = self._first = 0  # first: number of the oldest block that is kept
        self._changed, self._is_ended = Condition(), False

    def add(self, block: bytes) -> None:
        """Append whole messages; returns at once."""
        with self._changed:
            self._kept.append(block)
            self._bytes += len(block)
            while self._bytes > self._max_bytes and len(self._kept) > 1:
                self._bytes -= len(self._kept.popleft())
                self._first += 1
            self._changed.notify_all()

    def end(self) -> None:
        """Mark the end of the stream."""
        with self._changed:
            self._is_ended = True
            self._changed.notify_all()

    def blocks(self) -> Iterator[bytes]:
        """Yield the header, the stored data, and new data until the end."""
        yield self._begin
        number = 0
        while True:
            with self._changed:
                while number >= self._first + len(self._kept):
                    if self._is_ended:
                        return
                    self._changed.wait(WAKE_S)
                number = max(number, self._first)
                block = self._kept[number - self._first]
            number += 1
            yield block
