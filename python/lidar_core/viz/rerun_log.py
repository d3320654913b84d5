"""A run for the rerun viewer: as a file, and shown in a window."""

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.extras import require
from lidar_core.io.files.atomic import check_place, written_whole
from lidar_core.messages import ShownClass
from lidar_core.objects import Objects
from lidar_core.viz.drawing.frame import box_of_movers
from lidar_core.viz.playback import Moment, Playback
from lidar_core.viz.rerun_process import PURPOSE, free_port, rerun_process

_COLOURS = {
    ShownClass.INVALID: (140, 150, 160),
    ShownClass.BACKGROUND: (140, 150, 160),
    ShownClass.FLYING: (225, 60, 40),
    ShownClass.UNKNOWN: (230, 180, 60),
    ShownClass.MOVING: (70, 130, 230),
    ShownClass.OWN_BODY: (168, 85, 247),
}
CLASS_COLOURS = np.array([_COLOURS[one] for one in ShownClass], np.uint8)
"""Colours of points by class; INVALID is that of points without one."""
OBJECT_COLOUR, ELLIPSE_COLOUR, VOXEL_COLOUR = (255, 90, 25), (60, 130, 240), (95, 110, 125, 90)
SEEN_COLOUR, HIDDEN_COLOUR = (20, 160, 145), (130, 150, 150)
"""Colours of walls and other shapes, in sight and out of sight."""
SIGMAS = 2.0
TRAIL = 50  # positions of an object that stay in view
POINT_RADIUS, VOXEL_RADIUS = 0.02, 0.05
LOOK, SHORTEST_LOOK = 1.6, 8.0
"""Distance of the viewer's eye: ratio to the extent of moving objects, and its minimum [m]."""
LOOK_FROM = np.array([-0.45, -0.65, 0.61])
"""Direction from the moving objects to the eye."""


class RerunLog:
    """Moments of a run, logged to rerun as they come.

    Clouds by class under world/points, boxes with IDs under world/objects, their 2 sigma
    ellipsoids, velocities (a second long) and trails beside them, walls and other shapes under
    world/shapes.

    Parameters
    ----------
    name : str
        Name of the recording: the viewer joins logs of the same name.

    Attributes
    ----------
    stream : rerun.RecordingStream
        Stream that the caller connects to a file or a viewer.

    Raises
    ------
    MissingExtraError
        rerun-sdk is not installed.
    """

    def __init__(self, name: str) -> None:
        self._rr = require("rerun", extra="rerun", purpose=PURPOSE)
        self.stream = self._rr.RecordingStream("lidar_core", recording_id=name)
        self._trails: dict[int, list[NDArray[np.float64]]] = defaultdict(list)
        self._filled: set[str] = set()

    def begin(self) -> None:
        """Log which axis points up; to be called once the stream is connected."""
        self.stream.log("world", self._rr.ViewCoordinates.FLU, static=True)
        classes = [
            (int(one), one.name.lower().replace("_", " "), CLASS_COLOURS[one].tolist())
            for one in ShownClass
        ]
        self.stream.log("world/points", self._rr.AnnotationContext(classes), static=True)

    def follow(self) -> None:
        """Make viewers follow the newest time until the user selects another one."""
        views = require("rerun.blueprint", extra="rerun", purpose=PURPOSE)
        panel = views.TimePanel(timeline="time", play_state="following")
        blueprint = views.Blueprint(panel, auto_layout=True, auto_views=True)
        self._rr.send_blueprint(blueprint, recording=self.stream)

    def frame(self, places: NDArray[np.float64]) -> None:
        """Set the first view to `places` (N, 3) [m], seen from the south-west and above."""
        views = require("rerun.blueprint", extra="rerun", purpose=PURPOSE)
        low, high = places.min(axis=0), places.max(axis=0)
        target = (low + high) / 2
        away = max(SHORTEST_LOOK, LOOK * float(np.linalg.norm(high - low)))
        eye = views.archetypes.EyeControls3D(
            position=target + away * LOOK_FROM, look_target=target, eye_up=(0.0, 0.0, 1.0)
        )
        view = views.Spatial3DView(origin="world", name="run", eye_controls=eye)
        self._rr.send_blueprint(views.Blueprint(view), recording=self.stream)

    def log(self, moment: Moment) -> None:
        """Show one time of a run."""
        rr = self._rr
        self.stream.set_time("time", timestamp=np.datetime64(moment.stamp_ns, "ns"))
        if len(moment.points):
            classes = moment.point_class.astype(np.uint16)
            cloud = rr.Points3D(moment.points, class_ids=classes, radii=POINT_RADIUS)
            self.stream.log("world/points", cloud)
        self._log_extents(moment.objects)
        _log_motion(rr, self.stream, moment.objects, self._trails)
        shapes = moment.outlines
        seen = [SEEN_COLOUR if one.visible else HIDDEN_COLOUR for one in shapes]
        lines, labels = [one.points for one in shapes], [str(one.id) for one in shapes]
        self._log_lines("world/shapes", lines, labels, seen)

    def _log_extents(self, objects: Objects) -> None:
        """Log boxes for objects with a height, and circles for objects without one."""
        speeds = np.linalg.norm(objects.velocity, axis=1).tolist()
        labels = [
            f"{name}: {speed:.1f} m/s"
            for name, speed in zip(objects.id.tolist(), speeds, strict=True)
        ]
        heights = objects.size[:, 2]
        tall, flat = (np.flatnonzero(rows).tolist() for rows in (heights > 0, heights == 0))
        self._log_or_clear(
            "world/objects/boxes",
            len(tall),
            self._rr.Boxes3D(
                centers=objects.position[tall],
                sizes=objects.size[tall],
                labels=[labels[row] for row in tall],
                colors=OBJECT_COLOUR,
                show_labels=True,
            ),
        )
        self._log_lines(
            "world/objects/outlines",
            [objects.outline(row) for row in flat],
            [labels[row] for row in flat],
            OBJECT_COLOUR,
        )

    def _log_lines(
        self, place: str, lines: Sequence[NDArray[np.float64]], labels: list[str], colours: Any
    ) -> None:
        strips = self._rr.LineStrips3D(lines, labels=labels, colors=colours, show_labels=True)
        self._log_or_clear(place, len(lines), strips)

    def _log_or_clear(self, place: str, count: int, shown: Any) -> None:
        """Log `shown`, which has `count` items; if 0, log it only to remove earlier items."""
        if count or place in self._filled:
            self.stream.log(place, shown)
        (self._filled.add if count else self._filled.discard)(place)

    def log_map(self, voxel_map: Path) -> None:
        """Show the occupied voxels of a saved map, at all times."""
        from lidar_core import VoxelMap

        centres = VoxelMap.load(voxel_map).occupied_points()
        if len(centres):
            voxels = self._rr.Points3D(centres, colors=VOXEL_COLOUR, radii=VOXEL_RADIUS)
            self.stream.log("world/map", voxels, static=True)

    def close(self) -> None:
        """Send the pending data and disconnect."""
        self.stream.flush()
        self.stream.disconnect()


