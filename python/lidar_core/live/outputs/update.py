"""Results of one scan of a stream, in the form that outputs need."""

from abc import ABC, abstractmethod
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lidar_core.circles import CircleElements, CircleFrame
from lidar_core.flying import FlyingFrame, Tracks
from lidar_core.io.write.mcap import FoxgloveLog
from lidar_core.messages import LaserScan, PointClass, PosedScan, Scan
from lidar_core.objects import Objects, ObjectTable
from lidar_core.viz.playback import SMALLEST, Moment, in_world, outlines_of, swept
from lidar_core.viz.scan_log import log_circles, log_flying

LiveCapability: TypeAlias = Literal["flying", "circles"]


class Update(ABC):
    """One processed scan.

    Attributes
    ----------
    capability : str
        Capability that processed the scan.
    stamp_ns : int
        Time of the scan [ns].
    frame_id : str
        Frame of poses, tracks and maps.
    objects : Objects
        Tracks, or elements of the map of circles.
    covariance : ndarray, shape (K, 6, 6), float64
        Covariances of positions and velocities.
    """

    capability: LiveCapability

    @property
    @abstractmethod
    def states(self) -> ObjectTable:
        """Return the objects with everything that is known of them."""

    def __init__(
        self, stamp_ns: int, frame_id: str, objects: Objects, covariance: NDArray[np.float64]
    ) -> None:
        self.stamp_ns, self.frame_id = stamp_ns, frame_id
        self.objects, self.covariance = objects, covariance

    @abstractmethod
    def moment(self) -> Moment:
        """Return the scan in the world, with classes, and the objects."""

    @abstractmethod
    def log_to(self, log: FoxgloveLog) -> None:
        """Log the objects for viewers."""


class FlyingUpdate(Update):
    """Results of the detector of flying objects for one scan."""

    capability = "flying"

    def __init__(self, item: PosedScan[Scan], frame: FlyingFrame, frame_id: str) -> None:
        objects, covariance = objects_of_tracks(frame.tracks.flying)
        super().__init__(item.scan.stamp_ns, frame_id, objects, covariance)
        self.item, self.frame = item, frame

    @property
    def states(self) -> Tracks:
        """Return the tracks."""
        return self.frame.tracks

    def moment(self) -> Moment:
        """Return the points with information, with their classes, and the tracks."""
        shown = self.frame.shown_class
        is_point = shown != PointClass.INVALID
        local = self.item.scan.points.reshape(-1, 3)[is_point]
        points = in_world(local, self.item.world_from_lidar.reshape(-1, 4, 4)[0])
        return Moment(self.stamp_ns, points, shown[is_point], self.objects)

    def log_to(self, log: FoxgloveLog) -> None:
        """Log pose, cloud with classes, and tracks."""
        log_flying(log, self.item, self.frame, frame_id=self.frame_id)


class CirclesUpdate(Update):
    """Results of the pipeline of circles for one scan."""

    capability = "circles"

    def __init__(self, item: PosedScan[LaserScan], frame: CircleFrame, frame_id: str) -> None:
        objects, covariance = objects_of_circles(frame.map)
        super().__init__(item.scan.stamp_ns, frame_id, objects, covariance)
        self.item, self.frame = item, frame

    @property
    def states(self) -> CircleElements:
        """Return the circles of the map."""
        return self.frame.map

    def moment(self) -> Moment:
        """Return the hits, without classes, and the circles and other shapes of the map."""
        local = swept(self.item.scan)
        hits = local[np.isfinite(local).all(axis=1)]
        points = in_world(hits, self.item.world_from_lidar.reshape(-1, 4, 4)[0])
        classes, outlines = np.zeros(len(hits), np.uint8), outlines_of(self.frame.map_shapes)
        return Moment(self.stamp_ns, points, classes, self.objects, outlines)

    def log_to(self, log: FoxgloveLog) -> None:
        """Log pose, scan and map."""
        log_circles(log, self.item, self.frame, frame_id=self.frame_id)


def objects_of_tracks(tracks: Tracks) -> tuple[Objects, NDArray[np.float64]]:
    """Convert tracks to objects of viewers, with covariances (T, 6, 6) of position and velocity."""
    covariance = np.ascontiguousarray(tracks.covariance[:, :6, :6])
    objects = Objects(
        id=tracks.id,
        position=tracks.position,
        velocity=tracks.velocity,
        covariance=covariance[:, :3, :3],
        size=np.maximum(tracks.extent, SMALLEST),
    )
    return objects, covariance


def objects_of_circles(circles: CircleElements) -> tuple[Objects, NDArray[np.float64]]:
    """Convert map elements to objects of viewers; heights and their covariances are zero."""
    zero = np.zeros((len(circles), 1))
    covariance = np.zeros((len(circles), 6, 6))
    planar = np.array([0, 1, 3, 4])
    covariance[:, planar[:, None], planar] = circles.covariance[:, :4, :4]
    diameter = 2 * circles.radius[:, None]
    objects = Objects(
        id=circles.id,
        position=np.concatenate([circles.center, zero], axis=1),
        velocity=np.concatenate([circles.velocity, zero], axis=1),
        covariance=covariance[:, :3, :3],
        size=np.concatenate([diameter, diameter, zero], axis=1),
    )
    return objects, covariance
