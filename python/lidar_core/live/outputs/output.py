"""Outputs of live results: viewers and files. `zenoh_output` has the output for robots."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection
from contextlib import ExitStack, suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from queue import Empty, Full, Queue
from threading import Thread
from typing import TYPE_CHECKING

from lidar_core.errors import ConfigError
from lidar_core.extras import require
from lidar_core.io.files.atomic import check_place, commit, temporary_for
from lidar_core.io.write.mcap import McapWriter
from lidar_core.live.outputs.update import Update
from lidar_core.viz.foxglove_server import FoxgloveServer, ServedLog
from lidar_core.viz.origin_check import LOCAL
from lidar_core.viz.rerun_feed import LiveFeed
from lidar_core.viz.rerun_log import RerunLog
from lidar_core.viz.rerun_page import RerunPage
from lidar_core.viz.rerun_process import PATIENCE_S, free_port, has_display, rerun_process

BACKLOG = 64  # messages to a slow viewer; older ones go
PAGE_MEMORY_BYTES = 512 * 2**20  # of a stream without end, for pages that are opened later
WINDOW_BACKLOG = 16  # scans that wait for rerun's window
VIEWER_MEMORY = "2GB"  # what rerun's viewer keeps of a stream without end

if TYPE_CHECKING:
    from lidar_core.viz.playback import Moment


class Output(ABC):
    """Interface of outputs, which get every update in the order of the scans.

    Attributes
    ----------
    name : str
        Name of the output in messages.
    """

    def __init__(self, name: str) -> None:
        self.name = name

    @abstractmethod
    def publish(self, update: Update) -> None:
        """Send or write the results of one scan; never waits for a receiver."""

    @abstractmethod
    def close(self) -> None:
        """Complete files, end servers."""


class FoxgloveOutput(Output):
    """A Foxglove server on 127.0.0.1: scans, poses, tracks or maps.

    Parameters
    ----------
    port : int
        Port of the WebSocket; 0 selects a free one.
    allowed : collection of str
        Web pages that may connect beside those of this machine, from `allowed_origins`.
    on_refused : callable
        Called with the reason when a client is refused.

    Raises
    ------
    LinkError
        The port is in use.
    MissingExtraError
        foxglove-sdk or websockets is not installed.
    """

    def __init__(
        self,
        port: int,
        *,
        allowed: Collection[str] = (),
        on_refused: Callable[[str], None] = lambda reason: None,
    ) -> None:
        require("foxglove", extra="viz", purpose="the Foxglove server")
        self._server = FoxgloveServer(
            port, option="foxglove:", backlog=BACKLOG, allowed=allowed, on_refused=on_refused
        )
        super().__init__(f"ws://{LOCAL}:{self._server.port}")
        self._log: ServedLog | None = None

    def publish(self, update: Update) -> None:
        """Send the objects to viewers."""
        if self._log is None:
            self._log = ServedLog(self._server, tracks_frame=update.frame_id)
        update.log_to(self._log)

    def close(self) -> None:
        """End the server."""
        self._server.stop()


class McapOutput(Output):
    """An MCAP file of Foxglove's messages, complete when the run ends.

    Parameters
    ----------
    path : Path
        File to write.

    Raises
    ------
    FileNotFoundError
        The folder of the file is missing.
    MissingExtraError
        foxglove-sdk is not installed.
    """

    def __init__(self, path: Path) -> None:
        require("foxglove", extra="viz", purpose="writing MCAP")
        check_place(path)
        super().__init__(str(path))
        self._path = path
        self._writer: McapWriter | None = None

    def publish(self, update: Update) -> None:
        """Append the objects to the file."""
        if self._writer is None:
            self._writer = McapWriter(self._path, tracks_frame=update.frame_id, is_live=True)
        update.log_to(self._writer)

    def close(self) -> None:
        """Complete the file; without scans none is written."""
        if self._writer is not None:
            self._writer.close()


class RerunOutput(Output):
    """Rerun's recording as a file, complete when the run ends.

    Parameters
    ----------
    path : Path
        The .rrd file to write.

    Raises
    ------
    FileNotFoundError
        The folder of the file is missing.
    MissingExtraError
        rerun-sdk is not installed.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(f"rerun, {path}")
        check_place(path)
        self._path, self._is_empty = path, True
        self._log = _new_log()
        self._log.stream.save(str(temporary_for(path)))
        self._log.begin()

    def publish(self, update: Update) -> None:
        """Append the scan and the objects."""
        self._is_empty = False
        self._log.log(update.moment())

    def close(self) -> None:
        """Complete the file; without scans none is written."""
        self._log.close()
        if self._is_empty:
            temporary_for(self._path).unlink(missing_ok=True)
        else:
            commit(temporary_for(self._path), self._path)


