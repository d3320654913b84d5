"""Data of the 3-D view of a report: map, points and objects over time, as small integers."""

from base64 import b64decode, b64encode
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.viz.drawing.frame import box_of_movers
from lidar_core.viz.drawing.thinning import evenly, thinned
from lidar_core.viz.playback import Moment, Playback
from lidar_core.viz.report.seen import first_seen

MOST_MOMENTS = 300
"""Largest number of times of the slider: more are thinned evenly."""
MOST_POINTS = 500_000
"""Largest number of points of all scans together. A point takes 9 characters of the page."""
MOST_VOXELS = 40_000
MOST_PLACES = 3000
"""Largest number of true positions of each target."""
STEPS = 65_000
"""Steps per axis of a stored position, which fits 16 bits: 8 mm in a scene of 500 m."""


def scene_of(
    run: Playback, truth: dict[int, NDArray[np.float64]], *, start_ns: int, has_known_map: bool
) -> dict[str, Any]:
    """Everything that the 3-D view draws, as plain values.

    Parameters
    ----------
    run : Playback
        The run.
    truth : dict of int to ndarray, shape (S, 4)
        Time since `start_ns` [s] and true position [m] of each target.
    start_ns : int
        Time that the slider calls 0 [ns].
    has_known_map : bool
        True if the run began with a map, which is then shown from the start.

    Returns
    -------
    scene : dict
        Times [s], and for each time sensor, objects, outlines and points; for each voxel the index
        of the time from which on it is shown; corners of the boxes around what moves on the
        ground. Positions are in the world frame [m]; those of points and voxels are steps of a
        lattice, in base64.
    """
    moments = list(_picked(run))
    voxels, voxel_size = run.occupied()
    voxels = voxels[evenly(len(voxels), MOST_VOXELS)]
    per_scan = MOST_POINTS // max(1, sum(len(moment.points) > 0 for moment in moments))
    kept = [thinned(moment.points, moment.point_class, per_scan) for moment in moments]
    clouds = [
        (moment.points[rows], moment.point_class[rows])
        for moment, rows in zip(moments, kept, strict=True)
    ]
    measured = [] if has_known_map else [moment.points for moment in moments]
    lattice = _Lattice([voxels, *(points for points, _ in clouds)])
    return {
        "planar": run.capability != "flying",
        "points": run.points_name,
        "times": [round((moment.stamp_ns - start_ns) * 1e-9, 4) for moment in moments],
        "lattice": {"origin": lattice.origin.tolist(), "step": lattice.step},
        "voxels": lattice.packed(voxels),
        "seen": _base64(first_seen(voxels, voxel_size, measured).astype("<u2")),
        "scans": [
            {"points": lattice.packed(points), "classes": _base64(classes)}
            for points, classes in clouds
        ],
        "sensors": [
            None if moment.sensor is None else np.round(moment.sensor, 3).tolist()
            for moment in moments
        ],
        "objects": [_objects(moment) for moment in moments],
        "movers": [
            corner for one in moments for corner in box_of_movers(one.movers).round(3).tolist()
        ],
        "outlines": [
            [
                {"points": np.round(one.points, 3).tolist(), "visible": bool(one.visible)}
                for one in moment.outlines
            ]
            for moment in moments
        ],
        "truth": [
            np.round(way[evenly(len(way), MOST_PLACES)], 3).tolist() for way in truth.values()
        ],
    }


def map_note(scene: Mapping[str, Any]) -> str:
    """Note for the reader about the map of a scene over time; "" if there is no map."""
    if not scene["voxels"]:
        return ""
    if not any(b64decode(scene["seen"])):
        return "The map is that of the end of the run, at all times."
    return (
        "The map is that of the end of the run. Each place of it appears with the first scan that"
        " measured it."
    )


def _picked(run: Playback) -> Iterator[Moment]:
    """Yield moments with a scan, or all if no scans were kept; thinned evenly, with the last."""
    times = run.times()
    yield from run.moments({times[row] for row in evenly(len(times), MOST_MOMENTS).tolist()})


def _objects(moment: Moment) -> list[dict[str, Any]]:
    objects = moment.objects
    return [
        {
            "id": number,
            "position": np.round(objects.position[row], 3).tolist(),
            "velocity": np.round(objects.velocity[row], 3).tolist(),
            "covariance": objects.covariance[row].ravel().tolist(),
            "size": np.round(objects.size[row], 3).tolist(),
        }
        for row, number in enumerate(objects.id.tolist())
    ]


class _Lattice:
    """Lattice with equal steps along all axes, on which 16 bits per axis cover all points."""

    def __init__(self, parts: Sequence[NDArray[Any]]) -> None:
        known = [part.astype(np.float64) for part in parts if len(part)]
        low = np.min([part.min(axis=0) for part in known], axis=0) if known else np.zeros(3)
        high = np.max([part.max(axis=0) for part in known], axis=0) if known else np.ones(3)
        self.origin = np.asarray(low, np.float64)
        self.step = max(float((high - low).max()), 1e-3) / STEPS

    def packed(self, points: NDArray[Any]) -> str:
        """Positions as three unsigned 16-bit numbers each, little endian, in base64."""
        return _base64(np.round((points - self.origin) / self.step).astype("<u2"))


def _base64(values: NDArray[Any]) -> str:
    return b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
