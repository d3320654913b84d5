"""`tracking-scaling`: time of the tracker of many targets, by their number."""

from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from lidar_core.fusion import Measurement, MultiTargetConfig, MultiTargetTracker, TrackerHealth
from lidar_core.reproduce.common import BLUE
from lidar_core.reproduce.types import Item, Measured, Request, Row

COUNTS = (100, 300, 1000)
SPACING = 20.0
"""Distance between neighbours at first [m]: tracks have no measurements in common."""
STEP_NS = 100_000_000
NOISE = 0.15
"""Standard deviation of the LiDAR's x and y [m]: that of the default filter."""
START = 8
"""Scans after which every target has a track whose speed is known."""
ROUNDS = 9
"""Repetitions of which the fastest counts."""


@dataclass
class Crowd:
    """Targets on a lattice, each with a velocity of its own, and the tracker that follows them."""

    count: int
    tracker: MultiTargetTracker
    rng: np.random.Generator
    step: int = 0

    def __post_init__(self) -> None:
        side = int(np.ceil(np.sqrt(self.count)))
        rows = np.arange(self.count)
        self.place = SPACING * np.stack([rows % side, rows // side], axis=1).astype(float)
        self.velocity = self.rng.normal(0.0, 1.0, (self.count, 2))

    def scan(self) -> float:
        """Track one more scan; return its time [s]."""
        stamp = self.step * STEP_NS
        place = self.place + self.velocity * stamp * 1e-9
        seen = place + self.rng.normal(0.0, NOISE, place.shape)
        scan = [Measurement(stamp, "lidar", at) for at in seen]
        start = perf_counter()
        self.tracker.process(stamp, scan, source="lidar")
        self.step += 1
        return perf_counter() - start


@dataclass(frozen=True, slots=True)
class Cost:
    """Time of a scan [s], and counts of its work."""

    seconds: float
    predictions: float
    pairs: float


def _measure(request: Request) -> Measured:
    # Time also goes into scans that are kept for late ones; nothing else is configured.
    config = MultiTargetConfig()
    crowds = {
        count: Crowd(
            count, MultiTargetTracker(config), np.random.default_rng([20260604, request.seed])
        )
        for count in COUNTS
    }
    for crowd in crowds.values():
        for _ in range(START):
            crowd.scan()
    before = {count: crowd.tracker.health() for count, crowd in crowds.items()}
    times: dict[int, list[float]] = {count: [] for count in COUNTS}
    # Crowds take turns, so that a slow moment of the machine meets all of them.
    for _ in range(ROUNDS):
        for count, crowd in crowds.items():
            times[count].append(sum(crowd.scan() for _ in range(request.scans)) / request.scans)
    request.advance(request.scans)
    found = {
        count: _cost(min(times[count]), before[count], crowd.tracker.health(), count)
        for count, crowd in crowds.items()
    }
    return Measured(
        (found,),
        scans=request.scans,
        note="Sparse targets that a LiDAR sees in every scan, default configuration. The time per"
        " scan is the shortest of nine runs that take turns. Goal for 10 times the targets: at"
        " most 11 times the time.",
        config={"fusion_many": config},
    )


def _cost(seconds: float, before: TrackerHealth, after: TrackerHealth, count: int) -> Cost:
    looks = count * (after.n_scans - before.n_scans)
    return Cost(
        seconds,
        (after.n_predictions - before.n_predictions) / looks,
        (after.n_pairs - before.n_pairs) / looks,
    )


def _rows(found: Mapping[int, Cost]) -> list[Row]:
    least, most = found[COUNTS[0]], found[COUNTS[-1]]
    ratio = f"time of a scan, {COUNTS[-1]} over {COUNTS[0]} targets"
    rows = [Row(ratio, "1", None, None, most.seconds / least.seconds)]
    for count, cost in found.items():
        rows += [
            Row(f"time of a scan, {count} targets", "s", None, None, cost.seconds),
            Row(
                f"predictions per target and scan, {count} targets",
                "1",
                None,
                None,
                cost.predictions,
            ),
            Row(
                f"pairs compared per target and scan, {count} targets", "1", None, None, cost.pairs
            ),
        ]
    return rows


def _draw(figure: Any, found: Mapping[int, Cost]) -> None:
    """Draw the time per scan over the number of targets."""
    panel = figure.subplots()
    panel.loglog(list(found), [1e3 * cost.seconds for cost in found.values()], "o-", color=BLUE)
    panel.set(xlabel="targets", ylabel="time of a scan [ms]")


ITEM = Item(
    name="tracking-scaling",
    title="LiDAR and radar: time of a scan, by the number of targets",
    scans=10,
    minutes=0.1,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    heading="Time of a scan, by the number of sparse targets",
    counts="scans",
)
