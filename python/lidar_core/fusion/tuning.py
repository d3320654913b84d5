"""Noise from measurements alone."""

from collections.abc import Iterable, Sequence
from typing import Any

from lidar_core import _core
from lidar_core.config import as_config
from lidar_core.errors import ConfigError, InputError
from lidar_core.fusion.config import FusionConfig
from lidar_core.fusion.measurement import Measurement, Measurements, as_measurements

EVALUATIONS = 2000
"""Largest number of runs over all measurements in the last search of a fit.

Each of the six searches before it has at most a tenth of that.
"""
MODELS = ("ct", "ctrv")
"""Models of which the likelier is taken where none is told; both have as many values to find.

The noise of ct is the same in all directions. That of ctrv drives speed and turning apart, so that
a target that turns with an even speed is told from a noisy one.
"""
MAX_STD = 1e6
"""Largest deviation that may be asked for at least [m/s]."""


def fit_noise(
    measurements: Iterable[Measurement] | Measurements | Iterable[Measurements],
    config: FusionConfig | None = None,
    *,
    sensors: bool = True,
    least_range_rate_std: float = 0.0,
) -> FusionConfig:
    """Find the noise under which measurements are most likely; no truth is needed.

    Parameters
    ----------
    measurements : iterable of Measurement, Measurements, or sequence of Measurements
        Measurements of one target, or of several that move alike.
    config : FusionConfig, optional
        Model and method, and where the search begins; values that are zero stay zero. Without it
        the model is found, too: ct or ctrv, which of them makes the measurements likelier.
    sensors : bool
        Also fit the standard deviations of LiDAR and radar, for measurements without a covariance;
        otherwise only the process noise.
    least_range_rate_std : float
        Least deviation of the radar's range rate, if it is sought [m/s], >= 0. A target whose speed
        jumps has range rates that no model follows, though the radar is exact.

    Returns
    -------
    FusionConfig
        `config` with that noise. Where deviations of sensors were found, and `config` was not made
        with a `sensor_noise`, it is "configured": the filter does not look for them a second time.

    Raises
    ------
    ConfigError
        Model paper, which has no likelihood.
    InputError
        Fewer than ten measurements per value that is sought, after the first ten of every
        target; measurements that no noise makes possible, or only one outside the ranges of the
        configuration; or a deviation that is negative or not finite.

    Notes
    -----
    Maximum of the likelihood of the innovations, found by Nelder & Mead's method over the
    logarithms of the values, from the best places of a coarse grid, each value within a factor of
    1000 of where it begins. Gates are open meanwhile. Deterministic.
    """
    if not 0 <= least_range_rate_std <= MAX_STD:
        raise InputError(
            f"least_range_rate_std: expected 0 to {MAX_STD} m/s, got {least_range_rate_std}"
        )
    settings = as_config(config, FusionConfig)
    return fit_likeliest(
        measurements,
        [settings] if config is not None else with_models(settings),
        sensors=sensors,
        least_range_rate_std=least_range_rate_std,
        believes="sensor_noise" not in settings.model_fields_set,
    )


def fit_likeliest(
    measurements: Iterable[Measurement] | Measurements | Iterable[Measurements],
    configs: Sequence[FusionConfig],
    *,
    sensors: bool = True,
    least_range_rate_std: float = 0.0,
    believes: bool = True,
) -> FusionConfig:
    """Fit each of several configurations, as `fit_noise`, and return the likeliest.

    `believes` makes `sensor_noise` "configured" where deviations of sensors were found.

    Raises
    ------
    InputError
        As for `fit_noise`, if no configuration can be fitted.
    """
    targets, found, errors = _targets(measurements), [], []
    for one in configs:
        try:
            found.append(_fitted(targets, one, sensors, least_range_rate_std, believes))
        except InputError as error:
            errors.append(error)
    if not found:
        raise errors[0]
    return max(found, key=lambda one: one[1])[0]


def with_models(config: FusionConfig) -> list[FusionConfig]:
    """Return `config` with each of `MODELS`."""
    return [config.model_copy(update={"model": model}) for model in MODELS]


def _fitted(
    targets: list[Measurements],
    settings: FusionConfig,
    sensors: bool,
    least_rate: float,
    believes: bool,
) -> tuple[FusionConfig, float]:
    """Return `settings` with the most likely noise, and the logarithm of the likelihood."""
    (acceleration, jerk, turn), lidar, radar, likelihood = _core.fusion_fit_noise(
        settings,
        [target._core for target in targets],
        sensors=sensors,
        least_rate=least_rate,
        evaluations=EVALUATIONS,
    )
    found: dict[str, Any] = {
        "acceleration_noise": acceleration,
        "jerk_noise": jerk,
        "turn_noise": turn,
    }
    if sensors:
        stds = {"lidar_std": tuple(lidar.tolist()), "radar_std": tuple(radar.tolist())}
        if any(stds[name] != getattr(settings, name) for name in stds):
            found |= stds | ({"sensor_noise": "configured"} if believes else {})
    try:
        return FusionConfig(**(settings.model_dump() | found)), likelihood
    except ConfigError as error:
        raise InputError(f"the likeliest noise is out of range: {error}") from error


def _targets(
    measurements: Iterable[Measurement] | Measurements | Iterable[Measurements],
) -> list[Measurements]:
    if isinstance(measurements, Measurements):
        return [measurements]
    several: list[Measurements] = []
    one: list[Measurement] = []
    for given in measurements:
        if isinstance(given, Measurements):
            several.append(given)
        else:
            one.append(given)
    return several + ([as_measurements(one)] if one or not several else [])
