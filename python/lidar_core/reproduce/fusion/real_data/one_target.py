"""Scores on L/R files of the default filter with correct and wrong noise of its sensors."""

from collections.abc import Mapping

import numpy as np

from lidar_core.estimation import chi2_quantile
from lidar_core.evaluation import nees
from lidar_core.fusion import FusionConfig, Run, run
from lidar_core.reproduce.fusion.contenders import FIXED, REFERENCE, SAMPLE_1_NOISE, TOLD
from lidar_core.reproduce.fusion.laser_radar import (
    OBJ_POSE,
    SAMPLE_1,
    Course,
    Noise,
    course,
    measurements,
)
from lidar_core.reproduce.types import Row

FILES: Mapping[str, tuple[str, int, Noise]] = {
    "sample-1": (SAMPLE_1, 1224, SAMPLE_1_NOISE),
    "obj_pose": (OBJ_POSE, 500, FIXED),
}
"""File, its rows, and the noise that its sensors have."""
SETTLED = 60
"""Measurements of the first 3 s, which do not count."""
REGION = 0.95


def file_rows(name: str, count: int) -> list[Row]:
    """Scores of the default filter on the first `count` rows of a file."""
    place, _, noise = FILES[name]
    of = course(place)
    right, _, _ = scored(of, followed(of, noise, 1.0, **REFERENCE), count)
    found = {told: scored(of, followed(of, noise, by), count) for told, by in TOLD.items()}
    values: dict[tuple[str, str], float] = {
        ("rows", "1"): float(min(count, len(of.values))),
        ("2-D RMSE, noise believed and right", "m"): right,
    }
    for told, (rmse, ratio, share) in found.items():
        values |= {
            (f"2-D RMSE over that, noise told {told}", "1"): rmse / right,
            (f"NEES / 2, noise told {told}", "1"): ratio,
            (f"95 % regions hold, noise told {told}", "1"): share,
        }
    untold, ratio, share = scored(of, run(measurements(of, of.values, "fixed", noise, 0.0)), count)
    values |= {
        ("2-D RMSE over that, nothing told", "1"): untold / right,
        ("NEES / 2, nothing told", "1"): ratio,
        ("95 % regions hold, nothing told", "1"): share,
    }
    return [Row(f"{name}/{what}", unit, best_mode=value) for (what, unit), value in values.items()]


def followed(of: Course, noise: Noise, factor: float, **changes: object) -> Run:
    """Run the filter on a simulated course.

    Its configured noise is `factor` times the true noise.
    """
    told = {
        "lidar_std": (factor * noise.lidar,) * 2,
        "radar_std": tuple(factor * np.array(noise.radar)),
    }
    config = FusionConfig.load({**told, **changes})
    return run(measurements(of, of.values, "fixed", noise, 0.0), config)


def scored(of: Course, found: Run, count: int) -> tuple[float, float, float]:
    """RMSE of the position [m], NEES over its degrees of freedom, share of 95 % regions that hold.

    Score the rows from `SETTLED` to `count`.
    """
    rows = slice(SETTLED, count)
    wrong = found.states[rows, :2] - of.truth.position[rows]
    values = nees(wrong, found.covariances[rows, :2, :2])
    return (
        float(np.sqrt(np.square(wrong).sum(axis=1).mean())),
        float(values.mean() / 2),
        float((values <= chi2_quantile(REGION, degrees=2)).mean()),
    )
