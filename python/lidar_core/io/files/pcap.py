"""Framing of packet captures: detects the format and truncated files.

Packets themselves are decoded by the vendors' libraries, which skip a broken end silently.
"""

import mmap
import struct
from collections import Counter
from pathlib import Path
from typing import Any

from lidar_core.errors import FormatError
from lidar_core.io.files import pcapng

_ORDERS = {
    b"\xd4\xc3\xb2\xa1": "<",
    b"\x4d\x3c\xb2\xa1": "<",
    b"\xa1\xb2\xc3\xd4": ">",
    b"\xa1\xb2\x3c\x4d": ">",
}
_FILE_HEADER, _PACKET_HEADER = 24, 16
_LARGEST_PACKET = 262_144
VELODYNE_PAYLOAD = 1206  # data packet as it is sent
VELODYNE_BYTES = VELODYNE_PAYLOAD + 42  # the same in UDP, IPv4 and Ethernet headers


def packet_sizes(path: Path) -> Counter[int]:
    """Number of packets of each captured size [bytes].

    Raises
    ------
    FormatError
        No packet capture, or one that ends inside a packet.
    """
    with path.open("rb") as file:
        magic = file.read(4)
        if magic == pcapng.MAGIC:
            return Counter(len(packet.data) for packet in pcapng.packets(path))
        if magic not in _ORDERS:
            raise FormatError(f"{path}: no packet capture: it begins with {magic!r}")
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            return _walk(path, data, struct.Struct(_ORDERS[magic] + "IIII"))


def readable(path: Path) -> Any:
    """Input for libraries that read only pcap: the file's name, or pcapng shown as pcap."""
    with path.open("rb") as file:
        is_next = file.read(4) == pcapng.MAGIC
    return pcapng.AsPcap(path) if is_next else str(path)


def _walk(path: Path, data: mmap.mmap, header: struct.Struct) -> Counter[int]:
    sizes: Counter[int] = Counter()
    position, end = _FILE_HEADER, len(data)
    while position + _PACKET_HEADER <= end:
        captured = header.unpack_from(data, position)[2]
        if captured > _LARGEST_PACKET:
            raise FormatError(f"{path}, byte {position}: a packet of {captured} bytes")
        sizes[captured] += 1
        position += _PACKET_HEADER + captured
    if position != end:
        raise FormatError(f"{path}, byte {min(position, end)}: the file ends inside a packet")
    return sizes
