"""Scans and poses of a Foxglove WebSocket server, such as foxglove_bridge on a robot."""

import base64
import json
import re
import struct
import time
from collections import Counter
from collections.abc import Collection, Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from math import inf
from threading import Event, Thread
from typing import Any

from lidar_core.errors import ConfigError, LidarCoreError, LinkError
from lidar_core.extras import require
from lidar_core.io import ReadOptions, Topic
from lidar_core.io.messages.foxglove import FoxgloveDecoder, foxglove_kind
from lidar_core.io.messages.ros import RosDecoder, kind_of, ros_name
from lidar_core.io.records import POSE_KINDS, SCAN_KINDS, Record
from lidar_core.live.config import CONNECT_TIMEOUT, RETRY_INTERVAL, LiveConfig
from lidar_core.live.sources.inbox import Inbox
from lidar_core.live.sources.source import Source, StreamTopics
from lidar_core.messages import Message

DEFAULT_ADDRESS = "ws://127.0.0.1:8765"
PROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
MESSAGE_DATA = 1
UNKNOWN_CHANNEL = re.compile(r"Unknown channel ID: (\d{1,19})")  # how foxglove-sdk refuses one
HEAD = struct.Struct("<BIQ")  # kind, subscription, time [ns]
PATIENCE_S = 0.2  # how soon `close` is noticed
MAX_CHANNELS = 4096
MAX_TRIES = 10  # to subscribe to a channel


@dataclass(frozen=True, slots=True)
class _Schema:
    """Schema of messages, in the form that `FoxgloveDecoder` reads."""

    id: int
    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True)
class _Channel:
    topic: Topic
    encoding: str
    schema: _Schema


