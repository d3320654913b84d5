"""Configuration of the tracker of many targets."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from lidar_core.config import Config
from lidar_core.fusion.config import FusionConfig

Density = Annotated[float, Field(gt=0, le=1e6)]


class MultiTargetConfig(Config):
    """Tracks of many targets from scans of LiDAR and radar.

    Source: Bar-Shalom, Li & Kirubarajan, "Estimation with Applications to Tracking and Navigation",
    2001; Blackman & Popoli, "Design and Analysis of Modern Tracking Systems", 1999; Fortmann,
    Bar-Shalom & Scheffe, "Sonar tracking of multiple targets using joint probabilistic data
    association", 1983; Musicki & Evans, "Joint integrated probabilistic data association: JIPDA",
    2004; Musicki, Evans & Stankovic, "Integrated probabilistic data association", 1994, whose
    second Markov chain separates hidden targets from targets that do not exist.
    """

    removed: ClassVar[Mapping[str, str]] = {
        "lidar_clutter": "write it as the first value of clutter",
        "radar_clutter": "write it as the second value of clutter",
    }
    target: FusionConfig = Field(
        default=FusionConfig(
            method="imm",
            imm_models=("cv", "standing"),
            imm_quiet=0.1,
            acceleration_noise=1.0,
            start_rows=1,
            initial_speed=15.0,
        ),
        description="The filter of each target; its gate decides which measurements may be one's,"
        " its `buffer_time` how late scans may come. `loss_ratio` and `sensor_noise` are not"
        " used: a lost track ends, and noise is as configured. With association integrated,"
        " `initial_speed` is the first guess: speeds of tracks teach better.",
    )
    confirm_hits: int = Field(
        default=3,
        ge=1,
        le=64,
        description="Scans of the last `confirm_window` that must have measured a track before it"
        " is confirmed, for associations nearest and joint (count, no unit).",
    )
    confirm_window: int = Field(
        default=5,
        ge=1,
        le=64,
        description="Scans looked back on for that, of scanners that have measured the track"
        " (count, no unit).",
    )
    max_coast: float = Field(
        default=2.0,
        gt=0,
        le=600,
        description="A track ends when it has not been measured for longer, for associations"
        " nearest and joint [s].",
    )
    max_position_std: float = Field(
        default=5.0,
        gt=0,
        le=1e4,
        description="A track ends when the standard deviation of its x or y is larger [m].",
    )
    birth_distance: float = Field(
        default=0.0,
        ge=0,
        le=1000,
        description="Least distance of a new track from a track that the same scan measured:"
        " parts of an object are not objects [m]. With associations nearest and joint, a track may"
        " start abeam of one that moves, from 0.5 times this distance on. A track that moves along"
        " ahead or astern of one with more measurements, up to 1.5 times this distance along and"
        " 0.6 times across, is a part of it and not reported. Half of the spread of the"
        " measurements within this distance of a track, and up to 0.25 times as far abeam, is added"
        " to the covariance of its reported position.",
    )
    report_speed: float = Field(
        default=0.0,
        ge=0,
        le=1e3,
        description="Least mean speed over the last 15 s of a reported track [m/s]: against"
        " static clutter, where targets always move. Places with measurements"
        " again and again for more than 10 s then count as clutter; 0 switches"
        " both off.",
    )

    association: Literal["integrated", "nearest", "joint"] = Field(
        default="integrated",
        description="Assignment of measurements within gates: to all near tracks, each with"
        " its probability, where each track has a probability of existence"
        " (JIPDA); or to the nearest track, over all distances together (global"
        " nearest neighbours); or to all near ones, confirmed by counts (JPDA) (no"
        " unit).",
    )
    detection_probability: float = Field(
        default=0.9,
        gt=0,
        lt=1,
        description="Probability that a scan measures a target, for associations joint and"
        " integrated (no unit); with integrated only the first guess, as `clutter`: scans teach"
        " better.",
    )

    clutter: tuple[Density, Density] = Field(
        default=(1e-3, 1e-3),
        description="Densities of clutter of the LiDAR [1/m^2] and of the radar [1/(m rad m/s)],"
        " for the same; with joint the least densities: scans may show more.",
    )
    report_existence: float = Field(
        default=0.95,
        gt=0,
        lt=1,
        description="A track is reported from this probability of existence on, until it falls"
        " below half of it, for association integrated (no unit).",
    )

    @classmethod
    def boats(cls) -> Self:
        """Return a configuration for boats of 10 to 40 m, scanned every 0.5 to 2 s."""
        return cls(
            target=FusionConfig(
                model="cv",
                acceleration_noise=0.3,
                initial_position=5.0,
                initial_speed=6.0,
                gate_probability=0.999,
            ),
            association="joint",
            clutter=(1e-5, 1e-4),
            confirm_hits=4,
            confirm_window=8,
            max_coast=15.0,
            max_position_std=12.0,
            birth_distance=20.0,
            report_speed=0.4,
        )

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.confirm_hits > self.confirm_window:
            raise ValueError("confirm_hits: expected at most confirm_window")
        return self
