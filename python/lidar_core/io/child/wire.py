"""Frames between a reader in a child and its caller: JSON, and the bytes of its arrays.

A frame is the length of the JSON (u32) and the number of buffers (u32), their lengths (u64 each),
the JSON, the buffers. No frame is executed or unpickled: a child that a file has taken over can
send wrong values, but only of the kinds below.
"""

import json
import math
import socket
import struct
from collections.abc import Callable, Iterator
from dataclasses import fields
from functools import lru_cache
from itertools import groupby
from operator import attrgetter
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core import errors
from lidar_core.errors import FormatError, LidarCoreError, LimitError
from lidar_core.messages import LaserScan, Pose, Scan

MOST_JSON, MOST_BUFFERS, MOST_BYTES = 64 * 2**20, 10_000, 2 * 2**30
"""Largest frame that is taken: letters, number of arrays, and their bytes."""
_HEAD = struct.Struct("<II")
SMALL = 4096
"""Arrays up to this go together in one call of the system [bytes]."""
_KIND = "~"
_MESSAGES: dict[str, type] = {kind.__name__: kind for kind in (Scan, LaserScan, Pose)}
_PLAIN = "biufUSMm"
_LITERALS = frozenset({int, float, str, bool, type(None)})
_FIELDS: dict[type, Callable[[Any], tuple[Any, ...]]] = {
    kind: attrgetter(*(field.name for field in fields(kind))) for kind in _MESSAGES.values()
}


def send(link: socket.socket, value: Any, buffers: list[memoryview] | None = None) -> int:
    """Send a value; return the number of bytes. With `buffers` the value is already packed."""
    if buffers is None:
        buffers = []
        value = packed(value, buffers)
    text = json.dumps(value).encode()
    sizes = [buffer.nbytes for buffer in buffers]
    head = _HEAD.pack(len(text), len(buffers)) + struct.pack(f"<{len(sizes)}Q", *sizes) + text
    small = [head]
    for buffer in buffers:
        if buffer.nbytes <= SMALL:
            small.append(bytes(buffer))
            continue
        link.sendall(b"".join(small))
        link.sendall(buffer)
        small = []
    if small:
        link.sendall(b"".join(small))
    return len(text) + sum(sizes)


def receive(link: socket.socket) -> Any:
    """Receive a value.

    Raises
    ------
    EOFError
        The other side is gone.
    FormatError, LimitError
        The bytes are not a frame, or the frame is too large.
    """
    n_text, n_buffers = _HEAD.unpack(_exactly(link, _HEAD.size))
    if n_text > MOST_JSON or n_buffers > MOST_BUFFERS:
        raise LimitError(f"a frame of {n_text} letters and {n_buffers} arrays is too large")
    sizes = struct.unpack(f"<{n_buffers}Q", _exactly(link, 8 * n_buffers))
    if sum(sizes) > MOST_BYTES:
        raise LimitError(f"a frame of {sum(sizes)} bytes, limit {MOST_BYTES}")
    text = _exactly(link, n_text)
    buffers: list[memoryview] = []
    for is_small, group in groupby(sizes, lambda size: size <= SMALL):
        if not is_small:
            buffers += [memoryview(_exactly(link, size)) for size in group]
            continue
        some = list(group)
        data, at = memoryview(_exactly(link, sum(some))), 0
        for size in some:
            # A copy, so that one small array does not keep the memory of all.
            buffers.append(memoryview(bytearray(data[at : at + size])))
            at += size
    try:
        return _unpacked(json.loads(text), iter(buffers))
    except (ValueError, TypeError, KeyError, StopIteration, RecursionError) as error:
        raise FormatError(f"a frame breaks its format: {error!r}") from error


def _exactly(link: socket.socket, size: int) -> bytearray:
    data = bytearray(size)
    view, got = memoryview(data), 0
    while got < size:
        part = link.recv_into(view[got:])
        if part == 0:
            raise EOFError("the other side is gone")
        got += part
    return data


def packed(value: Any, buffers: list[memoryview]) -> Any:
    """Return the value in a form for JSON; its arrays go to `buffers`."""
    kind = type(value)
    if kind in _LITERALS:
        return value
    if kind in _FIELDS:  # by far the most frequent: no recursion for plain fields
        values = [
            one if type(one) in _LITERALS else packed(one, buffers) for one in _FIELDS[kind](value)
        ]
        return {_KIND: kind.__name__, "v": values}
    if isinstance(value, np.ndarray):
        return _packed_array(value, buffers)
    if isinstance(value, list | tuple):
        return [packed(one, buffers) for one in value]
    return _packed_other(value, buffers)


