"""Scans with poses from a recording: one or several LiDARs, once or over and over."""

import heapq
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from types import TracebackType
from typing import Generic, Self

import numpy as np
from numpy.typing import NDArray

from lidar_core.errors import ConfigError
from lidar_core.io import PosedScan, PosedScans, PoseOptions, ReadOptions, open_recording
from lidar_core.io.recording import Recording
from lidar_core.io.scan_topics import NAMELESS
from lidar_core.io.stamp_unit import stamp_unit_note
from lidar_core.messages import Scan, ScanT
from lidar_core.util.reasons import first_of_kind

STAMP = attrgetter("scan.stamp_ns")
ROBOT = "robot"
"""Name in examples for the frame that LiDARs are mounted on."""
JUMP = 0.1
"""Way from the last place of a sensor to its first one from which on it is told [m]."""


@dataclass(frozen=True, slots=True)
class _Lidar(Generic[ScanT]):
    recording: Recording
    scans: PosedScans[ScanT]


class ScanSource(Generic[ScanT]):
    """Context manager that iterates over the posed scans of one recording in time order.

    Parameters
    ----------
    path : Path
        Recording.
    read : ReadOptions
        Options for reading it.
    pose : PoseOptions
        Source of the poses; its `cloud` is not used.
    clouds : sequence of str
        Topics of the LiDARs; empty for the only one. Each is read through a handle of its own.
    repeat : int
        Number of times that the recording is played: more than one opens the gate of the burn-in on
        recordings that are too short for it.
    sort : type
        `Scan` or `LaserScan`: the kind of scans to read.

    Raises
    ------
    ConfigError
        Several LiDARs without poses that give their mountings, a topic named twice, or an unknown
        topic.
    """

    def __init__(
        self,
        path: Path,
        read: ReadOptions,
        pose: PoseOptions,
        clouds: Sequence[str],
        repeat: int,
        sort: type[ScanT],
    ) -> None:
        if twice := [topic for topic, count in Counter(clouds).items() if count > 1]:
            raise ConfigError(
                f"topic {twice[0]!r}: expected once, it is given {clouds.count(twice[0])} times"
            )
        self._read = read
        self._repeat = repeat
        self._jump = 0.0
        self._left_out = Counter[str]()  # for want of a pose, in earlier turns
        self._stamps: dict[str, list[int]] = {}
        self._stack = ExitStack()
        self._lidars: list[_Lidar[ScanT]] = []
        with ExitStack() as stack:
            for cloud in clouds or (None,):
                recording = stack.enter_context(open_recording(path, read))
                chosen = pose.model_copy(update={"cloud": cloud})
                self._lidars.append(_Lidar(recording, PosedScans(recording, chosen, sort)))
            if len(clouds) > 1 and pose.pose == "static" and not pose.mounting:
                raise self._at_one_place()
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def __iter__(self) -> Iterator[PosedScan[ScanT]]:
        first_ns = last_ns = 0
        shift_ns = 0
        self._stamps.clear()
        first, last = dict[str, NDArray[np.float64]](), dict[str, NDArray[np.float64]]()
        self._left_out.clear()
        for turn in range(self._repeat):
            if turn:  # each turn counts from zero
                self._left_out = Counter(self.without_pose)
            for item in heapq.merge(*(lidar.scans for lidar in self._lidars), key=STAMP):
                if turn == 0:
                    last_ns = item.scan.stamp_ns
                    first_ns = last_ns if not self._stamps else first_ns
                    self._stamps.setdefault(item.scan.topic, []).append(last_ns)
                    last[item.scan.topic] = item.world_from_lidar.reshape(-1, 4, 4)[0, :3, 3]
                    first.setdefault(item.scan.topic, last[item.scan.topic])
                yield item if turn == 0 else _shifted(item, turn * shift_ns)
            if not self._stamps:
                return
            self._jump = max(float(np.linalg.norm(last[one] - first[one])) for one in first)
            most = max(map(len, self._stamps.values()))
            period = (last_ns - first_ns) // (most - 1) if most > 1 else 0
            shift_ns = last_ns - first_ns + (period or round(1e9 / self._read.scan_rate))

    def _at_one_place(self) -> ConfigError:
        """Error for several LiDARs without mountings; it names the option for each frame."""
        frames = dict.fromkeys(lidar.scans.first_frame() or "FRAME" for lidar in self._lidars)
        given = " ".join(f"mounting='{ROBOT} {frame} x y z roll pitch yaw'" for frame in frames)
        return ConfigError(
            "pose: static would put several LiDARs at one place; give the mounting of each, such as"
            f" {given}, or leave pose out and give the frame that they are mounted on with"
            " fixed_frame=FRAME"
        )

    @property
    def total(self) -> int | None:
        """Number of scans in all passes; None if the recording does not state it."""
        counts = [
            topic.count
            for lidar in self._lidars
            for topic in lidar.recording.topics()
            if topic.name == lidar.scans.cloud
        ]
        known = [count for count in counts if count is not None]
        return self._repeat * sum(known) if len(known) == len(self._lidars) else None

    @property
    def frame_id(self) -> str:
        """Frame that the poses are in."""
        return self._lidars[0].scans.fixed_frame

    @property
    def pose_source(self) -> str:
        """Return the source of the poses, in words."""
        return self._lidars[0].scans.source

    @property
    def format(self) -> str:
        """Format of the recording."""
        return self._lidars[0].recording.format

    @property
    def notes(self) -> list[str]:
        """Return the findings of the readers: defects, assumed conventions, skipped messages."""
        found = [lidar.recording.noticed() for lidar in self._lidars]
        rejected = Counter[str]()
        for item in found:
            rejected |= item.rejected
        texts = [note for item in found for note in item.notes]
        texts += [f"{topic}: {count} messages rejected" for topic, count in rejected.items()]
        for topic, stamps in self._stamps.items():
            if unit := stamp_unit_note(stamps):
                texts.append(f"{topic or NAMELESS}: {unit}")
        if self._repeat > 1 and self._jump > JUMP:
            texts.append(
                f"the recording is played {self._repeat} times, and the sensor jumps back by"
                f" {self._jump:.1f} m each time: tracks show what the jumps seem to move, too"
            )
        return list(dict.fromkeys(texts))

    @property
    def without_pose(self) -> dict[str, int]:
        """Scans left out because they have no pose, per reason.

        Reasons that differ only in their numbers, such as stamps, count as the first one.
        """
        total = Counter(self._left_out)
        for lidar in self._lidars:
            for reason, count in lidar.scans.without_pose.items():
                total[first_of_kind(total, reason)] += count
        return dict(total)


def _shifted(item: PosedScan[ScanT], shift_ns: int) -> PosedScan[ScanT]:
    """Return `item` with all its times later by `shift_ns` [ns]."""
    scan, stamps = replace(item.scan, stamp_ns=item.scan.stamp_ns + shift_ns), item.pose_stamps_ns
    if isinstance(scan, Scan) and scan.point_time_ns is not None:
        scan = replace(scan, point_time_ns=scan.point_time_ns + shift_ns)
    later = None if stamps is None else stamps + shift_ns
    return PosedScan(scan, item.world_from_lidar, later, item.pose_covariance)
