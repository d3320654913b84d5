"""`tracking-takeover`: the number of a hidden target when another appears nearby."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.fusion import Measurement, MultiTargetConfig, MultiTargetTracker, TargetTracks
from lidar_core.reproduce.common import BLUE, RED
from lidar_core.reproduce.tracking.arena import NOISE
from lidar_core.reproduce.types import Item, Measured, Request, Row

RATE = 10
"""Scans per second."""
BEFORE, AFTER = 8.0, 1.0
"""Time for which the first target is seen, and after which the number is looked up [s]."""
HIDDEN = (2.0, 4.0)
"""For how long nobody is seen before another target appears [s]."""
BACK = 2.0
"""After which time the first target comes back [s]."""
SPEED = 1.5
"""Of targets that move [m/s]."""
OFF = 4.0
"""Least distance of another target from a moving one, in predicted standard deviations."""
BYSTANDERS = 8
"""Other targets within 20 m, which show the tracker how rare false measurements are."""
NEAR = 0.45
"""Largest distance of a track from the target whose number it carries [m]."""
STOOD = {"1 m": (1.0, 1.0), "1 to 3 m": (1.0, 3.0)}
"""Distances of another target from one that stood."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Fate of the target that was shown last.

    `has_number`: its track has the number in question. `is_found`: it has a track at all.
    """

    has_number: bool
    is_found: bool


@dataclass
class Scene:
    """A target and bystanders, and the tracker that follows them."""

    rng: np.random.Generator
    speed: float
    bystanders: int

    def __post_init__(self) -> None:
        heading = self.rng.uniform(-np.pi, np.pi)
        self.velocity = self.speed * np.array([np.cos(heading), np.sin(heading)])
        angle = self.rng.uniform(-np.pi, np.pi, self.bystanders)
        ring = self.rng.uniform(10.0, 20.0, self.bystanders)
        self.others = (ring * [np.cos(angle), np.sin(angle)]).T + self.velocity * BEFORE / 2
        self.tracker = MultiTargetTracker(MultiTargetConfig())
        self.step = 0

    def tracks(self) -> TargetTracks:
        """All reported tracks after the last scan."""
        return self.tracker.tracks_at((self.step - 1) * 1_000_000_000 // RATE)

    def place(self) -> NDArray[np.float64]:
        """Return the expected place of the target at the next scan [m]."""
        return self.velocity * self.step / RATE

    def scan(self, *seen: NDArray[np.float64]) -> None:
        """Track one more scan with measurements at `seen` [m] and of the bystanders."""
        places = np.array([*seen, *self.others]).reshape(-1, 2)
        stamp = self.step * 1_000_000_000 // RATE
        places = places + self.rng.normal(0.0, NOISE, places.shape)
        scan = [Measurement(stamp, "lidar", place) for place in places]
        self.tracker.process(stamp, scan, source="lidar")
        self.step += 1

    def followed(self) -> int | None:
        """Show the target for a while; return its track number, None if it has none."""
        for _ in range(round(BEFORE * RATE)):
            place = self.place()
            self.scan(place)
        return number_at(self.tracks(), place)

    def hide(self, seconds: float) -> None:
        """Track scans in which only the bystanders are measured, for `seconds` [s]."""
        for _ in range(round(seconds * RATE)):
            self.scan()

    def ended(self, number: int, start: NDArray[np.float64]) -> Outcome:
        """Show a target that starts at `start` and moves like the first; return its fate."""
        for k in range(round(AFTER * RATE)):
            place = start + self.velocity * k / RATE
            self.scan(place)
        found = number_at(self.tracks(), place)
        return Outcome(found == number, found is not None)

    def far_off(self, number: int, hidden: float) -> NDArray[np.float64]:
        """Position `OFF` predicted standard deviations from the hidden target, at least 1 m off."""
        tracks = self.tracker.tracks_at(self.step * 1_000_000_000 // RATE, confirmed=False)
        (rows,) = np.nonzero(tracks.id == number)
        if len(rows):
            covariance = tracks.covariances[rows[0], :2, :2]
        else:  # forgotten: as uncertain as its acceleration makes it
            covariance = np.eye(2) * hidden**3 / 3
        angle = self.rng.uniform(-np.pi, np.pi)
        away = np.linalg.cholesky(covariance) @ [np.cos(angle), np.sin(angle)]
        return self.place() + max(OFF, 1.0 / float(np.linalg.norm(away))) * away


def number_at(tracks: TargetTracks, place: NDArray[np.float64]) -> int | None:
    """Return the number of the nearest track, if one is near the place."""
    away = np.linalg.norm(tracks.position - place, axis=1)
    return int(tracks.id[away.argmin()]) if away.min(initial=np.inf) < NEAR else None


def outcomes(rng: np.random.Generator, bystanders: int) -> Iterator[tuple[str, Outcome]]:
    """Yield one case of each kind; none where the first target has no number."""
    for name, (least, most) in STOOD.items():
        scene = Scene(rng, 0.0, bystanders)
        number, hidden = scene.followed(), rng.uniform(*HIDDEN)
        scene.hide(hidden)
        angle, away = rng.uniform(-np.pi, np.pi), rng.uniform(least, most)
        if number is not None:
            start = away * np.array([np.cos(angle), np.sin(angle)])
            yield f"stood, another {name} away", scene.ended(number, start)
    for name, speed in {"stands": 0.0, "moves": SPEED}.items():
        scene = Scene(rng, speed, bystanders)
        if (number := scene.followed()) is not None:
            scene.hide(BACK)
            yield f"{name}, comes back", scene.ended(number, scene.place())
    scene = Scene(rng, SPEED, bystanders)
    number, hidden = scene.followed(), rng.uniform(*HIDDEN)
    scene.hide(hidden)
    if number is not None:
        yield "moved, another 4 sd off", scene.ended(number, scene.far_off(number, hidden))


def _measure(request: Request) -> Measured:
    found: dict[str, list[Outcome]] = {}
    for place, bystanders in {"alone": 0, f"beside {BYSTANDERS} others": BYSTANDERS}.items():
        for run in range(request.scans):
            rng = np.random.default_rng([20260607, request.seed, bystanders, run])
            for name, outcome in outcomes(rng, bystanders):
                found.setdefault(f"{name}, {place}", []).append(outcome)
    request.advance(request.scans)
    return Measured(
        (found,),
        scans=request.scans,
        note="A target is seen for 8 s, ten times a second, and hidden. Another one appears after 2"
        " to 4 s, or it comes back itself after 2 s; a second later the number of the nearest track"
        " is looked up. Goals: number taken over in at most .05 of the cases, own number kept in at"
        " least .95.",
        config={"fusion_many": MultiTargetConfig()},
    )


def is_kept(name: str) -> bool:
    """Return whether `name` is a case in which the target itself comes back."""
    return "comes back" in name


def _rows(found: Mapping[str, list[Outcome]]) -> list[Row]:
    rows = []
    for name, some in found.items():
        of = "own number kept, goal >= .95" if is_kept(name) else "number taken over, goal <= .05"
        share = float(np.mean([outcome.has_number for outcome in some]))
        tracked = float(np.mean([outcome.is_found for outcome in some]))
        rows += [
            Row(f"{name}: {of}", "1", best_mode=share),
            Row(f"{name}: tracked after 1 s", "1", best_mode=tracked),
        ]
    return rows


def _draw(figure: Any, found: Mapping[str, list[Outcome]]) -> None:
    """Draw the share of targets that get the old number."""
    panel = figure.subplots()
    shares = [np.mean([outcome.has_number for outcome in some]) for some in found.values()]
    colours = [BLUE if is_kept(name) else RED for name in found]
    panel.barh(np.arange(len(found)), shares, color=colours)
    panel.set_yticks(np.arange(len(found)), list(found), fontsize=7)
    panel.invert_yaxis()
    panel.set(xlabel="share that carries the old number (red: should not)")


ITEM = Item(
    name="tracking-takeover",
    title="LiDAR and radar: numbers of hidden targets",
    scans=100,
    minutes=0.5,
    measure=_measure,
    rows=_rows,
    draw=_draw,
    grid="x",
    heading="Whose is the number of a hidden target",
    counts="cases",
)
