"""Detection of poses in a wrong frame: only correct poses align the scans with each other.

Poses of a camera or of another body have the right motion about the wrong axes. So pairs of scans
are aligned by the given motion, and by the same motion about the axes of the 24 right-angled
rotations of a frame, as given and inverted. Poses of a file in which the order of the quaternion
is a convention are also read in the order w x y z. The given poses are blamed only if another
reading fits clearly better.
"""

from collections.abc import Iterator
from enum import Enum
from itertools import permutations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_core.io.poses.cells import cell_keys, surrounding_keys
from lidar_core.io.rotations import matrix_from_quaternion, quaternion_from_matrix

MOST_SCANS, MOST_PAIRS = 40, 8
"""Scans that are looked at, and pairs of them."""
POINTS = 4000
"""Of a scan, at most."""
LEAST_POINTS = 200
"""Scans with fewer points away from the sensor may fit by chance."""
TURN_REACH = 10.0
"""Distance at which a turn counts as a motion [m]."""
LEAST_MOTION, GOOD_MOTION = 0.3, 1.5
"""Of a pair, to be looked at, and above which no later scan is waited for [m]."""
CELL_SHARE, CELL_LIMITS = 0.25, (0.06, 0.5)
"""Edge of the cells in which points must meet: this share of the motion, within limits [m]."""
LEAST_PAIRS, LEAST_GAIN, LEAST_WINS = 3, 0.1, 0.8
"""Pairs; share of the points that fit only otherwise; share of pairs that say so."""
TIED = 0.03
"""Shares nearer than this are the same, and the more usual frame is named."""
NEAREST = 2.5
"""Points nearer than this are often of the carrier itself, which fits without any motion [m]."""


class Reading(Enum):
    """Possible meanings of the numbers of a pose."""

    GIVEN = "given"
    INVERTED = "inverted"
    W_FIRST = "w first"


class FrameMismatch(NamedTuple):
    """Best explanation: frame, rotation `frame_from_lidar` (3, 3), shares of aligned points.

    `other` is a frame that explains the scans as well as another order of the quaternion does.
    """

    name: str
    turn: NDArray[np.float64]
    reading: Reading
    given: float
    found: float
    other: "FrameMismatch | None" = None

    @property
    def is_inverse(self) -> bool:
        """True if the poses are those of the world in the sensor's frame."""
        return self.reading is Reading.INVERTED


def _turn(*axes: str) -> NDArray[np.float64]:
    """Rotation whose rows are the axes of the LiDAR, such as "-y"."""
    rows = [(-1 if axis[0] == "-" else 1) * np.eye(3)["xyz".index(axis[-1])] for axis in axes]
    return np.array(rows)


USUAL = (
    ("the LiDAR's own (x forward, y left, z up)", _turn("x", "y", "z")),
    ("a camera's (x right, y down, z forward)", _turn("-y", "-z", "x")),
    ("a body's with z down (x forward, y right, z down)", _turn("x", "-y", "-z")),
    ("a body's with y forward (x right, y forward, z up)", _turn("-y", "x", "z")),
    ("one turned half round (x back, y right, z up)", _turn("-x", "-y", "z")),
    ("one turned to the right (x left, y back, z up)", _turn("y", "-x", "z")),
    ("a graphics camera's (x right, y up, z back)", _turn("-y", "z", "-x")),
)
"""Frames that poses are given in, by their axes in the LiDAR's where its x is forward."""
OFTEN_INVERTED = 2
"""Inverted poses of so many of them are more usual than the others."""


class _Candidate(NamedTuple):
    name: str
    turn: NDArray[np.float64]
    reading: Reading


def _candidates(*, has_quaternions: bool) -> list[_Candidate]:
    """Explanations to try, usual ones first; the first one is that the poses are right."""
    known = list(USUAL)
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        turn = np.diag(signs) @ np.eye(3)[list(order)]
        if np.linalg.det(turn) > 0 and not any(np.array_equal(turn, one) for _, one in known):
            known.append((f"one whose axes are {_axes(turn)} of the LiDAR's", turn))
    often, others = known[:OFTEN_INVERTED], known[OFTEN_INVERTED:]
    parts = [(often, Reading.GIVEN), (often, Reading.INVERTED)]
    parts += [(others, Reading.GIVEN), (others, Reading.INVERTED)]
    if has_quaternions:  # a mistake as usual as a frame, and one that needs no odd frame
        parts[:1] = [
            (known[:1], Reading.GIVEN),
            (known[:1], Reading.W_FIRST),
            (often[1:], Reading.GIVEN),
        ]
        parts.insert(4, (known[1 : len(USUAL)], Reading.W_FIRST))
    return [_Candidate(*frame, reading) for frames, reading in parts for frame in frames]


