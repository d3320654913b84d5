"""Filters that the items of the third paper compare: as published, and our best ones."""

from typing import Any

from lidar_core.fusion import FusionConfig
from lidar_core.reproduce.fusion.laser_radar import Contender, Noise

FIXED = Noise(0.15, (0.3, 0.03, 0.3))
"""What courses and the paper take for the noise, whatever is added."""
SAMPLE_1_NOISE = Noise(0.01, (0.1, 0.001, 0.1))
"""Of the sensors of the first recording."""
JUMPS = 0.6
"""Deviation of its range rates from a smooth motion [m/s]: the true speed jumps."""
OURS = Noise(0.01, (0.1, 0.001, JUMPS))
TOLD = {"x 0.2": 0.2, "x 1/3": 1 / 3, "x 0.5": 0.5, "right": 1.0, "x 2": 2.0, "x 3": 3.0}
"""Factors on the standard deviations of the sensors that a filter is told."""
REFERENCE = {"gate_probability": None, "loss_ratio": None, "sensor_noise": "configured"}
"""A filter that believes what it is told, and every measurement."""
LINEAR = "linear KF"
LINEAR_LIDAR = "linear KF, LiDAR alone"
EKF = "EKF-CTRV"
BEST = "IMM of CV and CTRV"


def printed() -> dict[str, Contender]:
    """Return the filters of the paper: linear ones, and its own with the equations as printed."""
    return {
        LINEAR_LIDAR: Contender("fixed-lidar", _of_courses("cv", "kf"), FIXED),
        LINEAR: Contender("fixed", _of_courses("cv", "kf"), FIXED),
        EKF: Contender("fixed", FusionConfig.paper(), FIXED),
    }


def corrected() -> dict[str, Contender]:
    """Return the paper's filter with correct equations, and alternatives; noise as in `printed`."""
    ways = {
        "EKF-CV": ("cv", "ekf"),
        EKF: ("ctrv", "ekf"),
        "UKF-CTRV": ("ctrv", "ukf"),
        "CKF-CTRV": ("ctrv", "ckf"),
    }
    return {name: Contender("fixed", _of_courses(*way), FIXED) for name, way in ways.items()}


def _of_courses(model: str, method: str) -> FusionConfig:
    """Configuration with discrete process noise, no gate and no restart of a lost filter."""
    return FusionConfig.load(
        {
            "model": model,
            "method": method,
            "process": "discrete",
            "acceleration_noise": 5.0,
            "turn_noise": 3.0,
            "gate_probability": None,
            "loss_ratio": None,
            "sensor_noise": "configured",
        }
    )


def ours() -> dict[str, Contender]:
    """Return our filters: known noise, densities of the process noise, gate and restart.

    The densities were found with seeds from 1000 on.
    """
    known: dict[str, Any] = {"sensor_noise": "configured"}
    linear = FusionConfig(model="cv", method="kf", acceleration_noise=1.0, **known)
    smooth = {"acceleration_noise": 0.08, "turn_noise": 0.9} | known

    def filter_of(method: str) -> FusionConfig:
        return FusionConfig.load({"model": "ctrv", "method": method, **smooth})

    return {
        LINEAR_LIDAR: Contender("lidar", linear, SAMPLE_1_NOISE),
        LINEAR: Contender("polar", linear, SAMPLE_1_NOISE),
        "EKF-CV": Contender(
            "position", FusionConfig(model="cv", acceleration_noise=1.0, **known), OURS
        ),
        EKF: Contender("position", filter_of("ekf"), OURS),
        "UKF-CTRV": Contender("position", filter_of("ukf"), OURS),
        "CKF-CTRV": Contender("position", filter_of("ckf"), OURS),
        BEST: Contender("position", filter_of("imm"), OURS),
    }
