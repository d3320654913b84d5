"""Poses from the scans themselves, while a recording is read: KISS-ICP, with a covariance.

Source: Vizzo et al., "KISS-ICP: In Defense of Point-to-Point ICP", RA-L 2023; its package does the
registration. Its poses are those of the end of a scan, to which it deskews; here they become a
pose, or one at the start and one at the end, in the frame of the first scan's end. Clouds of a
spinning sensor without times are deskewed, too, where they show that they are as measured; their
pose is that of the middle of the turn, and the detector deskews them with the motion between poses.

Longer than other files: times, motion and doubt of a scan are estimated in one step, and all of it
serves that step.
"""

import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_core import _core
from lidar_core.errors import InputError, OdometryWarning
from lidar_core.extras import require
from lidar_core.io.poses.cells import cell_keys, surrounding_keys
from lidar_core.io.rotations import matrix_from_quaternion, quaternion_from_matrix, slerp
from lidar_core.messages import Scan

LEAST_RANGE, MOST_RANGE = 10.0, 100.0
"""Reach of the odometry [m]: 1.25 times what 95 % of the first scan's points are within."""
NEAREST_SHARE, NEAREST = 0.04, (0.5, 2.5)
"""Points nearer than this share of the reach, within limits [m], are of the sensor's own carrier
more often than not, and pull towards standing still."""
VOXELS = 100
"""Edge of KISS-ICP's voxels: its reach divided by this, as its authors have it."""
COARSE = 4
"""While no motion is known, scans are registered with voxels larger by this factor first:
registration looks for neighbours in adjacent voxels only, and a car moves further than that."""
FEWEST, LEAST_SHARE = 50, 0.35
"""Points, and share of them near the map, below which a scan is not placed."""
HELD = 12
"""First scans of a recording that show whether clouds without times are as measured."""
LOST_IN_A_ROW = 10
JUMP, JUMP_ANGLE = 3.0, np.radians(30.0)
"""Departure from constant velocity within one scan that is told as a jump [m, rad]."""
MOST_PERIODS = 5.0
"""Over a gap in the recording the last motion goes on for so many scans at most."""
MEMORY = 0.95
"""Weight that the deviations of before keep with every scan: some 20 of them count."""
STEP_SHARE = 0.75
"""Variance of a step's error over that of its deviation from constant velocity: 1/2 where errors of
steps are independent; more as registration also pulls towards standing still, which no deviation
shows. Found on simulated flights, seeds from 1000 on."""
USUAL = np.array([0.1] * 3 + [0.01] * 3) ** 2
USUAL_WEIGHT = 2.0
"""Deviations before any was seen [m^2, rad^2], and how many scans they count for."""
FLOOR = np.array([0.002] * 3 + [2e-4] * 3) ** 2
"""Least variances: what the voxels of the map round away [m^2, rad^2]."""


class Placed(NamedTuple):
    """Pose of a scan from odometry.

    `poses` (4, 4), or (2, 4, 4) at `stamps_ns` if the scan has times of points; `covariance` (6, 6)
    of translation and angles about x, y, z, relative to the scan before. Errors of steps add up:
    over K scans the covariance of the motion is about the sum of K of them.
    """

    poses: NDArray[np.float64]
    stamps_ns: NDArray[np.int64] | None
    covariance: NDArray[np.float64]


@dataclass(slots=True)
class _Last:
    """State after the previous scan: time and pose of its last point, motion during the scan."""

    end_ns: int
    pose: NDArray[np.float64]
    motion: NDArray[np.float64]
    period_ns: int
    stamp_ns: int
    is_first: bool = False

    def latest(self, cloud: "_Cloud") -> int:
        """Time after which `cloud` must end: its times, if estimated, begin before its stamp."""
        return self.stamp_ns if cloud.part is None else self.end_ns