def _packed_other(value: Any, buffers: list[memoryview]) -> Any:
    if isinstance(value, bool | int | float | str):  # of a subclass
        return value
    if isinstance(value, dict):
        return {_KIND: "dict", "f": {str(k): packed(v, buffers) for k, v in value.items()}}
    if isinstance(value, np.generic):
        return packed(value.item(), buffers)
    if isinstance(value, bytes | bytearray | memoryview):
        buffers.append(memoryview(value).cast("B"))
        return {_KIND: "bytes"}
    inner = {field.name: packed(getattr(value, field.name), buffers) for field in fields(value)}
    return {_KIND: "object", "f": inner}


def _packed_array(array: NDArray[Any], buffers: list[memoryview]) -> Any:
    if array.dtype.hasobject or array.dtype.kind not in _PLAIN:
        values = [packed(one, buffers) for one in array.reshape(-1).tolist()]
        return {_KIND: "objects", "s": list(array.shape), "v": values}
    if array.nbytes <= SMALL:
        data = memoryview(array.tobytes())
    else:
        data = memoryview(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
    buffers.append(data)
    return {_KIND: "array", "v": [array.dtype.str, *array.shape]}


def _unpacked(value: Any, buffers: Iterator[memoryview]) -> Any:
    """Reverse `packed`; arrays take the buffers in the order in which they were packed."""
    if isinstance(value, list):
        return [_unpacked(one, buffers) for one in value]
    if not isinstance(value, dict):
        return value
    kind = value.get(_KIND)
    if kind is None:  # of a frame that was packed already
        return {name: _unpacked(one, buffers) for name, one in value.items()}
    if kind == "array":
        return _unpacked_array(*value["v"], data=next(buffers))
    if kind in _MESSAGES:
        return _MESSAGES[kind](
            *(one if type(one) in _LITERALS else _unpacked(one, buffers) for one in value["v"])
        )
    return _unpacked_other(kind, value, buffers)


def _unpacked_other(kind: str, value: Any, buffers: Iterator[memoryview]) -> Any:
    if kind == "bytes":
        return bytes(next(buffers))
    if kind == "objects":
        flat = np.empty(len(value["v"]), object)
        flat[:] = [_unpacked(one, buffers) for one in value["v"]]
        return flat.reshape(value["s"])
    inner = {str(name): _unpacked(one, buffers) for name, one in value["f"].items()}
    return inner if kind == "dict" else SimpleNamespace(**inner)


def _unpacked_array(name: str, *shape: int, data: memoryview) -> NDArray[Any]:
    dtype = _dtype(name)
    if math.prod(shape) * dtype.itemsize != data.nbytes:
        raise ValueError(f"{data.nbytes} bytes for {dtype} {shape}")
    return np.frombuffer(data, dtype).reshape(shape)


@lru_cache(64)
def _dtype(name: str) -> np.dtype[Any]:
    dtype = np.dtype(str(name))
    if dtype.hasobject:
        raise ValueError("objects are no plain array")
    return dtype


def told_error(error: BaseException, place: str) -> dict[str, Any]:
    """Encode an error as a value; errors that no reader should raise become a `FormatError`."""
    if isinstance(error, MemoryError):
        error = LimitError(f"{place}: takes more memory than available")
    if isinstance(error, OSError) and not isinstance(error, LidarCoreError) and error.errno:
        return {"class": "OSError", "args": [error.errno, error.strerror, error.filename]}
    if isinstance(error, LidarCoreError | FileNotFoundError | IsADirectoryError):
        return {"class": type(error).__name__, "args": [str(error)]}
    return {
        "class": "FormatError",
        "args": [f"{place}: cannot be read: {type(error).__name__}: {error}"],
    }


def error_of(told: dict[str, Any]) -> Exception:
    """Return the error that `told_error` encoded."""
    name, args = str(told["class"]), told["args"]
    if name == "OSError":
        return OSError(*args)
    known = {"FileNotFoundError": FileNotFoundError, "IsADirectoryError": IsADirectoryError}
    made: Any = known.get(name) or getattr(errors, name, None)
    if not (isinstance(made, type) and issubclass(made, Exception)):
        made = FormatError
    found: Exception = made(*map(str, args))
    return found
