"""The items of `lidar-core reproduce`."""

from importlib import import_module
from types import ModuleType

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
    "flying.encounters.crossings",
    "flying.encounters.occlusions",
    "flying.pose_noise",
    "flying.consistency",
    "flying.detection_range",
    "flying.false_tracks",
    "flying.real",
    "flying.drivers",
    "flying.surfaces",
    "flying.situations.table",
    "circles.table1",
    "circles.table2",
    "circles.fig5",
    "circles.table3",
    "circles.detectors",
    "circles.single",
    "circles.fig8",
    "circles.lab",
    "circles.shapes",
    "circles.real",
    "circles.situations",
    "fusion.rmse",
    "fusion.fig4",
    "fusion.noisy_tracks",
    "fusion.noise_power",
    "fusion.drone_yaw",
    "fusion.consistency",
    "fusion.real",
    "tracking.noise",
    "tracking.dropout",
    "tracking.scaling",
    "tracking.existence",
    "tracking.clutter",
    "tracking.takeover",
)
"""Modules of this package that declare items, by paper, in the order in which `all` runs them."""


def items() -> dict[str, Item]:
    """Return every item by its name."""
    modules = (import_module(f"lidar_core.reproduce.{name}") for name in MODULES)
    return {item.name: item for module in modules for item in declared(module)}


def declared(module: ModuleType) -> list[Item]:
    """Items of one module, in the order in which it declares them."""
    return [value for value in vars(module).values() if isinstance(value, Item)]


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
