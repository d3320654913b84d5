"""Configuration from the command line: a mode, a file, single values."""

import json
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lidar_core.cli.config import Mode
from lidar_core.errors import ConfigError

if TYPE_CHECKING:
    from lidar_core.flying import FlyingConfig


def flying_config(mode: Mode, file: Path | None, assignments: Iterable[str]) -> "FlyingConfig":
    """Configuration of a run: that of `mode`, then the file's values, then `a.b=c` ones.

    A scan that cannot be used is counted, unless the file or an assignment says otherwise: one
    bad scan is no reason to give a recording up.

    Raises
    ------
    ConfigError
        A file or assignment is no TOML, or a value is unknown or outside its range.
    """
    from lidar_core.flying import FlyingConfig

    base = FlyingConfig() if mode == "best" else FlyingConfig.paper()
    values = base.model_dump() | {"on_bad_scan": "count"}
    if file is not None:
        values = merged(values, file_values(file))
    return FlyingConfig.load(with_assignments(values, assignments))


def with_assignments(values: dict[str, Any], assignments: Iterable[str]) -> dict[str, Any]:
    """`values` with those of `a.b=c` texts.

    Raises
    ------
    ConfigError
        A text is no assignment.
    """
    for text in assignments:
        values = merged(values, _assignment(text))
    return values


def merged(values: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """`values` with `changes`, table by table."""
    result = dict(values)
    for name, change in changes.items():
        before = result.get(name)
        both = isinstance(change, dict) and isinstance(before, dict)
        result[name] = merged(before, change) if both and before is not None else change
    return result


def file_values(file: Path) -> dict[str, Any]:
    """Values of a configuration file, or those that a run.toml says its run used."""
    try:
        values = tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: expected TOML: {error}") from error
    noted = values.get("config")
    of_run = noted.get("flying") if isinstance(noted, dict) else None
    return of_run if isinstance(of_run, dict) else values


def _assignment(text: str) -> dict[str, Any]:
    """`a.b=c` as tables; what is no TOML value is taken as text."""
    key, equals, value = text.partition("=")
    for candidate in (text, f"{key}={json.dumps(value.strip())}"):
        try:
            return tomllib.loads(candidate)
        except tomllib.TOMLDecodeError:
            if not equals or not key.strip():
                break
    raise ConfigError(f"--set {text}: expected name=value, such as voxel_map.voxel_size=0.5")
