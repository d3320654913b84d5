"""Base of the configuration models: TOML in and out, JSON Schema, help, errors with dotted paths.

Longer than other files: the errors and the help of a model are made of the same fields.
"""

import re
import textwrap
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, wraps
from inspect import Parameter, Signature, cleandoc, formatannotation, signature
from pathlib import Path
from types import UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    ParamSpec,
    Self,
    TypeVar,
    Union,
    get_args,
    get_origin,
)

import tomli_w
from pydantic import (
    BaseModel,
    ConfigDict,
    GetJsonSchemaHandler,
    TypeAdapter,
    ValidationError,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema

from lidar_core.errors import ConfigError, closest, without_prefix
from lidar_core.files import read_whole

__all__ = [
    "NONE",
    "Config",
    "ConfigT",
    "as_config",
    "checked",
    "in_file",
    "tables_at",
    "toml_values",
]

NONE = "none"
"""What TOML files say for "no value"."""

UNITS = {
    "m": " m: lengths are in metres",
    "s": " s: times are in seconds",
    "rad": " rad: angles are in radians",
    "m/s": " m/s",
    "m/s^2": " m/s^2",
    "rad/s": " rad/s",
}
"""What an error says after a limit, by unit."""

WIDTH, LONGEST = 96, 60
"""Width of a line, and length of a default that is still shown whole."""
EXAMPLES = "Examples\n--------\n"

ConfigT = TypeVar("ConfigT", bound="Config")
P = ParamSpec("P")
T = TypeVar("T")


class _Lazy:
    """Attribute of a class that is computed at the first access, so that imports are fast."""

    def __init__(self, make: Callable[[Any], Any]) -> None:
        self._make = make

    def __get__(self, instance: object, owner: type) -> Any:
        return self._make(owner)


class Config(BaseModel):
    """Base of every configuration model: unknown keys fail, every problem is reported at once."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    own_doc: ClassVar[str] = ""
    """Docstring of the class as it is written, without the fields."""

    removed: ClassVar[Mapping[str, str]] = {}
    """Parameters of earlier versions that files may still have, and what holds instead; of one that
    has moved, "write it as" and its new place."""

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise _config_error(type(self), error) from error

    @classmethod
    def __pydantic_init_subclass__(cls, **values: Any) -> None:
        """Set docstring and signature, which are made from the fields at the first access."""
        super().__pydantic_init_subclass__(**values)
        cls.own_doc = cleandoc(cls.__doc__ or "")
        cls.__doc__ = _Lazy(_documented)  # type: ignore[assignment]
        cls.__signature__ = _Lazy(_short_signature)  # type: ignore[assignment]

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Schemas describe every field in its place, so the model has its own text only."""
        found = handler(core_schema)
        schema = handler.resolve_ref_schema(found)
        schema.pop("description", None)  # pydantic takes the docstring, with all fields
        if cls.own_doc:
            schema["description"] = cls.own_doc
        return found

    # Not pydantic's word for "overridden": models inside models are then validated as one, and
    # every problem carries its whole path.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @model_validator(mode="before")
    @classmethod
    def _read_none(cls, values: Any) -> Any:
        """Replace "none" by None where None is allowed, because TOML has no null."""
        if not isinstance(values, dict):
            return values
        return {
            name: None if value == NONE and _may_be_none(cls, name) else value
            for name, value in values.items()
        }

    @classmethod
    def load(cls, values: Mapping[str, Any]) -> Self:
        """Validate values that come from a file or a command line.

        Raises
        ------
        ConfigError
            One line per problem: dotted path, expected and received value.
        """
        return cls(**values)

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a TOML file.

        Raises
        ------
        ConfigError
            The file is not TOML, or a value is unknown or outside its range.
        """
        values = toml_values(read_whole(path), path)
        try:
            return cls.load(values)
        except ConfigError as error:
            raise in_file(error, path) from error

    def to_toml(self) -> str:
        """Return every value, as TOML that `read` accepts; "none" for None."""
        return tomli_w.dumps(_without_null(self.model_dump(mode="json")))


def toml_values(content: bytes, place: str | Path) -> dict[str, Any]:
    """Parse the content of the TOML file `place`.

    Raises
    ------
    ConfigError
        It is not TOML, or contains values that no configuration needs: deeply nested tables,
        numbers with thousands of digits.
    """
    try:
        return tomllib.loads(content.decode("utf-8"))
    except RecursionError as error:
        raise ConfigError(f"{place}: expected TOML, got values nested too deep") from error
    except ValueError as error:  # TOMLDecodeError, UnicodeDecodeError, and too many digits
        raise ConfigError(f"{place}: expected TOML: {error}") from error


def as_config(config: ConfigT | None, model: type[ConfigT]) -> ConfigT:
    """Return `config`, or the default configuration if it is None.

    Raises
    ------
    ConfigError
        `config` is not of this model.
    """
    if config is None:
        return model()
    if not isinstance(config, model):
        raise ConfigError(f"config: expected a {model.__name__}, got {type(config).__name__}")
    return config


def checked(function: Callable[P, T]) -> Callable[P, T]:
    """Decorator: an argument that its annotation does not allow raises ConfigError.

    Annotations are read at the first call: they may contain the schemas of all models.
    """
    parameters = signature(function)

    @cache
    def check_of(name: str) -> TypeAdapter[Any]:
        rules = ConfigDict(strict=True, arbitrary_types_allowed=True)
        return TypeAdapter(parameters.parameters[name].annotation, config=rules)

    @wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> T:
        problems = []
        try:
            bound = parameters.bind(*args, **kwargs)
        except TypeError as error:
            raise TypeError(f"{function.__name__}({_required(parameters)}): {error}") from None
        for name, value in bound.arguments.items():
            plain = value.item() if getattr(value, "shape", None) == () else value  # of numpy
            wanted = f"expected {_annotated(parameters.parameters[name].annotation)}"
            try:
                # Models take tables of values, too; arguments have to be models.
                is_given = isinstance(check_of(name).validate_python(plain), BaseModel)
                is_refused = is_given and not isinstance(plain, BaseModel)
            except ValidationError as error:
                limits = [one["msg"] for one in error.errors() if "than" in one["type"]]
                is_refused, wanted = True, limits[0] if limits else wanted
            if is_refused:
                told = wanted.replace("Input should be", "expected a value")
                got = type(value).__name__ if isinstance(value, BaseModel) else _short(value)
                problems.append(f"{name}: {told}, got {got}")
        if problems:
            raise ConfigError("\n".join(problems))
        return function(*args, **kwargs)

    return called


def _required(parameters: Signature) -> str:
    """Text with the arguments of a function that have no default, in their order."""
    names = [one.name for one in parameters.parameters.values() if one.default is one.empty]
    has_more = len(names) < len(parameters.parameters)
    return ", ".join([*names, "..."] if has_more else names)


def _annotated(annotation: Any) -> str:
    """Text of what an annotation allows, without the modules of its names."""
    plain = annotation.__origin__ if hasattr(annotation, "__metadata__") else annotation
    return re.sub(r"[a-z_]+[.]", "", formatannotation(plain))


def _without_null(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_null(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_without_null(inner) for inner in value]
    return NONE if value is None else value


def _may_be_none(model: type[BaseModel], name: str) -> bool:
    field = model.model_fields.get(name)
    return field is not None and type(None) in get_args(field.annotation)


def _config_error(model: type[BaseModel], error: ValidationError) -> ConfigError:
    lists = _lists_of_numbers(error)
    texts: dict[str, None] = {}  # in order; all problems of one list have the same text
    for problem in error.errors():
        place = problem["loc"]
        within = [outer for outer in lists if place[: len(outer)] == outer]
        if within:
            place, text = within[0], _list_text(within[0], lists[within[0]], model)
        elif place[-1:] == ("[key]",) and problem["type"] == "literal_error":
            # A name that its table must not contain, not the value beside it.
            place = place[:-2]
            text = f"expected the name {problem['ctx']['expected']}, got {problem['input']!r}"
        else:
            text = _problem_text(problem, model)
        texts[f"{'.'.join(map(str, place)) or model.__name__}: {text}"] = None
    return ConfigError("\n".join(texts))


_NUMBERS = re.compile(r"tuple\[float(, float)*\]")
"""How pydantic names one of several lists of numbers that a parameter may be."""


def _lists_of_numbers(error: ValidationError) -> dict[tuple[int | str, ...], list[Any]]:
    """Group the problems of parameters that are lists with alternative lengths, by parameter."""
    found: dict[tuple[int | str, ...], list[Any]] = {}
    for problem in error.errors():
        for depth, part in enumerate(problem["loc"]):
            if _NUMBERS.fullmatch(str(part)):
                found.setdefault(problem["loc"][:depth], []).append(problem)
    return found


def _list_text(
    place: tuple[int | str, ...], problems: Sequence[Any], model: type[BaseModel]
) -> str:
    """Text of what a list parameter accepts, with its default, and what was received."""
    depth = len(place)
    lengths = sorted({str(problem["loc"][depth]).count("float") for problem in problems})
    # Some problem is one of the whole list: at most one of the lengths can be right.
    whole = (one for one in problems if len(one["loc"]) == depth + 1 or one["type"] == "missing")
    field = _fields(model).get(".".join(map(str, place)))
    default = field.default if field is not None else None
    such_as = f" such as {list(default)}" if isinstance(default, tuple) else ""
    counts = " or ".join(map(str, lengths))
    return f"expected a list of {counts} numbers{such_as}, got {_short(next(whole)['input'])}"


def in_file(error: ConfigError, path: str | Path) -> ConfigError:
    """Return the error of values in a file, with a remedy for files of an earlier version."""
    cure = f"\n`lidar-core config migrate {path} -o NEW` writes a file without these"
    return ConfigError(f"{path}: {error}{cure if _OLD in str(error) else ''}")


_OLD = "is no parameter any more"


def _problem_text(problem: Any, model: type[BaseModel]) -> str:
    """Text of a problem: what is wrong, what was received, the name that was probably meant."""
    text, received = without_prefix(problem["msg"]), problem["input"]
    place, fields = ".".join(map(str, problem["loc"])), _fields(model)
    match problem["type"]:
        case "missing":
            return "has to be given"
        case "extra_forbidden" if reason := _removed(model, problem["loc"]):
            cure = "" if reason.startswith("write it as") else "; leave it out"
            return f"{_OLD}: {reason}{cure}"
        case "extra_forbidden":
            return f"no such parameter, got {_short(received)}{_did_you_mean(place, fields)}"
        case "value_error" if isinstance(received, dict):
            return text
        case "model_type":
            text = "expected a table of parameters"
        case "tuple_type" | "list_type":
            # A field that takes one of several kinds is followed by the kind, such as tuple[...].
            names = [part for part in problem["loc"] if isinstance(part, str) and "[" not in part]
            header = ".".join(names)
            as_tables = f", its tables as [[{header}]]" if isinstance(received, dict) else ""
            text = f"expected a list{as_tables}"
        case "less_than_equal" | "greater_than_equal" if any(problem["ctx"].values()):
            field = fields.get(re.sub(r"([.]\d+)+$", "", place))
            units = re.findall(r"\[([^]]+)\]", (field and field.description) or "")
            text += UNITS.get(units[0], "") if len(units) == 1 else ""
        case "string_pattern_mismatch" if place in fields and fields[place].examples:
            text = f"expected a text such as {', '.join(map(str, fields[place].examples or ()))}"
    return f"{text}, got {_short(received)}"


def _did_you_mean(place: str, paths: Iterable[str]) -> str:
    """Hint at the parameter that was meant: its name if it is in the same table, else its path."""
    table, _, name = place.rpartition(".")
    names = {path.rpartition(".")[2]: path for path in reversed(list(paths))}
    near = closest(name, names)
    if near is None:
        return ""
    is_beside = names[near].rpartition(".")[0] == table
    return f"; did you mean {near if is_beside else names[near]}?"


def _fields(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Parameters of a model and of those inside it, by path; the outer ones first."""
    return {
        place + name: field
        for one, place in _models(model).items()
        for name, field in one.model_fields.items()
    }


def _removed(model: type[BaseModel], place: tuple[int | str, ...]) -> str | None:
    """Text on what replaced the parameter at `place`; None if it never was a parameter."""
    reasons = [one.removed for one in tables_at(model, place[:-1]) if issubclass(one, Config)]
    return next((known[str(place[-1])] for known in reasons if place[-1] in known), None)


def tables_at(model: type[BaseModel], place: Sequence[int | str]) -> list[type[BaseModel]]:
    """Return the models that the table at `place` of a problem may belong to."""
    tables = [model]
    for part in place:
        if inner := [one.model_fields[part] for one in tables if part in one.model_fields]:
            tables = [table for field in inner for table in _parts(field.annotation)]
        else:  # entry of a list or a dictionary, or the kind by which a table was chosen
            tables = [one for one in tables if _kind(one) == part] or tables
    return tables


def _kind(model: type[BaseModel]) -> object:
    return model.model_fields["kind"].default if "kind" in model.model_fields else None


def _models(model: type[BaseModel]) -> dict[type[BaseModel], str]:
    """A model and those inside it, with the beginning of the paths of their parameters."""
    known: dict[type[BaseModel], str] = {model: ""}
    for one in (waiting := [model]):
        for name, field in one.model_fields.items():
            inner = [part for part in _parts(field.annotation) if part not in known]
            known |= dict.fromkeys(inner, f"{known[one]}{name}.")
            waiting += inner
    return known


def _parts(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [part for one in get_args(annotation) for part in _parts(one)]


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 100 else f"{text[:97]}..."


def _documented(model: type["Config"]) -> str:
    """Docstring of a model: its own text, with the fields before the examples."""
    if not model.model_fields:
        return model.own_doc
    before, examples, after = model.own_doc.partition(EXAMPLES)
    parts = (before.strip(), _attributes(model), f"{examples}{after}".strip())
    return "\n\n".join(part for part in parts if part)


def _attributes(model: type[BaseModel]) -> str:
    """Section "Attributes" of a model: type, default and meaning of every field."""
    lines = ["Attributes", "----------"]
    for name, field in model.model_fields.items():
        default = "" if field.is_required() else f", default {_shown(field)}"
        lines.append(f"{name} : {_type_text(field.annotation)}{default}")
        lines += textwrap.wrap(
            field.description or _summary(field.annotation),
            WIDTH,
            initial_indent="    ",
            subsequent_indent="    ",
            break_on_hyphens=False,
        )
    return "\n".join(lines)


def _short_signature(model: type[BaseModel]) -> Signature:
    """Names and defaults of the fields, without their types and ranges."""
    made_from = signature(model.__init__).parameters.values()
    by_position = any(one.kind is Parameter.VAR_POSITIONAL for one in made_from)
    return Signature(
        [
            Parameter(
                name,
                Parameter.POSITIONAL_OR_KEYWORD if by_position else Parameter.KEYWORD_ONLY,
                default=Parameter.empty if field.is_required() else _Shown(_shown(field)),
            )
            for name, field in model.model_fields.items()
        ],
        __validate_parameters__=False,  # a field without a default may follow one that has one
    )


class _Shown:
    """Default in a signature that is shown as a short text without quotes."""

    def __init__(self, text: str) -> None:
        self._text = text

    def __repr__(self) -> str:
        return self._text


def _shown(field: FieldInfo) -> str:
    if field.default_factory is not None:
        return "..."
    value = field.default
    if isinstance(value, BaseModel):
        return f"{type(value).__name__}({'...' if value.model_fields_set else ''})"
    text = repr(value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST].rpartition(', ')[0]}, ..."


def _summary(annotation: Any) -> str:
    """First line of the docstring of the model that a field without a description contains."""
    found = isinstance(annotation, type) and issubclass(annotation, BaseModel) and annotation
    return cleandoc(found.__doc__ or "").partition("\n")[0] if found else ""


def _type_text(annotation: Any) -> str:
    """Text of a type without the ranges that `Annotated` adds to it."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _type_text(arguments[0])
    if origin in (Union, UnionType):
        return " | ".join(map(_type_text, arguments))
    if origin is Literal:
        return "{" + ", ".join(map(repr, arguments)) + "}"
    if arguments and isinstance(origin, type):
        return f"{origin.__name__}[{', '.join(map(_type_text, arguments))}]"
    if annotation in (None, type(None)):
        return "None"
    return "..." if annotation is Ellipsis else getattr(annotation, "__name__", str(annotation))


def __dir__() -> list[str]:
    return __all__
