"""Where live results go: viewers and files. `zenoh_output` has the one for robots."""

from abc import ABC, abstractmethod
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path

from lidar_core.extras import require
from lidar_core.io.atomic import check_place, commit, temporary_for
from lidar_core.io.write_mcap import FoxgloveLog, McapWriter
from lidar_core.live.update import Update
from lidar_core.viz.foxglove_server import LOCAL, start_server
from lidar_core.viz.rerun_log import RerunLog, Where, rerun_viewer

BACKLOG = 64  # messages to a slow viewer; older ones go
GRPC_PORT = 9876
VIEWER_MEMORY = "2GB"  # what rerun's viewer keeps of a stream without end


class Output(ABC):
    """Gets every update, in the order of the scans.

    Attributes
    ----------
    name : str
        Where it goes, for people.
    """

    def __init__(self, name: str) -> None:
        self.name = name

    @abstractmethod
    def publish(self, update: Update) -> None:
        """Send or write what one scan gave; never waits for a receiver."""

    @abstractmethod
    def close(self) -> None:
        """Complete files, end servers."""


class FoxgloveOutput(Output):
    """A Foxglove server on 127.0.0.1: scans, poses, tracks or maps.

    Parameters
    ----------
    port : int
        Of the WebSocket; 0 takes a free one.

    Raises
    ------
    LinkError
        The port is in use.
    MissingExtraError
        foxglove-sdk is not installed.
    """

    def __init__(self, port: int) -> None:
        foxglove = require("foxglove", extra="viz", purpose="the Foxglove server")
        self._context = foxglove.Context()
        self._server = start_server(self._context, port, option="foxglove:", backlog=BACKLOG)
        super().__init__(f"ws://{LOCAL}:{self._server.port}")
        self._log: FoxgloveLog | None = None

    def publish(self, update: Update) -> None:
        """Send what viewers draw."""
        if self._log is None:
            self._log = FoxgloveLog(self._context, tracks_frame=update.frame_id)
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
        """Append what viewers draw."""
        if self._writer is None:
            self._writer = McapWriter(self._path, tracks_frame=update.frame_id)
        update.log_to(self._writer)

    def close(self) -> None:
        """Complete the file; without scans there is none."""
        if self._writer is not None:
            self._writer.close()


class RerunOutput(Output):
    """Rerun's viewer in a window or a page, or its recording.

    Parameters
    ----------
    where : str or Path
        window, web, or the .rrd file to write.

    Raises
    ------
    FileNotFoundError
        The folder of the file is missing.
    MissingExtraError
        rerun-sdk is not installed.
    """

    def __init__(self, where: Where | Path) -> None:
        super().__init__(f"rerun, {where}")
        self._path = where if isinstance(where, Path) else None
        if self._path is not None:
            check_place(self._path)
        self._log = RerunLog(f"lidar-core live {datetime.now(UTC).isoformat()}")
        self._stack, self._is_empty = ExitStack(), True
        if isinstance(where, Path):
            self._log.stream.save(str(temporary_for(where)))
        else:
            arguments = ["--port", str(GRPC_PORT), "--memory-limit", VIEWER_MEMORY,
                         "--server-memory-limit", VIEWER_MEMORY]  # fmt: skip
            self._stack.enter_context(rerun_viewer(arguments, where=where))
            self._log.stream.connect_grpc(f"rerun+http://{LOCAL}:{GRPC_PORT}/proxy")
        self._log.begin()

    def publish(self, update: Update) -> None:
        """Show the scan and the objects."""
        self._is_empty = False
        self._log.log(update.moment())

    def close(self) -> None:
        """Complete the file, without scans there is none; or close the viewer."""
        self._log.close()
        self._stack.close()
        if self._path is not None and self._is_empty:
            temporary_for(self._path).unlink(missing_ok=True)
        elif self._path is not None:
            commit(temporary_for(self._path), self._path)
