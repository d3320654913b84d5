"""Configuration of the semantic map: the only source of its defaults and ranges."""

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from lidar_core.config import Config


class CircleMapConfig(Config):
    """Map of circles in the world, with identities, radii, velocities and covariances.

    `CircleMapConfig()` is what works best; `CircleMapConfig.paper()` is the filter as published,
    with values of ours where the paper gives none.

    Source: Sanchez-Lopez et al., sec. V.
    """

    filter: Literal["paper", "independent"] = Field(
        "independent",
        description="What keeps the elements: one filter for the robot and all of them, eqs 8-33,"
        " with nearest neighbours, new elements at once and one limit for all eigenvalues; or a"
        " filter per element (no unit). In both an element goes whose radius is no more positive.",
    )
    gate_probability: float = Field(
        0.9999,
        gt=0,
        lt=1,
        description="Probability that a circle passes the gate of its element, chi-square with 3"
        " degrees of freedom (no unit); the paper gives no threshold.",
    )
    initial_speed: float = Field(
        1.5,
        ge=1e-6,
        le=1e6,
        description="Standard deviation of a new element's velocity, per axis, n_gv of eq. 19"
        " [m/s]; the paper gives none.",
    )
    process_noise: tuple[Annotated[float, Field(ge=0, le=1e6)], ...] = Field(
        (0.1, 0.5, 200.0),
        min_length=1,
        max_length=4,
        description="Densities of the white acceleration of the modes between which an element"
        ' switches [m^2/s^3]: steady, manoeuvring, sudden turn; `filter` "independent", as all'
        " that follows up to `line_coast`.",
    )
    mode_weight: tuple[Annotated[float, Field(ge=1e-6, le=1e6)], ...] = Field(
        (0.4, 0.599, 0.001),
        min_length=1,
        max_length=4,
        description="Share of each mode among new elements and among those that change their mode"
        " (no unit).",
    )
    mode_time: tuple[Annotated[float, Field(ge=1e-3, le=1e6)], ...] = Field(
        (2.0, 2.0, 0.1),
        min_length=1,
        max_length=4,
        description="Mean time that each mode lasts [s].",
    )
    standing_share: float = Field(
        0.5,
        ge=0,
        le=0.999,
        description="Share of new elements that stand still, one more mode beside those of"
        " `mode_weight`; 0: no element is known to stand (no unit).",
    )
    standing_time: float = Field(
        10.0, ge=1e-3, le=1e6, description="Mean time that an element stands [s]."
    )
    moving_time: float = Field(
        5.0, ge=1e-3, le=1e6, description="Mean time that an element moves until it stands [s]."
    )
    standing_noise: float = Field(
        1e-4,
        ge=0,
        le=1e3,
        description="Density of the random walk of the centre of what stands [m^2/s]: another part"
        " of it comes into view.",
    )
    start_speed: float = Field(
        1.0,
        ge=1e-6,
        le=1e6,
        description="Standard deviation of the velocity with which an element starts to move, per"
        " axis [m/s].",
    )
    standing_probability: tuple[
        Annotated[float, Field(ge=0, le=1)], Annotated[float, Field(ge=0, le=1)]
    ] = Field(
        (0.8, 0.4),
        description="Probabilities of standing above which an element begins, and below which it"
        " ends, to be reported as standing: without velocity (no unit).",
    )
    center_noise: float = Field(
        0.002,
        ge=0,
        le=0.1,
        description="Standard deviation of centres beyond that of their fits, until the scans show"
        " it: real objects are not round [m].",
    )
    radius_noise: float = Field(
        1e-6,
        ge=0,
        le=1e3,
        description="Density of the random walk of radii [m^2/s]; paper, eq. 15: 0.",
    )
    turn_noise: float = Field(
        0.01,
        ge=0,
        le=1e3,
        description="Density of the random walk of the headings of ellipses and rectangles"
        " [rad^2/s]; their half lengths wander as radii do.",
    )
    birth_density: float = Field(
        1e-4,
        gt=0,
        description="Density of circles that belong to no element, per area and radius [1/m^3]: a"
        " circle joins an element that explains it better.",
    )
    merge_gap: float = Field(
        0.15,
        ge=0,
        le=5,
        description="Elements with a smaller gap between their surfaces are one object, as arms"
        " and trunk of a person are [m]; 0: only those whose centre lies inside another.",
    )
    confirm_hits: int = Field(
        3,
        ge=1,
        le=64,
        description="Scans of the last `confirm_window` that must have measured an element before"
        " it is reported (count, no unit).",
    )
    confirm_window: int = Field(
        5, ge=1, le=64, description="Scans looked back on for that (count, no unit)."
    )
    max_position_std: float = Field(
        1.0,
        gt=0,
        le=50,
        description="An element that is not hidden goes when the standard deviation of its centre"
        " in its worst direction is larger, eq. 33 for a block of the covariance [m].",
    )
    max_velocity_std: float = Field(3.0, gt=0, description="Same of the velocity [m/s].")
    max_radius_std: float = Field(0.3, gt=0, le=10, description="Same of the radius [m].")
    min_misses: int = Field(
        3,
        ge=1,
        le=1_000,
        description="Scans in a row that must miss an element before one of the times that follow"
        " lets it go: a slow scanner may miss one (count, no unit).",
    )
    absent_time: float = Field(
        0.25,
        ge=0,
        description="An element goes when rays have passed wherever it may be for longer without"
        " a measurement [s].",
    )
    unmatched_time: float = Field(
        0.5,
        ge=0,
        description="An element goes when rays have ended at its place for longer, but no circle"
        " was found there [s].",
    )
    max_coast: float | None = Field(
        5.0,
        ge=0,
        description="An element goes when it has been hidden or out of view for longer without a"
        " measurement [s]; none: never.",
    )
    see_margin: float = Field(
        0.15,
        ge=0,
        le=5,
        description="A ray that ends nearer to the surface of an element than this belongs to it"
        " [m].",
    )
    min_rays: int = Field(
        4,
        ge=1,
        le=10_000,
        description="An element that fewer rays meet is out of view (count, no unit).",
    )
    buffer_time: float = Field(
        0.25,
        ge=0,
        le=60,
        description="How late a scan may come: all scans since are taken in again after it, of"
        " which the last 1000 are kept [s].",
    )
    line_noise: float = Field(
        1e-6,
        ge=0,
        description="Density of the random walk of the ends of a line, across it [m^2/s]: it lets"
        " lines follow a pose that drifts; ours, as all that follows up to `line_coast`.",
    )
    line_std: float = Field(
        0.01,
        ge=0,
        le=0.5,
        description="Standard deviation of how far surfaces depart from a straight line [m].",
    )
    line_gap: float = Field(
        0.5,
        ge=0,
        le=20,
        description="Stretches of one line with a longer gap between them are two [m].",
    )
    line_length: float = Field(
        0.5,
        ge=0,
        le=20,
        description="Shorter stretches make no new line: they may be parts of anything [m].",
    )
    line_reach: float = Field(
        3.0,
        ge=0,
        description="Hits that lie off a line of the map by less, as root mean square, are its own:"
        " they are no circle (standard deviations, no unit).",
    )
    line_coast: float | None = Field(
        60.0,
        ge=0,
        description="A line goes when it has been hidden or out of view for longer [s]; none:"
        " never.",
    )
    velocity_step: float = Field(
        0.1,
        ge=0,
        le=1e3,
        description="Noise of the velocity per step, n_fv of eq. 14, as a standard deviation [m/s];"
        ' `filter` "paper", which gives no value.',
    )
    max_eigenvalue: float = Field(
        3.0,
        gt=0,
        description="An element goes when an eigenvalue of its covariance is larger, eq. 33 (no"
        ' unit: it mixes metres and metres per second); `filter` "paper", which gives no value.',
    )

    @classmethod
    def posts(cls) -> Self:
        """A map of what stands still: elements out of view stay, and keep their numbers.

        Circles that move get new numbers all the time.
        """
        return cls(
            initial_speed=0.01,
            process_noise=(1e-6,),
            mode_weight=(1.0,),
            mode_time=(1.0,),
            standing_share=0.0,
            max_coast=None,
        )

    @classmethod
    def paper(cls, **changes: Any) -> Self:
        """Return the filter as published, with given changes."""
        return cls(**{"filter": "paper", **changes})

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.confirm_hits > self.confirm_window:
            raise ValueError("expected confirm_hits <= confirm_window")
        if self.standing_probability[1] > self.standing_probability[0]:
            raise ValueError("expected standing_probability[1] <= standing_probability[0]")
        if not len(self.process_noise) == len(self.mode_weight) == len(self.mode_time):
            raise ValueError("expected process_noise, mode_weight and mode_time of one length")
        return self
