"""Recording that a child process reads, with the same messages, order and errors."""

import os
from collections import Counter, deque
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from lidar_core.io.child.client import ReaderLink, valued
from lidar_core.io.info import RecordingInfo, info_of
from lidar_core.io.options import ReadOptions
from lidar_core.io.recording import Recording
from lidar_core.io.records import Record, Topic


class ChildRecording(Recording):
    """Recording that a child process parses; the process sends records in advance.

    Parameters
    ----------
    path : Path
        File or folder.
    options : ReadOptions
        Options for reading it.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        super().__init__(path, options)
        self._link = ReaderLink(path)
        self._streams: dict[int, deque[dict[str, Any]]] = {}
        self._n_streams = 0
        self._temporary: TemporaryDirectory[str] | None = None
        self._known: list[Topic] = []
        try:
            is_packed = path.suffix == ".zstd" or (path.is_dir() and any(path.glob("*.zstd")))
            if is_packed:
                self._temporary = TemporaryDirectory(prefix="lidar_core-")
            opened = self._ask(
                "open",
                path=str(path),
                folder=os.getcwd(),
                options=options.model_dump(mode="json", exclude_unset=True),
                most_written=options.max_unpacked_bytes if is_packed else 0,
                temporary=self._temporary.name if self._temporary is not None else None,
            )
            self.format = str(opened["format"])
            self.has_arrivals = bool(opened["has_arrivals"])
            self._topics = [Topic(**one) for one in opened["topics"]]
        except BaseException:
            self.close()
            raise

    def topics(self) -> list[Topic]:
        """Streams of the recording, by name."""
        return list(self._topics)

    def close(self) -> None:
        """End the child."""
        self._link.close()
        if self._temporary is not None:
            self._temporary.cleanup()

    def info(self) -> RecordingInfo:
        """Topics, rates, frames, time span and defects."""
        return info_of(self._ask("info"))

    def first_stamp(self) -> int | None:
        """Time of the first scan or moving pose [ns]; None without."""
        first = self._ask("first_stamp")
        return None if first is None else int(first)

    def records(self, kinds: frozenset[str] | None = None) -> Iterator[Record]:
        """Stored messages in time order; only topics of `kinds`, if given."""
        stream, self._n_streams = self._n_streams, self._n_streams + 1
        wanted = None if kinds is None else sorted(kinds)
        more = partial(self._link.send, "more", stream=stream, kinds=wanted)
        waiting = self._streams[stream] = deque[dict[str, Any]]()
        is_new = True
        try:
            more()
            while True:
                while not waiting:
                    self._receive()
                frame = waiting.popleft()
                if is_new and not frame.keys() & {"pause", "end"}:
                    more()  # the child goes on while the caller works on what is here
                is_new = "pause" in frame
                yield from (self._record(stream, wanted, *item) for item in frame["items"])
                valued(frame)
                if "end" in frame:
                    return
        finally:
            self._streams.pop(stream, None)
            if self._link.is_open:
                self._link.send("stop", stream=stream)

    def _record(
        self,
        stream: int,
        kinds: list[str] | None,
        number: int,
        topic: int,
        time_ns: int,
        has_parse: bool,
        found: dict[str, Any],
    ) -> Record:
        def of(what: str) -> Callable[[], Any]:
            if what in found:
                return partial(valued, found[what])
            return partial(self._ask, "read", stream=stream, number=number, what=what, kinds=kinds)

        parse = of("parse") if has_parse else None
        return Record(self._known[topic], int(time_ns), of("decode"), parse)

    def _ask(self, kind: str, **values: Any) -> Any:
        """Send a request; return the value of its answer. Earlier records go to their streams."""
        self._link.send(kind, **values)
        while (answer := self._receive()) is None:
            pass
        return valued(answer)

    def _receive(self) -> dict[str, Any] | None:
        """Receive the next answer to a request; None for a record, which goes to its stream."""
        frame = self._link.receive()
        self._note(frame)
        if "stream" not in frame:
            return frame
        if (waiting := self._streams.get(frame["stream"])) is not None:
            waiting.append(frame)
        return None

    def _note(self, answer: dict[str, Any]) -> None:
        """Add the new topics and findings of the child that an answer contains."""
        self._known += [Topic(**one) for one in answer.get("topics", ())]
        news = answer.get("news")
        if news is None:
            return
        self.findings.point_time |= news["point_time"]
        self.findings.no_return |= news["no_return"]
        self.findings.rejected += Counter(news["rejected"])
        for text in news["notes"]:
            self.findings.note(text)
