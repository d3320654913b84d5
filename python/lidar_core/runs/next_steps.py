"""Suggested commands for a recording, tried out up to the first scan with a pose."""

import shlex
import warnings
from collections.abc import Iterator
from typing import NamedTuple

from lidar_core.errors import LidarCoreError, PoseFrameWarning
from lidar_core.io import PosedScans, PoseOptions, ReadOptions, RecordingInfo, TopicInfo
from lidar_core.io.hints import RECOVERED
from lidar_core.io.poses.nameless import UnclearCarrierError
from lidar_core.io.poses.pose_topics import is_odometry
from lidar_core.io.recording import Recording
from lidar_core.io.records import POSE_KINDS, SCAN_KINDS, Record, Topic
from lidar_core.io.restamped import RestampedRecording
from lidar_core.io.scan_topics import NAMELESS
from lidar_core.messages import LaserScan, Pose, Scan

COMMANDS = (
    ("detect", "--cloud", ("scan", "scan+pose")),
    ("circles", "--scan", ("planar", "planar+pose")),
)
"""What goes on from a recording: command, option of its topic, kinds of topics."""
RADAR = "radar_msgs/"
TRIED_S = 20.0
"""How much of a recording is looked at for a scan with a pose [s]."""
AT_ORIGIN = "0 0 0 0 0 0"
STANDS = {"detect": "--pose kiss, or --pose FILE", "circles": "--pose FILE"}
"""Poses of a sensor that moved, where the recording has none."""
PLACED = "x y z roll pitch yaw"
MOUNTED = f"zeros: the sensor sits at the origin of {{}}; else put {PLACED}, in m and rad"
MOST_OTHERS = 3
"""Topics that are named beside the one of a command."""

UNCLEAR = "if the poses are those of {}: the recording does not say"


class _Try(NamedTuple):
    """Options that may give poses to the scans, and a remark about them."""

    values: dict[str, str]
    remark: str = ""

    def words(self) -> list[str]:
        return [word for name, value in self.values.items() for word in (f"--{name}", value)]


def next_steps(recording: Recording, info: RecordingInfo) -> Iterator[str]:
    """Return commands for an open recording, with the options that it needs.

    They include the options that the user gave for reading.
    """
    read = _read_options(recording.options)
    if recording.options.recover:
        if not any(topic.count for topic in info.topics if topic.kind in SCAN_KINDS | POSE_KINDS):
            return
        words = ["lidar-core", "convert", info.path, RECOVERED, *read, "--recover"]
        yield f"{shlex.join(words)}  (then go on with {RECOVERED})"
        return
    for command, option, kinds in COMMANDS:
        topics = [topic for topic in info.topics if topic.kind in kinds]
        if not topics:
            continue
        topic = max(topics, key=lambda one: one.points or 0)
        choice = [option, topic.name] if len(topics) > 1 else []
        stamps = info.stamps.get(topic.name)
        times = [] if stamps is None else ["--stamps", stamps]
        poses, remark = _poses(recording, info, topic, stamps)
        remarks = [one for one in (remark, _others(topics, topic, option, poses)) if one]
        own = [
            word
            for pair in zip(read[::2], read[1::2], strict=True)
            for word in pair
            if command == "detect" or pair[0] != "--metadata"
        ]
        line = _command_line(command, info.path, *choice, *own, *times, *poses)
        yield f"{line}  ({'; '.join(remarks)})" if remarks else line
    if any(topic.type.startswith(RADAR) for topic in info.topics):
        yield _command_line("fuse", info.path)


def _command_line(command: str, path: str, *options: str) -> str:
    return shlex.join(["lidar-core", command, path, "-o", "run/", *options])


def _read_options(options: ReadOptions) -> list[str]:
    """Read options that differ from the defaults, as words of a command line."""
    names = ("no_return", "point_time", "metadata", "stamps", "scan_rate")
    defaults = type(options)()
    given = {
        name: getattr(options, name)
        for name in names
        if getattr(options, name) != getattr(defaults, name)
    }
    return [
        word
        for name, value in given.items()
        for word in (f"--{name.replace('_', '-')}", f"{value}")
    ]


