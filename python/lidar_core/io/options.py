"""Options for reading a recording: conventions of its driver, and limits on its sizes."""

from typing import Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from lidar_core.config import Config
from lidar_core.io.rotations import pose_matrix, quaternion_from_angles
from lidar_core.messages import Pose

NS = 1_000_000_000
LONGEST = 9e9  # times in nanoseconds fit into 64 bits [s]


class ReadOptions(Config):
    """Options of `open_recording`; each reader uses the ones that its format needs."""

    no_return: Literal["auto", "zero", "nan", "max", "none"] = Field(
        default="auto",
        description="Mark of a ray without return, besides +inf in a 2D scan: zeros, NaN, in"
        " a 2D scan ranges of range_max or more (max), or nothing; auto decides by"
        " the first cloud with a mark, and for 2D scans by the share of rays with each"
        " mark so far (no unit).",
    )
    point_time: str = Field(
        default="auto",
        pattern=r"^(auto|none|[^:]+:(s|ms|us|ns):(start|end|absolute))$",
        examples=["auto", "none", "t:ns:start", "timestamp:s:absolute"],
        description="3D: time of each point as field:unit:reference, unit s, ms, us or ns,"
        " reference start, end (what the scan's own stamp marks) or absolute; auto detects it,"
        " none ignores it, in 2D scans too (no unit).",
    )
    metadata: str | None = Field(
        default=None, description="JSON file of an Ouster pcap, if not found beside it (no unit)."
    )
    destagger: bool = Field(
        default=False,
        description="Ouster: shift rows so that columns share an azimuth, not a time (no unit).",
    )
    returns: Literal["first", "second"] = Field(
        default="first",
        description="Ouster with two returns per beam: which one is read, in the order that the"
        " sensor sends them. A beam without second return is not a ray without return (no unit).",
    )
    velodyne_model: str | None = Field(
        default=None,
        description="Velodyne model as velodyne-decoder names it; else detected (no unit).",
    )
    scan_rate: float = Field(
        default=10.0,
        gt=0,
        le=1e5,
        description="Scans per second of a folder of files that carries no times, and of counted"
        " `stamps` [Hz].",
    )
    stamps: Literal["own", "recorded", "counted"] = Field(
        default="own",
        description="Times of scans and poses: their own stamps; recorded, the times at which they"
        " were stored, where stamps are zero, repeat or jump; or counted from zero at `scan_rate`"
        " (no unit).",
    )
    recover: bool = Field(
        default=False,
        description="MCAP: read the complete part of a file that was not closed, was cut, or"
        " has broken chunks. A folder with one scan per file: leave damaged files out. The lost"
        " part is reported (no unit).",
    )
    max_record_bytes: int = Field(
        default=64 * 2**20,
        gt=0,
        le=2**40,
        description="Largest message, decompressed chunk or file of a sequence [bytes]."
        " Source: limits table of SECURITY.md.",
    )
    max_unpacked_bytes: int = Field(
        default=64 * 2**30,
        gt=0,
        le=2**60,
        description="ROS 2 recordings whose files were compressed: their size unpacked, in the"
        " folder for temporary files [bytes]. Source: limits table of SECURITY.md.",
    )
    max_points: int = Field(
        default=4_000_000,
        gt=0,
        le=10**9,
        description="Most points or rays of one scan (no unit)."
        " Source: limits table of SECURITY.md.",
    )


