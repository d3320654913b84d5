"""List of all configuration models and their parameters, and configuration files to start from."""

import json
import re
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Annotated, Any, Literal, get_args, get_origin

import tomli_w
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from lidar_core.config import NONE, Config
from lidar_core.errors import ConfigError, unknown

__all__ = [
    "MODELS",
    "Parameter",
    "commented_toml",
    "model_named",
    "models_within",
    "parameters_of",
    "toml_value",
]

MODELS = {
    "batch": "lidar_core.batch:BatchConfig",
    "circle_dataset": "lidar_core.circles:DatasetConfig",
    "circles": "lidar_core.circles:CirclesConfig",
    "evaluation": "lidar_core.evaluation:EvaluationConfig",
    "flight": "lidar_core.sim:InsertedFlight",
    "flying": "lidar_core.flying:FlyingConfig",
    "fusion": "lidar_core.fusion:FusionConfig",
    "fusion_bag": "lidar_core.fusion:BagOptions",
    "fusion_many": "lidar_core.fusion:MultiTargetConfig",
    "fusion_table": "lidar_core.fusion:TableOptions",
    "live": "lidar_core.live:LiveConfig",
    "overflight": "lidar_core.sim:Overflight",
    "pose_noise": "lidar_core.sim:PoseNoise",
    "poses": "lidar_core.io:PoseOptions",
    "read": "lidar_core.io:ReadOptions",
    "scene": "lidar_core.sim:Scene",
    "span": "lidar_core.io:Span",
    "steering": "lidar_core.sim:Steering",
}
"""Models that a file or a command line fills, by the name the command gives them."""

_BOUNDS = {
    "gt": ">",
    "ge": ">=",
    "lt": "<",
    "le": "<=",
    "min_length": "length >=",
    "max_length": "length <=",
    "pattern": "matches",
}
_EDGE = re.compile(r"(?<=\[)\n\s*|,\n\s*(?=\])")
_BREAK = re.compile(r"\n\s*")
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


@dataclass(frozen=True, slots=True)
class Parameter:
    """One field of a model, as text.

    Attributes
    ----------
    name, type, description : str
        Name, type and description with unit.
    default : str
        Default in TOML; "required" if there is none.
    range : str
        Allowed range; empty if it has no bound.
    """

    name: str
    type: str
    default: str
    range: str
    description: str


def model_named(name: str) -> type[Config]:
    """Return the model that the command calls `name`.

    Raises
    ------
    ConfigError
        There is no such model.
    """
    if name not in MODELS:
        raise ConfigError(unknown("model", name, MODELS))
    module, _, attribute = MODELS[name].partition(":")
    model: type[Config] = getattr(import_module(module), attribute)
    return model


def parameters_of(model: type[BaseModel]) -> list[Parameter]:
    """Return every field of one model."""
    return [
        Parameter(
            name=name,
            type=_type_text(field.annotation),
            default=_default_text(field),
            range=", ".join(_bounds(field.metadata)),
            description=field.description or _summary(field.annotation),
        )
        for name, field in model.model_fields.items()
    ]


def models_within(model: type[Config]) -> list[type[Config]]:
    """Return `model` and every model that its fields may hold, in order of appearance."""
    found = [model]
    for known in found:
        for field in known.model_fields.values():
            found += [inner for inner in _models_in(field.annotation) if inner not in found]
    return found


def commented_toml(config: Config) -> str:
    """Return every value as TOML that `Config.read` accepts, each with its meaning and range."""
    described: set[type[BaseModel]] = set()
    return "\n".join(_section(config, "", "", described)) + "\n"


def toml_value(value: Any) -> str:
    """Return `value` as TOML on one line; "none" for None."""
    if value == {}:
        return "{}"
    text = tomli_w.dumps({"x": NONE if value is None else value}).strip().removeprefix("x = ")
    return _BREAK.sub(" ", _EDGE.sub("", text))  # strings hold no bare line break


