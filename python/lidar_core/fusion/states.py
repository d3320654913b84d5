"""What the numbers of a state are, model by model."""

import numpy as np
from numpy.typing import NDArray

from lidar_core._core import fusion_models
from lidar_core.fusion.config import FusionConfig

STATES: dict[str, tuple[str, ...]] = {name: tuple(states) for name, states, *_ in fusion_models()}
"""Names of states by model; w_d of ctrv-drone is there unless a gyro is an input."""


def state_names(config: FusionConfig) -> tuple[str, ...]:
    """Names of the states that a filter of this configuration estimates.

    Examples
    --------
    >>> state_names(FusionConfig(model="ctrv"))
    ('x', 'y', 'v', 'theta', 'w')
    """
    if config.method == "imm":
        return STATES["ca"]
    if config.model == "ctrv-drone" and config.gyro == "input":
        return STATES["ctrv"]
    return STATES[config.model]


def velocities(states: NDArray[np.float64], config: FusionConfig) -> NDArray[np.float64]:
    """Velocity vectors (K, 2) [m/s] of states (K, n).

    Examples
    --------
    >>> velocities(np.array([[1.0, 2.0, 3.0, 0.0, 0.1]]), FusionConfig(model="ctrv")).tolist()
    [[3.0, 0.0]]
    """
    if "vx" in state_names(config):
        return states[:, 2:4]
    speed, heading = states[:, 2:3], states[:, 3]
    vectors: NDArray[np.float64] = speed * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return vectors
