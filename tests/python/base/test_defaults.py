"""Defaults: what the Rust crate ships is what the configuration models ship, value by value."""

import difflib

import pytest

from lidar_core import ConfigError, VoxelMapConfig, _core
from lidar_core.circles import CircleMapConfig, CirclesConfig
from lidar_core.config import Config
from lidar_core.flying import ClassifyConfig, FlyingConfig, TrackerConfig
from lidar_core.fusion import FusionConfig, MultiTargetConfig

DEFAULTS = {
    ("flying", "default"): FlyingConfig(),
    ("flying", "paper"): FlyingConfig.paper(),
    ("voxel_map", "default"): VoxelMapConfig(),
    ("voxel_map", "paper"): FlyingConfig.paper().voxel_map,
    ("classify", "default"): ClassifyConfig(),
    ("classify", "paper"): ClassifyConfig.paper(),
    ("tracker", "default"): TrackerConfig(),
    ("tracker", "paper"): TrackerConfig.paper(),
    ("circles", "default"): CirclesConfig(),
    ("circles", "paper"): CirclesConfig.paper(),
    ("circle_map", "default"): CircleMapConfig(),
    ("circle_map", "paper"): CircleMapConfig.paper(),
    ("fusion", "default"): FusionConfig(),
    ("fusion", "paper"): FusionConfig.paper(),
    ("many", "default"): MultiTargetConfig(),
    ("many", "nearest"): MultiTargetConfig(association="nearest"),
    ("many", "joint"): MultiTargetConfig(association="joint"),
}


def differing(model, mode, config):
    """Lines of the core's parameters that the model has otherwise."""
    own = _core.default_parameters(model, mode).splitlines()
    given = _core.parameters_of(model, config).splitlines()
    lines = difflib.unified_diff(own, given, "Rust", "Python", n=0, lineterm="")
    return [line for line in lines if not line.startswith(("---", "+++", "@@"))]


@pytest.mark.parametrize(("model", "mode"), DEFAULTS, ids=" ".join)
def test_rust_and_python_ship_the_same_values(model, mode):
    assert differing(model, mode, DEFAULTS[model, mode]) == []


def leaves(config, path=()):
    """Paths of all numbers and switches of a configuration that the core reads."""
    for name in type(config).model_fields:
        value = getattr(config, name)
        if isinstance(value, Config):
            yield from leaves(value, (*path, name))
        elif isinstance(value, bool | int | float):
            yield (*path, name)


def changed(config, path):
    """The configuration with the value at `path` changed a little; not validated."""
    name, *rest = path
    value = getattr(config, name)
    if rest:
        return config.model_copy(update={name: changed(value, rest)})
    match value:
        case bool():
            other = not value
        case int():
            other = value + 1
        case _:
            other = value / 2 or 1.0
    return config.model_copy(update={name: other})


UNREAD = {
    ("flying", "tracker.confirm_hits"): "without report_existence",
    ("flying", "tracker.confirm_window"): "without report_existence",
    ("circles", "segment.distance"): "of the fixed bound",
    ("circles", "map.velocity_step"): "of the joint filter",
    ("circles", "map.max_eigenvalue"): "of the joint filter",
    ("fusion", "imm_sojourn"): "of method imm",
    ("fusion", "sigma_spread"): "of method ukf",
    ("fusion", "published.speed"): "of model paper",
    ("fusion", "published.elevation"): "of model paper",
}
"""Values that the chosen way does not need."""


@pytest.mark.parametrize("model", ["flying", "circles", "fusion"])
def test_a_change_of_any_value_is_seen(model):
    config = DEFAULTS[model, "default"]
    paths = list(leaves(config))
    assert len(paths) > 15
    unseen = {
        ".".join(path) for path in paths if not differing(model, "default", changed(config, path))
    }
    assert unseen == {name for owner, name in UNREAD if owner == model}


def test_unknown_names_are_refused():
    with pytest.raises(ConfigError, match="model"):
        _core.parameters_of("lidar", FlyingConfig())
    with pytest.raises(ConfigError, match="mode"):
        _core.default_parameters("flying", "worst")
