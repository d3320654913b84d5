"""Syntax of queries: a text as a tree of Python's syntax, and a tree as text."""

import ast
import keyword
import re
from collections.abc import Iterable, Mapping

_TICKED = re.compile(r"""('(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*")|`([^`]*)`""", re.DOTALL)
"""A text, or a name between backticks."""
_SINGLE_SIGN = re.compile(r"""('[^']*'|"[^"]*"|`[^`]*`|[<>=!]=)|=""")
"""A single =, or what is left as it is: texts, names between backticks, signs of two letters."""


def tree_of(query: str) -> ast.expr:
    """Parse a query; names with dots, and names between backticks, become names in the tree.

    Raises
    ------
    SyntaxError, ValueError, MemoryError, RecursionError
        Errors of Python's parser.
    """
    known = "_"
    while known in query:
        known += "_"
    names: dict[str, str] = {}

    def replaced(found: re.Match[str]) -> str:
        if found[2] is None:
            return found[0]
        own = f"{known}{len(names)}"
        names[own] = found[2]
        return f" {own} "

    plain = _TICKED.sub(replaced, query).strip()
    tree: ast.expr = _Named(names).visit(ast.parse(plain, mode="eval").body)
    return tree


def with_double_signs(query: str) -> str | None:
    """Return the query with == in place of every single =; None if that is no valid query."""
    cure = _SINGLE_SIGN.sub(lambda found: found[1] or "==", query.strip())
    try:
        tree_of(cure)
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        return None
    return cure if cure != query.strip() else None


def ticked(name: str) -> str:
    """Return the name of a column as a query has it: between backticks if it needs them."""
    parts = name.split(".")
    is_plain = all(part.isidentifier() and not keyword.iskeyword(part) for part in parts)
    return name if is_plain else f"`{name}`"


def without_ticks(query: str, columns: Iterable[str]) -> str | None:
    """Return the first column that a query names without the backticks that it needs, if any."""
    outside = _TICKED.sub(" ", query)
    return next(
        (
            name
            for name in columns
            if ticked(name) != name and re.search(r"[^\W\d]", name) and "`" not in name
            if not keyword.iskeyword(name)
            if re.search(rf"(?<!\w){re.escape(name)}(?!\w)", outside)
        ),
        None,
    )


def text_of(node: ast.expr) -> str:
    """Return a part of a query as text, for an error; the names in `node` are replaced."""
    try:
        return ast.unparse(_Ticked().visit(node))
    except RecursionError:
        return "a part that is nested too deep"


class _Named(ast.NodeTransformer):
    """Transformer of a query's syntax tree that restores the names of columns.

    It turns a.b, as in tables of results, into one name.
    """

    def __init__(self, names: Mapping[str, str]) -> None:
        self._names = names

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return ast.Name(self._names.get(node.id, node.id))

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        value, end = self.visit(node.value), self._names.get(node.attr, node.attr)
        return (
            ast.Name(f"{value.id}.{end}")
            if isinstance(value, ast.Name)
            else ast.Attribute(value, end)
        )

    def visit_keyword(self, node: ast.keyword) -> ast.keyword:
        return ast.keyword(self._names.get(node.arg or "", node.arg), self.visit(node.value))


class _Ticked(ast.NodeTransformer):
    """Transformer of a query's syntax tree that puts names between backticks that need them."""

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return ast.Name(ticked(node.id))
