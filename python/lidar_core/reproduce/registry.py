"""The items of `lidar-core reproduce`."""

from importlib import import_module

from lidar_core.errors import ConfigError, unknown
from lidar_core.reproduce.types import Item

MODULES = (
    "flying.fig3",
    "flying.fig4",
    "flying.fig5",
    "flying.detection_probability",
    "flying.table3",
    "flying.fig7",
    "flying.fig8",
    "flying.crossings",
    "flying.occlusions",
    "flying.pose_noise",
    "flying.consistency",
    "flying.detection_range",
    "flying.false_tracks",
    "flying.real",
    "flying.drivers",
    "flying.surfaces",
    "circles.table1",
    "circles.table2",
    "circles.fig5",
    "circles.table3",
    "circles.detectors",
    "circles.table4",
    "circles.table5",
    "circles.fig7",
    "circles.fig8",
    "circles.lab",
    "circles.shapes",
    "fusion.rmse",
    "fusion.fig4",
    "fusion.fig7",
    "fusion.fig8",
    "fusion.fig9",
    "fusion.fig10",
    "fusion.fig11",
    "fusion.drone_yaw",
    "fusion.consistency",
)
"""Modules of this package, by paper, that hold an `ITEM`, in the order in which `all` runs them."""


def items() -> dict[str, Item]:
    """Every item by its name."""
    found = (import_module(f"lidar_core.reproduce.{name}").ITEM for name in MODULES)
    return {item.name: item for item in found}


def item_named(name: str) -> Item:
    """Return the item that the command calls `name`.

    Raises
    ------
    ConfigError
        There is no such item.
    """
    known = items()
    if name not in known:
        raise ConfigError(unknown("item", name, [*known, "all"]))
    return known[name]
