"""Packet captures as tcpdump and Wireshark write them, packet by packet.

Libraries that decode captures skip a broken end silently; here it is an error.
"""

import mmap
import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lidar_core.errors import FormatError
from lidar_core.io.files import pcapng
from lidar_core.io.files.pcapng import Packet

_ORDERS = {
    b"\xd4\xc3\xb2\xa1": "<",
    b"\x4d\x3c\xb2\xa1": "<",
    b"\xa1\xb2\xc3\xd4": ">",
    b"\xa1\xb2\x3c\x4d": ">",
}
_NANOSECONDS = frozenset({b"\x4d\x3c\xb2\xa1", b"\xa1\xb2\x3c\x4d"})
_FILE_HEADER, _PACKET_HEADER = 24, 16
_LINK_AT, _LINK_BITS = 20, 0xFFFF
_LARGEST_PACKET = 262_144
VELODYNE_PAYLOAD = 1206  # data packet as it is sent
VELODYNE_BYTES = VELODYNE_PAYLOAD + 42  # the same in UDP, IPv4 and Ethernet headers


def packet_sizes(path: Path) -> Counter[int]:
    """Number of packets of each captured size [bytes].

    Raises
    ------
    FormatError
        The file is not a packet capture, or ends inside a packet.
    """
    magic = _magic(path)
    if magic == pcapng.MAGIC:
        return Counter(len(packet.data) for packet in pcapng.packets(path))
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        return Counter(captured for _, captured in _places(path, data, _ORDERS[magic]))


def packets(path: Path) -> Iterator[Packet]:
    """Packets of a capture in their order; errors as of `packet_sizes`."""
    magic = _magic(path)
    if magic == pcapng.MAGIC:
        yield from pcapng.packets(path)
        return
    order, unit = _ORDERS[magic], 1 if magic in _NANOSECONDS else 1000
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        for position, captured in _places(path, data, order):
            seconds, rest = struct.unpack_from(f"{order}II", data, position - _PACKET_HEADER)
            (link,) = struct.unpack_from(f"{order}I", data, _LINK_AT)
            stamp_ns = seconds * 10**9 + rest * unit
            # The upper bits tell of checksums at the end of frames.
            yield Packet(stamp_ns, data[position : position + captured], link & _LINK_BITS)


def readable(path: Path) -> Any:
    """Return an input for libraries that read only pcap: the file's name, or pcapng as pcap."""
    with path.open("rb") as file:
        is_next = file.read(4) == pcapng.MAGIC
    return pcapng.AsPcap(path) if is_next else str(path)


def _magic(path: Path) -> bytes:
    with path.open("rb") as file:
        magic = file.read(4)
    if magic != pcapng.MAGIC and magic not in _ORDERS:
        raise FormatError(f"{path}: not a packet capture: it begins with {magic!r}")
    return magic


def _places(path: Path, data: mmap.mmap, order: str) -> Iterator[tuple[int, int]]:
    """Where the data of every packet begin, and how many bytes they are."""
    header = struct.Struct(order + "IIII")
    position, end = _FILE_HEADER, len(data)
    while position + _PACKET_HEADER <= end:
        captured = header.unpack_from(data, position)[2]
        if captured > _LARGEST_PACKET:
            raise FormatError(f"{path}, byte {position}: a packet of {captured} bytes is too large")
        following = position + _PACKET_HEADER + captured
        if following > end:
            break
        yield position + _PACKET_HEADER, captured
        position = following
    if position != end:
        raise FormatError(f"{path}, byte {min(position, end)}: the file ends inside a packet")
