"""Configuration of the multi-target tracker: the only source of its defaults and ranges."""

from typing import Literal, Self

from pydantic import Field, model_validator

from lidar_core.config import Config
from lidar_core.flying.config_types import MOST_POINTS


class TrackerConfig(Config):
    """Tracks of flying objects over point clouds and detections that may come late.

    `TrackerConfig()` is what works best; `TrackerConfig.paper()` is the algorithm as published.

    Source: Vrba et al., sec. III-F and Algorithm 2; paper's values: Table II.
    """

    buffer_size: int = Field(
        10, ge=1, le=1000, description="Clouds kept for late detections, N_buf (count, no unit)."
    )
    cluster_distance: float = Field(
        0.5, gt=0, le=10, description="Largest gap inside a cluster [m]; paper: d_cluster, 0.25 m."
    )
    cluster_min_points: int = Field(
        1, ge=1, le=MOST_POINTS, description="Smaller clusters are no targets (count, no unit)."
    )
    cluster_max_points: int | None = Field(
        None,
        ge=1,
        le=MOST_POINTS,
        description="Larger clusters are no targets (count, no unit); none: no limit.",
    )
    max_extent: float | None = Field(
        2.0,
        ge=0,
        le=50,
        description="Clusters with a longer side of their bounding box are no targets [m];"
        " none, as in the paper: no limit.",
    )
    occupied_distance: float = Field(
        0.7,
        ge=0,
        le=10,
        description="A centroid this close to an occupied voxel's centre is background, d_min [m];"
        " the paper gives no value; paper mode uses 1.0 m.",
    )
    occupied_adds_extent: bool = Field(
        False,
        description="The diagonal of the cluster's box is added to `occupied_distance`, as in the"
        " authors' code (no unit).",
    )
    radius: Literal["paper", "sixth-root"] = Field(
        "sixth-root",
        description="Root of the determinant in the uncertainty radius: cube root, eq. 26, or sixth"
        " root, which gives a length (no unit).",
    )
    radius_scale: float = Field(
        1.22, gt=0, description="Multiplier of the uncertainty radius, c_r (no unit); paper: 0.5."
    )
    radius_min: float = Field(
        1.5, gt=0, le=100, description="Smallest uncertainty radius, r_min [m]."
    )
    radius_max: float = Field(
        3.0,
        gt=0,
        le=100,
        description="Tracks with a larger uncertainty radius are removed, r_max [m].",
    )
    acceleration_time: float | None = Field(
        1.0,
        gt=0,
        description="Time constant with which accelerations fade [s]; none, as in eq. 27 of the"
        " paper: they stay.",
    )
    unseen_acceleration_time: float | None = Field(
        0.3,
        gt=0,
        description="`acceleration_time` while a track continues without measurements [s]; none, as"
        " in the paper: the same value.",
    )
    process_noise: Literal["paper", "continuous"] = Field(
        "continuous",
        description="Growth of uncertainty: the same at every step, eq. 31, or white noise in"
        " continuous time (no unit).",
    )
    process_position: float = Field(
        0.0,
        ge=0,
        le=10,
        description="Noise of the position, Xi_r: per step [m], or root of a density [m/s^0.5];"
        " paper: 0.5 m.",
    )
    process_velocity: float = Field(
        0.1,
        ge=0,
        description="Noise of the velocity, Xi_v: per step [m/s], or root of a density [m/s^1.5];"
        " paper: 0.5 m/s.",
    )
    process_acceleration: float = Field(
        4.0,
        ge=0,
        description="Noise of the acceleration, Xi_a: per step [m/s^2], or root of a density"
        " [m/s^2.5]; paper: 0.1 m/s^2.",
    )
    initial_position: float = Field(
        0.3,
        gt=0,
        le=20,
        description="Standard deviation of a new track's position where the detection has no"
        " covariance, P_0,r [m]; paper: 0.5 m.",
    )
    initial_velocity: float = Field(
        4.0, gt=0, description="Same of the velocity, P_0,v [m/s]; paper: 3 m/s."
    )
    initial_acceleration: float = Field(
        3.0, gt=0, description="Same of the acceleration, P_0,a [m/s^2]; paper: 3 m/s^2."
    )
    measurement: Literal["paper", "cluster", "center"] = Field(
        "center",
        description="What a cluster measures: its centroid with covariance Z^2 I; or with that plus"
        " the scatter of its points divided by their number; or the centre of the target behind"
        " the points, where the rays of the scan are known (as in the detector), else as"
        " `cluster` (no unit).",
    )
    measurement_std: float = Field(
        0.07, gt=0, le=5, description="Standard deviation of a centroid, Z [m]; paper: 1 m."
    )
    hidden_share: float | None = Field(
        0.75,
        gt=0,
        le=1,
        description="A cluster with a side shorter than this share of the track's usual one is"
        " partly hidden, unless the scan shows that nothing nearer is beside it: the missing part"
        " is added to its standard deviation (share, no unit); none, as in the paper: never; global"
        " association.",
    )
    size_time: float = Field(
        2.0, gt=0, description="Time constant of the usual size of a track's clusters [s]."
    )
    association: Literal["paper", "global"] = Field(
        "global",
        description="Who gets a cluster: every track the nearest one, Algorithm 2, or global"
        " nearest neighbour, one to one and gated (no unit).",
    )
    gate_probability: float = Field(
        0.9999,
        gt=0,
        lt=1,
        description="Probability that a target passes the gate of its own track (no unit); global"
        " association.",
    )
    clutter_density: float = Field(
        1e-5,
        gt=0,
        description="Density of clusters that belong to no track [1/m^3]; global association.",
    )
    rejoin_acceleration: float | None = Field(
        2.0,
        gt=0,
        description="A confirmed track that has lost its target is given detections as if the"
        " target had accelerated by this all the time, as a standard deviation [m/s^2]; none, as in"
        " the paper: only where it was predicted; global association.",
    )
    split_distance: float | None = Field(
        0.8,
        gt=0,
        le=10,
        description="A cluster this near to several confirmed tracks, which are further apart from"
        " each other, is divided among them [m]; none, as in the paper: it stays whole; global"
        " association.",
    )
    confirm_hits: int = Field(
        3,
        ge=1,
        le=64,
        description="A track is reported once it has a detection in this many of the last"
        " `confirm_window` sets of detections (count, no unit); paper: 1.",
    )
    confirm_window: int = Field(
        10, ge=1, le=64, description="Sets of detections looked back on (count, no unit)."
    )
    confirm_confidence: float | None = Field(
        0.7,
        ge=0,
        le=1,
        description="Detections of less confidence confirm a track only once it has moved, or as"
        " `confirm_still_hits`: weak ones that stand still may be background that has just come"
        " into view (share, no unit); none, as in the paper: all count.",
    )
    confirm_distance: float = Field(
        0.5,
        ge=0,
        le=10,
        description="A track this far from where it began has moved, with two standard deviations"
        " of its position on top [m].",
    )
    confirm_cleared: float = Field(
        0.3,
        ge=0,
        le=10,
        description="But only while the newest scan shows that nothing is this near to its start."
        " Otherwise leaves of a tree that appear one after the other, or a surface behind a moving"
        " gap, would count as moved [m].",
    )
    confirm_still_hits: int = Field(
        10,
        ge=1,
        le=64,
        description="This many weak detections confirm a static track (count, no unit).",
    )
    confirm_still_window: int = Field(
        20, ge=1, le=64, description="Sets of detections looked back on for them (count, no unit)."
    )
    merge_distance: float | None = Field(
        0.3,
        ge=0,
        le=10,
        description="Tracks this close are one target [m]; none, as in the paper: never.",
    )
    merge_speed: float = Field(
        1.0, ge=0, description="Tracks whose velocities differ by more are two targets [m/s]."
    )
    ageing: Literal["paper", "visible"] = Field(
        "visible",
        description="When the uncertainty of a track without a cluster grows towards removal:"
        " always (Algorithm 2), or only while its region should give returns (no unit).",
    )
    max_coast: float = Field(
        3.0,
        gt=0,
        description="A track without measurement for longer is removed in any case [s]; ageing"
        " `visible`.",
    )
    report_coast: float = Field(
        0.3,
        gt=0,
        description="A track without measurement for longer is kept but not reported [s]; ageing"
        " `visible`.",
    )

    @model_validator(mode="after")
    def _values_fit_together(self) -> Self:
        if self.radius_min > self.radius_max:
            raise ValueError("expected radius_min <= radius_max")
        if self.confirm_hits > self.confirm_window:
            raise ValueError("expected confirm_hits <= confirm_window")
        if self.confirm_still_hits > self.confirm_still_window:
            raise ValueError("expected confirm_still_hits <= confirm_still_window")
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
            unseen_acceleration_time=None,
            process_noise="paper",
            process_position=0.5,
            process_velocity=0.5,
            process_acceleration=0.1,
            initial_position=0.5,
            initial_velocity=3.0,
            initial_acceleration=3.0,
            measurement="paper",
            measurement_std=1.0,
            hidden_share=None,
            association="paper",
            rejoin_acceleration=None,
            split_distance=None,
            confirm_hits=1,
            confirm_window=1,
            confirm_confidence=None,
            merge_distance=None,
            ageing="paper",
        )
