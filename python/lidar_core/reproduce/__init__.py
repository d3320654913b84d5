"""Tables and figures of the papers, run again: the paper's numbers | paper mode | best mode.

Where printed equations contradict each other, a column `equations_corrected` has corrected ones.

One folder per paper: `flying`, `circles`, `fusion`. An item is a declaration: its name, how long it
takes, what it measures, and how rows and picture are made of that. A module that declares items is
named in `registry.MODULES`.
"""

from lidar_core.reproduce.registry import item_named, items
from lidar_core.reproduce.types import COLUMNS, Item, Measured, Request, Result, Row

__all__ = ["COLUMNS", "Item", "Measured", "Request", "Result", "Row", "item_named", "items"]


def __dir__() -> list[str]:
    return __all__
