"""Eight targets among false measurements: lidar_core beside Stone Soup's JPDA, on the same scans.

The scans are those of `lidar-core reproduce tracking-clutter`. Stone Soup is told what lidar_core
has to learn: the density of false measurements, the probability of detection, and the noise. A
track starts with Stone Soup's initiator for several measurements; the table has a row for each
number of measurements, so that nobody has to guess the best one.
"""

import argparse
import json
from collections.abc import Callable, Iterator
from datetime import datetime, timedelta
from importlib.metadata import version
from pathlib import Path
from time import process_time

import numpy as np
from numpy.typing import NDArray
from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
from stonesoup.dataassociator.probability import JPDAwithLBP
from stonesoup.deleter.error import CovarianceBasedDeleter
from stonesoup.deleter.multi import CompositeDeleter
from stonesoup.deleter.time import UpdateTimeStepsDeleter
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.hypothesiser.probability import PDAHypothesiser
from stonesoup.initiator.simple import MultiMeasurementInitiator
from stonesoup.measures import Mahalanobis
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import (
    CombinedLinearGaussianTransitionModel,
    ConstantVelocity,
)
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.tracker.simple import MultiTargetMixtureTracker
from stonesoup.types.detection import Detection
from stonesoup.types.state import GaussianState
from stonesoup.updater.kalman import KalmanUpdater

from lidar_core.evaluation import ospa
from lidar_core.fusion import MultiTargetConfig
from lidar_core.reproduce.tracking.arena import (
    NOISE,
    SETTLED,
    SIDE,
    SPEEDS,
    UNREST,
    Arena,
    Moment,
    are_matched,
    followed,
)

DETECTION, CUTOFF = 0.7, 1.0
GATE = 0.99
"""Probability with which a measurement of a target is in its gate."""
POINTS = (3, 4, 5, 6)
"""Measurements with which Stone Soup starts a track."""
UNSEEN = 5
"""Scans after which it drops a track that nothing updated."""
START = datetime(2026, 1, 1)

Places = NDArray[np.float64]


def stonesoup_tracks(moments: list[Moment], clutter: float, points: int) -> Iterator[Places]:
    """Positions that Stone Soup reports after every scan."""
    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(UNREST)] * 2)
    measured = LinearGaussian(4, (0, 2), np.diag([NOISE**2] * 2))
    predictor, updater = KalmanPredictor(motion), KalmanUpdater(measured)
    deleter = CompositeDeleter(
        [UpdateTimeStepsDeleter(UNSEEN), CovarianceBasedDeleter(4.0, mapping=[0, 2])],
        intersect=False,
    )
    nearest = DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=3.0)
    prior = GaussianState([[0]] * 4, np.diag([0, SPEEDS[1] ** 2, 0, SPEEDS[1] ** 2]))
    scans = [
        (
            START + timedelta(microseconds=moment.stamp_ns // 1000),
            {
                Detection(
                    place[:, None],
                    timestamp=START + timedelta(microseconds=moment.stamp_ns // 1000),
                    measurement_model=measured,
                )
                for place in moment.places
            },
        )
        for moment in moments
    ]
    tracker = MultiTargetMixtureTracker(
        initiator=MultiMeasurementInitiator(
            prior_state=prior,
            deleter=UpdateTimeStepsDeleter(2),
            data_associator=GNNWith2DAssignment(nearest),
            updater=updater,
            measurement_model=measured,
            min_points=points,
        ),
        deleter=deleter,
        detector=scans,
        data_associator=JPDAwithLBP(
            PDAHypothesiser(
                predictor,
                updater,
                clutter_spatial_density=clutter / SIDE**2,
                prob_detect=DETECTION,
                prob_gate=GATE,
            )
        ),
        updater=updater,
    )
    for _, tracks in tracker:
        means = [np.ravel(track.state.mean)[[0, 2]] for track in tracks]
        yield np.array(means, float).reshape(-1, 2)


def our_tracks(moments: list[Moment], clutter: float, points: int) -> Iterator[Places]:
    """Positions that lidar_core reports; it is told nothing."""
    del clutter, points

    class Replay:
        """The same scans again."""

        def moments(self, _: np.random.Generator) -> Iterator[Moment]:
            return iter(moments)

    config = MultiTargetConfig()
    for _, tracks in followed(Replay(), config, np.random.default_rng(0)):  # type: ignore[arg-type]
        yield tracks.position[tracks.confirmed]


Tracker = Callable[[list[Moment], float, int], Iterator[Places]]


def score(tracker: Tracker, clutter: float, points: int, runs: int) -> list[float]:
    """Mean OSPA [m], false and missed targets per scan, CPU time per scan [ms]."""
    rows, spent, scans = [], 0.0, 0
    for run in range(runs):
        rng = np.random.default_rng([20260606, 0, int(clutter), run])
        moments = list(Arena(clutter, DETECTION).moments(rng))
        start = process_time()
        found = list(tracker(moments, clutter, points))
        spent += process_time() - start
        scans += len(moments)
        counted = moments[SETTLED:]
        for moment, places in zip(counted, found[-len(counted) :], strict=True):
            hits = int(are_matched(places, np.full(len(places), CUTOFF), moment.truth).sum())
            spaces = [np.pad(one, ((0, 0), (0, 1))) for one in (places, moment.truth)]
            far = ospa(*spaces, cutoff=CUTOFF, order=1.0)
            rows.append((far, len(places) - hits, len(moment.truth) - hits))
    return [*np.mean(rows, axis=0).tolist(), 1e3 * spent / scans]


def measure(runs: int) -> tuple[str, dict[str, dict[str, float]]]:
    """The table in Markdown, and its numbers."""
    name = f"Stone Soup {version('stonesoup')}, JPDA, tracks of"
    systems: list[tuple[str, Tracker, int]] = [("lidar_core, default", our_tracks, 0)]
    systems += [(f"{name} {points}", stonesoup_tracks, points) for points in POINTS]
    lines, figures = [], {}
    for clutter in (10, 50):
        lines += [
            f"\n| eight targets, {clutter} false measurements a scan | OSPA [m]"
            " | false tracks per scan | missed targets per scan | CPU [ms per scan] |",
            "|---|---|---|---|---|",
        ]
        for place, (title, tracker, points) in enumerate(systems):
            values = score(tracker, clutter, points, runs)
            lines.append(f"| {title} | " + " | ".join(f"{v:.3g}" for v in values) + " |")
            keys = ("ospa", "false", "missed", "ms")
            figures[f"{clutter}/{title}"] = {"place": place, **dict(zip(keys, values, strict=True))}
    return "\n".join(lines).strip(), figures


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=5, help="runs of 100 scans")
    parser.add_argument("--figures", type=Path, help="JSON file for the numbers")
    chosen = parser.parse_args()
    text, figures = measure(chosen.runs)
    print(text)
    if chosen.figures:
        chosen.figures.write_text(json.dumps(figures, indent=1), encoding="utf-8")
