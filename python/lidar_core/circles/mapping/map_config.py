"""Configuration of the semantic map: the only source of its defaults and ranges."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field

from lidar_core.config import Config

Mode = tuple[
    Annotated[float, Field(ge=0, le=1e6)],
    Annotated[float, Field(ge=1e-6, le=1e6)],
    Annotated[float, Field(ge=1e-3, le=1e6)],
]


class CircleMapConfig(Config):
    """Map of circles in the world, with identities, radii, velocities and covariances.

    `CircleMapConfig()` is best mode; `CircleMapConfig.paper()` is the filter as published, with our
    values where the paper gives none.

    Source: Sanchez-Lopez et al., sec. V.
    """

    removed: ClassVar[Mapping[str, str]] = {
        "standing_probability": "an element stands from 0.8 on, and moves below 0.4",
        "birth_density": "circles of no element have a density of 1e-4 per m^3",
        "max_velocity_std": "the velocity may be uncertain by 3 m/s",
        "max_radius_std": "the radius may be uncertain by 0.3 m",
        "confirm_hits": "elements are reported from `report_existence` on",
        "confirm_window": "elements are reported from `report_existence` on",
        "min_misses": "an element goes when its existence is below 0.05",
        "absent_time": "what rays pass goes after 0.25 s",
        "unmatched_time": "what is no circle any more goes after 0.5 s",
        "see_margin": "rays that end within 0.15 m belong to an element",
        "min_rays": "an element that fewer than 4 rays meet is out of view",
        "line_gap": "stretches of a line with a gap above 0.5 m are two",
        "line_length": "new lines have 0.5 m at least",
        "line_reach": "hits within 3 standard deviations of a line are its own",
        "process_noise": "write it as the first value of each entry of modes",
        "mode_weight": "write it as the second value of each entry of modes",
        "mode_time": "write it as the third value of each entry of modes",
        "center_noise": "centres of new elements jitter by 2 mm",
        "line_coast": "lines stay for 60 s after they were last seen",
    }
    filter: Literal["paper", "independent"] = Field(
        default="independent",
        description="Filter of the elements: one for the robot and all elements, eqs 8-33,"
        " with nearest neighbours, new elements at once and one limit for all"
        " eigenvalues; or one filter per element (no unit). Both remove an element"
        " whose radius is not positive.",
    )
    gate_probability: float = Field(
        default=0.9999,
        gt=0,
        lt=1,
        description="Probability that a circle passes the gate of its element, chi-square with 3"
        " degrees of freedom (no unit); the paper gives no threshold.",
    )
    initial_speed: float = Field(
        default=1.5,
        ge=1e-6,
        le=1e6,
        description="Standard deviation of a new element's velocity, per axis, n_gv of eq. 19"
        " [m/s]; the paper gives none.",
    )
    modes: tuple[Mode, ...] = Field(
        default=((0.1, 0.4, 2.0), (0.5, 0.599, 2.0), (200.0, 0.001, 0.1)),
        min_length=1,
        max_length=4,
        description="Modes between which an element switches: density of its white acceleration"
        " [m^2/s^3], share among new elements and among those that change their mode (no unit),"
        " mean time that it lasts [s]. The defaults: steady, manoeuvring, sudden turn; `filter`"
        ' "independent", as all that follows up to `line_std`.',
    )
    standing_share: float = Field(
        default=0.5,
        ge=0,
        le=0.999,
        description="Share of new elements at rest, a mode besides those of `modes`; 0"
        " switches it off (no unit).",
    )
    standing_time: float = Field(
        default=10.0, ge=1e-3, le=3600, description="Mean time that an element stays at rest [s]."
    )
    moving_time: float = Field(
        default=5.0,
        ge=1e-3,
        le=3600,
        description="Mean time that an element moves before it comes to rest [s].",
    )
    standing_noise: float = Field(
        default=1e-4,
        ge=0,
        le=1e3,
        description="Density of the random walk of the centre of an element at rest [m^2/s]:"
        " other parts of it come into view.",
    )
    start_speed: float = Field(
        default=1.0,
        ge=1e-6,
        le=1e6,
        description="Standard deviation of the velocity with which an element starts to move, per"
        " axis [m/s].",
    )
    radius_noise: float = Field(
        default=1e-6,
        ge=0,
        le=1e3,
        description="Density of the random walk of radii [m^2/s]; paper, eq. 15: 0.",
    )
    turn_noise: float = Field(
        default=0.01,
        ge=0,
        le=1e3,
        description="Density of the random walk of the headings of ellipses and rectangles"
        " [rad^2/s]; their half lengths wander as radii do.",
    )
    merge_gap: float = Field(
        default=0.15,
        ge=0,
        le=5,
        description="Elements with a smaller gap between their surfaces are one object, as arms"
        " and trunk of a person are [m]; 0: only those whose centre lies inside another.",
    )
    report_existence: float = Field(
        default=0.9,
        ge=0.05,
        lt=1,
        description="An element is reported from this probability of existence on, until it falls"
        " below half of it (no unit).",
    )
    max_position_std: float = Field(
        default=1.0,
        gt=0,
        le=50,
        description="Largest standard deviation of the centre of a visible element, in its"
        " worst direction; a more uncertain element is not reported, and is removed if it is that"
        " uncertain after a measurement, eq. 33 for a block of the covariance [m].",
    )
    max_coast: float | None = Field(
        default=5.0,
        ge=0,
        le=600,
        description="An element is removed after this time hidden or out of view without a"
        " measurement [s]; none: never.",
    )
    buffer_time: float = Field(
        default=0.25,
        ge=0,
        le=60,
        description="Largest delay of a late scan: all later scans, of which the last 1000"
        " are kept, are then processed again [s].",
    )
    line_noise: float = Field(
        default=1e-6,
        ge=0,
        le=100,
        description="Density of the random walk of the ends of a line, across it [m^2/s]: it lets"
        " lines follow a pose that drifts; ours, as `line_std`.",
    )
    line_std: float = Field(
        default=0.01,
        ge=0,
        le=0.5,
        description="Standard deviation of how far surfaces depart from a straight line [m].",
    )
    velocity_step: float = Field(
        default=0.1,
        ge=0,
        le=1e3,
        description="Noise of the velocity per step, n_fv of eq. 14, as a standard deviation [m/s];"
        ' `filter` "paper", which gives no value.',
    )
    max_eigenvalue: float = Field(
        default=3.0,
        gt=0,
        le=1e4,
        description="An element is removed if an eigenvalue of its covariance is larger, eq."
        " 33 (no unit: it mixes metres and metres per second); for `filter`"
        ' "paper", which states no value.',
    )

    @classmethod
    def posts(cls) -> Self:
        """Return a configuration for static objects: elements out of view keep IDs.

        Circles that move get new IDs all the time.
        """
        return cls(
            initial_speed=0.01,
            modes=((1e-6, 1.0, 1.0),),
            standing_share=0.0,
            max_coast=None,
        )

    @classmethod
    def paper(cls, **changes: Any) -> Self:
        """Return the filter as published, with given changes."""
        return cls(**{"filter": "paper", **changes})
