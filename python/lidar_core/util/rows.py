"""Lines of a table of results, for consoles and pages."""

from typing import NamedTuple


class Row(NamedTuple):
    """One line of a table of results: a measure, its value, and a remark."""

    name: str
    value: str
    remark: str


def number(value: float | None, digits: int, unit: str = "") -> str:
    """Return a number as text; a dash for None."""
    return "-" if value is None else f"{value:.{digits}f}{unit}"