def _axes(turn: NDArray[np.float64]) -> str:
    return ", ".join(
        ("" if row.sum() > 0 else "-") + "xyz"[int(np.abs(row).argmax())] for row in turn
    )


class _View(NamedTuple):
    pose: NDArray[np.float64]
    points: NDArray[np.float64]
    w_first: NDArray[np.float64]


def _w_first(
    world_from_lidar: NDArray[np.float64], carrier_from_lidar: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the pose that results if the carrier's quaternion is read in the order w x y z.

    This equals reading the file in that order: the sign of the quaternion has no effect, and
    interpolation between two quaternions commutes with the exchange of their parts.
    """
    pose = world_from_lidar @ np.linalg.inv(carrier_from_lidar)
    quaternion = np.roll(quaternion_from_matrix(pose[:3, :3]), -1)
    pose[:3, :3] = matrix_from_quaternion(quaternion)
    return np.asarray(pose @ carrier_from_lidar)


class PoseFrameCheck:
    """Check of the first scans and their poses; reports once whether another frame fits better.

    Parameters
    ----------
    carrier_from_lidar : (4, 4) array of float64, optional
        Mounting of the LiDAR on the body whose quaternions a file gives in an order that is a
        convention: then the order w x y z is tried too. By default it is not.

    Attributes
    ----------
    is_done : bool
        True after the decision: further scans change nothing.
    """

    def __init__(self, carrier_from_lidar: NDArray[np.float64] | None = None) -> None:
        self._carrier_from_lidar = carrier_from_lidar
        self._views: list[_View] = []
        self.is_done = False

    def add(self, points: NDArray[np.float32], pose: NDArray[np.float64]) -> FrameMismatch | None:
        """Add one scan; return a mismatch if the poses are in another frame."""
        if self.is_done:
            return None
        rows = np.asarray(points, np.float64).reshape(-1, 3)
        far = np.linalg.norm(rows, axis=1) > NEAREST
        rows = rows[far & np.isfinite(rows).all(axis=1)]
        # Every so many-th of a shuffled order: rows of an organised cloud would leave out whole
        # rings.
        order = np.random.default_rng(0).permutation(len(rows))
        mounted = self._carrier_from_lidar
        w_first = pose if mounted is None else _w_first(pose, mounted)
        view = _View(pose, np.asarray(rows[order[:POINTS]]), w_first)
        if len(view.points) >= LEAST_POINTS:
            self._views.append(view)
        if len(self._views) < MOST_SCANS:
            return None
        return self.decide()

    def decide(self) -> FrameMismatch | None:
        """Return the mismatch if the scans show that the poses are in another frame, else None."""
        if self.is_done:
            return None
        self.is_done = True
        pairs = list(_pairs(self._views))
        self._views.clear()
        if len(pairs) < LEAST_PAIRS:
            return None
        candidates = _candidates(has_quaternions=self._carrier_from_lidar is not None)
        shares = np.array([_shares(first, second, candidates) for first, second in pairs])
        total = shares.mean(axis=0)
        fits = [int(one) for one in np.flatnonzero(total >= total.max() - TIED)]
        gains = shares[:, fits[0]] - shares[:, 0]
        if gains.mean() < LEAST_GAIN or (gains > 0).mean() < LEAST_WINS:
            return None
        found = [FrameMismatch(*candidates[at], float(total[0]), float(total[at])) for at in fits]
        first = found[0]
        if first.reading is not Reading.W_FIRST:
            return first
        frames = (one for one in found if one.reading is not Reading.W_FIRST)
        return first._replace(other=next(frames, None))


def _pairs(views: list[_View]) -> Iterator[tuple[_View, _View]]:
    """Yield pairs of scans with enough motion between them to compare frames, and overlap."""
    at = 0
    for _ in range(MOST_PAIRS):
        later = [(_motion(views[at], view), view) for view in views[at + 1 :]]
        good = next((number for number, (size, _) in enumerate(later) if size >= GOOD_MOTION), None)
        if good is None:
            if later and later[-1][0] >= LEAST_MOTION:
                yield views[at], later[-1][1]
            at += 1
        else:
            yield views[at], later[good][1]
            at += max(1, (good + 1) // 2)
        if at >= len(views) - 1:
            return


def _motion(first: _View, second: _View) -> float:
    """Size of the motion between two scans, with the rotation as a length [m]."""
    relative = np.linalg.inv(first.pose) @ second.pose
    angle = np.arccos(np.clip((np.trace(relative[:3, :3]) - 1) / 2, -1, 1))
    return float(np.linalg.norm(relative[:3, 3]) + TURN_REACH * angle)


def _shares(first: _View, second: _View, candidates: list[_Candidate]) -> list[float]:
    """Share of the second scan's points that lie on the first, for every explanation."""
    edge = float(np.clip(CELL_SHARE * _motion(first, second), *CELL_LIMITS))
    known = surrounding_keys(first.points, edge)
    given = {
        Reading.GIVEN: np.linalg.inv(first.pose) @ second.pose,
        Reading.INVERTED: first.pose @ np.linalg.inv(second.pose),
        Reading.W_FIRST: np.linalg.inv(first.w_first) @ second.w_first,
    }
    found = []
    for _, turn, reading in candidates:
        motion = given[reading]
        rotation, translation = turn.T @ motion[:3, :3] @ turn, turn.T @ motion[:3, 3]
        keys = cell_keys(second.points @ rotation.T + translation, edge)
        at = np.minimum(np.searchsorted(known, keys), len(known) - 1)
        found.append(float((known[at] == keys).mean()) if len(keys) and len(known) else 0.0)
    return found


def advice(mismatch: FrameMismatch, *, frame: str, source: str) -> str:
    """Describe the mismatch in words, with a remedy."""
    fits = (
        f"{mismatch.found:.0%} of the points of one scan then fit another scan, with the given"
        f" poses {mismatch.given:.0%}"
    )
    text = f"poses ({source}) seem to be {_named(mismatch)}; {fits}. Cure: {_cure(mismatch, frame)}"
    if mismatch.other is None:
        return text
    return (
        f"{text}. Or the order is right, and they are {_named(mismatch.other)}, which explains"
        f" {mismatch.other.found:.0%}; then the cure is: {_cure(mismatch.other, frame)}"
    )


def _named(mismatch: FrameMismatch) -> str:
    meaning = {
        Reading.GIVEN: "",
        Reading.INVERTED: "inverted, of the world in the sensor's frame",
        Reading.W_FIRST: "written with quaternions in the order w x y z, not x y z w",
    }[mismatch.reading]
    is_own = np.array_equal(mismatch.turn, np.eye(3))
    named = "" if is_own else f"in another frame than the scans: {mismatch.name}"
    return ", and ".join(text for text in (meaning, named) if text)


def _cure(mismatch: FrameMismatch, frame: str) -> str:
    mounting = f'mounting="carrier {frame or "lidar"} 0 0 0 {_angles(mismatch.turn)}"'
    steps = {
        Reading.GIVEN: [],
        Reading.INVERTED: ["give the inverse of every matrix"],
        Reading.W_FIRST: [
            "in every line of the file move column 5, which holds qw, to the end, so that the"
            " columns are t x y z qx qy qz qw"
        ],
    }[mismatch.reading]
    if not np.array_equal(mismatch.turn, np.eye(3)):
        steps.append(
            f"state the mounting of the LiDAR on the body of the poses: {mounting}, with"
            " its position in metres instead of 0 0 0"
        )
    return "; and ".join(steps)


def _angles(turn: NDArray[np.float64]) -> str:
    """Roll, pitch and yaw of a rotation as text."""
    pitch = np.arcsin(np.clip(-turn[2, 0], -1, 1))
    if abs(turn[2, 0]) > 1 - 1e-9:  # roll and yaw turn about one axis: all of it is yaw
        roll, yaw = 0.0, np.arctan2(-turn[0, 1], turn[1, 1])
    else:
        roll, yaw = np.arctan2(turn[2, 1], turn[2, 2]), np.arctan2(turn[1, 0], turn[0, 0])
    return " ".join(f"{float(value) + 0.0:.4f}" for value in (roll, pitch, yaw))
