"""Scans in 3D or 2D with the sensor's pose, from transforms, odometry or a poses file."""

import warnings
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import ConfigError, FormatError, InputError, PoseFrameWarning, did_you_mean
from lidar_core.io.options import NS, PoseOptions
from lidar_core.io.poses.leaps import leap_notes
from lidar_core.io.poses.nameless import carrier_of
from lidar_core.io.poses.pose_files import read_poses
from lidar_core.io.poses.pose_frames import FrameMismatch, PoseFrameCheck, advice
from lidar_core.io.poses.pose_topics import is_odometry
from lidar_core.io.poses.tf_buffer import NoTransformError, TransformBuffer
from lidar_core.io.scan_topics import WORDS, listed, scan_topic
from lidar_core.messages import LaserScan, Pose, PosedScan, Scan, ScanT

if TYPE_CHECKING:
    from lidar_core.io.recording import Recording
    from lidar_core.io.records import Topic

WORLD_FRAME = "world"
AUTO, STATIC, KISS = "auto", "static", "kiss"
SOURCES = (AUTO, STATIC, KISS)
"""Sources of poses that are no files; the last one takes them from the scans themselves."""
MOST_POSES_PER_SCAN = 64
PAST_THE_END = 10
"""Scans in a row after the end of a span that end it: a single one may have a wrong stamp."""


