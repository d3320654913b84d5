"""Digests of results: what a scene gave, in a form that is small, exact and tells what changed."""

import hashlib
import json
import math
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from itertools import groupby, product
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
FOLDER = HERE / "replay"
TOLERANCE = 1e-5
"""Of results of networks, which differ from one CPU to another."""
KEPT = 10
"""Every so many records of a network's results are kept in full."""
SHOWN = 3
"""Values that an entry shows."""
SKIPPED = {"timing_ms", "n_voxels", "n_visits_skipped", "n_voxels_changed"}
"""Fields that differ from run to run, or that the speed of a map may change."""


class Record:
    """Values of one scene by path; a path that is added to again has one record per call."""

    def __init__(self) -> None:
        self.exact: dict[str, list[Any]] = {}
        self.near: dict[str, list[Any]] = {}

    def add(self, path: str, value: Any, *, near: bool = False, skip: frozenset[str] = frozenset()):
        """Take in a value: an array, a dataclass, a mapping; `near`: only known by tolerance."""
        for place, leaf in _leaves(path, value, SKIPPED | skip):
            store = self.near if near and np.asarray(leaf).dtype.kind == "f" else self.exact
            store.setdefault(place, []).append(leaf)

    def entries(self) -> dict[str, dict[str, Any]]:
        """Digests by path."""
        found = {path: exact_entry(values) for path, values in self.exact.items()}
        return found | {path: near_entry(values) for path, values in self.near.items()}


def _leaves(path: str, value: Any, skipped: set[str]) -> Iterator[tuple[str, Any]]:
    if is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, Mapping):
        for name, inner in value.items():
            if name not in skipped:
                yield from _leaves(f"{path}/{name}", inner, skipped)
    else:
        yield path, value


def canonical(value: Any) -> tuple[str, tuple[int, ...], bytes, list[Any]]:
    """Kind, shape, bytes and values. Integers of all widths are one kind, floats another."""
    if value is None:
        return "none", (), b"", []
    array = np.asarray(value.value if isinstance(value, Enum) else value)
    match array.dtype.kind:
        case "b" | "i" | "u":
            array = array.astype(np.int64)
            kind = "int"
        case "f":
            array = array.astype(np.float64)
            array = np.where(np.isnan(array), np.nan, array)  # one NaN for all
            kind = "float"
        case _:
            flat = [str(text) for text in array.ravel().tolist()]
            return "text", array.shape, json.dumps(flat).encode(), flat
    return kind, array.shape, array.astype(array.dtype.newbyteorder("<")).tobytes(), array.ravel()


def exact_entry(values: list[Any]) -> dict[str, Any]:
    """Digest of all records, one of each, and a few numbers by which a person sees a change."""
    whole, each, shapes, total, shown = hashlib.sha256(), [], [], 0, []
    for value in values:
        kind, shape, content, flat = canonical(value)
        head = f"{kind}{shape}".encode()
        whole.update(head + content)
        each.append(hashlib.sha256(head + content).hexdigest()[:4])
        shapes.append(f"{kind}{list(shape)}")
        if kind in ("int", "float"):
            finite = flat[np.isfinite(flat)]
            total += math.fsum(finite.tolist()) if kind == "float" else int(finite.sum())
        shown += [_plain(one) for one in flat[: SHOWN - len(shown)]]
    distinct = list(dict.fromkeys(shapes))
    return {
        "sha": whole.hexdigest()[:16],
        "shapes": " ".join(distinct[:4]) + (" ..." if len(distinct) > 4 else ""),
        "sum": total,
        "first": shown,
        "each": _runs(each),
    }


def _runs(each: list[str]) -> str:
    """Digests of the records; "906c*10" stands for ten times the same."""
    grouped = [(one, len(list(group))) for one, group in groupby(each)]
    return " ".join(one if count == 1 else f"{one}*{count}" for one, count in grouped)


def _records(runs: str) -> list[str]:
    pairs = (part.partition("*") for part in runs.split())
    return [one for one, _, count in pairs for _ in range(int(count or 1))]


def near_entry(values: list[Any]) -> dict[str, Any]:
    """Sums of every record, and the values of some: `TOLERANCE` decides whether they are alike."""
    rows = [np.asarray(value, np.float64) for value in values]
    return {
        "shapes": _runs([f"float{list(row.shape)}" for row in rows]),
        "sums": [_rounded(np.nansum(row)) for row in rows],
        "sizes": [_rounded(np.nansum(np.abs(row))) for row in rows],
        "values": {
            str(k): [_rounded(one) for one in rows[k].ravel()]
            for k in sorted({*range(KEPT - 1, len(rows), KEPT), len(rows) - 1})
        },
    }


