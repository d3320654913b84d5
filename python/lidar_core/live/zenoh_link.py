"""Zenoh sessions, and the names that ROS 2 topics have there.

rmw_zenoh puts topics at DOMAIN/TOPIC/TYPE/HASH, a bridge from DDS (zenoh-bridge-ros2dds) at TOPIC.
Source: design document of rmw_zenoh; README of zenoh-plugin-ros2dds.
"""

import json
import time
from typing import Any, NamedTuple

from lidar_core.errors import ConfigError, LinkError
from lidar_core.extras import require

__all__ = [
    "DEFAULT_ENDPOINT",
    "RosKey",
    "dds_name",
    "is_linked",
    "key_of",
    "open_session",
    "told_of_key",
    "topic_of",
    "topic_of_token",
]

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
"""Where the router of rmw_zenoh and the bridge listen."""
_DDS, _DDS_MARK = "::dds_::", "::msg::dds_::"


class RosKey(NamedTuple):
    """Topic and type of a key of rmw_zenoh."""

    topic: str
    type: str


def key_of(topic: str, type_name: str, type_hash: str, *, domain: int) -> str:
    """Return the key of a topic for rmw_zenoh; `**` as topic and `*` as hash match any.

    Examples
    --------
    >>> key_of("/scan", "sensor_msgs/msg/LaserScan", "RIHS01_64", domain=0)
    '0/scan/sensor_msgs::msg::dds_::LaserScan_/RIHS01_64'
    """
    return f"{domain}/{topic.strip('/')}/{dds_name(type_name)}/{type_hash}"


def dds_name(type_name: str) -> str:
    """Convert the name of a type to that of DDS: package::msg::dds_::Name_."""
    package, _, name = type_name.split("/")
    return f"{package}{_DDS_MARK}{name}_"


def topic_of(key: str) -> RosKey | None:
    """Return topic and type of a key of rmw_zenoh; None for other keys.

    Examples
    --------
    >>> topic_of("0/front/scan/sensor_msgs::msg::dds_::LaserScan_/RIHS01_64")
    RosKey(topic='/front/scan', type='sensor_msgs/msg/LaserScan')
    """
    parts = key.split("/")
    if len(parts) < 4 or _DDS not in parts[-2]:
        return None
    package, _, name = parts[-2].partition(_DDS_MARK)
    return RosKey("/" + "/".join(parts[1:-2]), f"{package}/msg/{name.removesuffix('_')}")


def topic_of_token(token: str) -> str | None:
    """Return the publisher in a token of the ROS graph as text; None for other tokens.

    Tokens of rmw_zenoh: @ros2_lv/DOMAIN/../MP/../NODE/%topic/type/hash/qos; of
    zenoh-bridge-ros2dds: @/ID/@ros2_lv/MP/topic/type/qos, with a paragraph sign for every slash.

    Examples
    --------
    >>> topic_of_token("@ros2_lv/7/a/0/1/MP/%/%/n/%scan/sensor_msgs::msg::dds_::LaserScan_/h/q")
    '/scan (sensor_msgs/msg/LaserScan), domain 7'
    >>> topic_of_token("@/a1/@ros2_lv/MP/scan/sensor_msgs\u00a7msg\u00a7LaserScan/q")
    '/scan (sensor_msgs/msg/LaserScan)'
    """
    parts = token.split("/")
    if parts[0] == "@ros2_lv" and len(parts) >= 11 and parts[5] == "MP":
        found = topic_of(f"0/{parts[9].strip('%').replace('%', '/')}/{parts[10]}/-")
        return None if found is None else f"{found.topic} ({found.type}), domain {parts[1]}"
    if parts[2:4] == ["@ros2_lv", "MP"] and len(parts) >= 6:
        name, type_name = (part.replace("\u00a7", "/") for part in parts[4:6])
        return f"/{name} ({type_name})"
    return None


def told_of_key(key: str) -> str:
    """Return a key with messages as text: topic, type and domain, or the key itself."""
    found = topic_of(key)
    if found is None:
        return f"/{key} (no type in its key)"
    return f"{found.topic} ({found.type}), domain {key.partition('/')[0]}"


def open_session(endpoint: str, *, timeout: float) -> Any:
    """Open a session that is linked to `endpoint`, and that reconnects by itself.

    Parameters
    ----------
    endpoint : str
        Endpoint to link to, such as tcp/127.0.0.1:7447.
    timeout : float
        Longest time until the first link [s].

    Raises
    ------
    ConfigError
        The endpoint is not valid.
    LinkError
        No router or peer answers there.
    MissingExtraError
        eclipse-zenoh is not installed.
    """
    zenoh = require("zenoh", extra="live", purpose="ROS 2 over Zenoh")
    config = zenoh.Config()
    settings: dict[str, Any] = {
        "mode": "peer",
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "listen/endpoints": [],
        "scouting/multicast/enabled": False,
    }
    try:
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise ConfigError(
            f"zenoh: expected an endpoint such as {DEFAULT_ENDPOINT}, got {endpoint!r}"
            f" ({str(error).partition(' at ')[0]})"
        ) from error
    end = time.monotonic() + timeout
    while not is_linked(session):
        if time.monotonic() > end:
            session.close()
            raise LinkError(
                f"zenoh: no router reachable at {endpoint} within {timeout:g} s; start the router"
                " of rmw_zenoh (ros2 run rmw_zenoh_cpp rmw_zenohd) or zenoh-bridge-ros2dds, or"
                " give another endpoint: zenoh:tcp/HOST:PORT"
            )
        time.sleep(0.05)
    return session


def is_linked(session: Any) -> bool:
    """True while a router or peer is connected."""
    return bool(list(session.info.routers_zid()) or list(session.info.peers_zid()))


def __dir__() -> list[str]:
    return __all__
