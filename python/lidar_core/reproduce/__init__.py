"""Reproduction of the papers' tables and figures: paper's value, paper mode, best mode.

If printed equations contradict each other, a column `equations_corrected` has the results of
corrected ones.

There is one folder per paper: `flying`, `circles`, `fusion`. An item declares its name, its
duration, its measurement, and how rows and picture are made of it. A module that declares items is
named in `registry.MODULES`.
"""

from lidar_core.reproduce.registry import item_named, items
from lidar_core.reproduce.types import COLUMNS, Item, Measured, Request, Result, Row

__all__ = ["COLUMNS", "Item", "Measured", "Request", "Result", "Row", "item_named", "items"]


def __dir__() -> list[str]:
    return __all__
