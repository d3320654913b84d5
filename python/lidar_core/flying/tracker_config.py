"""Configuration of the multi-target tracker: the only source of its defaults and ranges."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from lidar_core.config import Config

NotNegative = Annotated[float, Field(ge=0, le=1000)]
Triple = tuple[NotNegative, NotNegative, NotNegative]
Radius = Annotated[float, Field(gt=0, le=100)]


class TrackerConfig(Config):
    """Tracks of flying objects over point clouds and detections that may come late.

    `TrackerConfig()` is best mode; `TrackerConfig.paper()` is the algorithm as published.

    Source: Vrba et al., sec. III-F and Algorithm 2; paper's values: Table II.
    """

    removed: ClassVar[Mapping[str, str]] = {
        "cluster_min_points": "a single point is a cluster",
        "cluster_max_points": "clusters have any number of points",
        "occupied_adds_extent": "the centroid alone counts",
        "unseen_acceleration_time": "accelerations of hidden targets fade within 0.3 s",
        "radius_min": "write it as the first value of radius_limits",
        "radius_max": "write it as the second value of radius_limits",
        "process_position": "write it as the first value of process_std",
        "process_velocity": "write it as the second value of process_std",
        "process_acceleration": "write it as the third value of process_std",
        "initial_position": "write it as the first value of initial_std",
        "initial_velocity": "write it as the second value of initial_std",
        "initial_acceleration": "write it as the third value of initial_std",
        "size_time": "the usual size follows within 2 s",
        "confirm_confidence": "tracks have a probability of existence: report_existence",
        "confirm_distance": "that it has moved by 0.5 m makes a target more probable",
        "confirm_cleared": "the start of a track is free if nothing is within 0.3 m",
        "confirm_still_hits": "tracks have a probability of existence: report_existence",
        "confirm_still_window": "tracks have a probability of existence: report_existence",
        "merge_speed": "tracks of one target differ by 1 m/s at most",
    }
    buffer_size: int = Field(
        default=10,
        ge=1,
        le=1000,
        description="Clouds kept for late detections, N_buf (count, no unit).",
    )
    cluster_distance: float = Field(
        default=0.5,
        gt=0,
        le=10,
        description="Largest gap inside a cluster [m]; paper: d_cluster, 0.25 m.",
    )
    max_extent: float | None = Field(
        default=2.5,
        ge=0,
        le=50,
        description="Largest side of the bounding box of a target's cluster [m]; none, as in"
        " the paper: no limit.",
    )
    occupied_distance: float = Field(
        default=0.7,
        ge=0,
        le=10,
        description="A centroid this close to an occupied voxel's centre is background, d_min [m];"
        " the paper gives no value; paper mode uses 1.0 m.",
    )
    radius: Literal["paper", "sixth-root"] = Field(
        default="sixth-root",
        description="Root of the determinant in the uncertainty radius: cube root, eq. 26, or sixth"
        " root, which gives a length (no unit).",
    )
    radius_scale: float = Field(
        default=1.22,
        gt=0,
        le=100,
        description="Multiplier of the uncertainty radius, c_r (no unit); paper: 0.5.",
    )
    radius_limits: tuple[Radius, Radius] = Field(
        default=(1.5, 3.0),
        description="Smallest uncertainty radius, r_min, and the largest, r_max, above which a"
        " track is removed [m].",
    )
    acceleration_time: float | None = Field(
        default=1.0,
        gt=0,
        le=60,
        description="Time constant with which accelerations fade [s]; none, as in eq. 27 of the"
        " paper: they stay.",
    )
    process_noise: Literal["paper", "continuous", "adaptive"] = Field(
        default="adaptive",
        description="Growth of uncertainty: the same at every step, eq. 31; white noise in"
        " continuous time; or that, up to 5 times wider for a flying target whose measurements lie"
        " further from their predictions than it allows, and with a new acceleration where it has"
        " turned hard between two scans (no unit).",
    )
    process_std: Triple = Field(
        default=(0.0, 0.1, 4.0),
        description="Noise of position, velocity and acceleration, Xi_r, Xi_v, Xi_a: per step [m],"
        " [m/s], [m/s^2], or roots of densities [m/s^0.5], [m/s^1.5], [m/s^2.5]; paper: 0.5, 0.5,"
        " 0.1.",
    )
    initial_std: Triple = Field(
        default=(0.3, 4.0, 3.0),
        description="Standard deviations of a new track's position, where the detection has no"
        " covariance [m], velocity [m/s] and acceleration [m/s^2], > 0, P_0; paper: 0.5, 3, 3.",
    )
    measurement: Literal["paper", "cluster", "center"] = Field(
        default="center",
        description="Measurement from a cluster: its centroid with covariance Z^2 I; or with"
        " that plus the scatter of its points divided by their number; or the"
        " centre of the target behind the points, if the rays of the scan are"
        " known (as in the detector), else as `cluster` (no unit).",
    )
    measurement_std: float = Field(
        default=0.07, gt=0, le=5, description="Standard deviation of a centroid, Z [m]; paper: 1 m."
    )
    hidden_share: float | None = Field(
        default=0.75,
        gt=0,
        le=1,
        description="A cluster with a side shorter than this share of the track's usual one is"
        " partly hidden, unless the scan shows that nothing nearer is beside it: the missing part"
        " is added to its standard deviation (share, no unit); none, as in the paper: never; global"
        " association.",
    )
    association: Literal["paper", "global"] = Field(
        default="global",
        description="Who gets a cluster: every track the nearest one, Algorithm 2, or global"
        " nearest neighbour, one to one and gated (no unit).",
    )
    gate_probability: float = Field(
        default=0.9999,
        gt=0,
        lt=1,
        description="Probability that a target passes the gate of its own track (no unit); global"
        " association.",
    )
    clutter_density: float = Field(
        default=1e-5,
        gt=0,
        le=1e3,
        description="Density of clusters that belong to no track [1/m^3]; global association.",
    )
    rejoin_acceleration: float | None = Field(
        default=2.0,
        gt=0,
        le=1e3,
        description="A track that was confirmed and lost its target gets detections as if the"
        " target had accelerated by this all the time, as a standard deviation [m/s^2]; none, as in"
        " the paper: only where it was predicted; global association.",
    )
    split_distance: float | None = Field(
        default=0.8,
        gt=0,
        le=10,
        description="A cluster this near to several confirmed tracks, which are further apart from"
        " each other, is divided among them [m]; none, as in the paper: it stays whole; global"
        " association.",
    )
    report_existence: float | None = Field(
        default=0.9,
        gt=0,
        lt=1,
        description="A track is reported from this probability of existence on, until it falls"
        " below half of it (no unit); none, as in the paper: by `confirm_hits` and"
        " `confirm_window`.",
    )
    confirm_hits: int = Field(
        default=1,
        ge=1,
        le=64,
        description="A track is reported once it has a detection in this many of the last"
        " `confirm_window` sets of detections (count, no unit); only without `report_existence`.",
    )
    confirm_window: int = Field(
        default=1,
        ge=1,
        le=64,
        description="Sets of detections looked back on (count, no unit); only without"
        " `report_existence`.",
    )
    merge_distance: float | None = Field(
        default=0.3,
        ge=0,
        le=10,
        description="Tracks this close are one target [m]; none, as in the paper: never.",
    )
    ageing: Literal["paper", "visible"] = Field(
        default="visible",
        description="When the uncertainty of a track without a cluster grows towards removal:"
        " always (Algorithm 2), or only while its region should give returns (no unit).",
    )
    max_coast: float = Field(
        default=3.0,
        gt=0,
        le=60,
        description="A track without measurement for longer is removed in any case [s]; ageing"
        " `visible`.",
    )
    report_coast: float = Field(
        default=0.5,
        gt=0,
        le=60,
        description="A track without measurement for longer is kept but not reported, at most"
        " `max_coast` [s]; ageing `visible`.",
    )

    @model_validator(mode="after")
    def _values_fit_together(self) -> Self:
        if self.radius_limits[0] > self.radius_limits[1]:
            raise ValueError("radius_limits: expected the smallest radius first")
        if self.confirm_hits > self.confirm_window:
            raise ValueError("expected confirm_hits <= confirm_window")
        is_default = self.report_coast == type(self).model_fields["report_coast"].default
        if self.report_coast > self.max_coast and not is_default:
            raise ValueError(
                "expected report_coast <= max_coast, because a removed track cannot be reported,"
                f" got {self.report_coast:g} and {self.max_coast:g} s"
            )
        if self.initial_std[0] > 20 or min(self.initial_std) <= 0:
            raise ValueError("initial_std: expected values > 0, the first <= 20 m")
        if self.process_std[0] > 10:
            raise ValueError("process_std: expected at most 10 m as the first value")
        return self

    @classmethod
    def paper(cls) -> Self:
        """The algorithm as published, with the values of Table II."""
        return cls(
            cluster_distance=0.25,
            max_extent=None,
            occupied_distance=1.0,
            radius="paper",
            radius_scale=0.5,
            acceleration_time=None,
            process_noise="paper",
            process_std=(0.5, 0.5, 0.1),
            initial_std=(0.5, 3.0, 3.0),
            measurement="paper",
            measurement_std=1.0,
            hidden_share=None,
            association="paper",
            rejoin_acceleration=None,
            split_distance=None,
            report_existence=None,
            merge_distance=None,
            ageing="paper",
        )