def _section(config: Config, path: str, header: str, described: set[type[BaseModel]]) -> list[str]:
    """Lines of one table: plain values first, then the tables inside it."""
    explain = type(config) not in described
    described.add(type(config))
    lines = _comment(_first_line(type(config))) if explain else []
    lines += [header] if header else []
    values = config.model_dump(mode="json")
    inner: list[str] = []
    for parameter in parameters_of(type(config)):
        value = getattr(config, parameter.name)
        below = f"{path}.{parameter.name}" if path else parameter.name
        tables = list(_tables(value, below))
        for table, heading, place in tables:
            inner += ["", *_section(table, place, heading, described)]
        if tables:
            continue
        is_table = bool(_models_in(type(config).model_fields[parameter.name].annotation))
        if explain:
            lines += _comment(
                f"[{below}] {_explained(parameter)}" if is_table else _explained(parameter)
            )
        if not is_table:
            lines.append(f"{parameter.name} = {toml_value(values[parameter.name])}")
    return lines + inner


def _tables(value: Any, path: str) -> Iterator[tuple[Config, str, str]]:
    """Yield the models that a value is or contains, with the header and path of their tables."""
    if isinstance(value, Config):
        yield value, f"[{path}]", path
    elif isinstance(value, Mapping):
        for key, item in value.items():
            if isinstance(item, Config):
                place = f"{path}.{key if _BARE_KEY.fullmatch(key) else json.dumps(key)}"
                yield item, f"[{place}]", place
    elif isinstance(value, tuple | list):
        for item in value:
            if isinstance(item, Config):
                yield item, f"[[{path}]]", path


def _comment(text: str) -> list[str]:
    return textwrap.wrap(text, 100, initial_indent="# ", subsequent_indent="# ")


def _explained(parameter: Parameter) -> str:
    allowed = f" Allowed: {parameter.range}." if parameter.range else ""
    is_choice = parameter.type.startswith('"') and " | " in parameter.type
    choices = f" One of {parameter.type}." if is_choice else ""
    return f"{parameter.description}{allowed}{choices}".strip()


def _models_in(annotation: Any) -> list[type[Config]]:
    if isinstance(annotation, type) and issubclass(annotation, Config):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_in(part)]


def _first_line(model: type[BaseModel]) -> str:
    return (model.__doc__ or model.__name__).strip().splitlines()[0]


def _summary(annotation: Any) -> str:
    models = _models_in(annotation)
    return _first_line(models[0]) if len(models) == 1 else ""


def _default_text(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True, validated_data={})
    if isinstance(value, Config):
        changes = value.model_dump(mode="json", exclude_unset=True)
        text = ", ".join(f"{name} = {toml_value(item)}" for name, item in changes.items())
        return f"{type(value).__name__}{' with ' * bool(text)}{text}"
    return " ".join(toml_value(value).split()) if value != {} else "empty"


def _bounds(metadata: list[Any]) -> Iterator[str]:
    for entry in metadata:
        for name, sign in _BOUNDS.items():
            bound = getattr(entry, name, None)
            if bound is not None:
                yield f"{sign} {bound}"


def _type_text(annotation: Any) -> str:
    """Text of a type in the terms of TOML."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if annotation is type(None):
        text = json.dumps(NONE)
    elif not arguments:
        text = str(getattr(annotation, "__name__", annotation))
    elif origin is Annotated:
        text = _type_text(arguments[0])
    elif origin is Literal:
        text = " | ".join(json.dumps(value) for value in arguments)
    elif origin is tuple and Ellipsis in arguments:
        text = f"list of {_type_text(arguments[0])}"
    elif origin is tuple:
        text = f"[{', '.join(map(_type_text, arguments))}]"
    elif origin is dict:
        text = f"table of {_type_text(arguments[1])}"
    else:
        text = " | ".join(map(_type_text, arguments))
    return text


def __dir__() -> list[str]:
    return __all__