def _poses(
    recording: Recording, info: RecordingInfo, topic: TopicInfo, stamps: str | None
) -> tuple[list[str], str]:
    """Find options that give poses to the scans of a topic; return them with a remark."""
    if "pose" in topic.kind and _tried(recording, topic, _Try({})) is True:
        return [], ""
    if stamps is not None:
        chosen = recording.options.model_copy(update={"stamps": stamps})
        recording = RestampedRecording(recording, chosen)
    recording, tries = _Remembered(recording), list(_tries(info, topic))
    while tries:
        one = tries.pop(0)
        found = _tried(recording, topic, one)
        if isinstance(found, list):
            tries[:0] = [
                _Try({**one.values, "mounting": text}, UNCLEAR.format(text.split()[0]))
                for text in found
            ]
        elif found:
            return one.words(), one.remark
    command = "circles" if topic.kind.startswith("planar") else "detect"
    return ["--pose", "static"], f"if the sensor moved: {STANDS[command]}"


def _others(topics: list[TopicInfo], chosen: TopicInfo, option: str, poses: list[str]) -> str:
    """Remark on the topics with scans that a command leaves out; empty if there are none."""
    names = sorted(one.name or NAMELESS for one in topics if one is not chosen)
    if not names:
        return ""
    more = [f"{len(names) - MOST_OTHERS} more"] if len(names) > MOST_OTHERS else []
    mounting = f", each with --mounting 'robot FRAME {PLACED}'" if "static" in poses else ""
    listed = ", ".join([*names[:MOST_OTHERS], *more])
    return f"left out: {listed}; {option} can be repeated{mounting}"


class _Remembered(Recording):
    """Recording that reads its poses only once, even if many options are tried."""

    def __init__(self, recording: Recording) -> None:
        super().__init__(recording.path, recording.options)
        self._recording, self.format = recording, recording.format
        self.has_arrivals = recording.has_arrivals
        self._poses: list[tuple[Topic, Pose]] | None = None

    def topics(self) -> list[Topic]:
        """Streams of the recording."""
        return self._recording.topics()

    def records(self, kinds: frozenset[str] | None = None) -> Iterator[Record]:
        """Yield the stored messages."""
        return self._recording.records(kinds)

    def poses(self) -> Iterator[tuple[Topic, Pose]]:
        """Yield only the poses, which are read once."""
        if self._poses is None:
            self._poses = list(self._recording.poses())
        return iter(self._poses)


def _tries(info: RecordingInfo, topic: TopicInfo) -> Iterator[_Try]:
    """Yield options to try: none, each odometry topic, a mounting on each moving frame."""
    moving = [child for _, child, is_static in info.transforms if not is_static]
    if not moving:
        return
    yield _Try({})
    named_topics = [one for one in info.topics if one.kind == "pose" and one.name]
    yield from (_Try({"odom": one.name}) for one in named_topics if not _has_transforms(one))
    if topic.frames:
        named = [child for child in moving if child and child not in topic.frames]
        yield from (
            _Try({"mounting": f"{child} {topic.frames[0]} {AT_ORIGIN}"}, MOUNTED.format(child))
            for child in named
        )
    # A transform without a name is that of the sensor only if nothing else can be.
    yield from (_Try({"odom": one.name}) for one in named_topics if _has_transforms(one))


def _has_transforms(topic: TopicInfo) -> bool:
    return not is_odometry(Topic(topic.name, topic.type, "pose"))


def _tried(recording: Recording, topic: TopicInfo, one: _Try) -> bool | list[str]:
    """Return whether scans get poses with these options, or the mountings to choose from."""
    is_planar = topic.kind.startswith("planar")
    values = {name: (value,) if name == "mounting" else value for name, value in one.values.items()}
    options = PoseOptions.load({**values, "cloud": topic.name, "end": TRIED_S})
    try:
        scans: PosedScans[LaserScan] | PosedScans[Scan] = (
            PosedScans(recording, options, LaserScan)
            if is_planar
            else PosedScans(recording, options, Scan)
        )
        with warnings.catch_warnings():
            warnings.simplefilter("error", PoseFrameWarning)
            return next(iter(scans), None) is not None
    except UnclearCarrierError as error:
        return error.mountings
    except (LidarCoreError, PoseFrameWarning):  # the poses are wrong, and a note says so
        return False