def _rounded(value: Any) -> Any:
    return float(f"{value:.8g}") if np.isfinite(value) else str(value)


def _plain(value: Any) -> Any:
    value = value.item() if isinstance(value, np.generic) else value
    return value if not isinstance(value, float) or math.isfinite(value) else str(value)


# Files


def golden(name: str, folder: Path = FOLDER) -> dict[str, dict[str, dict[str, Any]]]:
    """Entries of a file, by scene and path."""
    return json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))


def write(name: str, scenes: Mapping[str, Mapping[str, Any]], folder: Path = FOLDER) -> None:
    """One line per entry, so that a difference is a line."""
    lines = []
    for scene, entries in sorted(scenes.items()):
        rows = [f"  {json.dumps(path)}: {json.dumps(entries[path])}" for path in sorted(entries)]
        lines.append(f" {json.dumps(scene)}: {{\n" + ",\n".join(rows) + "\n }")
    folder.mkdir(exist_ok=True)
    text = "{\n" + ",\n".join(lines) + "\n}\n"
    (folder / f"{name}.json").write_text(text, encoding="utf-8")


# Names


def renames(path: Path = HERE / "renames.toml") -> dict[str, str]:
    """Old names and what they are called now."""
    return tomllib.loads(path.read_text(encoding="utf-8"))


def under_old_names(
    entries: Mapping[str, Any], known: Mapping[str, Any], renamed: Mapping[str, str]
) -> dict[str, Any]:
    """The entries under the paths that the golden file has for them."""
    return {_old_path(path, known, renamed): entry for path, entry in entries.items()}


def _old_path(path: str, known: Mapping[str, Any], renamed: Mapping[str, str]) -> str:
    if path in known:
        return path
    candidates = [(path,)]
    for old, new in renamed.items():
        if holds(path, new):
            candidates.append((new, old))
    for chosen in product((False, True), repeat=len(candidates) - 1):
        text = f"/{path}/"
        for use, pair in zip(chosen, candidates[1:], strict=True):
            text = text.replace(f"/{pair[0]}/", f"/{pair[1]}/") if use else text
        if text.strip("/") in known:
            return text.strip("/")
    return path


def holds(path: str, name: str) -> bool:
    """Whether a name, of one part or several, is in a path."""
    return f"/{name}/" in f"/{path}/"


# Comparison


def differences(place: str, expected: Mapping[str, Any], got: Mapping[str, Any]) -> list[str]:
    """What differs in a scene, a line each; if its inputs do, nothing else is said."""
    lines = {
        path: _difference(expected.get(path), got.get(path)) for path in sorted({*expected, *got})
    }
    found = {path: text for path, text in lines.items() if text}
    inputs = {path: text for path, text in found.items() if path.startswith("inputs/")}
    if inputs:
        rest = len(found) - len(inputs)
        found = inputs | ({"": f"and {rest} results of them"} if rest else {})
    return [f"{place}: {path}: {text}" for path, text in found.items()]


def _difference(expected: Any, got: Any) -> str | None:
    if expected is None:
        return "is new: `make golden` writes it"
    if got is None:
        return "is gone"
    if "values" in expected or "values" in got:
        return _distance(expected, got)
    if expected["sha"] == got["sha"]:
        return None
    before, after = _records(expected["each"]), _records(got["each"])
    parts = [f"{len(before)} records became {len(after)}"] if len(before) != len(after) else []
    changed = [k for k, pair in enumerate(zip(before, after, strict=False)) if len({*pair}) > 1]
    if changed:
        parts.append(f"{len(changed)} of {len(before)} records differ, the first is {changed[0]}")
    parts += [
        f"{name} {expected[name]} became {got[name]}"
        for name in ("shapes", "sum", "first")
        if expected[name] != got[name]
    ]
    return "; ".join(parts)


def _distance(expected: Mapping[str, Any], got: Mapping[str, Any]) -> str | None:
    if expected.get("shapes") != got.get("shapes"):
        return f"shapes {expected.get('shapes')} became {got.get('shapes')}"
    for k, (one, two) in enumerate(zip(expected["sums"], got["sums"], strict=True)):
        if abs(one - two) > TOLERANCE * max(expected["sizes"][k], got["sizes"][k]):
            return f"the sum of record {k}, {one}, became {two}"
    for k, values in expected["values"].items():
        one, two = (np.array(each, np.float64) for each in (values, got["values"][k]))
        close = TOLERANCE * np.abs(one).max(initial=0.0, where=np.isfinite(one))
        if not np.allclose(one, two, rtol=0, atol=close, equal_nan=True):
            worst = np.nanargmax(np.abs(one - two))
            return f"value {worst} of record {k}, {one[worst]}, became {two[worst]}"
    return None
