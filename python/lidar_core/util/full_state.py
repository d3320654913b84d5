"""Saved states of detectors, maps, trackers, filters and pipelines: files, copies, pickles.

One format serves all. Layout (little endian): magic `LCST`, version u32, length u32 and UTF-8
JSON of {kind, config, extra}, state of the core (with a checksum of its own), CRC-32 of everything
before it.
"""

import json
import struct
import zlib
from abc import ABC, abstractmethod
from inspect import signature
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar, Self

from lidar_core.config import Config
from lidar_core.errors import FormatError, InputError
from lidar_core.files import read_whole
from lidar_core.io.files.atomic import written_whole

MAGIC = b"LCST"
VERSION = 1
MOST_BYTES = 2**34
"""Largest file that is read [bytes]. Source: limits table of SECURITY.md."""
_HEAD = struct.Struct("<4sII")
_CHECKSUM = struct.Struct("<I")


class FullState(ABC):
    """Object whose whole state can be saved; a loaded object continues with the same bits.

    `copy.copy`, `copy.deepcopy` and pickling use the same bytes. Nothing is pickled inside them:
    a file from a stranger can be refused, but it cannot run code.
    """

    _kind: ClassVar[str]
    _config_type: ClassVar[type[Config]]
    config: Any

    @abstractmethod
    def _state(self) -> tuple[bytes, dict[str, Any]]:
        """Return the state of the core, and the state of the Python object as values for JSON."""

    @classmethod
    @abstractmethod
    def _from_state(cls, config: Any, core: bytes, extra: dict[str, Any], **options: Any) -> Self:
        """Make the object from a state; `options` are arguments that change no result."""

    def _options(self) -> dict[str, Any]:
        """Return the arguments that change no result, such as `threads`, for copies."""
        return {}

    def to_bytes(self) -> bytes:
        """Return the whole state, configuration included; `from_bytes` reads it."""
        core, extra = self._state()
        head = {"kind": self._kind, "config": self.config.model_dump(mode="json"), "extra": extra}
        text = json.dumps(head, allow_nan=False).encode()
        body = _HEAD.pack(MAGIC, VERSION, len(text)) + text + core
        return body + _CHECKSUM.pack(zlib.crc32(body))

    @classmethod
    def from_bytes(cls, content: bytes, **options: Any) -> Self:
        """Make the object whose state `to_bytes` returned.

        Parameters
        ----------
        content : bytes
        **options
            Arguments of the constructor that are not in the state, such as `estimator` of
            `CirclePipeline`.

        Raises
        ------
        InputError
            `content` is not bytes.
        FormatError
            The bytes are damaged, cut off, or the state of another kind of object.
        ConfigError
            The configuration is not one of this version.
        """
        try:
            content = bytes(memoryview(content))
        except TypeError as error:
            raise InputError(f"content: expected bytes, got {type(content).__name__}") from error
        unknown = options.keys() - signature(cls).parameters.keys()
        if unknown:
            raise TypeError(f"{cls.__name__} has no argument {min(unknown)!r}")
        head, core = _opened(content)
        if head["kind"] != cls._kind:
            raise FormatError(
                f"byte 12: expected the state of a {cls._kind}, got that of a {head['kind']}"
            )
        config = cls._config_type.load(head["config"])
        try:
            return cls._from_state(config, core, head["extra"], **options)
        except (KeyError, TypeError) as error:
            raise FormatError(f"byte 12: the state breaks its format: {error!r}") from error

    def save(self, path: str | Path) -> None:
        """Write the whole state to a file atomically.

        Raises
        ------
        OSError
            The file cannot be written.
        """
        with written_whole(path) as temporary:
            temporary.write_bytes(self.to_bytes())

    @classmethod
    def load(cls, path: str | Path, **options: Any) -> Self:
        """Load an object that `save` wrote; it continues with the same bits.

        Parameters
        ----------
        path : str or Path
        **options
            Arguments of the constructor that are not in the state, such as `estimator` of
            `CirclePipeline`.

        Raises
        ------
        FormatError, ConfigError
            As for `from_bytes`, with the name of the file.
        """
        content = read_whole(path, limit=MOST_BYTES)
        try:
            return cls.from_bytes(content, **options)
        except FormatError as error:
            raise FormatError(f"{path}: {error}") from error

    def __repr__(self) -> str:
        usual = self._config_type()
        names = [
            name
            for name in self._config_type.model_fields
            if getattr(self.config, name) != getattr(usual, name)
        ]
        changed = f"changed: {', '.join(names)}" if names else "default configuration"
        return f"<{type(self).__name__}, {changed}>"

    def __copy__(self) -> Self:
        return type(self).from_bytes(self.to_bytes(), **self._options())

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self.__copy__()

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (type(self), self.to_bytes(), self._options())


def is_full_state(path: str | PathLike[str]) -> bool:
    """True if a regular file begins like a saved state."""
    known = Path(path)
    if not known.is_file():
        return False
    with known.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def _unpickled(cls: type[FullState], content: bytes, options: dict[str, Any]) -> FullState:
    return cls.from_bytes(content, **options)


def _opened(content: bytes) -> tuple[dict[str, Any], bytes]:
    """Return header and state of the core from the bytes of `to_bytes`, after all checks."""
    if content[:4] != MAGIC:
        raise FormatError("byte 0: expected a saved state (magic LCST), got other data")
    body = content[: -_CHECKSUM.size]
    if len(body) < _HEAD.size or content[len(body) :] != _CHECKSUM.pack(zlib.crc32(body)):
        raise FormatError(f"byte {len(body)}: the checksum is wrong: damaged or cut off")
    _, version, length = _HEAD.unpack_from(body)
    if version != VERSION:
        raise FormatError(
            f"byte 4: expected version {VERSION}, got {version}; update lidar_core to read it"
        )
    text = body[_HEAD.size : _HEAD.size + length]
    try:
        head = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"byte {_HEAD.size}: the head is no JSON: {error}") from error
    parts = {"kind": str, "config": dict, "extra": dict}
    if not isinstance(head, dict) or any(
        not isinstance(head.get(name), kind) for name, kind in parts.items()
    ):
        raise FormatError(f"byte {_HEAD.size}: expected kind, config and extra in the head")
    return head, body[_HEAD.size + length :]
