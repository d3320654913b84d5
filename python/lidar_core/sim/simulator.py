"""Scans of a scene, one after the other, with the truth."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidar_core._core import SimScene, SimShape, SimTrajectory
from lidar_core.errors import ConfigError
from lidar_core.messages import Scan
from lidar_core.sim.config import Body, Scene
from lidar_core.sim.lidar import Spinning
from lidar_core.sim.motions import RandomMotion, poses
from lidar_core.sim.shapes import Sway, Tree


@dataclass(frozen=True, slots=True)
class TargetTruth:
    """Where the targets are at the start of a scan, world frame, one row per target.

    Attributes
    ----------
    id : ndarray, shape (T,), int32
        As in `SimulatedScan.label`.
    position, velocity : ndarray, shape (T, 3), float64
        Of the centre [m], [m/s].
    radius : ndarray, shape (T,), float64
        Of the sphere around the target [m].
    hits : ndarray, shape (T,), int64
        Points on the target in this scan.
    rays : ndarray, shape (T,), int64
        Rays that would meet it within range if nothing else were there: 0 out of the field of
        view or out of range; far more than `hits` if it is hidden.
    visible : ndarray, shape (T,), bool
        At least one point.
    """

    id: NDArray[np.int32]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    radius: NDArray[np.float64]
    hits: NDArray[np.int64]
    rays: NDArray[np.int64]
    visible: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class SimulatedScan:
    """A scan, where it was made, and the truth about it.

    Attributes
    ----------
    scan : Scan
        Points in the LiDAR's frame at the time of each ray.
    world_from_lidar : ndarray, shape (4, 4), float64
        At the start of the scan.
    pose_stamps_ns, poses : ndarray, shapes (K,), int64, and (K, 4, 4), float64
        The same over the whole scan, ends included.
    truth : TargetTruth
        The targets.
    label : ndarray, shape (N,), int32
        What every ray met: number of the body or target, -1 where there is no point, -2 for rain
        and dust.
    """

    scan: Scan
    world_from_lidar: NDArray[np.float64]
    pose_stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]
    truth: TargetTruth
    label: NDArray[np.int32]


class Simulator:
    """A scene at work: any scan of it, in any order. The same seed gives the same bits.

    Parameters
    ----------
    scene : Scene
        What is looked at.
    seed : int
        Seed of noise and random motions, >= 0.
    scans : int, optional
        Length of the recording; `scene.scans` if not given.
    threads : int
        Threads, >= 1; they do not change the result.

    Raises
    ------
    ConfigError
        A value is out of range, or a random motion finds no room.
    """

    def __init__(
        self, scene: Scene, *, seed: int, scans: int | None = None, threads: int = 1
    ) -> None:
        if not 0 <= seed < 2**64:
            raise ConfigError(f"seed: expected 0 to 2^64 - 1, got {seed}")
        self.scans = scene.scans if scans is None else scans
        if self.scans < 1:
            raise ConfigError(f"scans: expected >= 1, got {scans}")
        self.scene = scene
        self.seed = seed
        self._seconds = max(self.scans, scene.scans) * scene.lidar.period_ns * 1e-9
        self.sensor = self._trajectory(*scene.sensor.knots(self._seconds))
        bodies, sways = _bodies(scene)
        shapes = [target.shape.surfaces()[0][0] for target in scene.targets]
        ways = self._ways(SimScene(bodies, [], threads=1), shapes)
        labels = len(scene.bodies) + np.arange(len(shapes), dtype=np.int32)
        movers = list(zip(shapes, ways, labels.tolist(), strict=True))
        self._world = SimScene(bodies, movers, threads=threads, sways=sways, air=list(scene.air))
        self._is_target = np.array([not target.clutter for target in scene.targets], bool)
        self.targets = [way for way, wanted in zip(ways, self._is_target, strict=True) if wanted]
        self._ids = labels[self._is_target]
        self._radius = np.array([shape.radius for shape in shapes], np.float64)[self._is_target]

    def __iter__(self) -> Iterator[SimulatedScan]:
        return (self.scan(number) for number in range(self.scans))

    def scan(self, number: int, *, sensor: SimTrajectory | None = None) -> SimulatedScan:
        """Scan `number`, from 0; with a `sensor` steered by the caller, from its way.

        Raises
        ------
        ConfigError
            There is no such scan.
        """
        if not 0 <= number < max(self.scans, self.scene.scans):
            raise ConfigError(f"number: expected 0 to {self.scans - 1}, got {number}")
        lidar, way = self.scene.lidar, self.sensor if sensor is None else sensor
        start_ns = self.scene.start_ns + number * lidar.period_ns
        points, directions, no_return, label, time_ns, rays = self._world.scan(
            lidar, way, start_ns=start_ns, scan=number, seed=self.seed
        )
        count = max(2, 1 + int(np.ceil(self.scene.pose_rate / lidar.scan_rate)))
        stamps = start_ns + np.linspace(0, lidar.period_ns, count).round().astype(np.int64)
        path = way.poses_at(stamps)
        organised = isinstance(lidar.pattern, Spinning)
        return SimulatedScan(
            scan=Scan(
                stamp_ns=start_ns,
                points=points.reshape(*lidar.shape, 3),
                no_return=no_return,
                directions=directions,
                point_time_ns=time_ns,
                ring=np.repeat(np.arange(lidar.shape[0], dtype=np.uint16), lidar.shape[1])
                if organised
                else None,
            ),
            world_from_lidar=path[0],
            pose_stamps_ns=stamps,
            poses=path,
            truth=self.truth(start_ns, label, rays),
            label=label,
        )

    def truth(
        self, stamp_ns: int, label: NDArray[np.int32], rays: NDArray[np.uint32]
    ) -> TargetTruth:
        """Describe the targets at `stamp_ns`, as a scan with the labels `label` saw them."""
        stamps = np.array([stamp_ns])
        hits = np.array([np.count_nonzero(label == target) for target in self._ids], np.int64)
        position = [way.poses_at(stamps)[0, :3, 3] for way in self.targets]
        velocity = [way.velocities_at(stamps)[0] for way in self.targets]
        return TargetTruth(
            id=self._ids,
            position=np.reshape(position, (-1, 3)),
            velocity=np.reshape(velocity, (-1, 3)),
            radius=self._radius,
            hits=hits,
            rays=rays[self._is_target].astype(np.int64),
            visible=hits > 0,
        )

    def _ways(self, standing: SimScene, shapes: list[SimShape]) -> list[SimTrajectory]:
        ways: list[SimTrajectory] = []
        start_ns = self.scene.start_ns
        for number, (target, shape) in enumerate(zip(self.scene.targets, shapes, strict=True)):
            motion = target.motion
            if not isinstance(motion, RandomMotion):
                ways.append(self._trajectory(*motion.knots(self._seconds)))
                continue
            reach = motion.clearance + shape.radius
            others = zip(ways, shapes, strict=False)
            apart = [(way, reach + other.radius) for way, other in others]
            ways.append(
                standing.random_motion(
                    motion.model_copy(update={"clearance": reach}),
                    self.sensor,
                    apart=[(self.sensor, reach), *apart],
                    span_ns=(start_ns, start_ns + round(self._seconds * 1e9)),
                    seed=(self.seed, number),
                )
            )
        return ways

    def _trajectory(
        self, seconds: NDArray[np.float64], matrices: NDArray[np.float64]
    ) -> SimTrajectory:
        stamps = self.scene.start_ns + np.round(seconds * 1e9).astype(np.int64)
        return SimTrajectory(stamps, np.ascontiguousarray(matrices))


def simulate(
    scene: Scene, *, seed: int, scans: int | None = None, threads: int = 1
) -> Iterator[SimulatedScan]:
    """Make scans of `scene`, one after the other; parameters and errors as for `Simulator`.

    Examples
    --------
    >>> import lidar_core.sim as sim
    >>> first = next(sim.simulate(sim.scenes.demo(seed=0), seed=0))
    >>> first.scan.points.shape
    (128, 1024, 3)
    """
    return iter(Simulator(scene, seed=seed, scans=scans, threads=threads))


def _bodies(
    scene: Scene,
) -> tuple[list[tuple[SimShape, NDArray[np.float64], int]], list[Sway | None]]:
    """Surfaces, poses and labels of all bodies, and how each surface sways."""
    bodies = []
    sways: list[Sway | None] = []
    for label, body in enumerate(scene.bodies):
        pose = poses(np.array([body.position]), np.array([body.rotation]))[0]
        for shape, place in body.shape.surfaces():
            at = pose.copy()
            at[:3, 3] += pose[:3, :3] @ place
            bodies.append((shape, at, label))
        sways += _sways(body, pose[:3, :3], len(bodies) - len(sways))
    return bodies, sways


def _sways(body: Body, turn: NDArray[np.float64], surfaces: int) -> list[Sway | None]:
    """Return the sways of a body's surfaces, world frame."""
    if not isinstance(body.shape, Tree) or body.shape.sway == 0:
        return [None] * surfaces
    found: list[Sway | None] = []
    for sway in body.shape.sways():
        if sway is None:
            found.append(None)
        else:
            x, y, z = (turn @ sway[0]).tolist()
            found.append(((x, y, z), *sway[1:]))
    return found
