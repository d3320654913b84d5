"""Queries over tables, such as `distance < 20 and event == "lost"`: read, never executed."""

import ast
import operator
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import ConfigError, FormatError, unknown
from lidar_core.io.tables.columns import Columns, read_columns
from lidar_core.run_folder import RUN_FILE, table_in
from lidar_core.runs.catalogue.objects import events_of

MOST_LETTERS, MOST_DEPTH = 2000, 40
"""Of a query."""
_COMPARISONS: Mapping[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.In: np.isin,
    ast.NotIn: lambda one, many: ~np.isin(one, many),
}
_ARITHMETIC: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}


def read_table(path: str | Path) -> Columns:
    """Read a table of events or objects: arrays of equal length by the names of the columns.

    Parameters
    ----------
    path : str or Path
        A .csv or .parquet file; a folder of such files with the same columns; a folder that
        `lidar-core batch` wrote; a folder that a run wrote.

    Raises
    ------
    FormatError
        None of these.
    """
    place = Path(path)
    if not place.is_dir():
        return read_columns(place)
    if (place / RUN_FILE).is_file():
        return events_of(place)
    table = table_in(place, "events")
    if table is not None:
        return read_columns(table)
    files = sorted(one for one in place.iterdir() if one.suffix in {".csv", ".parquet"})
    if not files:
        raise FormatError(f"{place}: expected a table, the folder of a run or of a batch")
    parts = [read_columns(one) for one in files]
    for file, part in zip(files, parts, strict=True):
        if list(part) != list(parts[0]):
            raise FormatError(f"{file}: expected the columns of {files[0].name}")
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def matching_rows(columns: Columns, query: str) -> Columns:
    """The rows of a table for which a query is true.

    Parameters
    ----------
    columns : dict of ndarray
        The table.
    query : str
        Names of columns, numbers and texts with < <= > >= == != in, + - * /, and, or, not.

    Raises
    ------
    ConfigError
        The query is not valid, or names an unknown column.
    """
    tree = _parsed(query)
    count = len(next(iter(columns.values()), ()))
    with np.errstate(all="ignore"):
        chosen = _value(tree, columns, query, 0)
    if np.asarray(chosen).dtype != np.bool_:
        raise ConfigError(f"query: expected a comparison, got {query!r}; {_EXAMPLE}")
    rows = np.broadcast_to(np.asarray(chosen), (count,))
    return {name: values[rows] for name, values in columns.items()}


def columns_named(query: str) -> set[str]:
    """Return the names of the columns in a query; words inside quoted texts do not count.

    Raises
    ------
    ConfigError
        The text is not a query.
    """
    return {node.id for node in ast.walk(_parsed(query)) if isinstance(node, ast.Name)}


def _parsed(query: str) -> ast.expr:
    if len(query) > MOST_LETTERS:
        raise ConfigError(f"query: expected {MOST_LETTERS} letters at most, got {len(query)}")
    try:
        return ast.parse(query.strip(), mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        raise ConfigError(f"query: cannot read {query!r}: {error}; {_EXAMPLE}") from None


_EXAMPLE = "an example is: distance < 20 and event == 'closest_approach'"


def _value(node: ast.expr, columns: Columns, query: str, depth: int) -> Any:
    """Value of a part of a query: an array with a value per row, or one value."""
    if depth > MOST_DEPTH:
        raise ConfigError(f"query: nested deeper than {MOST_DEPTH}")

    def of(inner: ast.expr) -> Any:
        return _value(inner, columns, query, depth + 1)

    value: Any = None
    match node:
        case ast.Constant(value=bool() | int() | float() | str()):
            value = node.value
        case ast.Name():
            if node.id not in columns:
                raise ConfigError(f"query: {unknown('column', node.id, list(columns))}")
            value = columns[node.id]
        case ast.Tuple() | ast.List():
            value = [of(one) for one in node.elts]
        case ast.UnaryOp(op=ast.USub()):
            value = _applied(operator.neg, query, of(node.operand))
        case ast.UnaryOp(op=ast.Not()):
            value = ~_truth(of(node.operand), query)
        case ast.BoolOp():
            parts = [_truth(of(one), query) for one in node.values]
            value = _folded(
                np.logical_and if isinstance(node.op, ast.And) else np.logical_or, parts
            )
        case ast.BinOp() if type(node.op) in _ARITHMETIC:
            sides = of(node.left), of(node.right)
            value = _applied(_ARITHMETIC[type(node.op)], query, *sides)
        case ast.Compare():
            value = _compared(node, query, of)
        case _:
            raise ConfigError(
                f"query: cannot use {ast.unparse(node)!r}: expected columns, numbers and texts"
                f" with < <= > >= == != in, + - * /, and, or, not; {_EXAMPLE}"
            )
    return value


def _compared(node: ast.Compare, query: str, of: Callable[[ast.expr], Any]) -> Any:
    """`a < b <= c` is both comparisons."""
    values = [of(node.left), *(of(one) for one in node.comparators)]
    parts = []
    for one, kind, other in zip(values, node.ops, values[1:], strict=False):
        if type(kind) not in _COMPARISONS:
            raise ConfigError(f"query: cannot use {ast.unparse(node)!r}; {_EXAMPLE}")
        if _is_text(one) != _is_text(other):
            raise ConfigError(f"query: {ast.unparse(node)!r} compares a text with a number")
        parts.append(np.asarray(_applied(_COMPARISONS[type(kind)], query, one, other)))
    return _folded(np.logical_and, parts)


def _folded(together: Callable[[Any, Any], Any], parts: list[NDArray[np.bool_]]) -> Any:
    value: Any = parts[0]
    for part in parts[1:]:
        value = together(value, part)
    return value


def _is_text(value: Any) -> bool:
    return np.asarray(value).dtype.kind in "USO"


def _truth(value: Any, query: str) -> NDArray[np.bool_]:
    held = np.asarray(value)
    if held.dtype != np.bool_:
        raise ConfigError(f"query: expected comparisons between and, or, not, got {query!r}")
    return held


def _applied(function: Callable[..., Any], query: str, *values: Any) -> Any:
    try:
        return function(*values)
    except (TypeError, ValueError, OverflowError, ZeroDivisionError) as error:
        raise ConfigError(f"query: cannot compute {query!r}: {error}") from None
