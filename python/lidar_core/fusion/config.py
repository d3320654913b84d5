"""Configuration of the fusion filter: the only source of its defaults and ranges."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, Literal, Self, TypeAlias

from pydantic import Field, ValidationInfo, field_validator, model_validator

from lidar_core._core import fusion_models
from lidar_core.config import Config

_MODELS = fusion_models()
_MEANINGS = "; ".join(f"{title} [{', '.join(states)}]" for _, states, title, _ in _MODELS)
if TYPE_CHECKING:  # type checkers cannot read the names from the core
    ModelName: TypeAlias = str
    MixableName: TypeAlias = str
else:
    ModelName = Literal[tuple(name for name, *_ in _MODELS)]
    MixableName = Literal[tuple(name for name, *_, can_mix in _MODELS if can_mix)]

Pair = tuple[float, float]
Triple = tuple[float, float, float]
Four = tuple[float, float, float, float]
Six = tuple[float, float, float, float, float, float]
SI = "lengths are in metres, angles in radians, rates per second"
MOST: Mapping[str, Mapping[int, tuple[float, ...]]] = {
    "lidar_std": {2: (10,) * 2, 3: (10,) * 3},
    "radar_std": {3: (100, 3.2, 100), 4: (100, 3.2, 3.2, 100)},
    "pose_std": {3: (100, 100, 3.2), 6: (100,) * 3 + (3.2,) * 3},
    "lever_arm": {2: (1000,) * 2, 3: (1000,) * 3},
}
"""Greatest values, by parameter and number of its values; units as there."""
SIGN = {"lidar_std": "> 0", "radar_std": "> 0", "pose_std": ">= 0", "lever_arm": "of any sign"}
IN_SPACE = "-3d"
"""End of the names of models in space."""


class PublishedModel(Config):
    """Choices that the paper leaves open for its model.

    Source: Remote Sens. 2023, 15, 3396, eqs 5-28.
    """

    reading: Literal["a", "b", "c", "d"] = Field(
        default="a",
        description="Further states that the radar measures besides x and y, eq. 26 (no"
        " unit): a: v is the range rate, theta the bearing, w zero; b: as a, but w"
        " is the range rate; c: v and theta are the true ones, the fourth and"
        " fifth value of the measurement; d: none.",
    )
    alpha: Literal["literal", "fixed"] = Field(
        default="literal",
        description="alpha of eq. 18: theta + dt as printed, or theta + w dt as in eq. 8 (no"
        " unit).",
    )
    prediction: Literal["motion", "matrix"] = Field(
        default="motion", description="State predicted by eqs 8 and 9 or by Phi, eq. 15 (no unit)."
    )
    straight_y: Literal["literal", "fixed"] = Field(
        default="literal",
        description="Part of the platform in y of a target that goes straight, eq. 9: v_dx as"
        " printed, or v_dy as in eq. 8 (no unit). With `speed` zero both are zero.",
    )
    platform_column: Literal["literal", "zero"] = Field(
        default="literal",
        description="Column of w_d in eqs 18 and 19 (no unit): as printed; or zero, as eq. 16 makes"
        " it of eqs 8 and 9, in which w_d does not occur. With `speed` zero both are zero.",
    )
    speed: float = Field(
        default=0.0,
        ge=0,
        le=1e3,
        description="Speed of the platform, V0 of eq. 7 [m/s]. The paper states none, and its"
        " recordings are of a sensor at rest: zero, so nothing is subtracted from"
        " x and y, and the column of w_d in eqs 18 and 19 is zero.",
    )
    elevation: float = Field(
        default=0.0, ge=-1.6, le=1.6, description="Elevation of the platform, phi of eq. 7 [rad]."
    )


class FusionConfig(Config):
    """A filter of one target that LiDAR and radar measure.

    `FusionConfig()` is best mode; `FusionConfig.paper()` is the filter as published. The noise of
    the sensors applies to measurements without a covariance.

    Source: Remote Sens. 2023, 15, 3396; Bar-Shalom, Li & Kirubarajan, "Estimation with
    Applications to Tracking and Navigation", 2001.
    """

    removed: ClassVar[Mapping[str, str]] = {
        "start_noise": "targets that start accelerate by 4 m/s^2",
        "initial_platform_rate": "the platform's first turn rate is uncertain by 1 rad/s",
        "range_min": "a radar measures a position from 0.1 m on",
        "noise_memory": "noise is estimated over 200 measurements",
        "loss_window": "the NIS is averaged over 10 measurements",
    }
    model: ModelName = Field(default="ct", description=f"How targets move (no unit): {_MEANINGS}.")
    method: Literal["kf", "ekf", "ukf", "ckf", "imm"] = Field(
        default="ekf",
        description="Linear Kalman filter, which takes radar as a position, of models cv, ca,"
        " cv-3d, ca-3d; extended; unscented and cubature, both in square-root form; interacting"
        " multiple models, whose state is that of ca or ca-3d (no unit).",
    )
    sigma_spread: float | None = Field(
        default=3.0,
        gt=0,
        le=1e3,
        description="The sigma points of ukf lie this many variances from the mean: at 3, they lie"
        " sqrt(3) = 1.7 standard deviations away (no unit); none: the number of states plus 2."
        " Below the number of states a weight is negative; its part of a covariance is left out if"
        " the covariance would not stay positive. Distant points spoil models with a heading, which"
        " is undefined while a target is at rest.",
    )
    sigma_points: Literal["redrawn", "carried"] = Field(
        default="redrawn",
        description="Sigma points that ukf compares with a measurement: new ones, drawn from the"
        " predicted covariance; or those of the prediction, as courses do (no unit).",
    )
    imm_models: tuple[MixableName, ...] = Field(
        default=("cv", "ctrv"),
        min_length=1,
        description="Models that imm mixes, all in the plane or all in space (no unit).",
    )
    imm_sojourn: float = Field(
        default=2.0,
        gt=0,
        le=1000,
        description="Mean time for which a target follows one of them [s]; standing: 300 s.",
    )
    imm_quiet: float | None = Field(
        default=None,
        gt=0,
        lt=1,
        description="Share of the process noise with which each model of imm but standing takes"
        " part a second time, for targets that move evenly (no unit); none: no such models.",
    )
    process: Literal["continuous", "discrete"] = Field(
        default="continuous",
        description="Process noise: white in continuous time, the same for any rate of"
        " measurements; or constant over a step, as courses have it (no unit).",
    )
    acceleration_noise: float = Field(
        default=0.7,
        ge=0,
        le=1e4,
        description="Noise of the acceleration: root of its density [m/s^1.5], or discrete its"
        " standard deviation [m/s^2].",
    )
    jerk_noise: float = Field(
        default=2.0,
        ge=0,
        le=1e5,
        description="Noise of the jerk, models ca and ctra: root of its density [m/s^2.5], or"
        " discrete its standard deviation [m/s^3].",
    )
    turn_noise: float = Field(
        default=0.5,
        ge=0,
        le=1e3,
        description="Noise of the angular acceleration: root of its density [rad/s^1.5], or"
        " discrete its standard deviation [rad/s^2].",
    )
    platform_noise: float = Field(
        default=0.5,
        ge=0,
        le=1e3,
        description="Noise of the angular acceleration of the platform, if its turn rate is a"
        " state: root of its density [rad/s^1.5], or discrete its standard"
        " deviation [rad/s^2].",
    )
    lidar_std: Pair | Triple = Field(
        default=(0.15, 0.15),
        description="Standard deviations of x and y of the LiDAR [m], > 0; a third value is that of"
        " z, else it is that of y.",
    )
    radar_std: Triple | Four = Field(
        default=(0.3, 0.03, 0.3),
        description="Standard deviations of range [m], bearing [rad] and range rate [m/s] of"
        " the radar, > 0; or of range, bearing, elevation and range rate. Without"
        " the fourth, the elevation has the value of the bearing.",
    )
    gyro_std: float = Field(
        default=0.01, gt=0, le=10, description="Standard deviation of the gyro's turn rate [rad/s]."
    )
    pose_std: Triple | Six = Field(
        default=(0.0, 0.0, 0.0),
        description="Standard deviations of x, y [m] and yaw [rad] of the platform's poses,"
        " >= 0; or of x, y, z [m], roll, pitch and yaw [rad]. Their effect on a"
        " measured place is added to the noise of LiDAR and radar; zeros: exact.",
    )
    gyro: Literal["input", "exact", "measurement", "none"] = Field(
        default="input",
        description="Use of the gyro by model ctrv-drone (no unit): its rate as an input,"
        " with bias and delay estimated as states gyro_bias [rad/s] and gyro_delay"
        " [s]; or its rate as an exact input; or as a measurement of a sixth state"
        " w_d; or not used, with w_d estimated.",
    )
    lever_arm: Pair | Triple = Field(
        default=(0.0, 0.0),
        description="Position of the sensor relative to the platform's origin, platform axes:"
        " x, y (and z) [m].",
    )
    start_rows: int = Field(
        default=6,
        ge=1,
        le=1000,
        description="Measurements that a constant-velocity filter takes before the model does"
        " (count, no unit); 1: the model at once, as always with cv, cv-3d and ctrv-drone.",
    )
    start_speed: Literal["range-rate", "zero"] = Field(
        default="range-rate",
        description="Speed of a target that a radar sees first: its range rate along the bearing,"
        " or zero (no unit).",
    )
    initial_position: float = Field(
        default=0.7071, gt=0, le=1e6, description="Standard deviation of the first position [m]."
    )
    initial_speed: float = Field(
        default=5.0,
        gt=0,
        le=1e4,
        description="Standard deviation of the first speed, or of the first velocity per axis"
        " [m/s].",
    )
    initial_heading: float = Field(
        default=1.732, gt=0, le=100, description="Standard deviation of the first heading [rad]."
    )
    initial_turn_rate: float = Field(
        default=1.0, gt=0, le=1e3, description="Standard deviation of the first turn rate [rad/s]."
    )
    initial_acceleration: float = Field(
        default=3.0,
        gt=0,
        le=1e4,
        description="Standard deviation of the first acceleration [m/s^2].",
    )
    gate_probability: float | None = Field(
        default=0.9999,
        gt=0,
        lt=1,
        description="Probability that a measurement of the target is believed (no unit); none: all"
        " are.",
    )
    loss_ratio: float | None = Field(
        default=4.0,
        gt=1,
        le=1e6,
        description="The filter starts anew when the NIS per value, averaged over 10 measurements,"
        " is above this (ratio, no unit; 1 is expected); none: never.",
    )
    sensor_noise: Literal["estimated", "configured"] = Field(
        default="estimated",
        description="Noise of LiDAR and radar that filters use for measurements without a"
        " covariance (no unit): estimated from the measurements, starting with `lidar_std` and"
        " `radar_std`; or these as they are. With estimated a measurement beyond the gate also"
        " makes the state less certain where its motion is in doubt rather than the measurement.",
    )
    buffer_time: float = Field(
        default=0.5,
        ge=0,
        le=60,
        description="Time for which measurements are kept: late ones are processed at their"
        " time, later ones are filtered again, and duplicates are rejected [s].",
    )
    published: PublishedModel = PublishedModel()

    @classmethod
    def turning_sensor(cls) -> Self:
        """Return a configuration for targets in the frame of a moving sensor with a gyro."""
        return cls(model="ctrv-drone", acceleration_noise=1.0)

    @classmethod
    def paper(cls) -> Self:
        """Return the filter as published; it does not give the deviations of eq. 23."""
        return cls(
            model="paper",
            acceleration_noise=3.0,
            turn_noise=2.0,
            platform_noise=0.5,
            start_rows=1,
            gate_probability=None,
            loss_ratio=None,
            sensor_noise="configured",
        )

    @field_validator(*MOST)
    @classmethod
    def _lies_in_its_range(
        cls, values: tuple[float, ...], known: ValidationInfo
    ) -> tuple[float, ...]:
        """Check the range of each value; types cannot, because the values of one tuple differ."""
        name = str(known.field_name)
        sign, most = SIGN[name], MOST[name][len(values)]
        fits = {"> 0": min(values) > 0, ">= 0": min(values) >= 0, "of any sign": True}[sign]
        if not fits or any(abs(one) > limit for one, limit in zip(values, most, strict=True)):
            raise ValueError(f"expected values {sign} and at most {most}: {SI}")
        return values

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.model == "paper" and self.method != "ekf":
            raise ValueError('expected method "ekf" with model "paper"')
        linear = ("cv", "ca", "cv-3d", "ca-3d")
        if self.method == "kf" and self.model not in linear:
            raise ValueError(f'expected model {", ".join(linear)} with method "kf"')
        if len({name.endswith(IN_SPACE) for name in self.imm_models}) > 1:
            raise ValueError("imm_models: expected models in the plane, or models in space")
        return self