class RerunWindowOutput(Output):
    """Rerun's viewer in a window, which listens on a free port of 127.0.0.1.

    Raises
    ------
    ConfigError
        There is no display.
    MissingExtraError
        rerun-sdk is not installed.
    """

    def __init__(self) -> None:
        if not has_display():
            raise ConfigError(
                "out: rerun has no display here: expected rerun:web or rerun:FILE.rrd"
            )
        super().__init__("rerun, window")
        self._log, self._stack = _new_log(), ExitStack()
        port = free_port()
        arguments = [
            "--port",
            str(port),
            "--memory-limit",
            VIEWER_MEMORY,
            "--server-memory-limit",
            VIEWER_MEMORY,
        ]
        self._window = self._stack.enter_context(rerun_process(arguments))
        self._log.stream.connect_grpc(f"rerun+http://{LOCAL}:{port}/proxy")
        self._log.begin()
        # Sending waits while the viewer takes nothing, and the scans must not wait for a viewer.
        self._waiting: Queue[Moment | None] = Queue(WINDOW_BACKLOG)
        self._error: Exception | None = None
        self._sending = Thread(target=self._send, daemon=True)
        self._sending.start()

    def publish(self, update: Update) -> None:
        """Show the scan and the objects, as long as the window is open.

        A viewer that is more than `WINDOW_BACKLOG` scans behind misses the oldest of them.
        """
        if self._window.poll() is not None:
            return
        self._put(update.moment())
        error, self._error = self._error, None
        if error is not None:
            raise error

    def close(self) -> None:
        """Close the viewer; if its window was closed before, nothing is sent any more.

        Pending data that the viewer does not take within `PATIENCE_S` are lost.
        """
        self._put(None)
        self._sending.join(PATIENCE_S)
        self._stack.close()

    def _put(self, moment: "Moment | None") -> None:
        while True:
            try:
                self._waiting.put_nowait(moment)
            except Full:
                with suppress(Empty):
                    self._waiting.get_nowait()
            else:
                return

    def _send(self) -> None:
        moment: Moment | None
        while (moment := self._waiting.get()) is not None:
            self._try(partial(self._log.log, moment))
        self._try(self._log.close)

    def _try(self, send: Callable[[], None]) -> None:
        """Send something, if the window is open; an error is raised with the next scan."""
        if self._window.poll() is None:
            try:
                send()
            except Exception as error:
                self._error = error


class RerunPageOutput(Output):
    """Rerun's viewer in the browser, from a server of its own on 127.0.0.1.

    Parameters
    ----------
    port : int
        Port of the page; 0 selects a free one.

    Raises
    ------
    LinkError
        The port is in use.
    MissingExtraError
        rerun-sdk is not installed.
    """

    def __init__(self, port: int) -> None:
        self._log = _new_log()
        self._blocks = self._log.stream.binary_stream()
        self._log.begin()
        self._log.follow()
        self._feed = LiveFeed(self._take_messages(), max_bytes=PAGE_MEMORY_BYTES)
        self._page = RerunPage(self._feed.blocks, port=port, option="rerun:web:")
        super().__init__(self._page.address)

    def publish(self, update: Update) -> None:
        """Show the scan and the objects."""
        self._log.log(update.moment())
        self._feed.add(self._take_messages())

    def close(self) -> None:
        """End the page's stream and its server."""
        self._feed.end()
        self._page.close()
        self._log.close()

    def _take_messages(self) -> bytes:
        """Return the data logged since the last call, as whole messages."""
        return bytes(self._blocks.read(flush=True) or b"")


def _new_log() -> RerunLog:
    return RerunLog(f"lidar-core live {datetime.now(UTC).isoformat()}")
