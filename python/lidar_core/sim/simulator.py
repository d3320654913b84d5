"""Scans of a scene, one after the other, with the truth."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from lidar_core._core import SimScene, SimShape, SimTrajectory
from lidar_core.errors import ConfigError
from lidar_core.messages import LaserScan, Scan
from lidar_core.objects import ObjectTruth, TargetTruth
from lidar_core.sim.config import Body, Scene
from lidar_core.sim.delivery import delivered
from lidar_core.sim.lidar import Planar, Spinning
from lidar_core.sim.motion.knots import poses, times_of
from lidar_core.sim.motion.motions import RandomMotion
from lidar_core.sim.solids.movers import movers_of, reach_of
from lidar_core.sim.solids.people import Barrel
from lidar_core.sim.solids.shapes import Cylinder, Sway, Tree
from lidar_core.sim.surfaces import Answers
from lidar_core.sim.truth import SimulatedScan, SimulatedSweep

POSE_RATE = 100.0
"""Poses per second within a scan [Hz]: as self-localisation with an IMU gives them."""


class Simulator:
    """Simulator of any scan of a scene, in any order; the same seed gives the same bits.

    Parameters
    ----------
    scene : Scene
        Scene to scan.
    seed : int
        Seed of noise and random motions, >= 0.
    scans : int, optional
        Length of the recording; `scene.scans` if not given.
    threads : int
        Threads, >= 1; they do not change the result.

    Raises
    ------
    ConfigError
        A value is out of range, or a random motion finds no free path.
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
        bodies, sways, surfaces = _bodies(scene)
        radii = [reach_of(target.shape.surfaces()) for target in scene.targets]
        ways = self._ways(SimScene(bodies, [], threads=1), radii)
        labels = len(scene.bodies) + np.arange(len(radii), dtype=np.int32)
        movers = self._movers(ways, labels.tolist())
        names = [scene.targets[label - len(scene.bodies)].surface for _, _, label in movers]
        self._world = SimScene(
            bodies,
            movers,
            threads=threads,
            sways=sways,
            air=list(scene.air),
            surfaces=surfaces,
            mover_surfaces=names,
            carried=[one for body in scene.own_body for one in _place_surfaces(body)],
        )
        self._is_target = np.array([not target.clutter for target in scene.targets], bool)
        self.targets = [way for way, wanted in zip(ways, self._is_target, strict=True) if wanted]
        self._ids = labels[self._is_target]
        self._radius = np.array(radii, np.float64)[self._is_target]

    def __iter__(self) -> Iterator[SimulatedScan]:
        return (self.scan(number) for number in range(self.scans))

    def scan(self, number: int, *, sensor: SimTrajectory | None = None) -> SimulatedScan:
        """Make scan `number`, from 0; with a `sensor` steered by the caller, from its path.

        Raises
        ------
        ConfigError
            There is no such scan.
        """
        lidar, way = self.scene.lidar, self.sensor if sensor is None else sensor
        start_ns = self._start(number)
        points, directions, no_return, label, time_ns, rays = self._world.scan(
            lidar, way, start_ns=start_ns, scan=number, seed=self.seed
        )
        stamps = self._pose_stamps(start_ns)
        path = way.poses_at(stamps)
        organised = isinstance(lidar.pattern, Spinning)
        made = SimulatedScan(
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
        return delivered(made, lidar)

    def sweep(self, number: int, *, sensor: SimTrajectory | None = None) -> SimulatedSweep:
        """Make scan `number` of a 2D LiDAR; parameters and errors as for `scan`.

        Raises
        ------
        ConfigError
            The LiDAR is not planar.
        """
        lidar, way = self.scene.lidar, self.sensor if sensor is None else sensor
        pattern = lidar.pattern
        if not isinstance(pattern, Planar):
            raise ConfigError(f"lidar.pattern: expected a planar one, got {pattern.kind}")
        start_ns = self._start(number)
        ranges, label, rays = self._world.sweep(
            lidar, way, start_ns=start_ns, scan=number, seed=self.seed
        )
        stamps = self._pose_stamps(start_ns)
        path = way.poses_at(stamps)
        return SimulatedSweep(
            scan=LaserScan(
                stamp_ns=start_ns,
                ranges=ranges,
                angle_min=pattern.angle_min,
                angle_increment=pattern.angle_increment,
                range_min=lidar.range_min,
                range_max=lidar.range_max,
                time_increment_ns=0 if lidar.snapshot else pattern.time_increment_ns,
            ),
            world_from_lidar=path[0],
            pose_stamps_ns=stamps,
            poses=path,
            truth=self.objects(start_ns, label, rays),
            label=label,
        )

    def objects(
        self, stamp_ns: int, label: NDArray[np.int32], rays: NDArray[np.uint32]
    ) -> ObjectTruth:
        """Describe the targets in the plane at `stamp_ns`, as `truth` does in space."""
        found = self.truth(stamp_ns, label, rays)
        shapes = [target.shape for target in self.scene.targets if not target.clutter]
        radius = [
            shape.radius if isinstance(shape, Cylinder | Barrel) else np.nan for shape in shapes
        ]
        return ObjectTruth(
            id=found.id,
            kind=tuple(shape.kind for shape in shapes),
            center=found.position[:, :2],
            velocity=found.velocity[:, :2],
            radius=np.array(radius, np.float64),
            hits=found.hits,
            rays=found.rays,
        )

    def _start(self, number: int) -> int:
        """Start of scan `number` [ns]."""
        if not 0 <= number < max(self.scans, self.scene.scans):
            raise ConfigError(f"number: expected 0 to {self.scans - 1}, got {number}")
        return self.scene.start_ns + number * self.scene.lidar.period_ns

    def _pose_stamps(self, start_ns: int) -> NDArray[np.int64]:
        """Times of the poses over the scan that starts at `start_ns`, including both ends [ns]."""
        lidar = self.scene.lidar
        count = max(2, 1 + int(np.ceil(POSE_RATE / lidar.scan_rate)))
        return start_ns + np.linspace(0, lidar.period_ns, count).round().astype(np.int64)

    def truth(
        self, stamp_ns: int, label: NDArray[np.int32], rays: NDArray[np.uint32]
    ) -> TargetTruth:
        """Describe the targets at `stamp_ns`; `label` is that of the scan."""
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

    def _movers(
        self, ways: list[SimTrajectory], labels: list[int]
    ) -> list[tuple[SimShape, SimTrajectory, int]]:
        seconds = times_of(self._seconds)
        stamps = self._stamps(seconds)
        return [
            (surface, path, label)
            for target, way, label in zip(self.scene.targets, ways, labels, strict=True)
            for surface, path in movers_of(target.shape, way, stamps, seconds)
        ]

    def _ways(self, standing: SimScene, radii: list[float]) -> list[SimTrajectory]:
        ways: list[SimTrajectory] = []
        start_ns = self.scene.start_ns
        for number, (target, radius) in enumerate(zip(self.scene.targets, radii, strict=True)):
            motion = target.motion
            if not isinstance(motion, RandomMotion):
                ways.append(self._trajectory(*motion.knots(self._seconds)))
                continue
            reach = motion.clearance + radius
            apart = [(way, reach + other) for way, other in zip(ways, radii, strict=False)]
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
        return SimTrajectory(self._stamps(seconds), np.ascontiguousarray(matrices))

    def _stamps(self, seconds: NDArray[np.float64]) -> NDArray[np.int64]:
        return self.scene.start_ns + np.round(seconds * 1e9).astype(np.int64)


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


def sweeps(
    scene: Scene, *, seed: int, scans: int | None = None, threads: int = 1
) -> Iterator[SimulatedSweep]:
    """Make scans of `scene` with its 2D LiDAR; parameters and errors as for `Simulator.sweep`.

    Examples
    --------
    >>> import lidar_core.sim as sim
    >>> scene = sim.Scene(lidar=sim.LidarModel.preset("utm-30lx"))
    >>> next(sim.sweeps(scene, seed=0)).scan.ranges.shape
    (1081,)
    """
    simulator = Simulator(scene, seed=seed, scans=scans, threads=threads)
    return (simulator.sweep(number) for number in range(simulator.scans))


def _bodies(
    scene: Scene,
) -> tuple[list[tuple[SimShape, NDArray[np.float64], int]], list[Sway | None], Answers]:
    """Return surface, pose and label, sway, and reflection of each surface of all bodies."""
    bodies = []
    sways: list[Sway | None] = []
    surfaces: Answers = []
    for label, body in enumerate(scene.bodies):
        placed = _place_surfaces(body)
        bodies += [(shape, at, label) for shape, at in placed]
        sways += _sways(body, placed[0][1][:3, :3], len(placed))
        surfaces += [body.surface] * len(placed)
    return bodies, sways, surfaces


def _place_surfaces(body: Body) -> list[tuple[SimShape, NDArray[np.float64]]]:
    """Return the surfaces of a body and their poses in the world."""
    pose = poses(np.array([body.position]), np.array([body.rotation]))[0]
    found = []
    for shape, place in body.shape.surfaces():
        at = pose.copy()
        at[:3, 3] += pose[:3, :3] @ place
        found.append((shape, at))
    return found


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
