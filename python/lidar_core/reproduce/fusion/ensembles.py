"""Targets that move exactly by a model of fusion, and their LiDAR and radar measurements."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lidar_core.fusion import FusionConfig, Measurements
from lidar_core.reproduce.fusion.drone_yaw import GYRO_STD, Ride, turned_back
from lidar_core.reproduce.fusion.laser_radar import in_turn

Array = NDArray[np.float64]

STEPS, STEP_NS, SECONDS = 300, 50_000_000, 0.05
GREATEST_RATE = 1.0
"""Of a sensor that turns to and fro [rad/s]."""
SUBSTEPS = 5
"""Of a step, in whose middles noise enters."""
FIRST = (20.0, 0.5, 10.0)
"""Range [m], bearing [rad] and range rate [m/s] of the first measurement: from there the target's
state is drawn, as the filter expects it."""
SOJOURN = 5.0
"""Mean time between starts and ends of turns of a target that switches [s]."""
TURN = 0.5
"""Standard deviation of its turn rates [rad/s]."""
TRUE = {
    "process": "continuous",
    "acceleration_noise": 0.3,
    "jerk_noise": 0.1,
    "turn_noise": 0.1,
    "lidar_std": (0.15, 0.15),
    "radar_std": (0.3, 0.03, 0.3),
    "gyro_std": GYRO_STD,
    "start_rows": 1,
    "initial_position": 0.3,
    "initial_speed": 0.5,
    "initial_heading": 0.1,
    "initial_turn_rate": 0.1,
    "initial_acceleration": 0.1,
    "gate_probability": None,
    "loss_ratio": None,
    "sensor_noise": "configured",
}
"""How targets move and what sensors measure, in the words of `FusionConfig`."""
SWITCHING = "switching"


@dataclass(frozen=True, slots=True)
class Ensemble:
    """Independent targets.

    Attributes
    ----------
    states : ndarray, shape (R, STEPS, n)
        The truth, in the states of the model.
    targets : list of Measurements
        One per target, with a measurement per step; that of a gyro before it, if the sensor turns.
    rows : slice
        Indices of the measurements of the target.
    """

    states: Array
    targets: list[Measurements]
    rows: slice


def draw_ensemble(model: str, runs: int, rng: np.random.Generator) -> Ensemble:
    """Draw targets that move by the `model` of `FusionConfig`, or that start and end turns."""
    states = _simulate_states(model, _started(model, runs, rng), rng)
    stamps, names = np.arange(STEPS) * STEP_NS, np.where(_is_lidar(), "lidar", "radar")
    if model != "ctrv-drone":
        targets = [
            Measurements.from_arrays(stamps, names, one) for one in _measure(model, states, rng)
        ]
        return Ensemble(states, targets, slice(None))
    seconds = np.arange(STEPS).astype(np.float64) * SECONDS
    ride = Ride.of(seconds, GREATEST_RATE, 0.0)
    states[..., :2] = turned_back(
        states[..., :2], np.stack([np.cos(ride.yaw), np.sin(ride.yaw)], axis=1)
    )
    states[..., 3] -= ride.yaw
    values = np.zeros((runs, 2 * STEPS, 3))
    values[:, ::2, 0] = ride.gyro(seconds) + GYRO_STD * rng.normal(size=(runs, STEPS))
    values[:, 1::2] = _measure(model, states, rng)
    both = np.stack([np.full(STEPS, "gyro"), names], axis=1).reshape(-1)
    targets = [Measurements.from_arrays(stamps.repeat(2), both, one) for one in values]
    return Ensemble(states, targets, slice(1, None, 2))


def _started(model: str, runs: int, rng: np.random.Generator) -> Array:
    """Draw initial states (runs, n) around the state of the first measurement."""
    (distance, bearing, speed), config = FIRST, FusionConfig.load(TRUE)
    along = np.array([np.cos(bearing), np.sin(bearing)])
    rate, push = config.initial_turn_rate, config.initial_acceleration
    mean, std = [*distance * along], [config.initial_position] * 2
    if model in ("ctrv", "ctra", "ctrv-drone"):
        mean += [speed, bearing, 0.0]
        std += [config.initial_speed, config.initial_heading, rate]
    else:
        mean += [*speed * along]
        std += [config.initial_speed] * 2
    extra = {"ca": [push, push], "ct": [rate], "ctra": [push], SWITCHING: [0.0]}.get(model, [])
    return np.array(mean + [0.0] * len(extra)) + rng.normal(size=(runs, len(std + extra))) * (
        std + extra
    )


def _simulate_states(model: str, state: Array, rng: np.random.Generator) -> Array:
    """Simulate paths that start at `state` (R, n); return their states, (R, STEPS, n)."""
    config = FusionConfig.load(TRUE)
    pushes, jerks = config.acceleration_noise, config.jerk_noise
    turns = config.turn_noise
    driven = {
        "cv": {2: pushes, 3: pushes},
        "ca": {4: jerks, 5: jerks},
        "ct": {2: pushes, 3: pushes, 4: turns},
        "ctrv": {2: pushes, 4: turns},
        "ctra": {5: jerks, 4: turns},
        "ctrv-drone": {2: pushes, 4: turns},
        SWITCHING: {2: pushes, 3: pushes},
    }[model]
    strength = np.zeros(state.shape[1])
    strength[list(driven)] = list(driven.values())
    moved = partial(_polar if model.startswith("ctr") else _cartesian, half=SECONDS / SUBSTEPS / 2)
    states = [state]
    for _ in range(STEPS - 1):
        if model == SWITCHING:
            state = _switched(state, rng)
        for _ in range(SUBSTEPS):
            noise = rng.normal(size=state.shape) * strength * np.sqrt(SECONDS / SUBSTEPS)
            state = moved(moved(state) + noise)
        states.append(state)
    return np.stack(states, axis=1)


def _switched(state: Array, rng: np.random.Generator) -> Array:
    """Return the states after random switches: turns end, straight motion becomes a turn."""
    state, chosen = state.copy(), rng.random(len(state)) < 1 - np.exp(-SECONDS / SOJOURN)
    rates = np.where(state[:, 4] == 0.0, TURN * rng.normal(size=len(state)), 0.0)
    state[chosen, 4] = rates[chosen]
    return state


def _cartesian(state: Array, half: float) -> Array:
    """States with position and velocity after `half` a substep [s].

    They move with the acceleration (6 components) or the turn rate (5 components) of the state.
    """
    after, velocity = state.copy(), state[:, 2:4]
    if state.shape[1] == 6:
        after[:, 2:4] += state[:, 4:] * half
    elif state.shape[1] == 5:
        angle = state[:, 4] * half
        after[:, 2:4] = turned_back(velocity, np.stack([np.cos(angle), -np.sin(angle)], axis=1))
    after[:, :2] += (velocity + after[:, 2:4]) / 2 * half
    return after


def _polar(state: Array, half: float) -> Array:
    """States with position, speed, heading and turn rate after `half` a substep [s].

    A sixth component is the acceleration along the heading.
    """
    after = state.copy()
    if state.shape[1] == 6:
        after[:, 2] += state[:, 5] * half
    after[:, 3] += state[:, 4] * half
    heading = (state[:, 3] + after[:, 3]) / 2
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    after[:, :2] += ((state[:, 2] + after[:, 2]) / 2 * half)[:, None] * ahead
    return after


def _measure(model: str, states: Array, rng: np.random.Generator) -> Array:
    """Draw the values of one measurement per step, (R, STEPS, 3)."""
    x, y = states[..., 0], states[..., 1]
    vx, vy = states[..., 2], states[..., 3]
    if model.startswith("ctr"):
        vx, vy = vx * np.cos(vy), vx * np.sin(vy)
    distance, is_lidar = np.hypot(x, y), _is_lidar()
    values = np.stack([distance, np.arctan2(y, x), (x * vx + y * vy) / distance], axis=-1)
    values[:, is_lidar] = states[:, is_lidar, :3]
    config, noise = FusionConfig.load(TRUE), rng.normal(size=values.shape)
    values += noise * np.where(is_lidar[:, None], (*config.lidar_std, 0.0), config.radar_std)
    values[:, 0] = FIRST
    return values


def _is_lidar() -> NDArray[np.bool_]:
    """Return which steps the LiDAR measures, (STEPS,); the first step is the radar's."""
    return ~in_turn(STEPS)
