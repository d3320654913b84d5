"""Tracks and maps for robots: messages of ROS 2 over Zenoh."""

import time
from contextlib import suppress
from typing import Any
from uuid import uuid4

from lidar_core.extras import require
from lidar_core.io.write.ros import RosMessages
from lidar_core.live.config import CONNECT_TIMEOUT, LiveConfig
from lidar_core.live.outputs.output import Output
from lidar_core.live.outputs.ros import TRACKS, TYPES, ros_messages
from lidar_core.live.outputs.update import Update
from lidar_core.live.zenoh_link import dds_name, key_of, open_session

NODE = "lidar_core"
QOS = "::,10:,:,:,,"
"""Quality of service in tokens of rmw_zenoh: all defaults, the last ten are kept."""


class ZenohOutput(Output):
    """Publishes Detection3DArray at NAMESPACE/tracks, Odometry per object at NAMESPACE/odometry.

    Publishes under keys of rmw_zenoh and, for bridges to DDS, under plain keys.

    Parameters
    ----------
    endpoint : str
        Router, bridge or peer to link to.
    config : LiveConfig
        Domain, namespace, and how long to wait for the link.

    Raises
    ------
    LinkError
        No router or peer answers at the endpoint.
    MissingExtraError
        eclipse-zenoh or rosbags is not installed.
    """

    def __init__(self, endpoint: str, config: LiveConfig) -> None:
        super().__init__(f"zenoh, {endpoint}, {config.namespace}/{TRACKS}")
        self._messages = RosMessages(2)
        self._ext = require("zenoh.ext", extra="live", purpose="ROS 2 over Zenoh")
        self._session = open_session(endpoint, timeout=CONNECT_TIMEOUT)
        self._config = config
        self._count = 0
        self._gid = uuid4().bytes
        self._tokens = [self._token("NN", 0, "")]
        self._publishers: dict[str, list[Any]] = {}
        for number, (name, type_name) in enumerate(TYPES.items(), 1):
            topic = f"{config.namespace}/{name}"
            type_hash = self._messages.store.hash_rihs01(type_name)
            keys = key_of(topic, type_name, type_hash, domain=config.domain), topic.strip("/")
            publishers = [self._session.declare_publisher(key) for key in keys]
            self._publishers[name] = publishers
            graph = f"/{topic.replace('/', '%')}/{dds_name(type_name)}/{type_hash}/{QOS}"
            self._tokens.append(self._token("MP", number, graph))

    def publish(self, update: Update) -> None:
        """Send tracks and the odometry of each."""
        for name, message in ros_messages(update, self._messages):
            self._put(name, message)

    def close(self) -> None:
        """End the session."""
        with suppress(Exception):  # a broken session is as closed as it gets
            self._session.close()

    def _put(self, name: str, message: Any) -> None:
        raw = self._messages.packed(message)
        self._count += 1
        number, now = self._ext.Int64(self._count), self._ext.Int64(time.time_ns())
        attachment = self._ext.z_serialize((number, now, self._gid))
        for publisher in self._publishers[name]:
            publisher.put(raw, attachment=attachment)

    def _token(self, kind: str, number: int, rest: str) -> Any:
        """Declare the token by which ROS sees a node or a publisher."""
        place = f"@ros2_lv/{self._config.domain}/{self._session.zid()}/0/{number}"
        return self._session.liveliness().declare_token(f"{place}/{kind}/%/%/{NODE}{rest}")
