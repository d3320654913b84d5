"""Server in the child process: it forks a reader for every file, and the reader answers calls.

The process that forks has one thread and has loaded all modules of the readers, so that a reader
starts in milliseconds. It ends, with its readers, when its caller has ended.
"""

import os
import signal
import socket
import struct
import sys
import tempfile
import time
import warnings
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from lidar_core.io.child import limits, wire
from lidar_core.io.records import Findings, Record, Topic

ORDER, ANSWER = struct.Struct("<ci"), struct.Struct("<i")
OPEN, WAIT, END = b"o", b"w", b"e"
LIBRARIES = ("", "rosbags.highlevel", "mcap.reader", "pypcd4", "laspy", "trimesh")
"""Which a file needs, by the number of an order; each has one thread after it was loaded."""
PATIENCE = 1.0
"""A reader that closed its socket ends by itself within this [s]."""
BATCH, BATCH_BYTES = 128, 8 * 2**20
"""Records that are sent ahead, and their bytes."""
FIRST_BATCH = 4
"""Records of the first batch; each next one has twice as many. Who wants only the first records, as
those do who look for a frame or a time, does not wait for others to be read."""
TOGETHER, TOGETHER_BYTES = 32, 2**18
"""Records of one frame, and bytes of their arrays."""
KEPT = 2 * BATCH
"""Records that can still be decoded without reading them again."""


