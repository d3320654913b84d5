"""Detection of two bodies under one name: their poses alternate between two places.

Transforms with the same names are one motion to every reader. If two sources use the names, or if
they are the poses of two bodies without a name, the motion leaps to and fro.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from lidar_core.io.poses.pose_topics import is_odometry
from lidar_core.io.records import Topic
from lidar_core.io.scan_topics import NAMELESS
from lidar_core.messages import Pose

LEAST_LEAP = 0.1
"""Shorter steps are noise, or motion [m]."""
AROUND = 2
"""Poses after a leap among which one is near its start, or before it, near its end."""
BACK_SHARE, ON_SHARE = 1 / 3, 1.2
"""How near it is, as a share of the leap: the body may have moved meanwhile. Beyond the larger
share the step was a part of the motion, and no leap."""
LEAST_RETURNS, LEAST_LEAPS, LEAST_SHARE = 0.8, 6, 0.05
"""Share of the leaps that come back; leaps, and their share of all steps."""
MOST_POSES = 10_000
"""Poses of a transform that are compared with each other."""
LONGER = 3.0
"""How many times longer than the other steps leaps are: a body that turns back also comes back."""


def leaps(stamps_ns: NDArray[np.int64], positions: NDArray[np.float64]) -> tuple[int, float]:
    """Return the leaps to and fro of positions, 0 if they are those of one body; and their length.

    A body that moves fast does not come back, and noise seldom does so in every step.

    Parameters
    ----------
    stamps_ns : (K,) array of int64
        Times [ns], in any order.
    positions : (K, 3) array of float64
        Positions at these times [m].

    Returns
    -------
    count : int
        Leaps; 0 if too few of the steps are leaps, or too few of them come back.
    length : float
        Median length of the leaps [m].
    """
    order = np.argsort(stamps_ns, kind="stable")
    times, known = stamps_ns[order], positions[order]
    steps = np.linalg.norm(np.diff(known, axis=0), axis=1)
    # A body is at one place at a time, however fast it is.
    is_double = (np.diff(times) == 0) & (steps > LEAST_LEAP)
    if _is_enough(is_double, steps):
        return int(is_double.sum()), float(np.median(steps[is_double]))
    if len(known) < 2 * AROUND + 2:
        return 0, 0.0
    inner = slice(AROUND, len(steps) - AROUND)
    nearest = np.minimum(
        _nearest(known, inner, 0, range(2, AROUND + 2)),
        _nearest(known, inner, 1, range(-AROUND, 0)),
    )
    steps = steps[inner]
    is_leap = (steps > LEAST_LEAP) & (nearest < ON_SHARE * steps)
    returns = is_leap & (nearest <= BACK_SHARE * steps)
    if not _is_enough(is_leap, steps) or returns.sum() < LEAST_RETURNS * is_leap.sum():
        return 0, 0.0
    length = float(np.median(steps[is_leap]))
    others = steps[~is_leap]
    if len(others) and length < LONGER * float(np.median(others)):
        return 0, 0.0
    return int(is_leap.sum()), length


def _is_enough(found: NDArray[np.bool_], steps: NDArray[np.float64]) -> bool:
    """Return whether so many steps are no single mistakes."""
    return bool(found.sum() >= max(LEAST_LEAPS, LEAST_SHARE * len(steps)))


def _nearest(
    known: NDArray[np.float64], inner: slice, end: int, others: range
) -> NDArray[np.float64]:
    """Distance from one end of every inner step to the nearest of other poses around it [m]."""
    here = known[inner.start + end : inner.stop + end]
    away = [
        np.linalg.norm(known[inner.start + other : inner.stop + other] - here, axis=1)
        for other in others
    ]
    return np.asarray(np.min(away, axis=0))


def leap_notes(poses: Iterable[tuple[str, Pose]]) -> list[str]:
    """Texts about transforms that leap between two places, from poses with their topics."""
    stamps: defaultdict[tuple[str, str], list[int]] = defaultdict(list)
    places: defaultdict[tuple[str, str], list[NDArray[np.float64]]] = defaultdict(list)
    topics: defaultdict[tuple[str, str], dict[str, None]] = defaultdict(dict)
    for topic, pose in poses:
        if not pose.is_static:
            edge = pose.frame_id, pose.child_frame_id
            stamps[edge].append(pose.stamp_ns)
            places[edge].append(pose.matrix[:3, 3])
            topics[edge][topic] = None
    found = []
    for edge, times in stamps.items():
        count, length = leaps(np.array(times, np.int64), np.array(places[edge]))
        if count:
            found.append(_text(edge, list(topics[edge]), count, length))
    return found


class MovingTransforms:
    """Transforms that are not static: some are of two bodies, or of one without a name.

    Only the first `MOST_POSES` of a transform are kept: recordings of hours have millions.
    """

    def __init__(self) -> None:
        self._named: list[tuple[str, Pose]] = []
        self._nameless: dict[str, list[tuple[str, Pose]]] = {}
        self._counts: Counter[tuple[str, str, str]] = Counter()

    def add(self, topic: Topic, poses: Iterable[Pose]) -> None:
        """Take the poses of a message; those of odometry are of one body."""
        if is_odometry(topic):
            return
        for pose in poses:
            if pose.is_static:
                continue
            edge = topic.name, pose.frame_id, pose.child_frame_id
            self._counts[edge] += 1
            if self._counts[edge] <= MOST_POSES:
                named = pose.child_frame_id != ""
                kept = self._named if named else self._nameless.setdefault(topic.name, [])
                kept.append((topic.name, pose))

    def notes(self) -> list[str]:
        """Return texts about what was found."""
        without: Counter[str] = Counter()
        for (topic, _, child), count in self._counts.items():
            if not child:
                without[topic] += count
        return [
            *leap_notes(self._named),
            *(text for poses in self._nameless.values() for text in leap_notes(poses)),
            *(
                f"{topic or NAMELESS}: {count} transforms without a child frame: what moves there"
                " is not stated"
                for topic, count in without.items()
            ),
        ]


def _text(edge: tuple[str, str], topics: list[str], count: int, length: float) -> str:
    parent, child = edge
    what = f"transform {parent} -> {child}" if child else f"poses in {parent} without a child frame"
    return (
        f"{', '.join(topics)}: {what}: leaps {count} times to another place and back, by"
        f" {length:.2g} m: these are the poses of two bodies; a scan that uses them gets a wrong"
        " pose"
    )