def write_rerun(run: Playback, path: str | Path) -> Path:
    """Write a run as rerun's recording (.rrd); the file is complete or does not exist.

    Write the content of `RerunLog`, and occupied voxels under world/map.

    Raises
    ------
    FileNotFoundError
        The folder of the file is missing.
    MissingExtraError
        rerun-sdk is not installed.
    """
    place = Path(path)
    check_place(place)
    log = RerunLog(str(run.folder.resolve()))
    with written_whole(place) as temporary:
        log.stream.save(str(temporary))
        log.begin()
        if run.voxel_map is not None:
            log.log_map(run.voxel_map)
        places = [np.empty((0, 3)), *(objects.position for _, objects in run.steps())]
        for moment in run.moments():
            log.log(moment)
            places.append(box_of_movers(moment.movers))
        if len(seen := np.concatenate(places)):
            log.frame(seen)
        log.close()
    return place


def show_window(recording: str | Path) -> int:
    """Open rerun's window on a recording and wait until it is closed; returns its exit status.

    Parameters
    ----------
    recording : str or Path
        File that `write_rerun` wrote.
    """
    with rerun_process([str(recording), "--port", str(free_port())]) as process:
        try:
            return process.wait()
        except KeyboardInterrupt:
            return 0


def _log_motion(
    rr: Any, stream: Any, objects: Objects, trails: dict[int, list[NDArray[np.float64]]]
) -> None:
    names = objects.id.tolist()
    for name, position in zip(names, objects.position, strict=True):
        trails[name] = [*trails[name][1 - TRAIL :], position]
    for name in set(trails) - set(names):
        del trails[name]
    half, turns = _axes(objects.covariance)
    stream.log(
        "world/objects/covariance",
        rr.Ellipsoids3D(
            centers=objects.position,
            half_sizes=half,
            quaternions=turns,
            colors=ELLIPSE_COLOUR,
        ),
    )
    stream.log(
        "world/objects/velocity",
        rr.Arrows3D(
            origins=objects.position,
            vectors=objects.velocity,
            colors=OBJECT_COLOUR,
        ),
    )
    stream.log(
        "world/objects/trails",
        rr.LineStrips3D(
            [np.array(trails[name]) for name in names],
            colors=OBJECT_COLOUR,
        ),
    )


def _axes(covariance: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Half axes (K, 3) and rotations (K, 4) of the ellipsoids of `SIGMAS` deviations."""
    from lidar_core.io.rotations import quaternion_from_matrix

    values, vectors = np.linalg.eigh(covariance)
    vectors[:, :, 2] *= np.sign(np.linalg.det(vectors))[:, None]
    turns = [quaternion_from_matrix(matrix) for matrix in vectors]
    return SIGMAS * np.sqrt(np.maximum(values, 0.0)), np.reshape(turns, (-1, 4))
