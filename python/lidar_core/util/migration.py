"""Conversion of configuration files of earlier versions, whose parameters have changed."""

import re
from collections.abc import Mapping
from contextlib import suppress
from copy import deepcopy
from typing import Any, NamedTuple

from pydantic import BaseModel, ValidationError

from lidar_core.config import Config, tables_at
from lidar_core.errors import ConfigError

_MOVED = re.compile(r"write it as the (first|second|third) value of (each entry of )?(\w+)")
_NUMBERS = ("first", "second", "third")
_MOST = 1000
"""Largest number of changed parameters of a file."""


class Change(NamedTuple):
    """Change of one parameter between versions.

    Attributes
    ----------
    place : str
        Dotted path of the parameter in the file.
    value : Any
        Value in the file.
    told : str
        Text for the user: the replacement, or the new place of the value.
    """

    place: str
    value: Any
    told: str


def migrated(
    model: type[Config], values: Mapping[str, Any]
) -> tuple[dict[str, Any], tuple[Change, ...]]:
    """Convert the values of a file of an earlier version, and list the changes.

    A renamed parameter keeps its value. Other errors remain.

    Parameters
    ----------
    model : type
        Model of the configuration.
    values : mapping
        Values of the file; they are not changed.
    """
    result, changes = deepcopy(dict(values)), list[Change]()
    while len(changes) < _MOST:
        problem = _next_old(model, result)
        if problem is None:
            break
        place, reason = problem
        way, table = _table(result, place[:-1])
        value = table.pop(place[-1])
        changes.append(Change(".".join(map(str, (*way, place[-1]))), value, reason))
        if moved := _MOVED.fullmatch(reason):
            _put(table, tables_at(model, place[:-1]), moved, value)
    return result, tuple(changes)


def _next_old(
    model: type[Config], values: Mapping[str, Any]
) -> tuple[tuple[int | str, ...], str] | None:
    """Find the first parameter that no longer exists: its place, and the text about it."""
    try:
        model.load(values)
    except ConfigError as error:
        problems = error.__cause__.errors() if isinstance(error.__cause__, ValidationError) else []
        for problem in problems:
            place = problem["loc"]
            for table in tables_at(model, place[:-1]):
                removed = table.removed if issubclass(table, Config) else {}
                if problem["type"] == "extra_forbidden" and place[-1] in removed:
                    return place, removed[str(place[-1])]
    return None


def _table(
    values: Any, place: tuple[int | str, ...]
) -> tuple[list[int | str], dict[int | str, Any]]:
    """Return the path of the table that contains the place of a problem, and the table.

    The place of a problem may also name the kind that selected a table. The path omits it.
    """
    table, way = values, list[int | str]()
    for part in place:
        if isinstance(part, int) or part in table:  # a number is of a list
            table = table[part]
            way.append(part)
    return way, table


def _put(
    table: dict[int | str, Any], models: list[type[BaseModel]], moved: "re.Match[str]", value: Any
) -> None:
    """Write a value into the list to which its parameter moved; other entries are defaults."""
    index, name = _NUMBERS.index(moved[1]), moved[3]
    field = next(one.model_fields[name] for one in models if name in one.model_fields)
    if field.is_required():  # no usual values: all come from the file, one after another
        listed = table.setdefault(name, [])
        if isinstance(listed, list):
            listed += [value] * (index + 1 - len(listed))
    elif name not in table:
        table[name] = [list(one) if isinstance(one, tuple) else one for one in field.default]
    with suppress(TypeError, IndexError):  # the next reading tells what is wrong with the list
        for entry in table[name] if moved[2] else [table[name]]:
            entry[index] = value
