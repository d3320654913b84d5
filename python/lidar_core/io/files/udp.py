"""Datagrams of a packet capture: UDP over IPv4 and IPv6, fragments put together.

Layouts: RFC 768 (UDP), RFC 791 (IPv4), RFC 8200 (IPv6); link layers by the list of tcpdump.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from lidar_core.io.files.pcap import packets

ETHERNET, NULL, RAW, LOOP, LINUX_COOKED, IPV4, IPV6, LINUX_COOKED_2 = (
    1,
    0,
    101,
    108,
    113,
    228,
    229,
    276,
)
_IP_AT = {RAW: 0, IPV4: 0, IPV6: 0, NULL: 4, LOOP: 4, LINUX_COOKED: 16, LINUX_COOKED_2: 20}
"""Where IP begins; Ethernet may have tags of VLANs before it."""
_TAGS, _TAG_BYTES = (0x8100, 0x88A8), 4
_UDP, _FRAGMENT, _OPTIONS = 17, 44, (0, 43, 60)
_UDP_HEAD = 8
MOST_PENDING = 256
"""Datagrams whose fragments have not all come; beyond, the oldest is given up."""


class Datagram(NamedTuple):
    """UDP packet that a program received.

    Attributes
    ----------
    stamp_ns : int
        Time at which its last fragment was captured [ns].
    source : bytes
        Address of the sender.
    port : int
        Destination port.
    data : bytes
        Content.
    """

    stamp_ns: int
    source: bytes
    port: int
    data: bytes


class _Part(NamedTuple):
    """Whole IP packet or one fragment of a packet."""

    key: bytes
    source: bytes
    offset: int
    is_last: bool
    data: bytes


class _Pending:
    """Fragments of one packet."""

    def __init__(self) -> None:
        self._parts: dict[int, bytes] = {}
        self._size: int | None = None

    def add(self, part: _Part) -> bytes | None:
        """Return the packet, if this was its last missing fragment."""
        self._parts[part.offset] = part.data
        if part.is_last:
            self._size = part.offset + len(part.data)
        if self._size is None or sum(map(len, self._parts.values())) < self._size:
            return None
        data = b"".join(self._parts[offset] for offset in sorted(self._parts))
        return data[: self._size]


def datagrams(path: Path) -> Iterator[Datagram]:
    """Yield the UDP datagrams of a capture in the order in which they were complete.

    Raises
    ------
    FormatError
        The file is not a packet capture, or is broken.
    """
    pending: dict[bytes, _Pending] = {}
    for packet in packets(path):
        part = _ip_part(packet.data, packet.link)
        if part is None:
            continue
        whole: bytes | None = part.data
        if part.offset or not part.is_last:
            whole = pending.setdefault(part.key, _Pending()).add(part)
            if whole is not None:
                del pending[part.key]
            elif len(pending) > MOST_PENDING:
                del pending[next(iter(pending))]
        if whole is None or len(whole) < _UDP_HEAD:
            continue
        port, size = struct.unpack_from(">HH", whole, 2)
        if _UDP_HEAD <= size <= len(whole):  # longer than what was captured: cut by the capture
            yield Datagram(packet.stamp_ns, part.source, port, whole[_UDP_HEAD:size])


def _ip_part(data: bytes, link: int) -> _Part | None:
    """Return the UDP packet or fragment in a captured packet; None without one."""
    position = _ip_position(data, link)
    if position is None or len(data) < position + 20:
        return None
    version = data[position] >> 4
    if version == 4:
        return _ipv4(data, position)
    return _ipv6(data, position) if version == 6 and len(data) >= position + 40 else None


def _ip_position(data: bytes, link: int) -> int | None:
    if link != ETHERNET:
        return _IP_AT.get(link)
    position = 12
    while len(data) >= position + 2:
        (kind,) = struct.unpack_from(">H", data, position)
        if kind not in _TAGS:
            return position + 2 if kind in (0x0800, 0x86DD) else None
        position += _TAG_BYTES
    return None


def _ipv4(data: bytes, at: int) -> _Part | None:
    head = (data[at] & 15) * 4
    size, number, place, _, protocol = struct.unpack_from(">HHHBB", data, at + 2)
    if protocol != _UDP or size < head or len(data) < at + size:
        return None
    source = data[at + 12 : at + 16]
    key = data[at + 12 : at + 20] + number.to_bytes(2, "big")
    is_last = not place & 0x2000
    return _Part(key, source, (place & 0x1FFF) * 8, is_last, data[at + head : at + size])


def _ipv6(data: bytes, at: int) -> _Part | None:
    size, following = struct.unpack_from(">HB", data, at + 4)
    end, position = at + 40 + size, at + 40
    source, key, offset, is_last = data[at + 8 : at + 24], data[at + 8 : at + 40], 0, True
    while following in (*_OPTIONS, _FRAGMENT) and position + 8 <= min(end, len(data)):
        kind, following = following, data[position]
        if kind == _FRAGMENT:
            (place,) = struct.unpack_from(">H", data, position + 2)
            offset, is_last = place & 0xFFF8, not place & 1
            key += data[position + 4 : position + 8]
            position += 8
        else:
            position += 8 + 8 * data[position + 1]
    if following != _UDP or end > len(data):
        return None
    return _Part(key, source, offset, is_last, data[position:end])
