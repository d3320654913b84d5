"""Requirements of an ONNX file, checked before onnxruntime loads it: operators, subgraphs, files.

A graph without loops does the same work for every input of a size, and reads no file. The wire
format is that of protocol buffers; field numbers are those of onnx.proto.
"""

from collections.abc import Iterator
from pathlib import Path

from lidar_core.errors import FormatError

MOST_DEPTH, MOST_FIELDS = 16, 2_000_000
STANDARD = ("", "ai.onnx")
"""Domains of the operators that ONNX itself defines."""
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_MESSAGES: dict[str, dict[int, str]] = {
    "model": {7: "graph", 20: "training", 25: "function"},
    "training": {1: "graph", 2: "graph"},
    "function": {7: "node", 11: "attribute"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "inner", 10: "tensor", 11: "inner", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
}
"""Messages within messages that are looked into; `inner` graphs are refused where they are met."""
_OPERATOR, _DOMAIN = 4, 7
_EXTERNAL_DATA, _DATA_LOCATION = 13, 14


def check_graph(path: Path, content: bytes) -> None:
    """Refuse a model that could run for ever, read other files, or call foreign code.

    Raises
    ------
    FormatError
        The file is not an ONNX model, has control flow (Loop, Scan, If: graphs within the graph),
        weights in other files, its own functions or operators, or is nested too deep.
    """
    left = [("model", content, 0)]
    counted, has_graph = 0, False
    while left:
        kind, data, depth = left.pop()
        if depth > MOST_DEPTH:
            raise FormatError(f"{path}: expected an ONNX model: nested more than {MOST_DEPTH} deep")
        fields = list(_fields(path, data))
        counted += len(fields)
        if counted > MOST_FIELDS:
            raise FormatError(
                f"{path}: more than {MOST_FIELDS} entries, which no circle detector has"
            )
        _check_message(path, kind, fields)
        has_graph |= kind == "graph"
        inner = _MESSAGES.get(kind, {})
        left += [
            (inner[number], value, depth + 1)
            for number, value in fields
            if number in inner and isinstance(value, bytes)
        ]
    if not has_graph:
        raise FormatError(f"{path}: expected an ONNX model: it holds no graph")


def _check_message(path: Path, kind: str, fields: list[tuple[int, int | bytes]]) -> None:
    numbers = {number for number, _ in fields}
    if kind == "inner":
        raise FormatError(
            f"{path}: control flow (Loop, Scan, If) is refused; export the model without it"
        )
    if kind in ("function", "training"):
        raise FormatError(f"{path}: expected only a graph, got also a {kind}")
    is_external = any(number == _DATA_LOCATION and value != 0 for number, value in fields)
    if kind == "tensor" and (is_external or _EXTERNAL_DATA in numbers):
        raise FormatError(f"{path}: weights in another file (external data) are refused")
    if kind == "node":
        named = dict(fields)
        operator, domain = (_text(named.get(number, b"")) for number in (_OPERATOR, _DOMAIN))
        if domain not in STANDARD:
            raise FormatError(
                f"{path}: operator {operator} of {domain!r} is not a standard ONNX operator"
            )


def _text(value: int | bytes) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _fields(path: Path, data: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Yield numbers and values of the fields of one message; fixed-size numbers as bytes."""
    at = 0
    while at < len(data):
        tag, at = _varint(path, data, at)
        number, wire = tag >> 3, tag & 7
        if tag >= 2**32:  # onnxruntime's parser keeps 32 bits, which name another entry
            raise FormatError(f"{path}: expected an ONNX model: entry {number} at byte {at}")
        if wire == _VARINT:
            value, at = _varint(path, data, at)
            yield number, value
            continue
        if wire == _BYTES:
            size, at = _varint(path, data, at)
        elif wire in (_FIXED32, _FIXED64):
            size = 4 if wire == _FIXED32 else 8
        else:
            raise FormatError(
                f"{path}: expected an ONNX model: unknown wire type {wire} at byte {at}"
            )
        if size > len(data) - at:
            raise FormatError(
                f"{path}: expected an ONNX model: {size} bytes are stated, {len(data) - at} follow"
            )
        yield number, data[at : at + size]
        at += size


def _varint(path: Path, data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(data):
            break
        byte, at = data[at], at + 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise FormatError(f"{path}: expected an ONNX model: a number does not end at byte {at}")
