"""Poses of a stream, and scans that wait for their poses."""

from collections import Counter
from collections.abc import Callable

import numpy as np

from lidar_core.errors import ConfigError
from lidar_core.io import NoTransformError, PosedScan, PoseOptions, TransformBuffer
from lidar_core.io.poses.nameless import LOOKED_AT, carrier_of, same_movement
from lidar_core.io.poses.pose_topics import is_odometry
from lidar_core.io.poses.posed import KISS, SOURCES, WORLD_FRAME, pose_stamps, span_ns
from lidar_core.io.records import Topic
from lidar_core.io.scan_topics import listed
from lidar_core.live.config import MAX_FRAMES, POSE_HISTORY, LiveConfig
from lidar_core.live.scan_odometry import ScanOdometry
from lidar_core.messages import Pose, ScanT

__all__ = ["LivePoses"]

SOON_NS = 5_000_000_000
"""Odometry of two topics is ambiguous if both begin within this time [ns]."""
FEWEST_POSES = 2
"""A topic has odometry if it has at least this number of poses."""


class LivePoses:
    """Poses of the sensor from transforms and odometry of a stream.

    Recordings are read twice, a stream is not: the source of the poses is chosen with the first
    scan that has one, and kept. Transforms have priority; odometry is used if they contain no
    motion and one topic has odometry.

    Parameters
    ----------
    options : PoseOptions
        Source of the poses: auto, static, or kiss for the scans themselves.
    config : LiveConfig
        Time for which they are kept.

    Attributes
    ----------
    fixed_frame : str
        Frame that poses are given in, once the first scan has one.
    on_note : callable
        Called with the text of every warning of the odometry.
    dropped : Counter
        Poses of more frames than are kept, by topic.

    Raises
    ------
    ConfigError
        The options name a file.
    MissingExtraError
        kiss-icp is needed and not installed.
    """

    def __init__(self, options: PoseOptions, config: LiveConfig) -> None:
        if options.pose not in SOURCES:
            raise ConfigError(
                f"pose: expected auto, static or kiss for a live stream, got {options.pose!r};"
                " replay recordings that need a poses file with: lidar-core detect, lidar-core"
                " circles"
            )
        self._kiss = ScanOdometry(self._note) if options.pose == KISS else None
        self._options, self._config = options, config
        self._mountings = options.mountings()
        self._transforms = self._buffer()
        self._odometry: dict[str, TransformBuffer] = {}
        self._static: dict[tuple[str, str], Pose] = {}
        self._carriers: dict[str, str] = {}
        self._nameless: dict[str, list[Pose]] = {}
        self._chosen: tuple[TransformBuffer, str] | None = None
        self._began: dict[str, int] = {}
        self._counts: Counter[str] = Counter()
        self.fixed_frame = options.fixed_frame or WORLD_FRAME
        self.on_note: Callable[[str], object] = lambda text: None
        self.dropped: Counter[str] = Counter()

    def _note(self, text: str) -> None:
        self.on_note(text)

    def add(self, topic: Topic, pose: Pose, carried_frame: str) -> None:
        """Add a pose; without child frame it belongs to what carries `carried_frame`.

        Raises
        ------
        ConfigError
            Several frames carry it, and the stream does not state which one is meant; or a second
            topic has odometry soon after the first one, which is already used.
        """
        if is_odometry(topic) or topic.name == self._options.odom:
            self._add_odometry(topic.name, pose, carried_frame)
            return
        is_kept = self._add_to(self._transforms, topic.name, pose)
        if pose.is_static and is_kept:
            is_new = (pose.frame_id, pose.child_frame_id) not in self._static
            self._static[pose.frame_id, pose.child_frame_id] = pose
            if is_new and self._chosen is None:
                for name in self._carriers:  # what carries the sensor may be another frame now
                    self._odometry.pop(name, None)
                self._carriers.clear()
            for buffer in self._odometry.values():
                self._add_to(buffer, topic.name, pose)

    def is_complete(self, scan: ScanT) -> bool:
        """True if every pose that a scan needs is known, so that waiting is of no use."""
        if self._options.pose == "static" or self._kiss is not None:
            return True
        try:
            buffer, root = self._chosen or self._choice(scan.frame_id)
            until = buffer.known_until(root, scan.frame_id)
        except NoTransformError:
            return False
        return until is None or until >= span_ns(scan)[1]

    def posed(self, scan: ScanT) -> PosedScan[ScanT]:
        """Return `scan` with the sensor's poses; poses older than the history are dropped.

        Raises
        ------
        NoTransformError
            There is no pose; the text states what is missing.
        ConfigError
            KISS-ICP is given 2D scans, or those of a second LiDAR.
        """
        if self._kiss is not None:
            return self._kiss.posed(scan)
        if self._options.pose == "static":
            return self._standing(scan)
        buffer, root = self._chosen or self._choice(scan.frame_id)
        stamps = pose_stamps(scan, buffer, root, scan.frame_id)
        poses = buffer.lookup(root, scan.frame_id, stamps)
        self._chosen, self.fixed_frame = (buffer, root), root
        self._forget(scan.stamp_ns)
        is_single = len(stamps) == 1
        return PosedScan(scan, poses[0] if is_single else poses, None if is_single else stamps)

    def _standing(self, scan: ScanT) -> PosedScan[ScanT]:
        """Return a scan with a static pose: that of its sensor's mounting, or the origin."""
        if self._chosen is None:
            root = self._transforms.root_of(scan.frame_id)
            self._chosen = self._transforms, root
            if root != scan.frame_id and self._options.fixed_frame is None:
                self.fixed_frame = root
        buffer, root = self._chosen
        try:
            return PosedScan(scan, buffer.lookup(root, scan.frame_id, [scan.stamp_ns])[0])
        except NoTransformError:  # a second sensor without a mounting
            return PosedScan(scan, np.eye(4))

    def _choice(self, frame: str) -> tuple[TransformBuffer, str]:
        """Return the buffer of poses in which `frame` moves, and the fixed frame."""
        self._settle_nameless(frame)
        for buffer in self._candidates():
            root = self._options.fixed_frame or buffer.root_of(frame)
            if self._moves(buffer, root, frame):
                return buffer, root
        several = self._with_odometry()
        if len(several) > 1 and self._options.odom is None:
            raise _ambiguous(several)
        raise NoTransformError(self._missing(frame))

    def _candidates(self) -> list[TransformBuffer]:
        """Buffers to try: the named odometry; else transforms, then odometry if only one exists."""
        wanted = self._options.odom
        if wanted is not None:
            return [self._odometry[wanted]] if wanted in self._odometry else []
        names = self._with_odometry() if len(self._odometry) > 1 else list(self._odometry)
        return [self._transforms, *(self._odometry[name] for name in names if len(names) == 1)]

    def _with_odometry(self) -> list[str]:
        """Topics with more than a single pose."""
        return [name for name in self._odometry if self._counts[name] >= FEWEST_POSES]

    def _moves(self, buffer: TransformBuffer, root: str, frame: str) -> bool:
        try:
            is_static = buffer.is_static(root, frame)
        except NoTransformError:
            return False
        return root != frame and (not is_static or self._options.fixed_frame is not None)

    def _missing(self, frame: str) -> str:
        edges = sorted(f"{parent} -> {child}" for parent, child in self._transforms.edges())
        return (
            f"no pose for frame {frame!r}; transforms: {', '.join(edges) or 'none'}; odometry:"
            f" {', '.join(sorted(self._odometry)) or 'none'} (odom=TOPIC, fixed_frame=FRAME,"
            ' mounting=..., or pose="static" for a sensor that does not move)'
        )

    def _add_odometry(self, topic: str, pose: Pose, carried_frame: str) -> None:
        is_new = topic not in self._odometry
        if is_new and len(self._odometry) >= MAX_FRAMES:
            self.dropped[topic] += 1
            return
        if is_new:
            self._odometry[topic] = self._buffer()
            for fixed in self._static.values():
                self._odometry[topic].add(fixed)
        self._compare_with_chosen(topic, pose.stamp_ns)
        child = pose.child_frame_id or self._carrier(topic, pose, carried_frame)
        carried = Pose(pose.stamp_ns, pose.frame_id, child, pose.matrix)
        self._add_to(self._odometry[topic], topic, carried)

    def _compare_with_chosen(self, topic: str, stamp_ns: int) -> None:
        """Refuse a second topic of odometry that begins soon after the one in use; note others.

        One pose alone, such as a goal, is no odometry.
        """
        self._counts[topic] += 1
        self._began.setdefault(topic, stamp_ns)
        of_topics = {id(buffer): name for name, buffer in self._odometry.items()}
        used = of_topics.get(id(self._chosen[0])) if self._chosen is not None else None
        is_second = self._counts[topic] == FEWEST_POSES
        if used is None or used == topic or self._options.odom is not None or not is_second:
            return
        if abs(self._began[topic] - self._began[used]) <= SOON_NS:
            raise _ambiguous([used, topic])
        self._note(f"topic {topic!r} has odometry, too; that of {used!r} stays in use (odom=TOPIC)")

    def _carrier(self, topic: str, pose: Pose, frame: str) -> str:
        """Return the frame of a pose that names none; it is the same for all poses of the topic."""
        if not frame:  # no scan yet
            return frame
        early = self._nameless.setdefault(topic, [])
        if len(early) < LOOKED_AT:
            early.append(pose)
        if topic not in self._carriers:
            known, stated = self._static.values(), self._mountings
            self._carriers[topic] = carrier_of(frame, [pose], known, stated, topic)
        return self._carriers[topic]

    def _settle_nameless(self, frame: str) -> None:
        """Drop odometry that was assigned to the sensor but has the motion of another frame."""
        if frame in {item.child_frame_id for item in self._mountings}:
            return
        for topic, poses in self._nameless.items():
            same = same_movement(poses, self._transforms)
            if same is not None and same != self._carriers.get(topic):
                self._carriers[topic] = same
                self._odometry.pop(topic, None)

    def _add_to(self, buffer: TransformBuffer, topic: str, pose: Pose) -> bool:
        """Add a pose, unless there are too many pairs of frames; return whether it was added."""
        edges = buffer.edges()
        is_new = (pose.frame_id, pose.child_frame_id) not in edges
        if is_new and len(edges) >= MAX_FRAMES:
            self.dropped[topic] += 1
            return False
        buffer.add(pose)
        return True

    def _buffer(self) -> TransformBuffer:
        options = self._options
        buffer = TransformBuffer(
            max_gap=options.max_gap, max_extrapolation=options.max_extrapolation
        )
        for mounting in self._mountings:
            buffer.add(mounting)
        return buffer

    def _forget(self, stamp_ns: int) -> None:
        oldest_ns = stamp_ns - round(POSE_HISTORY * 1e9)
        for buffer in (self._transforms, *self._odometry.values()):
            buffer.forget(oldest_ns)


def _ambiguous(topics: list[str]) -> ConfigError:
    options = " or ".join(f"odom={topic!r}" for topic in topics)
    return ConfigError(
        f"odom: topics {listed(topics)} have odometry; name that of the robot with {options}"
    )


def __dir__() -> list[str]:
    return __all__
