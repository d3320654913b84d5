"""Captures as Wireshark writes them: pcapng, packet by packet, or as the pcap that libraries read.

Layout: IETF draft "PCAP Next Generation (pcapng) Capture File Format".
"""

import mmap
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from lidar_core.errors import FormatError

SECTION, INTERFACE, PACKET = 0x0A0D0D0A, 1, 6
MAGIC = SECTION.to_bytes(4, "big")
_ORDERS = {b"\x4d\x3c\x2b\x1a": "<", b"\x1a\x2b\x3c\x4d": ">"}
_LEAST_BLOCK, _LARGEST_BLOCK = 12, 16 * 2**20
_PACKET_HEAD, _OPTIONS = 20, 8  # where the data of a packet begin, and options of an interface
_CAPTURED_AT = 12  # in the head of a packet
_MOST_OPTIONS = 1024  # bytes of options of one packet: flags, hashes, a comment
_RESOLUTION, _OFFSET = 9, 14  # options
_MICROSECONDS = 6  # resolution of an interface that states none: a negative power of ten
_LATEST_NS = 2**32 * 10**9  # pcap counts seconds in 32 bits
_PCAP_HEAD = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 262_144, 1)  # Ethernet


class Packet(NamedTuple):
    """One captured packet, its time [ns], and the number of its kind of network ("LINKTYPE")."""

    stamp_ns: int
    data: bytes
    link: int = 1


class _Clock(NamedTuple):
    """Clock of an interface: ticks per second, seconds to add; and its kind of network."""

    rate: int = 10**_MICROSECONDS
    offset: int = 0
    link: int = 1

    def ns(self, ticks: int) -> int:
        return self.offset * 10**9 + ticks * 10**9 // self.rate


@dataclass(slots=True)
class CutEnd:
    """Bytes of the last packet of a capture that was killed; 0 if it is whole."""

    lost_bytes: int = 0


def packets(path: Path, cut: CutEnd | None = None) -> Iterator[Packet]:
    """Yield the packets of a capture in their order; blocks of other kinds are skipped.

    A last block that was cut is the end; `cut` gets its size.

    Raises
    ------
    FormatError
        A block is broken.
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        clocks: list[_Clock] = []
        for position, order, kind, body in _blocks(path, data, cut or CutEnd()):
            try:
                if kind == SECTION:
                    clocks.clear()
                elif kind == INTERFACE:
                    clocks.append(_clock(body, order))
                elif kind == PACKET:
                    yield _packet(body, order, clocks)
            except (struct.error, IndexError, ValueError) as error:
                raise FormatError(f"{path}, byte {position}: a broken block: {error}") from error


def _blocks(path: Path, data: mmap.mmap, cut: CutEnd) -> Iterator[tuple[int, str, int, bytes]]:
    """Yield position, byte order, kind and content of every block."""
    position, order, end = 0, "<", len(data)
    while position < end:
        if data[position : position + 4] == MAGIC:
            order = _ORDERS.get(data[position + 8 : position + 12], "")
        if position and end - position < _LEAST_BLOCK:
            cut.lost_bytes = end - position
            return
        if not order or end - position < _LEAST_BLOCK:
            raise FormatError(f"{path}, byte {position}: not a block of pcapng")
        kind, size = struct.unpack_from(f"{order}II", data, position)
        if not _LEAST_BLOCK <= size <= _LARGEST_BLOCK or size % 4:
            raise FormatError(f"{path}, byte {position}: a block of {size} bytes")
        if position + size > end:
            if not _can_be_cut(data[position + 8 : end], order, kind, size):
                raise FormatError(
                    f"{path}, byte {position}: the file ends inside a block of {size} bytes"
                )
            cut.lost_bytes = end - position
            return
        yield position, order, kind, data[position + 8 : position + size - 4]
        position += size


def _can_be_cut(body: bytes, order: str, kind: int, size: int) -> bool:
    """Return whether a block that exceeds the file has the size of a packet that was cut.

    Otherwise its size is damaged, and would hide all packets after it.
    """
    if kind != PACKET:
        return False
    if len(body) < _PACKET_HEAD:
        return True
    (captured,) = struct.unpack_from(f"{order}I", body, _CAPTURED_AT)
    padded = _LEAST_BLOCK + _PACKET_HEAD + (captured + 3) // 4 * 4
    return bool(padded <= size <= padded + _MOST_OPTIONS)


def _packet(body: bytes, order: str, clocks: list[_Clock]) -> Packet:
    interface, high, low, captured, _ = struct.unpack_from(f"{order}IIIII", body)
    if captured > len(body) - _PACKET_HEAD:
        raise ValueError(f"a packet of {captured} bytes")
    if interface >= len(clocks):
        raise ValueError(f"a packet of interface {interface}, which the file does not describe")
    stamp_ns = clocks[interface].ns(high << 32 | low)
    if not 0 <= stamp_ns < _LATEST_NS:
        raise ValueError(f"a packet at {stamp_ns} ns")
    data = body[_PACKET_HEAD : _PACKET_HEAD + captured]
    return Packet(stamp_ns, data, clocks[interface].link)


def _clock(body: bytes, order: str) -> _Clock:
    (link,) = struct.unpack_from(f"{order}H", body)
    clock, position = _Clock(link=link), _OPTIONS
    while position + 4 <= len(body):
        code, size = struct.unpack_from(f"{order}HH", body, position)
        if code == _RESOLUTION:
            power = body[position + 4]
            clock = clock._replace(rate=2 ** (power & 127) if power & 128 else 10**power)
        elif code == _OFFSET:
            (seconds,) = struct.unpack_from(f"{order}q", body, position + 4)
            clock = clock._replace(offset=seconds)
        elif code == 0:
            break
        position += 4 + (size + 3) // 4 * 4
    return clock


class AsPcap:
    """Pcapng file that is read like a pcap file with the same packets, times in microseconds."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.seek(0)

    def seek(self, position: int) -> None:
        """Go back to the beginning, whatever `position` is."""
        del position
        self._parts, self._left = self._pcap(), b""

    def read(self, size: int) -> bytes:
        """Read this many bytes, or fewer at the end."""
        while len(self._left) < size and (part := next(self._parts, None)) is not None:
            self._left += part
        taken, self._left = self._left[:size], self._left[size:]
        return taken

    def _pcap(self) -> Iterator[bytes]:
        yield _PCAP_HEAD
        for packet in packets(self._path):
            seconds, rest = divmod(packet.stamp_ns, 10**9)
            size = len(packet.data)
            yield struct.pack("<IIII", seconds, rest // 1000, size, size) + packet.data
