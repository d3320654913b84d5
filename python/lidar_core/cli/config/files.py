"""`lidar-core config show`, `init`, `migrate` and `schema`: print, create and convert files."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lidar_core.cli.shared.common import Mode, OverwriteFile, check_new
from lidar_core.parameters import MODELS
from lidar_core.use_cases import USES

if TYPE_CHECKING:
    from lidar_core.config import Config

SchemaModel = Annotated[
    str, typer.Option("--model", help=f"Configuration model: {', '.join(MODELS)}.")
]
ModelOption = Annotated[
    str | None,
    typer.Option(
        "--model",
        help=f"Configuration model: {', '.join(MODELS)};"
        " default: that of USE or FILE, otherwise flying.",
    ),
]
ModeOption = Annotated[Mode, typer.Option(help="Defaults of best mode or of paper mode.")]

PresetOption = Annotated[
    str | None,
    typer.Option(
        help="Sensor, such as vlp-16 or tim571 (for the models flying, circles and scene), or"
        " built-in scene, such as demo or circles-lab (for the model scene)."
    ),
]

UseOption = Annotated[
    str | None,
    typer.Option(help="; ".join(f"{name}: {use.title}" for name, use in USES.items()) + "."),
]


def show(
    file: Annotated[
        Path | None, typer.Argument(help="TOML file, a run.toml, or its folder.")
    ] = None,
    *,
    model: ModelOption = None,
    mode: ModeOption = "best",
    use: UseOption = None,
    preset: PresetOption = None,
    changed: Annotated[
        bool, typer.Option("--changed", help="List only values that differ from the defaults.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """List every value; FILE overrides PRESET, USE and MODE. Changed values are marked."""
    from lidar_core.runs.settings import file_values, loaded, merged, model_of

    if model is None and use is None and file is not None:
        model = model_of(file)
    model, config = _chosen(model, mode, use, preset)
    defaults = _of_mode(model, "best")
    if file is not None:
        values = merged(config.model_dump(), file_values(file, model))
        config = loaded(type(defaults), values, file)
    if as_json:
        print(json.dumps(config.model_dump(mode="json"), indent=2))
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    before = dict(_flat(defaults.model_dump(mode="json")))
    table = Table("parameter", "value", "default")
    for path, value in _flat(config.model_dump(mode="json")):
        text, default = _shown(value), _shown(before[path]) if path in before else "-"
        differs = text != default
        if differs or not changed:
            style = "bold" if differs else None
            table.add_row(path, escape(text), escape(default) if differs else "", style=style)
    Console().print(table)


def init(
    *,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File to write; default: standard output.")
    ] = None,
    model: ModelOption = None,
    mode: ModeOption = "best",
    use: UseOption = None,
    preset: PresetOption = None,
    overwrite: OverwriteFile = False,
) -> None:
    """Write a configuration file with every parameter, its meaning, unit and range."""
    from lidar_core.parameters import commented_toml

    text = commented_toml(_chosen(model, mode, use, preset)[1])
    _give_out(text, output, overwrite=overwrite)


def migrate(
    file: Annotated[Path, typer.Argument(help="TOML file, a run.toml, or its folder.")],
    *,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File to write; default: standard output.")
    ] = None,
    model: ModelOption = None,
    overwrite: OverwriteFile = False,
) -> None:
    """Convert FILE of an earlier version: parameters that no longer exist are removed.

    Values of moved parameters are kept; comments are lost.
    """
    import tomli_w

    from lidar_core.parameters import model_named, toml_value
    from lidar_core.runs.settings import file_values, loaded, model_of
    from lidar_core.util.migration import migrated

    model = model or model_of(file)
    kind = model_named(model)
    values, changes = migrated(kind, file_values(file, model))
    loaded(kind, values, file)
    for change in changes:
        value = toml_value(change.value)
        told = change.told.replace("write it as", "it is now")
        print(f"{change.place} = {value}: {told}", file=sys.stderr)
    if not changes:
        print(f"{file}: nothing to change", file=sys.stderr)
    _give_out(tomli_w.dumps(values), output, overwrite=overwrite)


def schema(*, model: SchemaModel = "flying") -> None:
    """Print the JSON Schema, for editors and checks."""
    from lidar_core.parameters import model_named

    print(json.dumps(model_named(model).model_json_schema(), indent=2))


def _give_out(text: str, output: Path | None, *, overwrite: bool) -> None:
    """Print a configuration, or write it to a file and print its name."""
    from lidar_core.io.files.atomic import written_whole

    if output is None:
        print(text, end="")
        return
    check_new(output, overwrite=overwrite)
    with written_whole(output) as temporary:
        temporary.write_text(text, encoding="utf-8")
    print(output)


def _chosen(
    model: str | None, mode: Mode, use: str | None, preset: str | None
) -> tuple[str, "Config"]:
    """Return the model that the options name, and its values before those of a file."""
    if use is None:
        model = model or "flying"
        config = _of_mode(model, mode)
    else:
        model, config = _of_use(use, model, mode)
    return model, config if preset is None else _with_preset(model, config, preset)


def _of_use(name: str, model: str | None, mode: Mode) -> tuple[str, "Config"]:
    from lidar_core.errors import ConfigError
    from lidar_core.use_cases import use_named

    use = use_named(name)
    if model not in (None, use.model):
        raise ConfigError(f"use: {name} is for {use.model}, got --model {model}")
    if mode != "best":
        raise ConfigError(f"use: {name} works only in best mode, got --mode {mode}")
    return use.model, use.config()


def _with_preset(model: str, config: "Config", preset: str) -> "Config":
    from lidar_core.circles import Scanner
    from lidar_core.cli.simulate import BUILT_IN, scene_named, with_sensor
    from lidar_core.errors import ConfigError
    from lidar_core.flying import SensorConfig
    from lidar_core.sim import Scene

    if isinstance(config, Scene):
        return scene_named(preset, 0) if preset in BUILT_IN else with_sensor(config, preset)
    if model == "circles":
        return config.model_copy(update={"scanner": Scanner.load({"preset": preset})})
    if model == "flying":
        return config.model_copy(update={"sensor": SensorConfig.preset(preset)})
    raise ConfigError(f"preset: the model {model} has no presets; flying, circles and scene have")


def _of_mode(model: str, mode: Mode) -> "Config":
    from lidar_core.errors import ConfigError
    from lidar_core.parameters import model_named

    kind = model_named(model)
    if mode == "best":
        return kind()
    paper = getattr(kind, "paper", None)
    if paper is None:
        raise ConfigError(f"mode: {model} has no paper mode")
    config: Config = paper()
    return config


def _shown(value: object) -> str:
    """Text of a value for one cell of a table; of a list of many tables their number."""
    from lidar_core.parameters import toml_value

    if isinstance(value, list) and any(isinstance(one, dict) for one in value):
        return f"{len(value)} tables"
    return toml_value(value)


def _flat(values: dict[str, object], path: str = "") -> list[tuple[str, object]]:
    """Return nested values by their dotted paths."""
    rows: list[tuple[str, object]] = []
    for name, value in values.items():
        if isinstance(value, dict):
            rows += _flat(value, f"{path}{name}.")
        else:
            rows.append((f"{path}{name}", value))
    return rows
