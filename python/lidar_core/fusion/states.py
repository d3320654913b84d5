"""Names and meaning of the states of each model."""

import numpy as np
from numpy.typing import NDArray

from lidar_core._core import fusion_models
from lidar_core.fusion.config import IN_SPACE, FusionConfig

STATES: dict[str, tuple[str, ...]] = {name: tuple(states) for name, states, *_ in fusion_models()}
"""Names of states by model; of ctrv-drone without a gyro as an input."""
_GYRO = {"input": ("gyro_bias", "gyro_delay"), "exact": ()}
"""What follows the states of ctrv when the turn rate of the sensor comes from a gyro."""


def state_names(config: FusionConfig) -> tuple[str, ...]:
    """Names of the states that a filter of this configuration estimates.

    Examples
    --------
    >>> state_names(FusionConfig(model="ctrv"))
    ('x', 'y', 'v', 'theta', 'w')
    >>> state_names(FusionConfig.turning_sensor())[5:]
    ('gyro_bias', 'gyro_delay')
    """
    if config.method == "imm":
        return STATES["ca-3d" if is_in_space(config) else "ca"]
    if config.model == "ctrv-drone" and config.gyro in _GYRO:
        return STATES["ctrv"] + _GYRO[config.gyro]
    return STATES[config.model]


def is_in_space(config: FusionConfig) -> bool:
    """True if the states include a height.

    Examples
    --------
    >>> is_in_space(FusionConfig()), is_in_space(FusionConfig(model="ctrv-3d"))
    (False, True)
    """
    name = config.imm_models[0] if config.method == "imm" else config.model
    return str(name).endswith(IN_SPACE)


def dimensions(config: FusionConfig) -> int:
    """Number of position coordinates: the first 2 states, or 3 in space."""
    return 3 if is_in_space(config) else 2


def velocities(states: NDArray[np.float64], config: FusionConfig) -> NDArray[np.float64]:
    """Velocity vectors (K, 2), or (K, 3) of a model in space, [m/s] of states (K, n).

    Examples
    --------
    >>> velocities(np.array([[1.0, 2.0, 3.0, 0.0, 0.1]]), FusionConfig(model="ctrv")).tolist()
    [[3.0, 0.0]]
    """
    size = dimensions(config)
    if "vx" in state_names(config):
        return states[:, size : 2 * size]
    speed, heading = states[:, size], states[:, size + 1]
    parts = [speed * np.cos(heading), speed * np.sin(heading)]
    return np.stack([*parts, *([states[:, -1]] if size == 3 else [])], axis=1)


def told_stds(config: FusionConfig) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Configured deviations of LiDAR and radar: (2,) and (3,), in space (3,) and (4,).

    Examples
    --------
    >>> [len(part) for part in told_stds(FusionConfig(model="cv-3d"))]
    [3, 4]
    """
    lidar, radar = list(config.lidar_std), list(config.radar_std)
    if is_in_space(config):
        lidar += lidar[-1:] if len(lidar) == 2 else []
        radar = [*radar[:2], radar[1], radar[2]] if len(radar) == 3 else radar
    elif len(radar) == 4:
        radar = [*radar[:2], radar[3]]
    return np.array(lidar if is_in_space(config) else lidar[:2]), np.array(radar)
