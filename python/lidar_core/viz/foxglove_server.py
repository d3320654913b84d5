"""A server of Foxglove's WebSocket protocol on 127.0.0.1 that checks its clients.

foxglove-sdk has a server too, but that server accepts web pages of any origin, and requests to any
host name. Source of the protocol: the specification foxglove.websocket.v1 of ws-protocol.
"""

import base64
import json
import logging
import struct
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping
from http import HTTPStatus
from itertools import count
from pathlib import Path
from threading import Condition, Lock, Thread
from typing import Any

from lidar_core.errors import LinkError
from lidar_core.extras import require
from lidar_core.io.formats.mcap import McapRecording
from lidar_core.io.options import ReadOptions
from lidar_core.io.write.mcap import FoxgloveLog
from lidar_core.viz.origin_check import LOCAL, refusal

PROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
MESSAGE_DATA, HEAD = 1, struct.Struct("<BIQ")  # kind, subscription, time [ns]
LAST_PORT = 65535
BACKLOG = 256  # messages to a slow viewer
LONGEST_PAUSE_S = 1.0  # gaps of a recording are played shorter
MAX_VIEWERS = 32
MAX_REQUEST_BYTES = 2**20  # of what a viewer says
MAX_SUBSCRIPTIONS = 4096  # of one viewer
HANDSHAKE_S, CLOSING_S = 10.0, 1.0
MAX_TOLD = 100  # different reasons why somebody was refused
PURPOSE = "the Foxglove server"
Told = Callable[[str], None]


class ServedChannel:
    """Topic of the server; its messages go to the viewers that subscribed to it.

    Attributes
    ----------
    id : int
        ID of the channel in messages to viewers.
    description : dict
        Description that viewers get.
    """

    def __init__(self, viewers: "Collection[_Viewer]", description: Mapping[str, Any]) -> None:
        self.id = int(description["id"])
        self.description = description
        self._viewers = viewers

    def log(self, message: Any, *, log_time: int) -> None:
        """Send a message: bytes, or one of foxglove.messages, encoded only for subscribers."""
        data: bytes | None = message if isinstance(message, bytes) else None
        for viewer in list(self._viewers):
            for subscription in viewer.subscriptions_to(self.id):
                data = message.encode() if data is None else data
                viewer.put(HEAD.pack(MESSAGE_DATA, subscription, log_time) + data)


