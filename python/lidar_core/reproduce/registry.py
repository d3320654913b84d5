"""The items of `lidar-core reproduce`."""

from importlib import import_module

from lidar_core.errors import ConfigError, unknown
from lidar_core.reproduce.types import Item

MODULES = (
    "flying_fig3",
    "flying_fig4",
    "flying_fig5",
    "flying_detection_probability",
    "flying_table3",
    "flying_fig7",
    "flying_fig8",
    "flying_crossings",
    "flying_occlusions",
    "flying_pose_noise",
    "flying_consistency",
    "flying_range",
    "flying_false_tracks",
    "flying_real",
    "flying_drivers",
    "flying_surfaces",
    "circles_table1",
    "circles_table2",
    "circles_fig5",
    "circles_table3",
    "circles_detectors",
    "circles_table4",
    "circles_table5",
    "circles_fig7",
    "circles_fig8",
    "circles_lab",
    "circles_shapes",
    "fusion_rmse",
    "fusion_fig4",
    "fusion_fig7",
    "fusion_fig8",
    "fusion_fig9",
    "fusion_fig10",
    "fusion_fig11",
    "fusion_drone_yaw",
    "fusion_consistency",
)
"""Modules of this package that hold an `ITEM`, in the order in which `all` runs them."""


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