class KissOdometry:
    """Odometry with KISS-ICP for the scans of one LiDAR, which are given in time order.

    Parameters
    ----------
    note : callable, optional
        Called with the text of every warning.

    Attributes
    ----------
    lost : int
        Scans that could not be placed.

    Raises
    ------
    MissingExtraError
        kiss-icp is not installed.
    """

    def __init__(self, note: Callable[[str], None] | None = None) -> None:
        self._note = note
        require("kiss_icp", extra="odometry", purpose='pose="kiss"')
        self._parts: _Parts | None = None
        self._times, self._is_timed = _core.SweepTimes(), False
        self._first_motion, self._first_period_ns = np.eye(4), 0
        self._doubt = _Doubt()
        self._last: _Last | None = None
        self._lost_in_a_row = 0
        self.lost = 0

    def prepare(self, first: Sequence[Scan]) -> None:
        """Learn from the first scans of a recording, so that all scans are deskewed alike.

        This is the motion during the first one, and, if the clouds have no times, whether their
        points are in the order of firing and as measured.
        """
        clouds = [_usable(scan) for scan in first]
        if len(clouds) < 2 or any(len(cloud.points) < FEWEST for cloud in clouds[:2]):
            return
        if clouds[0].part is None:
            trial = KissOdometry()
            trial._try(first)
            if not trial._is_timed:
                return
            self._times, self._is_timed = trial._times, True
            self._first_period_ns = clouds[1].stamp_ns - clouds[0].stamp_ns
        trial = KissOdometry()
        trial._times, trial._is_timed = self._times, self._is_timed
        trial._first_period_ns = self._first_period_ns
        if trial._try(first[:2]) and trial._last is not None:
            cloud = trial._timed(clouds[1], trial._last.motion, self._first_period_ns)
            sweep = (cloud.end_ns - cloud.start_ns) / trial._last.period_ns
            self._first_motion = _part_of(trial._last.motion, sweep)

    def _try(self, scans: Sequence[Scan]) -> bool:
        """Place `scans` without a word; True if all of them have a place."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", OdometryWarning)
            found = [self.place(scan) for scan in scans]
        return all(one is not None for one in found)

    def place(self, scan: Scan) -> Placed | None:
        """Pose of `scan`; None if it cannot be estimated.

        Warns
        -----
        OdometryWarning
            Tracking is lost or starts again, or the sensor seems to have jumped.

        Raises
        ------
        InputError
            The stamps do not increase.
        """
        cloud = _usable(scan)
        if (last := self._last) is not None and cloud.end_ns <= last.latest(cloud):
            raise InputError(f"scan at {scan.stamp_ns} ns: not later than the one before")
        if len(cloud.points) < FEWEST:
            return self._lose(cloud, f"{len(cloud.points)} points within reach")
        if self._parts is None or self._last is None:
            return self._begin(cloud, np.eye(4))
        return self._follow(cloud, self._parts, self._last)

    def _begin(self, cloud: "_Cloud", pose: NDArray[np.float64]) -> Placed:
        self._parts = _Parts(cloud.points)
        motion, self._first_motion, self._doubt = self._first_motion, np.eye(4), _Doubt()
        cloud = self._timed(cloud, motion, self._first_period_ns)
        frame, _ = self._parts.prepared(cloud, motion)
        self._parts.map.update(frame, pose)
        period_ns = cloud.end_ns - cloud.start_ns
        self._last = _Last(cloud.end_ns, pose, motion, period_ns, cloud.stamp_ns, is_first=True)
        covariance = self._doubt.covariance(pose)
        if cloud.part is None or np.array_equal(motion, np.eye(4)):
            return Placed(pose, None, covariance)
        since = (cloud.span_ns - cloud.end_ns) / (cloud.end_ns - cloud.start_ns)
        return _placed(cloud, [pose @ _part_of(motion, float(part)) for part in since], covariance)

    def _follow(self, cloud: "_Cloud", parts: "_Parts", last: _Last) -> Placed | None:
        since_last = cloud.stamp_ns - last.stamp_ns
        period_ns = min(since_last, last.period_ns or since_last)
        usual = _part_of(last.motion, period_ns / last.period_ns if last.period_ns else 1.0)
        cloud = self._timed(cloud, usual, period_ns)
        elapsed = cloud.end_ns - last.end_ns
        periods = min(elapsed / last.period_ns, MOST_PERIODS) if last.period_ns else 1.0
        motion = _part_of(last.motion, periods)
        sweep = (cloud.end_ns - cloud.start_ns) / elapsed
        frame, source = parts.prepared(cloud, _part_of(motion, sweep))
        guess = last.pose @ motion
        start = parts.coarsely_registered(source, guess) if last.is_first else guess
        pose = parts.registered(source, start)
        share = parts.share_near(source, pose)
        if share < LEAST_SHARE:
            return self._lose(cloud, f"{share:.0%} of its points are near the map")
        deviation = np.linalg.inv(guess) @ pose
        self._tell_jump(cloud, deviation)
        parts.threshold.update_model_deviation(deviation)
        if not np.array_equal(motion, np.eye(4)):  # else it is the whole motion, not a deviation
            self._doubt.add(deviation)
        covariance = self._doubt.covariance(pose)
        parts.map.update(frame, pose)
        moved = np.linalg.inv(last.pose) @ pose
        self._last = _Last(cloud.end_ns, pose, moved, elapsed, cloud.stamp_ns)
        self._lost_in_a_row = 0
        if cloud.part is None:
            return Placed(pose, None, covariance)
        since = (cloud.span_ns - last.end_ns) / elapsed
        poses = [last.pose @ _part_of(moved, float(part)) for part in since]
        return _placed(cloud, poses, covariance)

    def _timed(self, cloud: "_Cloud", motion: NDArray[np.float64], period_ns: int) -> "_Cloud":
        """Add estimated times to a cloud without times, if the clouds show that they are needed.

        The stamp is then taken to be that of the middle of a turn, which lasts `period_ns`;
        `motion` is that of the sensor in this time.
        """
        if cloud.part is not None or not period_ns:
            return cloud
        part = self._times.parts(cloud.points.astype(np.float32), motion.tolist())
        if part is None:
            # The cloud before may end later than this one, which is of its stamp.
            earliest = self._last.end_ns + period_ns // 4 if self._last else cloud.stamp_ns
            end = max(cloud.stamp_ns, earliest)
            return cloud._replace(start_ns=end, end_ns=end)
        self._is_timed, half, stamp = True, period_ns // 2, cloud.stamp_ns
        span = np.array([stamp], np.int64)
        return cloud._replace(part=part, start_ns=stamp - half, end_ns=stamp + half, span_ns=span)

    def _lose(self, cloud: "_Cloud", reason: str) -> Placed | None:
        self.lost += 1
        self._lost_in_a_row += 1
        if self._lost_in_a_row == 1:
            self._warn(
                f"KISS-ICP lost track at {cloud.stamp_ns} ns: {reason}; the scan is left out"
            )
        if self._lost_in_a_row < LOST_IN_A_ROW or self._last is None or not len(cloud.points):
            return None
        self._warn(
            f"KISS-ICP restarts at {cloud.stamp_ns} ns, after {self._lost_in_a_row} scans that it"
            " could not align: the map from here on does not fit the map before"
        )
        self._lost_in_a_row = 0
        return self._begin(cloud, self._last.pose)

    def _tell_jump(self, cloud: "_Cloud", deviation: NDArray[np.float64]) -> None:
        distance, angle = float(np.linalg.norm(deviation[:3, 3])), _angle(deviation)
        if distance > JUMP or angle > JUMP_ANGLE:
            self._warn(
                f"KISS-ICP: the sensor jumps by {distance:.1f} m and {np.degrees(angle):.0f} deg at"
                f" {cloud.stamp_ns} ns, or the scans do not fit: the map may be wrong"
            )

    def _warn(self, text: str) -> None:
        if self._note is not None:
            self._note(text)
        warnings.warn(text, OdometryWarning, stacklevel=4)


class _Cloud(NamedTuple):
    """Points of a scan that contain information.

    `part` is the relative time of each point, 0 at the first of them (`start_ns`) and 1 at the
    last (`end_ns`), None without times; `span_ns` are the times at which poses are wanted: first
    and last time of all rays, or the stamp if the times are estimated.
    """

    stamp_ns: int
    points: NDArray[np.float64]
    part: NDArray[np.float64] | None
    start_ns: int
    end_ns: int
    span_ns: NDArray[np.int64]


def _placed(
    cloud: _Cloud, poses: list[NDArray[np.float64]], covariance: NDArray[np.float64]
) -> Placed:
    """Poses at the times of `cloud.span_ns`; of estimated times only the middle one is used."""
    if len(poses) == 1:
        return Placed(poses[0], None, covariance)
    return Placed(np.stack(poses), cloud.span_ns, covariance)


class _Doubt:
    """Estimate of how much the motion deviates from constant velocity.

    The deviation contains errors of the registration and real changes of the motion. It is taken
    along and about the axes of the sensor, which are assumed independent.
    """

    def __init__(self) -> None:
        self._sum, self._weight = USUAL_WEIGHT * USUAL, USUAL_WEIGHT

    def add(self, deviation: NDArray[np.float64]) -> None:
        turn = (deviation[:3, :3] - deviation[:3, :3].T)[(2, 0, 1), (1, 2, 0)] / 2
        squares = np.concatenate([deviation[:3, 3], turn]) ** 2
        self._sum = MEMORY * self._sum + squares
        self._weight = MEMORY * self._weight + 1

    def covariance(self, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        """Covariance (6, 6): translation in the world [m], angles of R = Rz Ry Rx [rad]."""
        turned = np.zeros((6, 6))
        turned[:3, :3] = pose[:3, :3]
        turned[3:, 3:] = _angles_from_rotation(pose[:3, :3]) @ pose[:3, :3]
        found = turned * (STEP_SHARE * self._sum / self._weight + FLOOR) @ turned.T
        return np.asarray((found + found.T) / 2)


class _Parts:
    """Parts of KISS-ICP, set for the range of the scans; one thread, so runs are repeatable."""

    def __init__(self, points: NDArray[np.float64]) -> None:
        config = require("kiss_icp.config", extra="odometry", purpose='pose="kiss"')
        reach = 1.25 * float(np.percentile(np.linalg.norm(points, axis=1), 95))
        reach = float(np.clip(reach, LEAST_RANGE, MOST_RANGE))
        nearest = float(np.clip(NEAREST_SHARE * reach, *NEAREST))
        chosen = config.KISSConfig(
            data={"max_range": reach, "min_range": nearest, "deskew": True},
            mapping={"voxel_size": reach / VOXELS, "max_points_per_voxel": 20},
            registration={
                "max_num_threads": 1,
                "max_num_iterations": 500,
                "convergence_criterion": 1e-4,
            },
            adaptive_threshold={
                "initial_threshold": 2.0,
                "min_motion_th": 0.1,
                "fixed_threshold": None,
            },
        )
        package = require("kiss_icp.kiss_icp", extra="odometry", purpose='pose="kiss"')
        engine: Any = package.KissICP(chosen)
        self.map, self.threshold = engine.local_map, engine.adaptive_threshold
        self._engine, self._voxel, self._reach = engine, reach / VOXELS, reach

    def prepared(
        self, cloud: _Cloud, motion: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Points for the map and for registration, in the sensor frame at the end of the scan."""
        part = np.empty(0) if cloud.part is None else cloud.part
        near = self._engine.preprocessor.preprocess(cloud.points, part, motion)
        source, frame = self._engine.voxelize(near)
        return frame, source

    def coarsely_registered(
        self, source: NDArray[np.float64], guess: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Pose from which the registration starts if no motion is known yet."""
        mapping = require("kiss_icp.mapping", extra="odometry", purpose='pose="kiss"')
        coarse: Any = mapping.VoxelHashMap(
            voxel_size=COARSE * self._voxel, max_distance=self._reach, max_points_per_voxel=20
        )
        coarse.add_points(self.map.point_cloud())
        return self._align(source, guess, coarse)

    def registered(
        self, source: NDArray[np.float64], guess: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        return self._align(source, guess, self.map)

    def _align(
        self, source: NDArray[np.float64], guess: NDArray[np.float64], known: Any
    ) -> NDArray[np.float64]:
        sigma = self.threshold.get_threshold()
        pose = self._engine.registration.align_points_to_map(
            points=source,
            voxel_map=known,
            initial_guess=guess,
            max_correspondance_distance=3 * sigma,
            kernel=sigma,
        )
        return np.asarray(pose, np.float64)

    def share_near(self, source: NDArray[np.float64], pose: NDArray[np.float64]) -> float:
        """Share of a scan's points that lie in or beside a voxel of the map."""
        known = surrounding_keys(np.asarray(self.map.point_cloud(), np.float64), self._voxel)
        keys = cell_keys(source @ pose[:3, :3].T + pose[:3, 3], self._voxel)
        return float(np.isin(keys, known).mean()) if len(keys) else 0.0


def _usable(scan: Scan) -> _Cloud:
    points = np.asarray(scan.points, np.float64).reshape(-1, 3)
    is_point = np.isfinite(points).all(axis=1) & points.any(axis=1)
    if scan.no_return is not None:
        is_point &= ~scan.no_return.reshape(-1)
    points, stamp = points[is_point], scan.stamp_ns
    standing = _Cloud(stamp, points, None, stamp, stamp, np.array([stamp, stamp]))
    if scan.point_time_ns is None or not len(points):
        return standing
    every = scan.point_time_ns.reshape(-1)
    times = every[is_point]
    start, end = int(times.min()), int(times.max())
    if start == end:
        return standing
    span = np.array([min(stamp, int(every.min())), int(every.max())], np.int64)
    return _Cloud(stamp, points, (times - start) / (end - start), start, end, span)


def _part_of(motion: NDArray[np.float64], part: float) -> NDArray[np.float64]:
    """Scale a motion (4, 4) by `part`: its translation in proportion, its rotation on the arc."""
    if not part:
        return np.eye(4)
    end = quaternion_from_matrix(motion[None, :3, :3])
    scaled = np.eye(4)
    start = np.array([[0.0, 0.0, 0.0, 1.0]])
    scaled[:3, :3] = matrix_from_quaternion(slerp(start, end, np.array([part])))[0]
    scaled[:3, 3] = part * motion[:3, 3]
    return scaled


def _angle(motion: NDArray[np.float64]) -> float:
    return float(np.arccos(np.clip((np.trace(motion[:3, :3]) - 1) / 2, -1, 1)))


def _angles_from_rotation(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrix (3, 3) from a small rotation about the world axes to the angles of R = Rz Ry Rx."""
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    pitch = -np.arcsin(np.clip(rotation[2, 0], -1, 1))
    c, s = np.cos(yaw), np.sin(yaw)
    turns = np.array(
        [[c * np.cos(pitch), -s, 0], [s * np.cos(pitch), c, 0], [-np.sin(pitch), 0, 1.0]]
    )
    return np.linalg.pinv(turns, rcond=1e-3)


def placed_scans(
    scans: Iterable[Any], left_out: Counter[str], note: Callable[[str], None]
) -> Iterator[tuple[Any, Placed]]:
    """Yield the scans of one LiDAR with their poses; scans without a pose are counted.

    Warnings are also passed to `note`.
    """
    odometry, source = KissOdometry(note), iter(scans)
    held = list(islice(source, 1))
    if held:
        is_timed = held[0].point_time_ns is not None
        held.extend(islice(source, 1 if is_timed else HELD - 1))
        odometry.prepare(held)
    for scan in chain(held, source):
        placed = odometry.place(scan)
        if placed is None:
            left_out["KISS-ICP lost track"] += 1
        else:
            yield scan, placed