class FoxgloveServer:
    """Foxglove's WebSocket on 127.0.0.1, for programs of this machine and allowed web pages.

    Parameters
    ----------
    port : int
        Port of the WebSocket; 0 selects a free one.
    option : str
        Text before the port on the command line, such as "--port ", for error messages.
    backlog : int
        Largest number of messages kept for a slow viewer; older ones are dropped.
    allowed : collection of str
        Web pages that may connect beside those of this machine, from `allowed_origins`.
    on_refused : callable
        Called with the reason when a client is refused.

    Attributes
    ----------
    port : int
        Port that the server listens on.

    Raises
    ------
    LinkError
        The port is in use, or not for this user.
    MissingExtraError
        websockets is not installed.
    """

    def __init__(
        self,
        port: int,
        *,
        option: str,
        backlog: int = BACKLOG,
        allowed: Collection[str] = (),
        on_refused: Told = lambda reason: None,
    ) -> None:
        serving = require("websockets.sync.server", extra="viz", purpose=PURPOSE)
        self._allowed, self._on_refused, self._backlog = allowed, on_refused, backlog
        self._told: set[str] = set()
        quiet = logging.getLogger("lidar_core.websockets")
        quiet.setLevel(logging.CRITICAL)  # a broken handshake is no news for the console
        self._viewers: list[_Viewer] = []
        self._channels: dict[int, ServedChannel] = {}
        self._numbers, self._lock = count(1), Lock()
        try:
            self._server = serving.serve(
                self._serve,
                LOCAL,
                port,
                subprotocols=list(PROTOCOLS),
                compression=None,
                process_request=self._check,
                max_size=MAX_REQUEST_BYTES,
                server_header=None,
                logger=quiet,
                open_timeout=HANDSHAKE_S,
                close_timeout=CLOSING_S,
            )
        except OSError as error:
            raise LinkError(
                f"foxglove: port {port} cannot be opened ({error}); stop the program that uses"
                f" it, or choose another port: {option}{port + 1 if port < LAST_PORT else 0}"
            ) from error
        self.port = int(self._server.socket.getsockname()[1])
        self._thread = Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def channel(
        self, topic: str, *, encoding: str, schema: Any, metadata: Mapping[str, str]
    ) -> ServedChannel:
        """Begin a topic and announce it to the viewers.

        Parameters
        ----------
        topic : str
            Name of the topic.
        encoding : str
            Encoding of its messages, such as protobuf.
        schema : foxglove.Schema or mcap.records.Schema
            Schema with name, encoding and data.
        metadata : mapping
            Metadata of the channel.
        """
        is_text = schema.encoding not in ("protobuf", "flatbuffer")
        given = bytes(schema.data)
        text = given.decode(errors="replace") if is_text else base64.b64encode(given).decode()
        with self._lock:
            number = next(self._numbers)
            made = ServedChannel(
                self._viewers,
                {
                    "id": number,
                    "topic": topic,
                    "encoding": encoding,
                    "schemaName": schema.name,
                    "schemaEncoding": schema.encoding,
                    "schema": text,
                    "metadata": dict(metadata),
                },
            )
            self._channels[number] = made
            for viewer in self._viewers:
                viewer.put(_advertisement([made]), keep=True)
        return made

    def stop(self) -> None:
        """End the server and its connections."""
        self._server.shutdown()
        with self._lock:
            viewers = list(self._viewers)
        for viewer in viewers:
            viewer.end()
        self._thread.join()

    def _check(self, link: Any, request: Any) -> Any:
        """Refuse a handshake for another host than this machine, or of a foreign web page."""
        headers = request.headers
        reason = refusal(headers.get_all("Host"), headers.get_all("Origin"), self._allowed)
        if reason is None and len(self._viewers) >= MAX_VIEWERS:
            reason = f"more than {MAX_VIEWERS} viewers"
        if reason is None:
            return None
        self._tell(reason)
        return link.respond(HTTPStatus.FORBIDDEN, f"refused: {reason}\n")

    def _tell(self, reason: str) -> None:
        """Report every reason once, and at most `MAX_TOLD` reasons."""
        with self._lock:
            is_new = reason not in self._told and len(self._told) < MAX_TOLD
            self._told.add(reason)
        if is_new:
            self._on_refused(reason)

    def _serve(self, link: Any) -> None:
        """Serve one viewer until it disconnects."""
        viewer = _Viewer(link, self._backlog)
        viewer.put(
            json.dumps(
                {
                    "op": "serverInfo",
                    "name": "lidar_core",
                    "capabilities": [],
                    "sessionId": str(time.time_ns()),
                }
            ),
            keep=True,
        )
        with self._lock:
            if self._channels:
                viewer.put(_advertisement(self._channels.values()), keep=True)
            self._viewers.append(viewer)
        try:
            for text in link:
                viewer.read(text, self._channels)
        except Exception as error:  # a viewer that breaks the protocol harms itself alone
            self._tell(f"a viewer that broke the protocol: {type(error).__name__}")
        finally:
            with self._lock:
                self._viewers.remove(viewer)
            viewer.end()


def _advertisement(channels: Iterable[ServedChannel]) -> str:
    described = [channel.description for channel in channels]
    return json.dumps({"op": "advertise", "channels": described})


