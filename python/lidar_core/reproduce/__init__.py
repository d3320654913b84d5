"""Tables and figures of the papers, run again: the paper's numbers | paper mode | best mode.

Where printed equations contradict each other, a column `equations_corrected` has them put right.

One folder per paper: `flying`, `circles`, `fusion`; in it one file per item. An item is a module
with an `ITEM`, named in `registry.MODULES`.
"""

from lidar_core.reproduce.registry import item_named, items
from lidar_core.reproduce.types import COLUMNS, Item, Request, Result, Row

__all__ = ["COLUMNS", "Item", "Request", "Result", "Row", "item_named", "items"]
