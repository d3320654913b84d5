"""Elements of a map of circles and other shapes as Foxglove's scene entities."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_core.io.tables.shapes import outline
from lidar_core.objects import CircleElements, ShapeElements

LIFETIME_NS = 500_000_000  # an element that is no longer written disappears from the view
HEIGHT = 0.02  # of a disc [m]
SIGMAS = 2.0
CORNERS = 24  # of an ellipse
SLOWEST = 0.05  # shown with an arrow, as long as the way of one second [m/s]
SEEN, HIDDEN = (0.1, 0.55, 0.9, 0.6), (0.5, 0.5, 0.5, 0.4)
WALL = (0.85, 0.45, 0.1, 0.9)
LIKELY = 0.5  # probability from which on an element is called a person


def label_of(circles: CircleElements, row: int) -> str:
    """Return ID and kind of an element."""
    name = str(int(circles.id[row]))
    return f"{name} person" if circles.person_probability[row] > LIKELY else name


class CircleScene:
    """Builder of the scene entities of one time.

    Parameters
    ----------
    messages : module
        `foxglove.messages`.
    stamp : Timestamp
        Time of the entities.
    frame_id : str
        Frame of the map.
    """

    def __init__(self, messages: Any, stamp: Any, frame_id: str) -> None:
        self._m = messages
        self._stamp = stamp
        self._frame_id = frame_id

    def entities(self, circles: CircleElements) -> list[Any]:
        """Return one entity per element, named by its ID."""
        return [self._entity(circles, row) for row in range(len(circles.id))]

    def outlines(self, shapes: ShapeElements) -> list[Any]:
        """Return one entity per line, ellipse or rectangle, named by its ID."""
        return [self._outline(shapes, row) for row in range(len(shapes.id))]

    def _outline(self, shapes: ShapeElements, row: int) -> Any:
        m, number = self._m, str(int(shapes.id[row]))
        colour = self._colour(WALL if shapes.visible[row] else HIDDEN)
        speed = float(np.linalg.norm(shapes.velocity[row]))
        label = m.TextPrimitive(
            pose=self._pose(shapes.center[row], height=2 * HEIGHT),
            billboard=True,
            font_size=12.0,
            scale_invariant=True,
            color=colour,
            text=number,
        )
        return m.SceneEntity(
            timestamp=self._stamp,
            frame_id=self._frame_id,
            id=number,
            lifetime=m.Duration(sec=0, nsec=LIFETIME_NS),
            lines=[self._loop(outline(shapes, row, CORNERS), colour, 3.0)],
            arrows=[self._arrow(shapes.center[row], shapes.velocity[row], speed)]
            if speed > SLOWEST
            else [],
            texts=[label],
        )

    def _entity(self, circles: CircleElements, row: int) -> Any:
        m, center = self._m, circles.center[row]
        colour = self._colour(SEEN if circles.visible[row] else HIDDEN)
        radius = float(circles.radius[row])
        speed = float(np.linalg.norm(circles.velocity[row]))
        label = m.TextPrimitive(
            pose=self._pose(center, height=2 * HEIGHT),
            billboard=True,
            font_size=14.0,
            scale_invariant=True,
            color=colour,
            text=label_of(circles, row),
        )
        disc = m.CylinderPrimitive(
            pose=self._pose(center),
            size=m.Vector3(x=2 * radius, y=2 * radius, z=HEIGHT),
            bottom_scale=1.0,
            top_scale=1.0,
            color=colour,
        )
        return m.SceneEntity(
            timestamp=self._stamp,
            frame_id=self._frame_id,
            id=str(int(circles.id[row])),
            lifetime=m.Duration(sec=0, nsec=LIFETIME_NS),
            cylinders=[disc],
            lines=[
                self._loop(
                    center + ellipse(circles.covariance[row][:2, :2], SIGMAS, CORNERS), colour, 2.0
                )
            ],
            arrows=[self._arrow(center, circles.velocity[row], speed)] if speed > SLOWEST else [],
            texts=[label],
        )

    def _loop(self, around: NDArray[np.float64], colour: Any, thickness: float) -> Any:
        m = self._m
        corners = [m.Point3(x=float(x), y=float(y), z=2 * HEIGHT) for x, y in around]
        return m.LinePrimitive(
            type=m.LinePrimitiveLineType.LineLoop,
            pose=self._pose(np.zeros(2)),
            thickness=thickness,
            scale_invariant=True,
            points=corners,
            color=colour,
        )

    def _arrow(
        self, center: NDArray[np.float64], velocity: NDArray[np.float64], speed: float
    ) -> Any:
        pose = self._pose(center, yaw=math.atan2(velocity[1], velocity[0]), height=2 * HEIGHT)
        return self._m.ArrowPrimitive(
            pose=pose,
            shaft_length=0.8 * speed,
            shaft_diameter=0.03,
            head_length=0.2 * speed,
            head_diameter=0.08,
            color=self._colour(SEEN),
        )

    def _pose(self, at: NDArray[np.float64], *, yaw: float = 0.0, height: float = 0.0) -> Any:
        m = self._m
        return m.Pose(
            position=m.Vector3(x=float(at[0]), y=float(at[1]), z=height),
            orientation=m.Quaternion(z=math.sin(yaw / 2), w=math.cos(yaw / 2)),
        )

    def _colour(self, values: tuple[float, ...]) -> Any:
        return self._m.Color(**dict(zip("rgba", values, strict=True)))


def ellipse(covariance: NDArray[np.float64], sigmas: float, corners: int) -> NDArray[np.float64]:
    """Corners (corners, 2) of the ellipse where the Mahalanobis distance is `sigmas`."""
    values, vectors = np.linalg.eigh(covariance)
    angles = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    unit = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    around: NDArray[np.float64] = sigmas * (unit * np.sqrt(np.maximum(values, 0))) @ vectors.T
    return around
