"""Checkpoints of a run, from which it continues after its process was killed.

They lie in the folder of the run: new results as `.checkpoint-N` files, each written once, and
`run.checkpoint` with everything else, replaced as a whole. Every file ends with a checksum.
"""

import hashlib
import json
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic
from typing import Any, Protocol

from lidar_core.errors import FormatError, InputError
from lidar_core.files import read_whole
from lidar_core.io.files.atomic import written_whole
from lidar_core.run_folder import CHECKPOINT, build_digest, remove_checkpoint
from lidar_core.util.packed import packed, unpacked

_CHECKSUM, _LENGTH = struct.Struct("<I"), struct.Struct("<Q")
AGAIN = "run it again without resume, with overwrite=True"
NONE = "none"
"""How a value that is not given is told."""
MOST_TOLD = 3
"""Values of a configuration that an error names."""
MOST_BYTES = 2**34
"""Largest file that is read [bytes]. Source: limits table of SECURITY.md."""


class Resumable(Protocol):
    """A run whose state can be kept."""

    @property
    def KINDS(self) -> tuple[type, ...]:  # noqa: N802
        """Classes of the objects in `kept` and `rows`."""

    def checkpoint_state(self) -> dict[str, Any]:
        """Return the state without the rows, of limited size; states of the core as byte arrays."""

    def rows(self, since: int) -> list[Any]:
        """Return the permanent rows of each item, except the first `since`."""

    def restore(self, kept: Mapping[str, Any], rows: list[Any]) -> None:
        """Take over the state of another run of the same recording and configuration."""


@dataclass(slots=True)
class Checkpoints:
    """Writes checkpoints of a run, and finds the last one of a run that was killed.

    Attributes
    ----------
    folder : Path
        Folder of the run.
    every : float or None
        Time between two checkpoints [s]; None writes none.
    inputs : mapping
        All that determines the results: files with their hashes, configuration, options.
    """

    folder: Path
    every: float | None
    inputs: Mapping[str, Any]
    _parts: list[int] = field(default_factory=list)
    _n_rows: int = 0
    _last: float = field(default_factory=monotonic)

    def resume(self, run: Resumable) -> int:
        """Restore `run` from the last checkpoint; return the number of items it had processed.

        Returns 0 if there is no checkpoint.

        Raises
        ------
        InputError
            The checkpoint belongs to other inputs, another configuration or another build.
        FormatError
            The checkpoint is damaged.
        """
        place, content = self.folder / CHECKPOINT, self._checked()
        if content is None:
            return 0
        kept = unpacked(content, run.KINDS)
        if not isinstance(kept, dict) or not {"done", "parts", "run"} <= kept.keys():
            raise FormatError(f"{place}: not a checkpoint of a run")
        rows: list[Any] = []
        for number, checksum in enumerate(kept["parts"]):
            part = _content(self._part(number))
            if zlib.crc32(part) != checksum:
                raise FormatError(f"{self._part(number)}: not the part that {place.name} names")
            rows += unpacked(part, run.KINDS)
        run.restore(kept["run"], rows)
        self._parts, self._n_rows = list(kept["parts"]), len(rows)
        return int(kept["done"])

    def refuse(self, reason: str) -> None:
        """Raise `InputError` if the folder has a checkpoint, because this run would destroy it."""
        self._checked()
        place = self.folder / CHECKPOINT
        if place.exists():
            raise InputError(f"{place}: {reason}; {AGAIN}")

    def _checked(self) -> bytes | None:
        """Check the inputs of the last checkpoint; return its content, or None if there is none."""
        place = self.folder / CHECKPOINT
        if not place.exists():
            return None
        content = _content(place)
        try:
            (length,) = _LENGTH.unpack_from(content)
            was = json.loads(content[_LENGTH.size : _LENGTH.size + length])
        except (struct.error, ValueError):
            raise FormatError(f"{place}: not a checkpoint of a run") from None
        # Before anything else is read: runs of other commands keep objects of other classes.
        for name, change in _changes(was, self._named()).items():
            raise InputError(f"{place}: it is of a run with another {name} ({change}); {AGAIN}")
        return content[_LENGTH.size + length :]

    def take(self, run: Resumable, done: int) -> None:
        """Write a checkpoint if it is time for one; `done` items have been used."""
        if self.every is None or monotonic() - self._last < self.every:
            return
        # First the new results, which nothing names yet: a run that is killed in between goes on
        # from the checkpoint before.
        rows = run.rows(self._n_rows)
        if rows:
            part = packed(rows, run.KINDS)
            _write(self._part(len(self._parts)), part)
            self._parts.append(zlib.crc32(part))
            self._n_rows += len(rows)
        inputs = json.dumps(self._named()).encode()
        kept = packed(
            {"done": done, "parts": self._parts, "run": run.checkpoint_state()}, run.KINDS
        )
        _write(self.folder / CHECKPOINT, _LENGTH.pack(len(inputs)) + inputs + kept)
        self._last = monotonic()

    def end(self) -> None:
        """Remove the files that a finished run does not need any more."""
        remove_checkpoint(self.folder)

    def _part(self, number: int) -> Path:
        return self.folder / f".checkpoint-{number}"

    def _named(self) -> dict[str, Any]:
        """Return every input in a form that can be compared and shown to the user."""
        return {"build": build_digest()[:12]} | {
            name: _plain(value) for name, value in self.inputs.items()
        }


def _plain(value: Any) -> Any:
    """Return a value as text; of a table, its texts by name, with dots for nested tables."""
    if not isinstance(value, Mapping):
        return _value_text(value)
    texts: dict[str, str] = {}
    for name, one in value.items():
        part = _plain(one)
        texts |= (
            {f"{name}.{inner}": text for inner, text in part.items()}
            if isinstance(part, dict)
            else {str(name): part}
        )
    return texts


def _value_text(value: Any) -> str:
    if value is None:
        return NONE
    text = json.dumps(value, sort_keys=True, default=str)
    return text if len(text) <= 60 else f"{text[:40]}... ({_digest(text)})"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "replace")).hexdigest()[:12]


def _changes(was: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, str]:
    """Inputs that differ, with what they were and are; of tables only the values that differ."""
    changes = {}
    for name in [*now, *(name for name in was if name not in now)]:
        before, after = was.get(name, NONE), now.get(name, NONE)
        if before == after:
            continue
        if isinstance(before, Mapping) and isinstance(after, Mapping):
            inner = [f"{one} was {text}" for one, text in _changes(before, after).items()]
            more = [f"{len(inner) - MOST_TOLD} more"] if len(inner) > MOST_TOLD else []
            changes[name] = ", ".join(inner[:MOST_TOLD] + more)
        else:
            before, after = (
                "other values" if isinstance(one, Mapping) else one for one in (before, after)
            )
            changes[name] = f"{before}, now {after}"
    return changes


def _write(place: Path, content: bytes) -> None:
    with written_whole(place) as temporary:
        temporary.write_bytes(content + _CHECKSUM.pack(zlib.crc32(content)))


def _content(place: Path) -> bytes:
    whole = read_whole(place, limit=MOST_BYTES)
    content = whole[: -_CHECKSUM.size]
    if whole[-_CHECKSUM.size :] != _CHECKSUM.pack(zlib.crc32(content)):
        raise FormatError(f"{place}: damaged or cut off: the checksum is wrong")
    return content
