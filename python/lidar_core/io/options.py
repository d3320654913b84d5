"""How to read a recording: conventions of its driver, and limits on what it may hold."""

from typing import Literal

from pydantic import Field

from lidar_core.config import Config


class ReadOptions(Config):
    """Options of `open_recording`; each reader uses those that concern its format."""

    no_return: Literal["auto", "zero", "nan", "none"] = Field(
        "auto",
        description="What marks a ray without return: rows of zeros, rows of NaN, or nothing;"
        " auto decides by the first scan that shows either (no unit).",
    )
    point_time: str = Field(
        "auto",
        pattern=r"^(auto|none|[^:]+:(s|ms|us|ns):(start|end|absolute))$",
        description="Time of each point as field:unit:reference, unit s, ms, us or ns, reference"
        " start, end (what the scan's own stamp marks) or absolute; auto detects it, none ignores"
        " it (no unit).",
    )
    metadata: str | None = Field(
        None, description="JSON file of an Ouster pcap, if not found beside it (no unit)."
    )
    destagger: bool = Field(
        False,
        description="Ouster: shift rows so that columns share an azimuth, not a time (no unit).",
    )
    velodyne_model: str | None = Field(
        None, description="Velodyne model as velodyne-decoder names it; else detected (no unit)."
    )
    scan_rate: float = Field(
        10.0,
        gt=0,
        description="Scans per second of a folder of files that carries no times [Hz].",
    )
    max_record_bytes: int = Field(
        64 * 2**20,
        gt=0,
        description="Largest message, decompressed chunk or file of a sequence [bytes]."
        " Source: limits table of SECURITY.md.",
    )
    max_points: int = Field(
        4_000_000,
        gt=0,
        description="Most points of one scan (no unit). Source: limits table of SECURITY.md.",
    )


class PoseOptions(Config):
    """Options of `posed_scans`: where the sensor's poses come from."""

    pose: str = Field(
        "auto",
        description="auto: transforms, else odometry of the recording; static: the sensor does not"
        " move; anything else: a poses file, KITTI (12 numbers a line, one line per scan) or TUM"
        " (t x y z qx qy qz qw) (no unit).",
    )
    fixed_frame: str | None = Field(
        None, description="Frame of the map; default: root of the transform tree (no unit)."
    )
    cloud: str | None = Field(
        None, description="Topic of the clouds; default: the only one (no unit)."
    )
    odom: str | None = Field(
        None, description="Topic of the poses, instead of the transforms (no unit)."
    )
    max_gap: float = Field(
        1.0, gt=0, description="Longest time between two poses to interpolate over [s]."
    )
    max_extrapolation: float = Field(
        0.1,
        ge=0,
        description="How long the first or last pose is held before or after its time [s].",
    )
