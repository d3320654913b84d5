"""Configuration from the command line: a mode, a file, single values."""

import json
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeVar

from lidar_core.config import Config
from lidar_core.errors import ConfigError
from lidar_core.parameters import MODELS

ConfigT = TypeVar("ConfigT", bound=Config)


def run_config(
    base: ConfigT, section: str, file: Path | None, assignments: Iterable[str]
) -> ConfigT:
    """Configuration of a run: that of its mode, then the file's values, then `a.b=c` ones.

    A scan that cannot be used is counted, unless the file or an assignment says otherwise: one
    bad scan is no reason to give a recording up.

    Parameters
    ----------
    base : Config
        Configuration of a pipeline in the mode of the run.
    section : str
        Its name in a run.toml.
    file, assignments
        As the command line gives them.

    Raises
    ------
    ConfigError
        A file or assignment is no TOML, or a value is unknown or outside its range.
    """
    values = base.model_dump()
    if "on_bad_scan" in values:
        values["on_bad_scan"] = "count"
    if file is not None:
        values = merged(values, file_values(file, section))
        if section in values.keys() - type(base).model_fields.keys():
            raise ConfigError(
                f"{file}: {section}: expected its values without this table around them, or as"
                f" [config.{section}], as a run.toml has them"
            )
        loaded(type(base), values, file)
    return type(base).load(with_assignments(values, assignments))


def loaded(model: type[ConfigT], values: dict[str, Any], file: Path) -> ConfigT:
    """Configuration of these values, which are those of a file.

    Raises
    ------
    ConfigError
        A value is unknown or outside its range; the text names the file.
    """
    try:
        return model.load(values)
    except ConfigError as error:
        raise ConfigError(f"{file}: {error}") from error


def with_assignments(
    values: dict[str, Any],
    assignments: Iterable[str],
    *,
    option: str = "--set",
    example: str = "voxel_map.voxel_size=0.5",
) -> dict[str, Any]:
    """`values` with those of `a.b=c` texts; `option` and `example` are for the error.

    Raises
    ------
    ConfigError
        A text is no assignment.
    """
    for text in assignments:
        change = _assignment(text)
        if change is None:
            raise ConfigError(f"{option} {text}: expected name=value, such as {example}")
        values = merged(values, change)
    return values


def merged(values: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """`values` with `changes`, table by table."""
    result = dict(values)
    for name, change in changes.items():
        before = result.get(name)
        both = isinstance(change, dict) and isinstance(before, dict)
        result[name] = merged(before, change) if both and before is not None else change
    return result


def file_values(file: Path, section: str = "flying") -> dict[str, Any]:
    """Values of a configuration file, or those that a run.toml has of its run, under `section`."""
    values = _toml(file)
    of_run = _noted(values).get(section)
    return of_run if isinstance(of_run, dict) else values


def model_of(file: Path) -> str:
    """Name of the model that a file fills: the first of a run.toml, which is its pipeline's.

    Other files do not say: "flying".
    """
    return next((name for name in _noted(_toml(file)) if name in MODELS), "flying")


def _toml(file: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: expected TOML: {error}") from error


def _noted(values: dict[str, Any]) -> dict[str, Any]:
    """Configurations of a run.toml by their models; none of other files."""
    noted = values.get("config")
    return noted if isinstance(noted, dict) else {}


def _assignment(text: str) -> dict[str, Any] | None:
    """`a.b=c` as tables; what is no TOML value is taken as text. None for other texts."""
    key, equals, value = text.partition("=")
    for candidate in (text, f"{key}={json.dumps(value.strip())}"):
        try:
            return tomllib.loads(candidate)
        except tomllib.TOMLDecodeError:
            if not equals or not key.strip():
                break
    return None
