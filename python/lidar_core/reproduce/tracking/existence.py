"""`tracking-existence`: how many tracks with probability p of existence do exist."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.fusion import MultiTargetConfig
from lidar_core.reproduce.common import BLUE, GREY, RED
from lidar_core.reproduce.tracking.arena import Arena, are_matched, followed
from lidar_core.reproduce.types import Item, Measured, Request, Row

ARENAS = {
    "clutter 3, measured .9": Arena(3.0, 0.9, lifetime=20.0),
    "clutter 10, measured .7": Arena(10.0, 0.7, lifetime=20.0),
    "clutter 50, measured .7": Arena(50.0, 0.7, lifetime=20.0),
}
TOLD = {"default": 1.0, "half of default": 0.5, "twice default": 2.0}
"""Factors on the configured probability of detection and density of clutter."""
LEAST, MIDDLE = 0.05, (0.1, 0.9)
"""Hypotheses that count, and those that are neither sure nor gone."""
BINS = 10
REACH, DEVIATIONS = 0.5, 3.0
"""A hypothesis is true if it has a target within REACH [m], or within that many of its standard
deviations."""


@dataclass(frozen=True, slots=True)
class Hypotheses:
    """One row per hypothesis and scan.

    Attributes
    ----------
    existence : ndarray, shape (K,)
        Probability of existence.
    is_true : ndarray, shape (K,), bool
    tracks : int
        Different numbers among them.
    """

    existence: NDArray[np.float64]
    is_true: NDArray[np.bool_]
    tracks: int

    @classmethod
    def joined(cls, parts: list["Hypotheses"]) -> "Hypotheses":
        """Join the hypotheses of several runs."""
        return cls(
            np.concatenate([part.existence for part in parts]),
            np.concatenate([part.is_true for part in parts]),
            sum(part.tracks for part in parts),
        )

    @property
    def brier(self) -> float:
        """Brier score divided by the Brier score of a constant forecast of the base rate."""
        rate = self.is_true.mean()
        return float(np.square(self.existence - self.is_true).mean() / (rate * (1 - rate)))

    @property
    def middle(self) -> "Hypotheses":
        """Keep the hypotheses that are neither certain nor excluded."""
        low, high = MIDDLE
        rows = (self.existence >= low) & (self.existence <= high)
        return Hypotheses(self.existence[rows], self.is_true[rows], self.tracks)

    def bins(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Per bin: sum of the probabilities, number of true hypotheses, number of hypotheses."""
        place = np.minimum((self.existence * BINS).astype(np.int64), BINS - 1)
        told, true, count = np.zeros((3, BINS))
        np.add.at(told, place, self.existence)
        np.add.at(true, place, self.is_true)
        np.add.at(count, place, 1.0)
        return told, true, count

    def calibration_error(self) -> float:
        """Return the expected calibration error."""
        told, true, _ = self.bins()
        return float(np.abs(told - true).sum() / max(1, len(self.existence)))


def hypotheses(arena: Arena, config: MultiTargetConfig, rng: np.random.Generator) -> Hypotheses:
    """Collect the hypotheses of one run."""
    existence, is_true, numbers = [np.empty(0)], [np.empty(0, np.bool_)], set()
    for moment, tracks in followed(arena, config, rng):
        rows = tracks.existence >= LEAST
        variance = tracks.covariances[rows][:, [0, 1], [0, 1]].max(axis=1, initial=0.0)
        reach = np.maximum(REACH, DEVIATIONS * np.sqrt(variance))
        existence.append(tracks.existence[rows])
        is_true.append(are_matched(tracks.position[rows], reach, moment.truth))
        numbers |= set(tracks.id[rows].tolist())
    return Hypotheses(np.concatenate(existence), np.concatenate(is_true), len(numbers))


def config_with(factor: float) -> MultiTargetConfig:
    """Default configuration with probability of detection and clutter changed by a factor."""
    default = MultiTargetConfig()
    return MultiTargetConfig(
        detection_probability=min(0.99, factor * default.detection_probability),
        clutter=tuple(factor * density for density in default.clutter),
    )


def _measure(request: Request) -> Measured:
    found = {}
    for name, factor in TOLD.items():
        for number, (place, arena) in enumerate(ARENAS.items()):
            runs = [
                hypotheses(
                    arena,
                    config_with(factor),
                    np.random.default_rng([20260605, request.seed, number, run]),
                )
                for run in range(request.scans)
            ]
            found[name, place] = Hypotheses.joined(runs)
    request.advance(request.scans)
    return Measured(
        (found,),
        scans=request.scans,
        note="All hypotheses with p >= .05 of the tracker of many targets, reported or not, one row"
        " per hypothesis and scan. True: a target of its own within 0.5 m or 3 standard deviations."
        " Goals: calibration error at most .03, .05 between .1 and .9, .10 where detection and"
        " clutter are told wrongly by 2; Brier score at most .5 of that of the base rate.",
        config={"fusion_many": MultiTargetConfig()},
    )


def _rows(found: Mapping[tuple[str, str], Hypotheses]) -> list[Row]:
    rows = []
    for name in TOLD:
        of = {place: found[name, place] for place in ARENAS}
        for place, some in {"all": Hypotheses.joined(list(of.values())), **of}.items():
            rows += [
                Row(f"{name}, {place}: calibration error", "1", best_mode=some.calibration_error()),
                Row(
                    f"{name}, {place}: calibration error .1 to .9",
                    "1",
                    best_mode=some.middle.calibration_error(),
                ),
                Row(f"{name}, {place}: Brier over base rate", "1", best_mode=some.brier),
            ]
            if place == "all":
                counts = {
                    "hypotheses": some.tracks,
                    "rows .1 to .9": len(some.middle.existence),
                }
                rows += [Row(f"{name}: {what}", "1", best_mode=n) for what, n in counts.items()]
    return rows


def _draw(figure: Any, found: Mapping[tuple[str, str], Hypotheses]) -> None:
    """Draw the share of hypotheses that exist over their stated probability."""
    panel = figure.subplots()
    panel.plot([0, 1], [0, 1], color=GREY, linewidth=1)
    for name, style in zip(TOLD, ("o-", "s--", "^:"), strict=True):
        some = Hypotheses.joined([found[name, place] for place in ARENAS])
        sums, true, count = some.bins()
        used = count > 0
        panel.plot(
            sums[used] / count[used],
            true[used] / count[used],
            style,
            color=BLUE if name == "default" else RED,
            label=f"detection, clutter: {name}",
        )
    panel.set(xlabel="probability of existence", ylabel="share that exists")
    panel.legend(fontsize=8)


ITEM = Item(
    name="tracking-existence",
    title="LiDAR and radar: calibration of probabilities of existence in clutter",
    scans=30,
    minutes=0.5,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    heading="How often what exists with probability p does exist",
    counts="runs",
)
