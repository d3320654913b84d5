"""Runs of the circle pipeline on simulated 2D scans: stored results and scores."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core import circles, sim
from lidar_core.circles import CircleFrame, CirclePipeline, CirclesConfig
from lidar_core.evaluation.matching.assignment import assign
from lidar_core.reproduce.circles.errors import PAPER_NETWORK, checksums
from lidar_core.reproduce.jobs import Part
from lidar_core.reproduce.types import Row
from lidar_core.sim import Scene, SimulatedSweep

Mode: TypeAlias = Literal["paper", "best"]
MODES: tuple[Mode, Mode] = ("paper", "best")
Measure: TypeAlias = tuple[str, str, float | None]
"""Name, unit and value."""

GATE = 0.5
"""Elements further from every object are ghosts [m]."""
SETTLED = 2.0
"""Largest errors count from this time after the first report on [s]."""
GHOST_TIME = 0.5
"""Ghosts that last longer are counted [s]."""
CONFIRM_TIME = 0.5
"""Time to report an object that is visible [s]."""
LEAST_HITS, LEAST_SHARE = 5, 0.25
"""An object is visible with so many rays on it, and so much of what would meet it."""


def network_of(mode: Mode) -> str:
    """SHA-256 of the network that estimates circles in this mode; empty if the mode uses a fit."""
    return checksums()[PAPER_NETWORK] if mode == "paper" else ""


def both_modes() -> dict[str, circles.CirclesConfig]:
    """Return the paper's configuration, with its network, and the best one."""
    return {
        "paper": circles.CirclesConfig.paper(detector=PAPER_NETWORK),
        "best": circles.CirclesConfig(),
    }


def config_of(scene: Scene, network: str) -> CirclesConfig:
    """Return the configuration for the scanner of a scene: best mode, or the paper's.

    It is the paper's if `network`, the checksum of a network, is not empty.
    """
    lidar = scene.lidar
    if not isinstance(lidar.pattern, sim.Planar):
        raise TypeError(f"expected a planar scene, got {lidar.pattern.kind}")
    scanner = circles.Scanner(
        angle_min=lidar.pattern.angle_min,
        angle_increment=lidar.pattern.angle_increment,
        n_beams=lidar.pattern.beams,
        range_min=lidar.range_min,
        range_max=lidar.range_max,
    )
    if network:
        return circles.CirclesConfig.paper(scanner=scanner)
    return circles.CirclesConfig(scanner=scanner)


def mapped(scene: Scene, config: CirclesConfig, *, seed: int, scans: int) -> Part:
    """Give the first `scans` scans of a scene to a pipeline; return the columns of `MapRun`."""
    simulator = sim.Simulator(scene, seed=seed, scans=scans)
    pipeline = circles.CirclePipeline(config)
    truth, elements = [], []
    for number in range(scans):
        made = simulator.sweep(number)
        truth.append(made.truth)
        elements.append(processed(pipeline, made).map)
    count = np.array([len(one) for one in elements])
    return {
        "stamp_ns": scene.start_ns + np.arange(scans) * scene.lidar.period_ns,
        "kind": np.array(truth[0].kind, np.str_),
        "radius": truth[0].radius,
        "center": np.array([one.center for one in truth]),
        "hits": np.array([one.hits for one in truth]),
        "rays": np.array([one.rays for one in truth]),
        "element_scan": np.repeat(np.arange(scans), count),
        "element_id": np.concatenate([one.id for one in elements]),
        "element_center": np.concatenate([one.center for one in elements]),
        "element_radius": np.concatenate([one.radius for one in elements]),
        "element_visible": np.concatenate([one.visible for one in elements]),
    }


def processed(pipeline: CirclePipeline, made: SimulatedSweep) -> CircleFrame:
    """Process one scan with all its data in a pipeline."""
    scan = made.scan
    return pipeline.process(
        scan.ranges,
        made.poses,
        scan.stamp_ns,
        ray_time_ns=scan.stamp_ns + scan.time_increment_ns * np.arange(len(scan.ranges)),
        pose_stamps_ns=made.pose_stamps_ns,
    )


@dataclass(frozen=True, slots=True)
class MapRun:
    """Truth and map of a run, paired scan by scan.

    Attributes
    ----------
    seconds : ndarray, shape (S,), float64
        Times of the scans after the first [s].
    part : dict
        Arrays of the truth, `center` (S, T, 2), `radius` (T,), `hits` and `rays` (S, T), and of
        the map, `element_*`, one row per element and scan.
    row : ndarray, shape (S, T), int64
        Row of the element that every object was paired with, at most `GATE` away; -1 for none.
    """

    seconds: NDArray[np.float64]
    part: Part
    row: NDArray[np.int64]

    @classmethod
    def of(cls, part: Part) -> "MapRun":
        """Pair the results of `mapped`: as many pairs as possible, then the nearest."""
        row = np.full(part["hits"].shape, -1, np.int64)
        starts = np.searchsorted(part["element_scan"], np.arange(len(row) + 1))
        for scan, (first, last) in enumerate(pairwise(starts)):
            way = part["element_center"][first:last, None] - part["center"][scan][None]
            found, target = assign(np.linalg.norm(way, axis=-1), gate=GATE)
            row[scan, target] = first + found
        return cls((part["stamp_ns"] - part["stamp_ns"][0]) * 1e-9, part, row)

    @property
    def period(self) -> float:
        """Time from scan to scan [s]."""
        return float(self.seconds[1]) if len(self.seconds) > 1 else 0.0

    @property
    def is_visible(self) -> NDArray[np.bool_]:
        """Return which objects have enough rays on them, (S, T)."""
        hits, rays = self.part["hits"], self.part["rays"]
        return np.asarray((hits >= LEAST_HITS) & (hits >= LEAST_SHARE * rays), np.bool_)

    def ids(self, target: int) -> NDArray[np.int64]:
        """ID of the element that an object was paired with in every scan; -1 for none."""
        row = self.row[:, target]
        numbers = np.append(self.part["element_id"], -1)
        return np.asarray(numbers[row], np.int64)

    def errors(self, target: int) -> NDArray[np.float64]:
        """Errors of x, y [m] and the radius [m] in every scan, (S, 3); NaN where it has none."""
        row = self.row[:, target]
        rows = np.column_stack([self.part["element_center"], self.part["element_radius"]])
        rows = np.vstack([rows, np.full((1, 3), np.nan)])
        radius = np.full(len(row), self.part["radius"][target])
        errors: NDArray[np.float64] = rows[row] - np.column_stack(
            [self.part["center"][:, target], radius]
        )
        return errors

    def spells(self, target: int) -> Iterator[tuple[int, int]]:
        """Yield the first scan and the end of every period in which an object is visible.

        The end is the last scan + 1. Short gaps do not interrupt a period.
        """
        seen = np.flatnonzero(self.is_visible[:, target])
        if not len(seen):
            return
        breaks = np.flatnonzero(np.diff(seen) * self.period > CONFIRM_TIME)
        for first, last in zip(
            seen[np.append(0, breaks + 1)], seen[np.append(breaks, -1)], strict=True
        ):
            yield int(first), int(last) + 1

    def delays(self) -> NDArray[np.float64]:
        """Time from becoming visible to the report [s], for every long enough period of `spells`.

        Infinite for a period without a report.
        """
        found = []
        for target in range(self.row.shape[1]):
            for first, last in self.spells(target):
                if (last - first) * self.period > CONFIRM_TIME:
                    reported = np.flatnonzero(self.row[first:last, target] >= 0)
                    found.append(reported[0] * self.period if len(reported) else np.inf)
        return np.array(found, np.float64)

    def presence(self) -> tuple[int, int]:
        """Count visible object scans with a report, and all; time for confirmation is left out."""
        due = np.zeros(self.row.shape, np.bool_)
        for target in range(self.row.shape[1]):
            for first, last in self.spells(target):
                due[first + round(CONFIRM_TIME / max(self.period, 1e-9)) : last, target] = True
        due &= self.is_visible
        return int((due & (self.row >= 0)).sum()), int(due.sum())

    def switches(self) -> int:
        """Number of changes of identity over all objects."""
        changes = 0
        for target in range(self.row.shape[1]):
            numbers = self.ids(target)
            changes += int(np.count_nonzero(np.diff(numbers[numbers >= 0])))
        return changes

    def ghosts(self, *, hidden: bool = False) -> NDArray[np.float64]:
        """Return how long every element without an object stayed without interruption [s].

        Only the time in which the map considers it in sight counts. With `hidden` all time counts,
        also while no ray passes its place and the object may have turned elsewhere.
        """
        unpaired = hidden | self.part["element_visible"]
        unpaired[self.row[self.row >= 0]] = False
        scan, number = (self.part[f"element_{name}"][unpaired] for name in ("scan", "id"))
        order = np.lexsort((scan, number))
        scan, number = scan[order], number[order]
        is_new = np.append(True, (np.diff(scan) > 1) | (np.diff(number) != 0))[: len(scan)]
        lengths = np.diff(np.append(np.flatnonzero(is_new), len(scan)))
        return np.asarray(lengths * self.period, np.float64)


def lasting(ghosts: NDArray[np.float64]) -> int:
    """Count the false elements that last longer than `GHOST_TIME`."""
    return int(np.count_nonzero(ghosts > GHOST_TIME + 1e-6))


def both(paper_mode: Sequence[Measure], best_mode: Sequence[Measure]) -> tuple[Row, ...]:
    """Rows of the same measures in both modes."""
    return tuple(
        Row(name, unit, None, paper, best)
        for (name, unit, paper), (_, _, best) in zip(paper_mode, best_mode, strict=True)
    )
