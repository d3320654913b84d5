"""Tables and figures of the papers, run again: the paper's numbers | paper mode | best mode.

One file per item. An item is a module with an `ITEM`, named in `registry.MODULES`.
"""

from lidar_core.reproduce.registry import item_named, items
from lidar_core.reproduce.types import Item, Request, Result, Row

__all__ = ["Item", "Request", "Result", "Row", "item_named", "items"]