class FoxgloveSource(Source):
    """Source of the requested topics of a server; it reconnects after a lost connection.

    Parameters
    ----------
    address : str
        Address of the server, such as ws://127.0.0.1:8765.
    topics : StreamTopics
        Requested topics.
    options : ReadOptions
        Options for reading the messages.
    config : LiveConfig
        Waiting time for the server.

    Raises
    ------
    ConfigError
        `address` is not a WebSocket address.
    """

    def __init__(
        self, address: str, topics: StreamTopics, options: ReadOptions, config: LiveConfig
    ) -> None:
        super().__init__(f"foxglove, {address}")
        if not address.startswith(("ws://", "wss://")):
            raise ConfigError(
                f"foxglove: expected an address such as {DEFAULT_ADDRESS}, got {address!r}"
            )
        self._client = require("websockets.sync.client", extra="live", purpose="Foxglove's stream")
        self._address, self._topics = address, topics
        self._options, self._config = options, config
        self._ros = {
            encoding: RosDecoder(version, options, self.findings)
            for encoding, version in (("cdr", 2), ("ros1", 1))
        }
        self._foxglove = FoxgloveDecoder(options, self.findings)
        self._channels: dict[int, _Channel] = {}
        self._schemas: dict[tuple[str, str, bytes], _Schema] = {}
        self._told_of: dict[int, Topic] = {}  # every channel, wanted or not
        self._tries: Counter[int] = Counter()  # to subscribe to channels that were refused
        self._refused: set[int] = set()  # those that are asked for once more ...
        self._ask_again_at = inf  # ... at this time [s]
        self._ended = Event()
        self._connected = Event()
        self._error = ""
        self._thread: Thread | None = None

    def start(self, inbox: Inbox) -> None:
        """Connect and subscribe."""
        self._thread = Thread(target=self._work, args=(inbox,), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Disconnect."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()

    def trouble(self) -> str:
        """Problem of the connection: the last error, empty while connected."""
        if self._connected.is_set():
            return ""
        reason = f" ({self._error})" if self._error else ""
        return f"no server at {self._address}, trying again{reason}"

    @property
    def is_linked(self) -> bool:
        """True while the server is connected."""
        return self._connected.is_set()

    def advertised(self) -> list[str]:
        """Return the channels that the server announced."""
        topics = {topic.name: topic for topic in list(self._told_of.values())}
        return [f"{topic.name} ({topic.type})" for _, topic in sorted(topics.items())]

    def _work(self, inbox: Inbox) -> None:
        end = time.monotonic() + CONNECT_TIMEOUT
        was_there = False
        while not self._ended.is_set():
            try:
                with self._connect() as link:
                    was_there = True
                    self._connected.set()
                    self._listen(link, inbox)
            except LidarCoreError as error:
                inbox.fail(error)
                return
            except Exception as error:
                self._error = f"{type(error).__name__}: {error}"
                if self._connected.is_set():
                    self.findings.note(f"{self._address}: {self._error}")
                self._connected.clear()
                if not was_there and time.monotonic() > end:
                    inbox.fail(self._unreachable())
                    return
            self._connected.clear()
            self._ended.wait(RETRY_INTERVAL)

    def _connect(self) -> Any:
        return self._client.connect(
            self._address,
            subprotocols=list(PROTOCOLS),
            compression=None,
            max_size=self._options.max_record_bytes,
            open_timeout=CONNECT_TIMEOUT,
        )

    def _unreachable(self) -> LinkError:
        return LinkError(
            f"foxglove: no server at {self._address} within {CONNECT_TIMEOUT:g} s"
            f" ({self._error}); start foxglove_bridge on the robot, or give another address:"
            " foxglove:ws://HOST:PORT"
        )

    def _listen(self, link: Any, inbox: Inbox) -> None:
        """Handle messages until the connection ends or `close` is called."""
        self._channels.clear()
        self._told_of.clear()
        self._tries.clear()
        self._refused.clear()
        self._ask_again_at = inf
        while not self._ended.is_set():
            if time.monotonic() > self._ask_again_at:
                self._ask_again_at = inf
                self._subscribe(self._refused, link)
                self._refused.clear()
            with suppress(TimeoutError):
                data = link.recv(timeout=PATIENCE_S)
                if isinstance(data, bytes):
                    self._take(data, inbox)
                else:
                    self._converse(self._read(data), link)

    def _read(self, text: str) -> Any:
        """Parse a message of the server; if it is no JSON, count it and return None."""
        try:
            return json.loads(text)
        except (ValueError, RecursionError) as error:
            self._reject(self._address, error)
            return None

    def _converse(self, message: Any, link: Any) -> None:
        """Subscribe to channels that the server announces, and forget those that it withdraws."""
        kind = message.get("op") if isinstance(message, dict) else None
        if kind == "advertise":
            self._subscribe(list(self._wanted(_items(message.get("channels")))), link)
        elif kind == "unadvertise":
            for number in _items(message.get("channelIds")):
                self._forget(number)
        elif kind == "status":
            self._ask_again(str(message.get("message", "")))

    def _subscribe(self, numbers: Collection[int], link: Any) -> None:
        if numbers:
            # A subscription has the number of its channel.
            pairs = [{"id": number, "channelId": number} for number in sorted(numbers)]
            link.send(json.dumps({"op": "subscribe", "subscriptions": pairs}))

    def _forget(self, number: Any) -> None:
        with suppress(TypeError, ValueError):
            self._channels.pop(int(number), None)
            self._told_of.pop(int(number), None)
            self._refused.discard(int(number))

    def _ask_again(self, reason: str) -> None:
        """Repeat the subscription to a channel soon if the server does not know the channel yet.

        foxglove-sdk announces a new channel before it accepts subscriptions to it: a fast client is
        refused as if the channel did not exist.
        """
        unknown = UNKNOWN_CHANNEL.search(reason)
        number = int(unknown[1]) if unknown else -1
        if number not in self._channels:
            return
        self._tries[number] += 1
        if self._tries[number] >= MAX_TRIES:
            self.findings.note(
                f"{self._address}, channel {self._channels[number].topic.name}:"
                " the server announced it, but does not accept a subscription"
            )
            return
        self._refused.add(number)
        soon = time.monotonic() + RETRY_INTERVAL
        self._ask_again_at = min(self._ask_again_at, soon)

    def _wanted(self, channels: Iterable[Any]) -> Iterable[int]:
        for channel in channels:
            try:
                number, found = int(channel["id"]), self._channel(channel)
            except (
                KeyError,
                TypeError,
                ValueError,
            ) as error:  # the other channels are not affected
                topic = channel.get("topic") if isinstance(channel, dict) else None
                self._reject(f"{self._address}, channel {topic or '?'}", error)
                continue
            if len(self._told_of) < MAX_CHANNELS:
                self._told_of[number] = found.topic
            if self._is_wanted(found.topic) and len(self._channels) < MAX_CHANNELS:
                self._channels[number] = found
                yield number

    def _reject(self, place: str, error: Exception) -> None:
        """Count a message that cannot be understood, and note the error."""
        self.findings.rejected[self._address] += 1
        self.findings.note(f"{place}: {type(error).__name__}: {error}")

    def _channel(self, channel: Any) -> _Channel:
        name, encoding = str(channel["topic"]), str(channel["encoding"])
        type_name, schema = str(channel["schemaName"]), str(channel.get("schema", ""))
        if encoding == "protobuf":
            data, kind = base64.b64decode(schema), foxglove_kind(type_name)
        else:
            type_name, data = ros_name(type_name), b""
            kind = kind_of(type_name) if encoding in self._ros else "other"
        return _Channel(
            Topic(name, type_name, kind), encoding, self._schema(type_name, encoding, data)
        )

    def _schema(self, name: str, encoding: str, data: bytes) -> _Schema:
        """Return the schema with a number that identifies it, so that decoders can cache it."""
        key = name, encoding, data
        if key not in self._schemas:
            if len(self._schemas) >= MAX_CHANNELS:
                raise ValueError(f"more than {MAX_CHANNELS} schemas")
            self._schemas[key] = _Schema(len(self._schemas) + 1, *key)
        return self._schemas[key]

    def _is_wanted(self, topic: Topic) -> bool:
        topics = self._topics
        if topic.kind == "scan":
            return topics.wants_clouds and topic.name in (topics.clouds or (topic.name,))
        if topic.kind == "planar":
            return topics.wants_scans and topic.name in (topics.scans or (topic.name,))
        return topic.kind in POSE_KINDS | SCAN_KINDS

    def _take(self, data: bytes, inbox: Inbox) -> None:
        """Process one binary message; count it if it is invalid."""
        if len(data) < HEAD.size:
            inbox.reject(self._address)
            return
        kind, number, time_ns = HEAD.unpack_from(data)
        channel = self._channels.get(number)
        if kind != MESSAGE_DATA or channel is None:
            return
        decode = partial(self._decoded, channel, data[HEAD.size :])
        inbox.put(Record(channel.topic, time_ns, decode))

    def _decoded(self, channel: _Channel, raw: bytes) -> list[Message]:
        place = f"{self._address}, {channel.topic.name}"
        ros = self._ros.get(channel.encoding)
        if ros is not None:
            return ros.decode(channel.topic.name, channel.topic.type, raw, place)
        return self._foxglove.decode(channel.topic.name, channel.schema, {}, raw, place)


def _items(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []
