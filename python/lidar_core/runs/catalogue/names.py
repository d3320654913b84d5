"""Names of columns that are near a wrong one, for errors: tables of batches have many columns."""

import re
from collections.abc import Collection
from difflib import SequenceMatcher

MOST_NAMES = 10
"""Columns that a text lists."""
NEAR = 0.6
"""Likeness from which on a column was probably meant."""
_BETWEEN = re.compile(r"[^A-Za-z0-9]+")


def unknown_column(name: str, columns: Collection[str]) -> str:
    """Return the error text for a column that a table does not have: of many, the nearest first."""
    likeness = {one: _likeness(name, one) for one in columns}
    ranked = sorted(columns, key=lambda one: -likeness[one])
    shown = columns if len(ranked) <= MOST_NAMES + 2 else ranked[:MOST_NAMES]
    meant = bool(ranked) and likeness[ranked[0]] >= NEAR
    cure = f"; did you mean {ranked[0]}?" if meant else ""
    return f"column: expected one of {listed_columns(shown, len(ranked))}, got {name!r}{cure}"


def listed_columns(shown: Collection[str], total: int) -> str:
    """Return names of columns as one text, with how many others there are, and who lists them."""
    others = total - len(shown)
    more = f" and {others} others (`lidar-core events all TABLE` lists them)" if others else ""
    return f"{', '.join(shown) or 'none'}{more}"


def _likeness(name: str, other: str) -> float:
    """Likeness of two names, 0 to 1: of their words in any order, and a little of their letters."""
    ours, theirs = _words(name), _words(other)
    letters = _ratio(name.lower(), other.lower())
    if not ours or not theirs:
        return letters
    parts = [max(_ratio(one, word) for word in theirs) for one in ours]
    parts += [max(_ratio(one, word) for word in ours) for one in theirs]
    return 0.9 * sum(parts) / len(parts) + 0.1 * letters


def _words(name: str) -> list[str]:
    return [word for word in _BETWEEN.split(name.lower()) if word][:MOST_NAMES]


def _ratio(one: str, other: str) -> float:
    return SequenceMatcher(None, one, other).ratio()