class Span(Config):
    """Part of a recording, in seconds from its first stamp."""

    start: float = Field(
        default=0.0, ge=0, le=LONGEST, description="Start of the part that is used [s]."
    )
    end: float | None = Field(
        default=None, le=LONGEST, description="End of the part that is used [s]."
    )

    @field_validator("end")
    @classmethod
    def _end_follows_start(cls, end: float | None, known: ValidationInfo) -> float | None:
        start = known.data.get("start", 0.0)
        if end is not None and end <= start:
            raise ValueError(f"expected more than start, {start:g}")
        return end

    @property
    def is_whole(self) -> bool:
        """Return whether the whole recording is read."""
        return self.start == 0 and self.end is None

    def __str__(self) -> str:
        """Return the span as text."""
        end = "on" if self.end is None else f"to {self.end:g} s"
        return f"from {self.start:g} s {end}, counted from the first stamp"

    def holds(self, stamp_ns: int, first_ns: int) -> bool:
        """Return whether a time is inside the span of a recording that begins at `first_ns`.

        Without a start, earlier times are inside, too: the first message of a recording may be a
        transform that was sent ahead of its time.
        """
        is_early = self.start > 0 and stamp_ns - first_ns < round(self.start * NS)
        return not is_early and not self.is_past(stamp_ns, first_ns)

    def is_past(self, stamp_ns: int, first_ns: int) -> bool:
        """Return whether a time is after the end."""
        return self.end is not None and stamp_ns - first_ns > round(self.end * NS)


class PoseOptions(Span):
    """Options of `posed_scans`: which scans, and where the sensor's poses come from."""

    pose: str = Field(
        default="auto",
        description="auto: transforms, else odometry of the recording; static: the sensor does not"
        " move; kiss: KISS-ICP finds them from clouds on the way (extra odometry); anything else: a"
        " poses file, KITTI (12 numbers a line, one line per scan) or TUM"
        " (t x y z qx qy qz qw) (no unit).",
    )
    fixed_frame: str | None = Field(
        default=None, description="Frame of the map; default: root of the transform tree (no unit)."
    )
    cloud: str | None = Field(
        default=None, description="Topic of the scans; default: the only one (no unit)."
    )
    odom: str | None = Field(
        default=None,
        description="Topic of the poses, instead of the transforms; mountings still come from"
        " these. Poses without a child frame belong to the frame whose transforms"
        " have the same motion, else to the frame that the sensor is mounted on,"
        " else to the sensor (no unit).",
    )
    mounting: tuple[str, ...] = Field(
        default=(),
        description="Mountings of sensors that the recording does not contain, as texts"
        " PARENT FRAME x y z roll pitch yaw: FRAME is the frame of the scans,"
        " PARENT a frame with known poses; lengths in metres, angles in radians"
        " (no unit).",
    )
    max_gap: float = Field(
        default=1.0,
        gt=0,
        le=86_400,
        description="Longest time between two poses to interpolate over [s].",
    )
    max_extrapolation: float = Field(
        default=0.1,
        ge=0,
        le=86_400,
        description="Time for which the first pose holds before, and the last pose after, its"
        " own time [s].",
    )

    @field_validator("mounting")
    @classmethod
    def _mountings_can_be_read(cls, texts: tuple[str, ...]) -> tuple[str, ...]:
        for text in texts:
            mounting_of(text)
        return texts

    def mountings(self) -> list[Pose]:
        """The texts of `mounting` as static poses."""
        return [mounting_of(text) for text in self.mounting]


_MOUNTING = "expected texts PARENT FRAME x y z roll pitch yaw"


def mounting_of(text: str) -> Pose:
    """Parse a text PARENT FRAME x y z roll pitch yaw as a static pose.

    Raises
    ------
    ValueError
        The text has another form.
    """
    words = text.split()
    try:
        numbers = [float(word) for word in words[2:]]
    except ValueError as error:
        raise ValueError(f"{_MOUNTING}; in {text!r}: {error}") from None
    if len(numbers) != 6:
        raise ValueError(f"{_MOUNTING}; {text!r} has {len(numbers)} numbers, expected 6")
    x, y, z, roll, pitch, yaw = numbers
    if not np.isfinite([x, y, z, roll, pitch, yaw]).all():
        raise ValueError("expected finite numbers")
    matrix = pose_matrix(np.array([x, y, z]), quaternion_from_angles(roll, pitch, yaw))
    return Pose(0, words[0], words[1], matrix, is_static=True)
