"""Packet captures as tcpdump and Wireshark write them, packet by packet.

A capture that was killed ends inside a packet: everything before it is read, and the loss is
reported. Libraries that decode captures ignore such a loss, and other damage, without a message.
Here other damage is an error.
"""

import mmap
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from lidar_core.errors import FormatError
from lidar_core.io.files import pcapng
from lidar_core.io.files.beginnings import PCAP_ORDERS, not_a
from lidar_core.io.files.pcapng import CutEnd, Packet

_NANOSECONDS = frozenset({b"\x4d\x3c\xb2\xa1", b"\xa1\xb2\x3c\x4d"})
_FILE_HEADER, _PACKET_HEADER = 24, 16
_LINK_AT, _LINK_BITS = 20, 0xFFFF
_LARGEST_PACKET = 262_144
VELODYNE_PAYLOAD = 1206  # data packet as it is sent
VELODYNE_BYTES = VELODYNE_PAYLOAD + 42  # the same in UDP, IPv4 and Ethernet headers


def packet_sizes(path: Path, *, on_cut: Callable[[str], None] = lambda told: None) -> Counter[int]:
    """Count packets by captured size [byte]; `on_cut` gets a text if the last packet is cut.

    Raises
    ------
    FormatError
        The file is not a packet capture, or a packet is damaged.
    """
    end = CutEnd()
    magic = _magic(path)
    if magic == pcapng.MAGIC:
        sizes = Counter(len(packet.data) for packet in pcapng.packets(path, end))
    else:
        sizes = _pcap_sizes(path, magic, end)
    if end.lost_bytes:
        on_cut(
            f"{path}: the capture was cut inside its last packet; the last {end.lost_bytes} bytes"
            " are left out"
        )
    return sizes


def packets(path: Path) -> Iterator[Packet]:
    """Yield the packets of a capture in their order; errors as of `packet_sizes`."""
    magic = _magic(path)
    if magic == pcapng.MAGIC:
        yield from pcapng.packets(path)
        return
    order, unit = PCAP_ORDERS[magic], 1 if magic in _NANOSECONDS else 1000
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        for position, captured in _places(path, data, order):
            seconds, rest = struct.unpack_from(f"{order}II", data, position - _PACKET_HEADER)
            (link,) = struct.unpack_from(f"{order}I", data, _LINK_AT)
            stamp_ns = seconds * 10**9 + rest * unit
            # The upper bits tell of checksums at the end of frames.
            yield Packet(stamp_ns, data[position : position + captured], link & _LINK_BITS)


def readable(path: Path) -> Any:
    """Return an input for libraries that read only whole pcap: pcapng as pcap, no cut packet."""
    magic, end = _magic(path), CutEnd()
    if magic == pcapng.MAGIC:
        return pcapng.AsPcap(path)
    _pcap_sizes(path, magic, end)
    if not end.lost_bytes:
        return str(path)
    with path.open("rb") as file:
        whole = path.stat().st_size - end.lost_bytes
        return mmap.mmap(file.fileno(), whole, access=mmap.ACCESS_READ)


def _magic(path: Path) -> bytes:
    with path.open("rb") as file:
        magic = file.read(4)
    if magic != pcapng.MAGIC and magic not in PCAP_ORDERS:
        raise not_a(path, "a packet capture", magic)
    return magic


def _pcap_sizes(path: Path, magic: bytes, cut: CutEnd) -> Counter[int]:
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        return Counter(captured for _, captured in _places(path, data, PCAP_ORDERS[magic], cut))


def _places(
    path: Path, data: mmap.mmap, order: str, cut: CutEnd | None = None
) -> Iterator[tuple[int, int]]:
    """Yield the start and the size of the data of every packet [byte]."""
    header = struct.Struct(order + "IIII")
    position, end = _FILE_HEADER, len(data)
    while position + _PACKET_HEADER <= end:
        _, _, captured, sent = header.unpack_from(data, position)
        if captured > _LARGEST_PACKET:
            raise FormatError(f"{path}, byte {position}: a packet of {captured} bytes is too large")
        following = position + _PACKET_HEADER + captured
        if following > end:
            if captured > sent:  # no capture holds more of a packet than was sent
                raise FormatError(
                    f"{path}, byte {position}: a packet of {sent} bytes with {captured} captured"
                )
            break
        yield position + _PACKET_HEADER, captured
        position = following
    if end < _FILE_HEADER:
        raise FormatError(f"{path}, byte {end}: the file ends inside its header")
    if cut is not None:
        cut.lost_bytes = end - position
