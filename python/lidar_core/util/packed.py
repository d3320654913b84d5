"""Exact conversion of results to bytes and back: arrays, plain values, dataclass objects.

Nothing is pickled: bytes from a stranger can be refused, but they cannot run code. Layout (little
endian): length u64 of the outline, the outline as JSON, the contents of all arrays.
"""

import json
import struct
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import fields
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError

_LENGTH = struct.Struct("<Q")
_DTYPES = {np.dtype(kind).str for kind in ("?", "u1", "u4", "i4", "<i8", "<u8", "<f4", "<f8")}
_PLAIN = (bool, int, float, str, type(None))


def packed(value: Any, kinds: Iterable[type] = ()) -> bytes:
    """Convert arrays, plain values, lists, tuples, dicts and dataclasses of `kinds` to bytes.

    Raises
    ------
    TypeError
        `value` contains something else.
    """
    writer = _Writer({kind.__name__: kind for kind in kinds})
    outline = json.dumps(writer.outline(value)).encode()
    return b"".join([_LENGTH.pack(len(outline)), outline, *writer.contents])


def unpacked(content: bytes, kinds: Iterable[type] = ()) -> Any:
    """Return the value that `packed` converted to bytes.

    Raises
    ------
    FormatError
        The bytes are damaged or cut off, or hold objects of other classes.
    """
    reader = _Reader({kind.__name__: kind for kind in kinds}, memoryview(content))
    try:
        (length,) = _LENGTH.unpack_from(content)
        reader.place = _LENGTH.size + length
        return reader.value(json.loads(bytes(content[_LENGTH.size : reader.place])))
    except (KeyError, IndexError, TypeError, ValueError, struct.error, RecursionError) as error:
        raise FormatError(f"byte 0: the results break their format: {error!r}") from error


class _Writer:
    def __init__(self, kinds: dict[str, type]) -> None:
        self._kinds = kinds
        self.contents: list[bytes] = []

    def outline(self, value: Any) -> Any:
        """Return a value as JSON: plain ones as they are, others as a tag and their fields."""
        kind = type(value)
        name = kind.__name__
        if kind in _PLAIN:
            return value
        if kind is bytes:
            self.contents.append(value)
            made: list[Any] = [len(value)]
        elif kind is np.ndarray and value.dtype.str in _DTYPES:
            self.contents.append(np.ascontiguousarray(value).tobytes())
            made = [value.dtype.str, list(value.shape)]
        elif isinstance(value, np.generic):
            name, made = "generic", [self.outline(np.array(value))]
        elif kind in (list, tuple):
            made = [self.outline(item) for item in value]
        elif kind in (dict, Counter):
            made = [[self.outline(key), self.outline(item)] for key, item in value.items()]
        elif self._kinds.get(name) is kind:
            held = [self.outline(getattr(value, one.name)) for one in fields(value)]
            name, made = "object", [name, *held]
        else:
            raise TypeError(f"expected arrays, plain values and known objects, got {name}")
        return [name, *made]


class _Reader:
    def __init__(self, kinds: dict[str, type], content: memoryview) -> None:
        self._kinds = kinds
        self._content = content
        self.place = 0
        self._read: dict[str, Callable[..., Any]] = {
            "bytes": lambda length: self._next_bytes(length).tobytes(),
            "ndarray": self._array,
            "generic": lambda outline: self.value(outline)[()],
            "list": lambda *outlines: [self.value(one) for one in outlines],
            "tuple": lambda *outlines: tuple(self.value(one) for one in outlines),
            "dict": self._pairs,
            "Counter": lambda *pairs: Counter(self._pairs(*pairs)),
            "object": self._object,
        }

    def value(self, outline: Any) -> Any:
        """Return the value of an outline; the contents of arrays are read in order."""
        if type(outline) in _PLAIN:
            return outline
        tag, *rest = outline
        return self._read[tag](*rest)

    def _pairs(self, *pairs: Any) -> dict[Any, Any]:
        return {self.value(key): self.value(item) for key, item in pairs}

    def _object(self, name: str, *outlines: Any) -> Any:
        made: Any = object.__new__(self._kinds[name])
        for one, outline in zip(fields(made), outlines, strict=True):
            object.__setattr__(made, one.name, self.value(outline))
        return made

    def _array(self, dtype: str, shape: list[int]) -> NDArray[Any]:
        if dtype not in _DTYPES or not all(type(length) is int and length >= 0 for length in shape):
            raise ValueError(f"no such array: {dtype}, {shape}")
        part = np.frombuffer(self._next_bytes(prod(shape) * np.dtype(dtype).itemsize), dtype)
        return part.reshape(shape).copy()

    def _next_bytes(self, length: int) -> memoryview:
        """Return the next `length` bytes of the contents."""
        end = self.place + length
        if length < 0 or end > len(self._content):
            raise ValueError("the contents are cut off")
        part = self._content[self.place : end]
        self.place = end
        return part
