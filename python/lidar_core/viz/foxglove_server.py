"""The recording of a run, played to Foxglove over its WebSocket."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lidar_core.errors import LinkError
from lidar_core.extras import require
from lidar_core.io.mcap_file import McapRecording
from lidar_core.io.options import ReadOptions

LOCAL, LAST_PORT = "127.0.0.1", 65535
BACKLOG = 256  # messages to a slow viewer
LONGEST_PAUSE_S = 1.0  # gaps of a recording are played shorter


def start_server(context: Any, port: int, *, option: str, backlog: int) -> Any:
    """Foxglove's server on 127.0.0.1.

    Parameters
    ----------
    context : foxglove.Context
        What it serves.
    port : int
        Of the WebSocket; 0 takes a free one.
    option : str
        What is said on the command line before the port, such as "--port ".
    backlog : int
        Messages to a slow viewer; older ones go.

    Raises
    ------
    LinkError
        The port is in use, or not for this user.
    """
    foxglove = require("foxglove", extra="viz", purpose="the Foxglove server")
    try:
        return foxglove.start_server(
            name="lidar_core", host=LOCAL, port=port, context=context, message_backlog_size=backlog
        )
    except (RuntimeError, OSError) as error:
        raise LinkError(
            f"foxglove: port {port} cannot be opened ({error}); end the program that uses it, or"
            f" choose another one: {option}{port + 1 if port < LAST_PORT else 0}"
        ) from error


def serve_foxglove(
    recording: str | Path,
    *,
    port: int = 8765,
    speed: float = 1.0,
    repeat: bool = True,
    on_ready: Callable[[int], None] = lambda port: None,
) -> None:
    """Play an MCAP file at its own pace, to viewers on this machine, until Ctrl-C.

    Parameters
    ----------
    recording : str or Path
        MCAP file; its messages are sent as they are.
    port : int
        Of the WebSocket on 127.0.0.1; 0 takes a free one.
    speed : float
        Seconds of the recording per second.
    repeat : bool
        Whether to begin again at the end.
    on_ready : callable
        Told the port once viewers can connect.

    Raises
    ------
    MissingExtraError
        foxglove-sdk or mcap is not installed.
    FormatError
        Not a whole MCAP file.
    LinkError
        The port is in use.
    """
    foxglove = require("foxglove", extra="viz", purpose="the Foxglove server")
    context = foxglove.Context()
    with McapRecording(Path(recording), ReadOptions()) as opened:
        server = start_server(context, port, option="--port ", backlog=BACKLOG)
        try:
            on_ready(int(server.port))
            channels: dict[int, Any] = {}
            while True:
                _play(foxglove, context, opened, channels, speed)
                if not repeat:
                    return
        except KeyboardInterrupt:
            return
        finally:
            server.stop()


def _play(
    foxglove: Any, context: Any, recording: McapRecording, channels: dict[int, Any], speed: float
) -> None:
    """Send every message once, at its time."""
    last: int | None = None
    for channel, schema, message in recording.stored():
        if channel.id not in channels:
            given = foxglove.Schema(name=schema.name, encoding=schema.encoding, data=schema.data)
            channels[channel.id] = foxglove.Channel(
                channel.topic, schema=given, message_encoding=channel.message_encoding,
                metadata=dict(channel.metadata), context=context,
            )  # fmt: skip
        if last is not None and message.log_time > last:
            time.sleep(min((message.log_time - last) * 1e-9 / speed, LONGEST_PAUSE_S))
        last = message.log_time
        channels[channel.id].log(message.data, log_time=message.log_time)
