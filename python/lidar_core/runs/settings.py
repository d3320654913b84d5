"""Configuration of a run: a mode, a file, single values."""

import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypeVar, get_args

from lidar_core.config import Config, as_config, in_file, tables_at, toml_values
from lidar_core.errors import ConfigError
from lidar_core.files import read_whole
from lidar_core.parameters import MODELS, model_named

ConfigT = TypeVar("ConfigT", bound=Config)
Mode: TypeAlias = Literal["best", "paper"]
COMMANDS = {
    "flying": "`detect`",
    "circles": "`circles`",
    "fusion": "`fuse`",
    "fusion_many": "`fuse --many`",
    "evaluation": "`evaluate`",
    "scene": "the scene of `simulate`",
    "circle_dataset": "the data of `train`",
}
"""Commands by the models that they take values of."""
_MEANT = re.compile(r"; did you mean [\w.]+\?$")


@dataclass(frozen=True, slots=True)
class ConfigChoice:
    """Configuration of a run: that of a mode, changed by a file, then by single values.

    Attributes
    ----------
    mode : str
        "best" or "paper".
    file : str or Path, optional
        TOML file; the run.toml of an earlier run, or its folder, is also accepted.
    values : tuple of str
        Single values as "SECTION.NAME=VALUE".

    Raises
    ------
    ConfigError
        A mode that there is not, or a value of another type.
    """

    mode: Mode = "best"
    file: str | PathLike[str] | None = None
    values: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Raise `ConfigError` for an unknown mode or a value of another type."""
        if self.mode not in get_args(Mode):
            known = " or ".join(map(repr, get_args(Mode)))
            raise ConfigError(f"mode: expected {known}, got {self.mode!r}")
        if not isinstance(self.file, str | PathLike | None):
            raise ConfigError(f"file: expected a path, got {self.file!r}")
        if not isinstance(self.values, tuple | list) or not all(
            isinstance(one, str) for one in self.values
        ):
            raise ConfigError(f"values: expected a tuple of texts, got {self.values!r}")


def config_of_run(
    config: ConfigT | ConfigChoice | None,
    model: type[ConfigT],
    section: str,
    *,
    base: ConfigT | None = None,
) -> ConfigT:
    """Return the configuration of a run.

    A scan that cannot be used is counted, unless the configuration differs: one bad scan does not
    end the run.

    Parameters
    ----------
    config : Config, ConfigChoice or None
        A configuration, its choice, or None for best mode.
    model : type
        `FlyingConfig`, `CirclesConfig`, `FusionConfig` or `MultiTargetConfig`.
    section : str
        Name of the section in a run.toml.
    base : Config, optional
        Configuration of best mode, if not `model()`.

    Raises
    ------
    ConfigError
        Another class, a file or value that cannot be used, or a model without this mode.
    """
    if config is None or isinstance(config, ConfigChoice):
        choice = config or ConfigChoice()
        start = base or model()
        if choice.mode == "paper":
            paper = getattr(model, "paper", None)
            if paper is None:
                raise ConfigError(f"mode: {section} has no paper mode")
            start = paper()
        file = None if choice.file is None else Path(choice.file)
        return run_config(start, section, file, choice.values)
    given = as_config(config, model)
    if "on_bad_scan" in type(given).model_fields.keys() - given.model_fields_set:
        return given.model_copy(update={"on_bad_scan": "count"})
    return given


def run_config(
    base: ConfigT, section: str, file: Path | None, assignments: Iterable[str]
) -> ConfigT:
    """Return the configuration of a run: its mode, changed by a file, then by `a.b=c` values.

    A scan that cannot be used is counted, unless the file or an assignment differs: one bad scan
    does not end the run.

    Parameters
    ----------
    base : Config
        Configuration of a pipeline in the mode of the run.
    section : str
        Name of the section in a run.toml.
    file, assignments
        Values of the command line.

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
    values = with_assignments(values, assignments)
    try:
        return type(base).load(values)
    except ConfigError as error:
        raise _with_commands(error, type(base), values) from error


