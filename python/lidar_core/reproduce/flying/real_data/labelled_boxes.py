"""Points of the class MOVING against labelled boxes of a real sequence."""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import FormatError
from lidar_core.flying import FlyingFrame
from lidar_core.io import PosedScan
from lidar_core.messages import PointClass, Scan
from lidar_core.reproduce.common import share
from lidar_core.reproduce.flying.real_data.sequences import RealSequence, unpack_files
from lidar_core.reproduce.jobs import Part
from lidar_core.reproduce.recordings import recording

STANDING_SPEED, MOVING_SPEED = 0.3, 1.0
"""Speeds on the way from the first to the last box of an object: it stands below the first one, and
moves above the second one [m/s]. Labels are too coarse to tell what is between."""
FEWEST_SCANS = 5
"""Scans from the first to the last box of an object, below which its speed is not known."""
REACH = 20.0
"""Objects within this distance have to be found: that of the map [m]."""
CLOSE, WIDE = 0.1, np.array([0.5, 0.3, 0.3])
"""Margins of the boxes: for points that are certainly of the object, and for those that may be, as
labels are coarse: along, across, up [m]."""
PEOPLE = ("Pedestrian",)
FEWEST_POINTS = 8
"""Points of a box, below which it does not have to be found."""
COUNTS = ("right", "wrong", "vehicle", "vehicle_moving", "person", "person_moving")


@dataclass(frozen=True, slots=True)
class Box:
    """Labelled box of an object in one scan.

    Attributes
    ----------
    name : tuple of str
        Kind and number of the object; the same in all scans.
    center, size : ndarray, shape (3,)
        In the frame of the scan [m].
    yaw : float
        Angle of its length from the x axis [rad].
    """

    name: tuple[str, str]
    center: NDArray[np.float64]
    size: NDArray[np.float64]
    yaw: float

    @classmethod
    def of(cls, entry: dict[str, Any]) -> "Box":
        """Make a box from an entry of a label file."""
        place, size, turn = (entry["psr"][key] for key in ("position", "scale", "rotation"))
        center, extent = (np.array([part[axis] for axis in "xyz"]) for part in (place, size))
        return cls((entry["obj_type"], entry["obj_id"]), center, extent, float(turn["z"]))

    def holds(
        self, points: NDArray[np.float64], margin: float | NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """Return which points (N, 3) are in the box, enlarged by `margin` on every side [m]."""
        cosine, sine = np.cos(self.yaw), np.sin(self.yaw)
        away = points - self.center
        along = away[:, 0] * cosine + away[:, 1] * sine
        across = away[:, 1] * cosine - away[:, 0] * sine
        inside = np.abs(np.stack([along, across, away[:, 2]], axis=1)) <= self.size / 2 + margin
        return np.asarray(inside.all(axis=1))


def read_boxes(sequence: RealSequence) -> list[list[Box]]:
    """Boxes of every scan of a sequence, in the order of the scans.

    Raises
    ------
    FormatError
        A label file is not what it should be.
    """
    boxes = []
    for path in sorted(unpack_files(recording(sequence.labels or ""), ".json")):
        try:
            boxes.append([Box.of(entry) for entry in json.loads(path.read_text("utf-8"))])
        except (ValueError, KeyError, TypeError) as error:
            raise FormatError(f"{path}: expected a list of labelled boxes: {error!r}") from error
    return boxes


def speeds(
    boxes: list[list[Box]], poses: list[NDArray[np.float64]], seconds: list[float]
) -> dict[tuple[str, str], float]:
    """Speed of every object that was seen for long enough, by its name [m/s]."""
    seen: dict[tuple[str, str], list[tuple[int, NDArray[np.float64]]]] = {}
    for number, (of_scan, pose) in enumerate(zip(boxes, poses, strict=False)):
        for box in of_scan:
            place = pose[:3, :3] @ box.center + pose[:3, 3]
            seen.setdefault(box.name, []).append((number, place))
    found = {}
    for name, places in seen.items():
        (first, start), (last, end) = places[0], places[-1]
        if last - first >= FEWEST_SCANS:
            way = float(np.linalg.norm((end - start)[:2]))
            found[name] = way / (seconds[last] - seconds[first])
    return found


class MovingCounts:
    """Counts of the points of moving objects, scan by scan, while the gate is open.

    right, wrong : MOVING points in and not in boxes of objects that move. Points in boxes of
    unknown speed, or of objects that creep, are neither. vehicle, person : boxes of vehicles with
    their riders, and of people, that move within `REACH`; and the sum of the shares of their points
    that are MOVING, so that one large object does not hide what happens to small ones.
    """

    def __init__(self, boxes: list[list[Box]], speed: dict[tuple[str, str], float]) -> None:
        self._boxes, self._speed = boxes, speed
        self._rows: list[list[float]] = []

    def add(self, number: int, item: PosedScan[Scan], frame: FlyingFrame) -> None:
        """Count the points of scan `number`."""
        if not frame.status.gate_open:
            return
        points = item.scan.points.reshape(-1, 3).astype(np.float64)
        is_moving = frame.point_class == PointClass.MOVING
        of_mover, of_unknown = np.zeros((2, len(points)), np.bool_)
        counts = dict.fromkeys(COUNTS, 0.0)
        for box in self._boxes[number]:
            speed = self._speed.get(box.name)
            if speed is None or STANDING_SPEED <= speed <= MOVING_SPEED:
                of_unknown |= box.holds(points, WIDE)
            elif speed > MOVING_SPEED:
                of_mover |= box.holds(points, WIDE)
                own = box.holds(points, CLOSE)
                if np.hypot(*box.center[:2]) <= REACH and own.sum() >= FEWEST_POINTS:
                    kind = "person" if box.name[0] in PEOPLE else "vehicle"
                    counts[kind] += 1
                    counts[f"{kind}_moving"] += float(is_moving[own].mean())
        counts["right"] = int((is_moving & of_mover).sum())
        counts["wrong"] = int((is_moving & ~of_mover & ~of_unknown).sum())
        self._rows.append([counts[name] for name in COUNTS])

    def columns(self) -> Part:
        """Return the counts of all scans with an open gate, (S, 6) in the order of `COUNTS`."""
        return {"moving": np.array(self._rows, np.float64).reshape(-1, len(COUNTS))}


def moving_scores(part: Part) -> list[tuple[str, str, float | None]]:
    """Return precision and recall of MOVING in a run: name, unit, value; none without labels."""
    if "moving" not in part:
        return []
    total = dict(zip(COUNTS, part["moving"].sum(axis=0).tolist(), strict=True))
    return [
        ("moving, precision", "1", share(total["right"], total["right"] + total["wrong"])),
        ("moving, recall of vehicles", "1", share(total["vehicle_moving"], total["vehicle"])),
        ("moving, recall of people", "1", share(total["person_moving"], total["person"])),
    ]
