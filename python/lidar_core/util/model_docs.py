"""Documentation of configuration models, made of the descriptions of their fields."""

import inspect
import textwrap
from inspect import Parameter, Signature
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

WIDTH, LONGEST = 96, 60
"""Width of a line, and length of a default that is still shown whole."""
EXAMPLES = "Examples\n--------\n"


def documented(model: type[BaseModel], text: str) -> str:
    """Return the docstring of a model: its own text, with the fields before the examples."""
    if not model.model_fields:
        return text
    before, examples, after = text.partition(EXAMPLES)
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


def short_signature(model: type[BaseModel]) -> Signature:
    """Return names and defaults of the fields, without their types and ranges."""
    made_from = inspect.signature(model.__init__).parameters.values()
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
    """A default in a signature: a text without quotes, as long models would fill the screen."""

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
    """First line of the model that a field without a description holds."""
    found = isinstance(annotation, type) and issubclass(annotation, BaseModel) and annotation
    return inspect.cleandoc(found.__doc__ or "").partition("\n")[0] if found else ""


def _type_text(annotation: Any) -> str:
    """A type without the ranges that `Annotated` adds to it."""
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
