"""Check of the clients of servers on 127.0.0.1: programs and named web pages may connect.

Any web page can open connections to this machine. Browsers send the origin of the page in the
header Origin, and the name of the address in the header Host. A foreign name that resolves to
127.0.0.1 (DNS rebinding) appears there as it was typed.
"""

import re
from collections.abc import Collection, Iterable
from urllib.parse import urlsplit

from lidar_core.errors import ConfigError

LOCAL = "127.0.0.1"
LOCAL_NAMES = frozenset({LOCAL, "localhost", "::1"})
LONGEST = 200  # of a foreign text that is told
ORIGIN = re.compile(r"[a-z][a-z0-9+.-]*://[^/\s*?#@]*")


def allowed_origins(given: Iterable[str]) -> frozenset[str]:
    """Return the origins of web pages that may connect, as browsers write them.

    Raises
    ------
    ConfigError
        A text is no origin, that is scheme and host, with a port if it is not the usual one.
    """
    found = set()
    for text in given:
        origin = text.rstrip("/") if text.count("/") > 2 and text != "file://" else text
        if not ORIGIN.fullmatch(origin.lower()):
            raise ConfigError(
                "allow-origin: expected the scheme and the host of one web page, such as"
                f" https://app.foxglove.dev or http://robot:8080, got {text!r}"
            )
        found.add(origin.lower())
    return frozenset(found)


def refusal(
    hosts: Collection[str], origins: Collection[str], allowed: Collection[str] = ()
) -> str | None:
    """Return why a request is refused; None if it is allowed.

    Parameters
    ----------
    hosts, origins : collection of str
        All headers of these names; programs that are no browsers send no Origin.
    allowed : collection of str
        Result of `allowed_origins`.
    """
    if len(hosts) != 1 or _host_of(f"//{next(iter(hosts))}") not in LOCAL_NAMES:
        named = ", ".join(repr(host[:LONGEST]) for host in hosts) or "none"
        return f"requested host {named}; this server accepts 127.0.0.1 and localhost"
    if len(origins) > 1:
        return "several origins"
    for origin in origins:
        is_local = origin.startswith(("http://", "https://")) and _host_of(origin) in LOCAL_NAMES
        if not is_local and origin.lower() not in allowed:
            is_plain = ORIGIN.fullmatch(origin.lower()) and origin.isprintable()
            cure = f"; --allow-origin {origin[:LONGEST]} lets it in" if is_plain else ""
            return f"a web page of {origin[:LONGEST]!r}{cure}"
    return None


def _host_of(address: str) -> str | None:
    """Name of the host in an address; None if there is none."""
    try:
        parts = urlsplit(address)
        _ = parts.port  # a port that is none is refused here
    except ValueError:
        return None
    has_more = parts.path or parts.query or parts.fragment or "@" in parts.netloc
    return None if has_more else parts.hostname
