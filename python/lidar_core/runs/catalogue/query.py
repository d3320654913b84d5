"""Queries over tables, such as `distance < 20 and event == "lost"`: read, never executed."""

import ast
import operator
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.batch.results import NOTE, JobRecord
from lidar_core.errors import ConfigError, FormatError
from lidar_core.io.tables.columns import Columns, read_columns, read_tables, tables_of
from lidar_core.run_folder import RUN_FILE, table_in
from lidar_core.runs.catalogue.names import unknown_column
from lidar_core.runs.catalogue.objects import events_of
from lidar_core.runs.catalogue.syntax import (
    text_of,
    ticked,
    tree_of,
    with_double_signs,
    without_ticks,
)

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
        The path is none of these, or a batch that was interrupted before it wrote its tables.
    """
    place = Path(path)
    if not place.is_dir():
        return read_columns(place)
    if (place / RUN_FILE).is_file():
        return events_of(place)
    table = table_in(place, "events")
    if table is not None:
        return read_columns(table)
    files = tables_of(place)
    if not files:
        raise FormatError(f"{place}: {_without_tables(place)}")
    return read_tables(files)


def _without_tables(folder: Path) -> str:
    """Return the error text for a folder without tables, such as that of a killed batch."""
    records = [
        record for one in sorted(folder.glob(f"*/{NOTE}")) if (record := JobRecord.read(one.parent))
    ]
    if not records:
        return "expected a table, the folder of a run or of a batch"
    done = sum(record.status == "done" for record in records)
    return (
        f"this batch was interrupted, or still runs: {done} of {len(records)} jobs are done, and it"
        " has no table of events yet; run the same `lidar-core batch` command again, which keeps"
        " what is done and writes the table"
    )


def matching_rows(columns: Columns, query: str) -> Columns:
    """Return the rows of a table for which a query is true.

    Parameters
    ----------
    columns : dict of ndarray
        The table.
    query : str
        Names of columns, numbers and texts with < <= > >= == != in, + - * /, and, or, not. Names
        that are no words with dots, such as circles-1.elements, are given between backticks.

    Raises
    ------
    ConfigError
        The query is not valid, or names an unknown column.
    """
    count = len(next(iter(columns.values()), ()))
    try:
        with np.errstate(all="ignore"):
            chosen = _value(_parsed(query), columns, query, 0)
    except ConfigError as error:
        bare = without_ticks(query, columns)
        if bare is None:
            raise
        cure = f"a column of this name needs backticks: {ticked(bare)}"
        raise ConfigError(f"{error}; {cure}") from error
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


def absent_texts(columns: Columns, query: str) -> list[tuple[str, str, list[str]]]:
    """Return texts that a query compares with a column and that no row has.

    Parameters
    ----------
    columns : dict of ndarray
        The table.
    query : str
        A query that `matching_rows` takes.

    Returns
    -------
    found : list of (str, str, list of str)
        Name of the column, text, and the values that occur in the column, sorted.

    Raises
    ------
    ConfigError
        The text is not a query.
    """
    found = []
    for name, other in _pairs(_parsed(query)):
        if name not in columns or not _is_text(columns[name]):
            continue
        held = {str(value) for value in columns[name].tolist()}
        known = sorted(held - {""})
        parts = other.elts if isinstance(other, ast.List | ast.Tuple) else [other]
        texts = [part.value for part in parts if isinstance(part, ast.Constant)]
        found += [
            (name, text, known) for text in texts if isinstance(text, str) and text not in held
        ]
    return list({(name, text): (name, text, held) for name, text, held in found}.values())


def _pairs(tree: ast.expr) -> Iterator[tuple[str, ast.expr]]:
    """Yield the names in comparisons for equality, each with the expression compared with it."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Compare):
            continue
        sides = [node.left, *node.comparators]
        for one, kind, other in zip(sides, node.ops, sides[1:], strict=False):
            if isinstance(kind, ast.Eq | ast.NotEq | ast.In | ast.NotIn):
                for name, value in ((one, other), (other, one)):
                    if isinstance(name, ast.Name):
                        yield name.id, value


def _parsed(query: str) -> ast.expr:
    if len(query) > MOST_LETTERS:
        raise ConfigError(f"query: expected {MOST_LETTERS} letters at most, got {len(query)}")
    try:
        return tree_of(query)
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        cure = with_double_signs(query)
        if cure is not None:
            raise ConfigError(f"query: use == to compare: {cure}") from None
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
                raise ConfigError(f"query: {unknown_column(node.id, columns)}")
            value = columns[node.id]
        case ast.Tuple() | ast.List():
            value = [of(one) for one in node.elts]
            if any(isinstance(one, np.ndarray) for one in value):
                raise ConfigError(
                    f"query: {text_of(node)!r}: expected numbers or texts in a list, got a column"
                )
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
            value = _compared(node, columns, query, of)
        case _:
            raise ConfigError(
                f"query: cannot use {text_of(node)!r}: expected columns, numbers and texts"
                f" with < <= > >= == != in, + - * /, and, or, not; {_EXAMPLE}"
            )
    return value


def _compared(
    node: ast.Compare, columns: Columns, query: str, of: Callable[[ast.expr], Any]
) -> Any:
    """Value of a comparison; `a < b <= c` is true where both comparisons are."""
    _check_quotes(node, columns)
    values = [of(node.left), *(of(one) for one in node.comparators)]
    parts = []
    for one, kind, other in zip(values, node.ops, values[1:], strict=False):
        if type(kind) not in _COMPARISONS:
            raise ConfigError(f"query: cannot use {text_of(node)!r}; {_EXAMPLE}")
        if _is_text(one) != _is_text(other):
            raise ConfigError(f"query: {text_of(node)!r} compares a text with a number")
        parts.append(np.asarray(_applied(_COMPARISONS[type(kind)], query, one, other)))
    return _folded(np.logical_and, parts)


def _check_quotes(node: ast.Compare, columns: Columns) -> None:
    """Refuse a word that is compared with a text column and is no column: it lacks quotes."""
    for name, other in _pairs(node):
        if name not in columns or not _is_text(columns[name]):
            continue
        parts = other.elts if isinstance(other, ast.List | ast.Tuple) else [other]
        words = {part.id for part in parts if isinstance(part, ast.Name)} - columns.keys()
        if words:
            cure = text_of(_Quoted(words).visit(node))
            raise ConfigError(
                f"query: no column {', '.join(sorted(words))}; texts need quotes: {cure}"
            )


class _Quoted(ast.NodeTransformer):
    """Transformer of a query's syntax tree that turns words into texts."""

    def __init__(self, words: set[str]) -> None:
        self._words = words

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return ast.Constant(node.id) if node.id in self._words else node


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
