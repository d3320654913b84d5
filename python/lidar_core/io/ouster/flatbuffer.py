"""Reader of FlatBuffers tables in place; every offset in a file is checked.

Layout: FlatBuffers internals, "Format details".
"""

import struct
from collections.abc import Iterator

from lidar_core.errors import FormatError

Bytes = bytes | memoryview
SIZE_BYTES = 4


class Table:
    """One table: values and references by the number of their field in the schema."""

    def __init__(self, data: Bytes, position: int) -> None:
        self._data, self._position = data, position
        self._fields = position - int(self._number("i", position))
        self._size = int(self._number("H", self._fields))

    def number(self, field: int, code: str, default: int = 0) -> int:
        """Read a whole number; `code` is a format character of `struct`."""
        at = self._at(field)
        return int(self._number(code, at)) if at else default

    def bytes(self, field: int) -> memoryview:
        """Return a vector of bytes, or a text; empty if it is missing."""
        return self.vector(field, 1)

    def vector(self, field: int, item_bytes: int) -> memoryview:
        """Return the bytes of a vector of numbers or structs of `item_bytes` each."""
        begin, count = self._vector(field)
        end = begin + count * item_bytes
        if end > len(self._data):
            raise FormatError(f"a vector ends at byte {end} of {len(self._data)}")
        return memoryview(self._data)[begin:end]

    def tables(self, field: int) -> "Iterator[Table]":
        """Yield the tables of a vector."""
        begin, count = self._vector(field)
        for at in range(begin, begin + SIZE_BYTES * count, SIZE_BYTES):
            yield Table(self._data, at + int(self._number("I", at)))

    def _vector(self, field: int) -> tuple[int, int]:
        at = self._at(field)
        if not at:
            return 0, 0
        at += int(self._number("I", at))
        return at + SIZE_BYTES, int(self._number("I", at))

    def _at(self, field: int) -> int:
        """Position of a field [byte]; 0 if it was left out."""
        place = SIZE_BYTES + 2 * field
        if place + 2 > self._size:
            return 0
        offset = int(self._number("H", self._fields + place))
        return self._position + offset if offset else 0

    def _number(self, code: str, at: int) -> int:
        if not 0 <= at <= len(self._data) - struct.calcsize(code):
            raise FormatError(f"an offset points to byte {at} of {len(self._data)}")
        (value,) = struct.unpack_from(f"<{code}", self._data, at)
        return int(value)


def sized_table(data: Bytes) -> Table:
    """Return the root table of a buffer that begins with its size."""
    if len(data) < 2 * SIZE_BYTES:
        raise FormatError(f"a buffer of {len(data)} bytes")
    (root,) = struct.unpack_from("<I", data, SIZE_BYTES)
    return Table(data, SIZE_BYTES + root)
