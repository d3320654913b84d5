"""Scans and poses of ROS 2 over Zenoh."""

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any

from lidar_core.extras import require
from lidar_core.io import ReadOptions, Topic
from lidar_core.io.messages.ros import (
    PLANAR_TYPES,
    POSE_TYPES,
    SCAN_TYPES,
    TRANSFORM_TYPES,
    RosDecoder,
    kind_of,
)
from lidar_core.io.records import Record
from lidar_core.live.config import CONNECT_TIMEOUT, LiveConfig
from lidar_core.live.sources.inbox import Inbox
from lidar_core.live.sources.source import Source, StreamTopics
from lidar_core.live.zenoh_link import (
    is_linked,
    key_of,
    open_session,
    told_of_key,
    topic_of,
    topic_of_token,
)

GRAPH = ("@ros2_lv/**", "@/*/@ros2_lv/**")  # tokens of rmw_zenoh, of zenoh-bridge-ros2dds
LISTEN_S, ANSWER_S = 0.7, 0.3
MAX_KEYS = 1000
TRANSFORMS, ODOMETRY = TRANSFORM_TYPES[:1], POSE_TYPES[:1]


class ZenohSource(Source):
    """Source that subscribes only to the wanted types, so that only these use the network.

    Parameters
    ----------
    endpoint : str
        Router, bridge or peer to link to.
    topics : StreamTopics
        Requested topics. Topics of a bridge from DDS must be named: their keys have no type.
    options : ReadOptions
        Options for reading the messages.
    config : LiveConfig
        Domain, topics of transforms, and how long to wait for the link.
    """

    def __init__(
        self, endpoint: str, topics: StreamTopics, options: ReadOptions, config: LiveConfig
    ) -> None:
        super().__init__(f"zenoh, {endpoint}, domain {config.domain}")
        require("zenoh", extra="live", purpose="ROS 2 over Zenoh")
        self._endpoint, self._topics, self._config = endpoint, topics, config
        self._options = options
        self._decoder = RosDecoder(2, options, self.findings)
        self._types = {f"/{name.strip('/')}": types for name, types in _named(topics, config)}
        self._session: Any = None

    def start(self, inbox: Inbox) -> None:
        """Connect to the router or peer, and subscribe to the topics."""
        ext = require("zenoh.ext", extra="live", purpose="ROS 2 over Zenoh")
        self._session = open_session(self._endpoint, timeout=CONNECT_TIMEOUT)
        take: Callable[[Any], None] = partial(self._take, inbox)
        for key, is_kept in self._keys():
            if is_kept:  # those who publish once, and keep it for who comes later
                history = ext.HistoryConfig(detect_late_publishers=True)
                ext.declare_advanced_subscriber(self._session, key, take, history=history)
            else:
                self._session.declare_subscriber(key, take)

    def close(self) -> None:
        """End the session."""
        if self._session is not None:
            with suppress(Exception):  # a broken session is as closed as it gets
                self._session.close()
            self._session = None

    def trouble(self) -> str:
        """Problem of the link; empty while it is connected."""
        return "" if self.is_linked else f"no link to {self._endpoint}, trying again"

    @property
    def is_linked(self) -> bool:
        """True while a router or peer is connected."""
        return self._session is not None and is_linked(self._session)

    def advertised(self) -> list[str]:
        """Publishers in the ROS graph, and keys with messages in the meantime.

        Publishers that announce nothing are found by their messages: all messages are requested
        during `LISTEN_S`.
        """
        if self._session is None:
            return []
        keys: set[str] = set()

        def note(sample: Any) -> None:
            if len(keys) < MAX_KEYS:
                keys.add(str(sample.key_expr))

        with suppress(Exception):  # what a broken link tells is nothing
            listening = self._session.declare_subscriber("**", note)
            answers = [
                reply
                for place in GRAPH
                for reply in self._session.liveliness().get(place, timeout=ANSWER_S)
            ]
            time.sleep(LISTEN_S)
            listening.undeclare()
            tokens = [topic_of_token(str(answer.ok.key_expr)) for answer in answers if answer.ok]
            found = {token for token in tokens if token is not None}
            return sorted(found | {told_of_key(key) for key in keys})
        return []

    def _keys(self) -> Iterator[tuple[str, bool]]:
        """Yield the keys to subscribe to, and whether earlier messages are requested as well."""
        for name, types in self._types.items():
            is_kept = name.endswith("tf_static")
            for type_name in types:
                yield key_of(name, type_name, "*", domain=self._config.domain), is_kept
            yield name.strip("/"), is_kept
        wanted = [*SCAN_TYPES] if self._topics.wants_clouds and not self._topics.clouds else []
        wanted += [*PLANAR_TYPES] if self._topics.wants_scans and not self._topics.scans else []
        for type_name in [*wanted, *(ODOMETRY if self._topics.odometry is None else ())]:
            yield key_of("**", type_name, "*", domain=self._config.domain), False

    def _take(self, inbox: Inbox, sample: Any) -> None:
        """Process one message, in a thread of the session."""
        key = str(sample.key_expr)
        named = topic_of(key)
        name = f"/{key}" if named is None else named.topic
        if name.startswith(f"{self._config.namespace}/"):
            return  # our own
        type_name = self._types.get(name, ("",))[0] if named is None else named.type
        if len(sample.payload) > self._options.max_record_bytes:
            inbox.reject(name)
            return
        raw = sample.payload.to_bytes()
        topic = Topic(name, type_name, kind_of(type_name))
        decode = partial(self._decoder.decode, name, type_name, raw, f"{self.name}, {name}")
        inbox.put(Record(topic, time.time_ns(), decode))


def _named(topics: StreamTopics, config: LiveConfig) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield the named topics with the types they may have; a bridge's keys mean the first type."""
    yield from ((name, SCAN_TYPES) for name in topics.clouds)
    yield from ((name, PLANAR_TYPES) for name in topics.scans)
    yield from ((name, TRANSFORMS) for name in config.transform_topics)
    if topics.odometry is not None:
        yield topics.odometry, POSE_TYPES