def main(descriptor: int) -> None:
    """Fork a reader for every socket that comes in, until the caller is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    control = socket.socket(fileno=descriptor)
    _load()
    running: set[int] = set()
    try:
        while True:
            data, links, _, _ = socket.recv_fds(control, ORDER.size, 1)
            if len(data) < ORDER.size:
                return
            kind, number = ORDER.unpack(data)
            answer, library = 0, ""
            if kind == OPEN:
                answer = _forked(links[0], control)
                running.add(answer)
                os.close(links[0])
                library = LIBRARIES[number]
            elif number in running:
                running.discard(number)
                answer = _ended(number, patience=PATIENCE if kind == WAIT else 0)
            control.sendall(ANSWER.pack(answer))
            running -= {child for child in running if _has_ended(child)}
            if library:
                with suppress(Exception):  # the next reader of this format has it at once
                    import_module(library)
    except (BrokenPipeError, ConnectionResetError):
        return
    finally:
        for child in running:
            _ended(child, patience=PATIENCE)


def _load() -> None:
    """Import the modules that every reader needs, before readers are forked."""
    import_module("lidar_core.io")
    import_module("lidar_core.io.readers").known_formats()


def _forked(link: int, control: socket.socket) -> int:
    child = os.fork()
    if child:
        return child
    status = 1
    try:
        control.close()
        silent = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(silent, stream)
        with socket.socket(fileno=link) as connected:
            Reader(connected).serve()
        status = 0
    finally:
        os._exit(status)


def _ended(child: int, *, patience: float) -> int:
    """Wait for a reader at most `patience` [s], then kill it; return its exit status."""
    until = time.monotonic() + patience
    while not (found := os.waitpid(child, os.WNOHANG))[0]:
        if time.monotonic() >= until:
            os.kill(child, signal.SIGKILL)
            found = os.waitpid(child, 0)
            break
        time.sleep(0.01)
    return found[1]


def _has_ended(child: int) -> bool:
    """Return whether a reader has ended, without waiting for it."""
    return os.waitpid(child, os.WNOHANG)[0] != 0


class Reader:
    """Reader of one recording in its own process; it answers requests about it."""

    def __init__(self, link: socket.socket) -> None:
        self._link = link
        self._place = ""
        self._cpu = limits.CPU
        self._recording: Any = None
        self._topics: list[Topic] = []
        self._streams: dict[int, Iterator[Record]] = {}
        self._batches: dict[int, int] = {}
        self._counts: Counter[int] = Counter()
        self._kept: OrderedDict[tuple[int, int], Record] = OrderedDict()
        self._wanted: set[tuple[int, str, str]] = set()
        self._told = Findings()
        self._numbers: dict[Topic, int] = {}
        self._n_told = 0

    def serve(self) -> None:
        """Answer requests until the caller has ended."""
        answers: dict[str, Callable[..., Any]] = {
            "open": self._open,
            "call": self._call,
            "info": lambda: self._recording.info().to_dict(),
            "first_stamp": lambda: self._recording.first_stamp(),  # noqa: PLW0108
            "read": self._read,
        }
        try:
            while True:
                request = wire.receive(self._link)
                limits.allow_cpu(self._cpu)
                kind = request.pop("do")
                if kind == "more":
                    self._more(request["stream"], request["kinds"])
                elif kind == "stop":
                    self._stop(request["stream"])
                else:
                    wire.send(self._link, self._answered(answers[kind], request))
        except (EOFError, ConnectionError):
            return
        finally:
            if self._recording is not None:
                self._recording.close()

    def _answered(self, work: Callable[..., Any], request: dict[str, Any]) -> dict[str, Any]:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            try:
                answer = {"value": work(**request)}
            except Exception as error:
                answer = {"error": wire.told_error(error, self._place)}
        return answer | self._found() | {"warned": _told_warnings(warned)}

    def _begin(self, path: str, most_written: int, temporary: str | None, folder: str) -> Path:
        os.chdir(folder)  # the caller's: paths are relative to it, in errors, too
        self._place = path
        place = Path(path)
        self._cpu = limits.cpu_for(place)
        tempfile.tempdir = temporary  # the caller's, who removes it
        limits.limit_child(most_written)
        limits.allow_cpu(self._cpu)
        return place

    def _open(
        self,
        path: str,
        folder: str,
        options: dict[str, Any],
        most_written: int,
        temporary: str | None,
    ) -> dict[str, Any]:
        place = self._begin(path, most_written, temporary, folder)
        opened = import_module("lidar_core.io.opening").open_recording  # it knows this module
        self._recording = opened(place, **options, trusted=True)
        self._topics = self._recording.topics()
        return {
            "format": self._recording.format,
            "has_arrivals": self._recording.has_arrivals,
            "topics": [vars_of(topic) for topic in self._topics],
        }

    def _call(self, name: str, path: str, folder: str, arguments: dict[str, Any]) -> Any:
        module, _, function = name.partition(":")
        return getattr(import_module(f"lidar_core.io.{module}"), function)(
            self._begin(path, 0, None, folder), **arguments
        )

    def _more(self, stream: int, kinds: list[str] | None) -> None:
        """Send the next records of a stream; decode those of topics that were decoded before.

        Small records share a frame: a frame for every transform would cost more than reading it.
        """
        if stream not in self._streams:
            self._streams[stream] = iter(self._recording.records(_kinds(kinds)))
        left = self._batches.get(stream, FIRST_BATCH)
        self._batches[stream] = min(2 * left, BATCH)
        records, spent = self._streams[stream], 0
        while left > 0 and spent < BATCH_BYTES:
            frame: dict[str, Any] = {"stream": stream, "items": []}
            buffers: list[memoryview] = []
            size = n_seen = 0
            with warnings.catch_warnings(record=True) as warned:
                warnings.simplefilter("always")
                while left > 0 and len(frame["items"]) < TOGETHER and "end" not in frame:
                    try:
                        record = next(records, None)
                        if record is None:
                            frame["end"] = True
                        else:
                            left -= 1
                            frame["items"].append(self._item(stream, record, buffers))
                    except Exception as error:
                        frame |= {"end": True, "error": wire.told_error(error, self._place)}
                    size += sum(buffer.nbytes for buffer in buffers[n_seen:])
                    n_seen = len(buffers)
                    if size > TOGETHER_BYTES:
                        break
            told = {"warned": _told_warnings(warned), "topics": self._new_topics()}
            is_last = left <= 0 or "end" in frame
            spent += wire.send(self._link, frame | told | self._found(), buffers)
            limits.allow_cpu(self._cpu)
            if is_last:
                break
        if "end" not in frame:
            wire.send(self._link, {"stream": stream, "items": [], "pause": True}, [])

    def _item(self, stream: int, record: Record, buffers: list[memoryview]) -> list[Any]:
        """Encode a record for a frame: number, topic, time and content."""
        number = self._counts[stream]
        self._counts[stream] += 1
        topic = self._numbers.setdefault(record.topic, len(self._numbers))
        found = {
            what: self._worked(record, what, buffers)
            for what in ("decode", "parse")
            if (stream, what, record.topic.name) in self._wanted
        }
        if not found:
            self._kept[stream, number] = record
            while len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        return [number, topic, record.time_ns, record.parse is not None, found]

    def _new_topics(self) -> list[dict[str, Any]]:
        """Return the topics that were found since the last frame, in the order of their numbers."""
        new = list(self._numbers)[self._n_told :]
        self._n_told = len(self._numbers)
        return [vars_of(topic) for topic in new]

    def _worked(self, record: Record, what: str, buffers: list[memoryview]) -> dict[str, Any]:
        try:
            return {"value": wire.packed(_work(record, what), buffers)}
        except Exception as error:
            return {"error": wire.told_error(error, self._place)}

    def _read(self, stream: int, number: int, what: str, kinds: list[str] | None) -> Any:
        """Return the content of a record; later ones of its topic are then decoded in advance."""
        record = self._kept.get((stream, number)) or self._again(kinds, number)
        self._wanted.add((stream, what, record.topic.name))
        return _work(record, what)

    def _again(self, kinds: list[str] | None, number: int) -> Record:
        records = self._recording.records(_kinds(kinds))
        for position, record in enumerate(records):
            if position == number:
                found: Record = record
                return found
        raise EOFError(f"{self._place}: message {number} is gone")

    def _stop(self, stream: int) -> None:
        self._streams.pop(stream, None)
        self._batches.pop(stream, None)
        for key in [key for key in self._kept if key[0] == stream]:
            del self._kept[key]

    def _found(self) -> dict[str, Any]:
        """Return the findings of the reader since the last call; empty without new ones."""
        if self._recording is None:
            return {}
        now, before = self._recording.noticed(), self._told
        news = {
            "point_time": _changed(now.point_time, before.point_time),
            "no_return": _changed(now.no_return, before.no_return),
            "rejected": dict(now.rejected - before.rejected),
            "notes": [text for text in now.notes if text not in before.notes],
        }
        if not any(news.values()):
            return {}
        self._told = Findings(
            dict(now.point_time), dict(now.no_return), Counter(now.rejected), list(now.notes)
        )
        return {"news": news}


def _work(record: Record, what: str) -> Any:
    work = record.decode if what == "decode" else record.parse
    return None if work is None else work()


def _changed(now: dict[str, str], before: dict[str, str]) -> dict[str, str]:
    return {name: text for name, text in now.items() if before.get(name) != text}


def _kinds(given: list[str] | None) -> frozenset[str] | None:
    return None if given is None else frozenset(given)


def vars_of(topic: Topic) -> dict[str, Any]:
    """Return the fields of a topic."""
    names = ("name", "type", "kind", "count", "note")
    return {name: getattr(topic, name) for name in names}


def _told_warnings(warned: list[warnings.WarningMessage]) -> list[list[str]]:
    return [[one.category.__name__, str(one.message)] for one in warned]


if __name__ == "__main__":
    main(int(sys.argv[1]))