class PosedScans(Generic[ScanT]):
    """Iterable of `PosedScan`; made by `posed_scans` and `posed_laser_scans`.

    Attributes
    ----------
    cloud : str
        Topic of the scans.
    fixed_frame : str
        Frame that the poses are in.
    source : str
        Source of the poses, in words.
    without_pose : Counter
        Number of scans that were left out, per reason.
    """

    def __init__(self, recording: "Recording", options: PoseOptions, sort: type[ScanT]) -> None:
        self._recording = recording
        self._options = options
        self._sort: type[ScanT] = sort
        self._cloud = scan_topic(recording, options.cloud, sort)
        self.cloud = self._cloud.name
        self.fixed_frame = options.fixed_frame or WORLD_FRAME
        self.source = options.pose
        self.without_pose: Counter[str] = Counter()
        self._from_quaternions = False
        self._moving: list[tuple[str, Pose]] = []

    def __iter__(self) -> Iterator[PosedScan[ScanT]]:
        self.without_pose.clear()
        if self._options.pose == STATIC:
            return self._standing()
        if self._options.pose == KISS:
            return self._by_odometry()
        is_file = self._options.pose != AUTO
        found = self._from_file(self._options.pose) if is_file else self._from_buffer()
        return found if self._sort is LaserScan else self._check_pose_frame(found)

    def _check_pose_frame(self, found: Iterator[PosedScan[ScanT]]) -> Iterator[PosedScan[ScanT]]:
        """Yield the scans unchanged, and warn if the first ones show poses in another frame."""
        check, frame = PoseFrameCheck(), ""
        for number, item in enumerate(found):
            if number == 0 and self._from_quaternions:
                check = PoseFrameCheck(self._mounted(item.scan.frame_id))
            if not check.is_done:
                poses, frame = item.world_from_lidar.reshape(-1, 4, 4), item.scan.frame_id
                scan: Any = item.scan
                if mismatch := check.add(scan.points, poses[len(poses) // 2]):
                    self._tell(mismatch, frame)
            yield item
        if mismatch := check.decide():
            self._tell(mismatch, frame)

    def _tell(self, mismatch: FrameMismatch, frame: str) -> None:
        text = advice(mismatch, frame=frame, source=self.source)
        self._recording.findings.note(text)
        warnings.warn(text, PoseFrameWarning, stacklevel=3)

    def _scans(self) -> Iterator[tuple[int, ScanT]]:
        """Yield the scans within the span, each with its index among all scans of the topic.

        Raises
        ------
        InputError
            None of them is within the span that was asked for.
        """
        span = self._options
        scans = enumerate(
            scan
            for record in self._recording.records(WORDS[self._sort].kinds)
            if record.topic.name == self._cloud.name
            for scan in record.decode()
            if isinstance(scan, self._sort)
        )
        if span.is_whole:
            yield from scans
            return
        first_ns = self._recording.first_stamp() or 0
        is_found, past, latest_ns = False, 0, first_ns
        for number, scan in scans:
            past = past + 1 if span.is_past(scan.stamp_ns, first_ns) else 0
            if past == PAST_THE_END:
                break
            latest_ns = max(latest_ns, scan.stamp_ns)
            if span.holds(scan.stamp_ns, first_ns):
                is_found = True
                yield number, scan
        if not is_found:
            latest = (latest_ns - first_ns) / NS
            raise InputError(f"{self._recording.path}: no scans {span}; they end at {latest:g} s")

    def first_frame(self) -> str:
        """Frame of the first scan; empty without scans."""
        return next((scan.frame_id for _, scan in self._scans()), "")

    def _standing(self) -> Iterator[PosedScan[ScanT]]:
        """Yield every scan with the same pose: that of the mounting, or the origin."""
        self.source = "static: the sensor does not move"
        buffer, frame = self._buffer(), ""
        world_from_lidar = np.eye(4)
        for _, scan in self._scans():
            if scan.frame_id != frame:
                frame = scan.frame_id
                root = buffer.root_of(frame)
                world_from_lidar = buffer.lookup(root, frame, [scan.stamp_ns])[0]
                if root != frame and self._options.fixed_frame is None:
                    self.fixed_frame = root
            yield PosedScan(scan, world_from_lidar)

    def _by_odometry(self) -> Iterator[PosedScan[ScanT]]:
        """Yield clouds with poses from KISS-ICP, in the frame of the end of the first scan."""
        if self._sort is not Scan:
            raise ConfigError(
                "pose: kiss works for clouds, not for 2D scans; give a poses file, or a topic of"
                " poses with odom=TOPIC"
            )
        from lidar_core.io.poses.odometry import placed_scans

        self.source = "KISS-ICP, in the frame of the first scan"
        clouds: Any = (scan for _, scan in self._scans())
        note = self._recording.findings.note
        for scan, placed in placed_scans(clouds, self.without_pose, note):
            yield PosedScan(scan, placed.poses, placed.stamps_ns, placed.covariance)

    def _from_file(self, pose: str) -> Iterator[PosedScan[ScanT]]:
        path = Path(pose)
        if not path.exists():
            near = did_you_mean(pose, SOURCES)
            raise FileNotFoundError(f"{path}: no such poses file{near}")
        stamps, matrices = read_poses(path)
        self.source = f"{path}, {len(matrices)} poses"
        self._from_quaternions = stamps is not None
        if stamps is not None:
            buffer = self._buffer()
            frame = self.first_frame() if self._options.mounting else ""
            carrier = self._carrier(frame)
            for stamp, matrix in zip(stamps.tolist(), matrices, strict=True):
                buffer.add(Pose(stamp, WORLD_FRAME, carrier, matrix))
            yield from self._looked_up(buffer, WORLD_FRAME, frame)
            return
        stated = self._cloud.count
        if stated is not None and self._options.end is None:
            self._check_count(path, len(matrices), stated)
        mountings = {item.child_frame_id: item.matrix for item in self._options.mountings()}
        count = 0
        for number, scan in self._scans():
            if number >= len(matrices):
                raise FormatError(f"{path}: {len(matrices)} poses for a recording of more scans")
            mounted = mountings.get(scan.frame_id, np.eye(4))
            yield PosedScan(scan, matrices[number] @ mounted)
            count = number + 1
        if self._options.end is None:
            self._check_count(path, len(matrices), count)

    def _check_count(self, path: Path, poses: int, scans: int) -> None:
        """Refuse a poses file whose number of poses is not that of the scans."""
        if poses != scans:
            raise FormatError(f"{path}: {poses} poses for {scans} scans of {self._recording.path}")

    def _from_buffer(self) -> Iterator[PosedScan[ScanT]]:
        frame = self.first_frame()
        buffer = self._fill_buffer(frame)
        root = self._options.fixed_frame or buffer.root_of(frame)
        try:
            is_static = root == frame or buffer.is_static(root, frame)
        except NoTransformError as error:
            raise self._missing(frame, buffer, str(error)) from error
        if root == frame or (is_static and self._options.fixed_frame is None):
            raise self._missing(frame, buffer, f"nothing moves {frame!r}")
        self.fixed_frame = root
        self.source = f"transforms {root} -> {frame}"
        self._tell_leaps(buffer, root, frame)
        return self._looked_up(buffer, root, frame)

    def _looked_up(
        self, buffer: TransformBuffer, root: str, frame: str
    ) -> Iterator[PosedScan[ScanT]]:
        given = 0
        for _, scan in self._scans():
            stamps = pose_stamps(scan, buffer, root, frame)
            try:
                poses = buffer.lookup(root, frame, stamps)
            except NoTransformError as error:
                self.without_pose[str(error)] += 1
                continue
            given += 1
            single = len(stamps) == 1
            yield PosedScan(scan, poses[0] if single else poses, None if single else stamps)
        if given == 0:
            reason = next(iter(self.without_pose), "no scans")
            raise self._missing(frame, buffer, f"no scan has a pose: {reason}")

    def _buffer(self) -> TransformBuffer:
        options = self._options
        buffer = TransformBuffer(
            max_gap=options.max_gap, max_extrapolation=options.max_extrapolation
        )
        for mounting in options.mountings():
            buffer.add(mounting)
        return buffer

    def _carrier(self, frame: str) -> str:
        """Parent frame of the stated mounting of `frame`; `frame` itself without a mounting."""
        parents = {item.child_frame_id: item.frame_id for item in self._options.mountings()}
        return parents.get(frame, frame)

    def _mounted(self, frame: str) -> NDArray[np.float64]:
        """Pose of `frame` in the frame of the stated poses: `carrier_from_lidar` (4, 4)."""
        carrier = self._carrier(frame)
        return self._buffer().lookup(carrier, frame, [0])[0] if carrier != frame else np.eye(4)

    def _fill_buffer(self, frame: str) -> TransformBuffer:
        """Collect the poses of the recording: transforms; odometry if asked for or needed."""
        gathered = list(self._recording.poses())
        odometry = [item for item in gathered if is_odometry(item[0])]
        topics = sorted({topic.name for topic, _ in odometry})
        chosen = self._options.odom
        if chosen is not None and chosen not in {topic.name for topic, _ in gathered}:
            raise ConfigError(
                f"odom: no topic {chosen!r} with poses; found {listed(topics)}"
                f"{did_you_mean(chosen, topics)}"
            )
        transforms = [item for item in gathered if not is_odometry(item[0])]
        if chosen is None:
            buffer = self._with(transforms)
            root = self._options.fixed_frame or buffer.root_of(frame)
            if _moves(buffer, root, frame) or len(topics) != 1:
                return buffer
            chosen = topics[0]
        known = [pose for _, pose in transforms]
        fixed = [item for item in transforms if item[1].is_static]
        moving = [item for item in gathered if item[0].name == chosen]
        if nameless := [pose for _, pose in moving if not pose.child_frame_id]:
            mountings = self._options.mountings()
            carrier = carrier_of(frame, nameless, known, mountings, chosen)
            moving = [
                (topic, pose if pose.child_frame_id else replace(pose, child_frame_id=carrier))
                for topic, pose in moving
            ]
        return self._with(fixed + moving)

    def _with(self, poses: Iterable[tuple["Topic", Pose]]) -> TransformBuffer:
        """Fill a buffer; `_moving` keeps what moves, to look for two bodies under one name."""
        buffer = self._buffer()
        self._moving = []
        for topic, pose in poses:
            buffer.add(pose)
            if not pose.is_static:
                self._moving.append((topic.name, pose))
        return buffer

    def _tell_leaps(self, buffer: TransformBuffer, root: str, frame: str) -> None:
        """Note transforms on the way from `root` to `frame` that are those of two bodies."""
        used = buffer.edges_between(root, frame)
        moving, self._moving = self._moving, []
        for text in leap_notes(
            item for item in moving if (item[1].frame_id, item[1].child_frame_id) in used
        ):
            self._recording.findings.note(text)
            warnings.warn(text, PoseFrameWarning, stacklevel=3)

    def _missing(self, frame: str, buffer: TransformBuffer, reason: str) -> FormatError:
        edges = [f"{parent} -> {child}" for parent, child in buffer.edges()]
        odometry = [t.name for t in self._recording.topics() if is_odometry(t)]
        moving = [child for (_, child), is_static in buffer.edges().items() if not is_static]
        mounting = f"'{moving[0]} {frame} x y z roll pitch yaw'" if moving else "..."
        cures = ["a frame with fixed_frame=FRAME"] if edges else []
        if odometry and self._options.odom is None:
            cures.append("a topic with odom=TOPIC")
        cures.append("a poses file with pose=FILE")
        if self._sort is Scan:
            cures.append('poses from the scans with pose="kiss"')
        if edges or odometry:
            cures.append(f"the mounting of the sensor with mounting={mounting}")
        return FormatError(
            f"{self._recording.path}: no pose for frame {frame!r} of topic {self._cloud.name!r}:"
            f" {reason}. Found transforms: {listed(edges)}; odometry topics: {listed(odometry)}."
            f" Give one of: {', '.join(cures)}, or"
            ' pose="static" for a sensor that does not move'
        )


def posed_scans(
    recording: "Recording", options: PoseOptions | None = None, **values: Any
) -> PosedScans[Scan]:
    """Return the clouds of one topic with the sensor's poses.

    Parameters
    ----------
    recording : Recording
        Open recording; it is read twice, first for its poses.
    options : PoseOptions, optional
        Source of the poses.
    **values
        Single fields of `PoseOptions`, such as pose, cloud or start; they override `options`.

    Returns
    -------
    scans : PosedScans
        Iterator over the scans; scans outside the poses' time are left out and counted.

    Raises
    ------
    FormatError
        There are no poses (while iterating); the text states what was found and which option helps.
    InputError
        No scans within the span that was asked for (while iterating).
    ConfigError
        The topic does not exist, or none is named and there are several.
    """
    return PosedScans(recording, _merge_options(options, values), Scan)


def posed_laser_scans(
    recording: "Recording", options: PoseOptions | None = None, **values: Any
) -> PosedScans[LaserScan]:
    """Return the 2D scans of one topic with the sensor's poses; otherwise as `posed_scans`."""
    return PosedScans(recording, _merge_options(options, values), LaserScan)


def _merge_options(options: PoseOptions | None, values: dict[str, Any]) -> PoseOptions:
    given = options.model_dump() if options is not None else {}
    return PoseOptions(**(given | values))


def _moves(buffer: TransformBuffer, root: str, frame: str) -> bool:
    try:
        return root != frame and not buffer.is_static(root, frame)
    except NoTransformError:
        return False


def span_ns(scan: Scan | LaserScan) -> tuple[int, int]:
    """Times of the first and the last ray [ns]."""
    if isinstance(scan, LaserScan):
        return scan.stamp_ns, scan.stamp_ns + scan.time_increment_ns * (len(scan.ranges) - 1)
    if scan.point_time_ns is None or scan.point_time_ns.size == 0:
        return scan.stamp_ns, scan.stamp_ns
    start = min(scan.stamp_ns, int(scan.point_time_ns.min()))
    return start, int(scan.point_time_ns.max())


def pose_stamps(
    scan: Scan | LaserScan, buffer: TransformBuffer, root: str, frame: str
) -> NDArray[np.int64]:
    """Times at which poses are needed: start and end of the scan, and recorded poses between."""
    start, end = span_ns(scan)
    if end <= start:
        return np.array([start], np.int64)
    inside = buffer.knots(root, frame, start, end)
    if len(inside) > MOST_POSES_PER_SCAN:
        inside = np.linspace(start, end, MOST_POSES_PER_SCAN).astype(np.int64)[1:-1]
    return np.unique(np.concatenate([[start], inside, [end]])).astype(np.int64)