def _with_commands(error: ConfigError, model: type[Config], values: dict[str, Any]) -> ConfigError:
    """Return the error with the commands whose configurations have the unknown parameters."""
    lines = str(error).splitlines()
    for number, line in enumerate(lines):
        name, _, problem = line.partition(": ")
        if name in model.model_fields or not problem.startswith("no such parameter"):
            continue
        known = [
            command
            for section, command in COMMANDS.items()
            if _has(model_named(section), name, values.get(name))
        ]
        if known:
            told = _MEANT.sub("", line)  # a similar name of this model is less probable
            lines[number] = f"{told}; it is a parameter of {' and '.join(known)}"
    return ConfigError("\n".join(lines))


def _has(model: type[Config], name: str, value: Any) -> bool:
    """Return whether a model has this parameter and, if it is a table, each of its entries."""
    if name not in model.model_fields:
        return False
    inner = tables_at(model, [name])
    return not isinstance(value, dict) or any(
        value.keys() <= one.model_fields.keys() for one in inner
    )


def loaded(model: type[ConfigT], values: dict[str, Any], file: Path) -> ConfigT:
    """Make a configuration from the values of a file.

    Raises
    ------
    ConfigError
        A value is unknown or outside its range; the text names the file.
    """
    try:
        return model.load(values)
    except ConfigError as error:
        raise in_file(error, file) from error


def with_assignments(
    values: dict[str, Any],
    assignments: Iterable[str],
    *,
    argument: str = "values",
    example: str = "voxel_map.voxel_size=0.5",
) -> dict[str, Any]:
    """Return `values` changed by `a.b=c` texts; `argument` and `example` are for the error.

    Raises
    ------
    ConfigError
        A text is no assignment.
    """
    for text in assignments:
        change = _assignment(text)
        if change is None:
            raise ConfigError(f"{argument}: {text}: expected name=value, such as {example}")
        values = merged(values, change)
    return values


def merged(values: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Merge `changes` into `values`, table by table; a table of another `kind` replaces all."""
    result = dict(values)
    for name, change in changes.items():
        before = result.get(name)
        if isinstance(change, dict) and isinstance(before, dict) and _is_alike(before, change):
            result[name] = merged(before, change)
        else:
            result[name] = change
    return result


def _is_alike(before: dict[str, Any], change: dict[str, Any]) -> bool:
    kind = before.get("kind")
    return bool(change.get("kind", kind) == kind)


def file_values(file: Path, section: str) -> dict[str, Any]:
    """Return the values of the model `section` in a configuration file or a run.toml.

    Raises
    ------
    ConfigError
        The file is for another model.
    """
    values = _toml(file)
    of_run = _noted(values).get(section)
    if isinstance(of_run, dict):
        return of_run
    is_unknown = bool(values.keys() - _names_of(section) - {section})
    other = next(_models_of(file), section) if is_unknown else section
    if other != section:
        raise ConfigError(f"{file}: holds values of {other}, expected those of {section}")
    return values


def model_of(file: Path) -> str:
    """Name of the model that a file fills: the first of a run.toml, which is its pipeline's.

    For other files, return the first model that has all their values; "flying" if there is none.
    """
    return next(_models_of(file), "flying")


def _models_of(file: Path) -> Iterator[str]:
    """Yield the names of the models that a file may be for, the likeliest first."""
    values = _toml(file)
    yield from (name for name in _noted(values) if name in MODELS)
    for name in ("flying", *MODELS):
        if values.keys() <= _names_of(name):
            yield name


def _names_of(model: str) -> set[str]:
    """Names of parameters that a file of a model may have, those of earlier versions included."""
    kind = model_named(model)
    return {*kind.model_fields, *kind.removed}


def _toml(file: Path) -> dict[str, Any]:
    """Read the values of a TOML file; a folder stands for its run.toml."""
    from lidar_core.run_folder import RUN_FILE

    file = file / RUN_FILE if file.is_dir() else file
    return toml_values(read_whole(file), file)


def _noted(values: dict[str, Any]) -> dict[str, Any]:
    """Configurations in a run.toml by their models; empty for other files."""
    noted = values.get("config")
    return noted if isinstance(noted, dict) else {}


def _assignment(text: str) -> dict[str, Any] | None:
    """Parse `a.b=c` into nested tables; a value that is not TOML is text. None for other texts."""
    key, equals, value = text.partition("=")
    for candidate in (text, f"{key}={json.dumps(value.strip())}"):
        try:
            return toml_values(candidate.encode(), text)
        except (ConfigError, UnicodeEncodeError):  # the latter: a text that is no UTF-8
            if not equals or not key.strip():
                break
    return None