class _Viewer:
    """Subscriptions and pending messages of one viewer."""

    def __init__(self, link: Any, backlog: int) -> None:
        self._link = link
        self._subscriptions: dict[int, int] = {}  # channel by the viewer's number
        self._kept: deque[str] = deque()  # channels and other words, which must arrive
        self._waiting: deque[bytes] = deque(maxlen=backlog)
        self._changed, self._is_ended = Condition(), False
        self._thread = Thread(target=self._send, daemon=True)
        self._thread.start()

    def subscriptions_to(self, channel: int) -> list[int]:
        """IDs of the viewer's subscriptions to a channel."""
        with self._changed:
            return [name for name, number in self._subscriptions.items() if number == channel]

    def put(self, data: str | bytes, *, keep: bool = False) -> None:
        """Queue data; a full queue drops its oldest messages, except permanent ones."""
        with self._changed:
            (self._kept if keep else self._waiting).append(data)  # type: ignore[arg-type]
            self._changed.notify()

    def read(self, text: str | bytes, channels: Mapping[int, ServedChannel]) -> None:
        """Handle one request; only requests about subscriptions have an effect."""
        request = json.loads(text) if isinstance(text, str) else {}
        kind = request.get("op") if isinstance(request, dict) else None
        if kind == "subscribe":
            for pair in request["subscriptions"]:
                self._subscribe(int(pair["id"]), int(pair["channelId"]), channels)
        elif kind == "unsubscribe":
            with self._changed:
                for number in request["subscriptionIds"]:
                    self._subscriptions.pop(int(number), None)

    def _subscribe(self, number: int, channel: int, channels: Mapping[int, ServedChannel]) -> None:
        reason = ""
        with self._changed:
            if channel not in channels:
                reason = f"Unknown channel ID: {channel}"
            elif number in self._subscriptions:
                reason = f"Client subscription id {number} was already used"
            elif len(self._subscriptions) >= MAX_SUBSCRIPTIONS or not 0 <= number < 2**32:
                reason = f"Subscription id {number}: too many subscriptions, or no such number"
            else:
                self._subscriptions[number] = channel
        if reason:
            self.put(json.dumps({"op": "status", "level": 2, "message": reason}), keep=True)

    def end(self) -> None:
        """Close the connection."""
        with self._changed:
            self._is_ended = True
            self._changed.notify()
        self._link.close()

    def _send(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._kept or self._waiting or self._is_ended)
                if self._is_ended:
                    return
                data = self._kept.popleft() if self._kept else self._waiting.popleft()
            try:
                self._link.send(data)
            except Exception:  # the connection is gone: its reader notices, too
                return


class ServedLog(FoxgloveLog):
    """Scans, poses, tracks and maps as Foxglove's messages, on channels of a server.

    Parameters
    ----------
    server : FoxgloveServer
        Server that sends them.
    tracks_frame : str
        Frame that tracks are given in.
    """

    def __init__(self, server: FoxgloveServer, *, tracks_frame: str) -> None:
        super().__init__(None, tracks_frame=tracks_frame)
        self._server = server

    def _made_channel(self, kind: str, topic: str, metadata: Mapping[str, str]) -> Any:
        """Channel of the server for a type of foxglove.channels."""
        message = getattr(self._messages, kind.removesuffix("Channel"))
        return self._server.channel(
            topic, encoding="protobuf", schema=message.get_schema(), metadata=metadata
        )


def serve_foxglove(
    recording: str | Path,
    *,
    port: int = 8765,
    speed: float = 1.0,
    repeat: bool = True,
    allowed: Collection[str] = (),
    on_ready: Callable[[int], None] = lambda port: None,
    on_refused: Told = lambda reason: None,
) -> None:
    """Play an MCAP file at its own pace, to viewers on this machine, until Ctrl-C.

    Parameters
    ----------
    recording : str or Path
        MCAP file; its messages are sent as they are.
    port : int
        Port of the WebSocket on 127.0.0.1; 0 selects a free one.
    speed : float
        Seconds of the recording per second.
    repeat : bool
        Start again at the end.
    allowed : collection of str
        Web pages that may connect beside those of this machine, from `allowed_origins`.
    on_ready : callable
        Called with the port once viewers can connect.
    on_refused : callable
        Called with the reason when a client is refused.

    Raises
    ------
    MissingExtraError
        websockets or mcap is not installed.
    FormatError
        The file is no complete MCAP file.
    LinkError
        The port is in use.
    """
    with McapRecording(Path(recording), ReadOptions()) as opened:
        server = FoxgloveServer(port, option="--port ", allowed=allowed, on_refused=on_refused)
        try:
            on_ready(server.port)
            channels: dict[int, ServedChannel] = {}
            while True:
                _play(server, opened, channels, speed)
                if not repeat:
                    return
        except KeyboardInterrupt:
            return
        finally:
            server.stop()


def _play(
    server: FoxgloveServer,
    recording: McapRecording,
    channels: dict[int, ServedChannel],
    speed: float,
) -> None:
    """Send every message once, at its time."""
    last: int | None = None
    for channel, schema, message in recording.stored():
        if channel.id not in channels:
            channels[channel.id] = server.channel(
                channel.topic,
                encoding=channel.message_encoding,
                schema=schema,
                metadata=channel.metadata,
            )
        if last is not None and message.log_time > last:
            time.sleep(min((message.log_time - last) * 1e-9 / speed, LONGEST_PAUSE_S))
        last = message.log_time
        channels[channel.id].log(bytes(message.data), log_time=message.log_time)
