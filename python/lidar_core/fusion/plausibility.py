"""Checks whether measurements fit the assumptions of a filter, with probable causes if not."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lidar_core.config import as_config
from lidar_core.errors import InputError
from lidar_core.estimation import chi2_quantile
from lidar_core.fusion.config import FusionConfig
from lidar_core.fusion.measurement import Measurement, Measurements, SensorName, as_measurements
from lidar_core.fusion.places import HEAD, LEAST, MAY_BE_FALSE, geographic, several
from lidar_core.fusion.range_rates import rate_repairs
from lidar_core.fusion.recordings.table import TableOptions
from lidar_core.fusion.repairs import LATE, Change, later, lengths, repairs
from lidar_core.fusion.run import Run, run

PROBABILITY = 1e-6
"""Of a right recording being refused, noise being Gaussian and `FACTOR` times what is told."""
FACTOR = 3.0
"""Standard deviations may be so many times larger than told, or ten times that smaller."""
KEPT = 1 - MAY_BE_FALSE
"""Share of the measurements whose NIS counts, the least ones: a fifth may be false, or follow a
dropout or a turn that the model does not expect."""
KEPT_SUM = 0.56
"""What the least 80 % of chi-square values hold of their sum: 0.54 for the three values of a radar
(P(chi2_5 < q) with q such that P(chi2_3 < q) = 0.8), 0.55 in samples of 20; less for fewer."""
KEPT_SPREAD = 1.6
"""Relative variance of that part over that of the whole sum: 1.57, 1.38 and 1.31 for one, two and
three values, by the variance of values that are cut at their 80 % quantile."""
TURN = 2 * np.pi
PLACES = ("lidar", "x and y of the LiDAR")
"""The sensor whose places may be latitude and longitude, and what they are called."""
SUSPICIOUS = 2.0
"""Ratio above which a mistake is named that makes it ten times less: noise does not explain both,
the measurements as they are and as they would be."""
CLOCK_HEAD = 1000
"""Measurements among which the offset of a clock is looked for (count)."""
WIDEST_BEARING = 0.5
"""Noise of bearings above which they hardly tell a direction [rad]."""


@dataclass(frozen=True, slots=True)
class Implausible:
    """Measurements with an implausible NIS.

    Attributes
    ----------
    n_compared : int
        Number of measurements that were compared with expected values.
    ratio : float
        Sum of the least 80 % of their NIS divided by its expected value (1 is expected).
    limit : float
        Largest plausible value.
    shown : tuple of str
        Causes that the data shows.
    possible : tuple of str
        Likely causes if the data shows none.
    """

    n_compared: int
    ratio: float
    limit: float
    shown: tuple[str, ...]
    possible: tuple[str, ...]

    def __str__(self) -> str:
        """Return as text what is wrong, with the causes that the data shows, or likely causes."""
        how = f"{self.ratio:.3g} times what is expected"
        bound = (
            "far less than any target at rest would give"
            if self.limit < 1
            else f"up to {self.limit:.3g} would still be accepted"
            if self.ratio > self.limit
            else "and less if one mistake is corrected"
        )
        text = f"after {self.n_compared} measurements the NIS is {how}, {bound}"
        if self.shown:
            return f"{text}. The data shows: {either(self.shown)}"
        return f"{text}. Likely causes: {'; '.join(self.possible)}" if self.possible else text


def implausible(
    measurements: Iterable[Measurement],
    config: FusionConfig | None = None,
    options: TableOptions | None = None,
) -> Implausible | None:
    """Check whether measurements can belong to one target in the expected units.

    `lidar-core fuse` refuses measurements for which this is not None.

    Parameters
    ----------
    measurements : iterable of Measurement
        In any order.
    config : FusionConfig, optional
        Configuration of the filter. The configured noise is used: estimated noise would explain
        every mistake.
    options : TableOptions, optional
        Options with which a table was read (`MeasurementLog.options`): other conventions than these
        are tried, and the causes name options that replace them.

    Returns
    -------
    Implausible or None
        Problem, with causes as text. None if nothing is wrong, if fewer than 20 measurements
        were compared, and for the model as published: its matrices are no covariances, so its NIS
        has no meaning.

    Raises
    ------
    ConfigError
        A configuration of another class.
    InputError
        Something else than an iterable of `Measurement`.

    Notes
    -----
    The sum of the NIS of a correct recording is chi-square distributed. The noise may be three
    times the configured one, which multiplies the sum by nine; a fifth of the measurements, those
    with the largest NIS, is left out, and with it about half of the sum (`KEPT_SUM`). The rest is
    implausible above the quantile of 1 - 1e-6 of a chi-square variable with its variance. If one of
    the known mistakes makes a sum ten times larger, it is refused from `SUSPICIOUS` on. Range rates
    that are not the changes of the ranges, but would be in another unit, are refused with any sum
    that this unit makes less: this comparison does not depend on the configured noise. A sum, or a
    scatter of LiDAR positions, below the quantile of 1e-6 with noise 30 times smaller than
    configured is refused only if positions look like geographic coordinates: simulated measurements
    without noise are correct.

    Examples
    --------
    >>> seen = [Measurement(k * 50_000_000, "lidar", [0.1 * k, 2.0]) for k in range(40)]
    >>> implausible(seen) is None
    True
    >>> polar = [(np.hypot(*m.values), np.arctan2(*m.values[::-1])) for m in seen]
    >>> degrees = [
    ...     Measurement(m.stamp_ns, "radar", [far, np.degrees(bearing), 0.0])
    ...     for m, (far, bearing) in zip(seen, polar)
    ... ]
    >>> implausible([*seen, *degrees]).shown
    ('bearings are degrees: they fit times pi/180 (angle_unit="deg")',)
    """
    config, told = as_config(config, FusionConfig), as_config(options, TableOptions)
    measurements = _by_time(measurements)
    if config.model == "paper":
        return None
    config = config.model_copy(update={"sensor_noise": "configured"})
    found = _ratio(run(measurements, config))
    if found is None:
        return None
    ratio, degrees, count = found
    limit = FACTOR**2 * _quantile(1 - PROBABILITY, degrees)
    head = measurements[:HEAD]
    shown = _shown(head, config, told, ratio, limit)
    if shown or ratio > limit:
        return Implausible(count, ratio, limit, tuple(shown), () if shown else ANY_CAUSE)
    least = _quantile(PROBABILITY, degrees) / (10 * FACTOR) ** 2
    on_earth = geographic(head, *PLACES)
    if on_earth and min(ratio, _scatter(measurements, config)) < least:
        return Implausible(count, ratio, least, tuple(on_earth), ())
    return None


def _shown(
    measurements: Sequence[Measurement],
    config: FusionConfig,
    options: TableOptions,
    ratio: float,
    limit: float,
) -> list[str]:
    """Causes, shown by the data, of a sum of NIS that is too large or suspicious."""
    rates = _rates(measurements, config, options, limit)
    if rates:
        return rates
    on_earth = geographic(measurements, *PLACES)
    if ratio > limit:
        # Wrong angles make places jump, too: jumps say something where nothing else explains them.
        return _repairs(measurements, config, options, ratio, limit) + on_earth or several(
            measurements
        )
    if ratio > SUSPICIOUS and not on_earth:
        return _repairs(measurements, config, options, ratio, limit)
    return []


def _by_time(measurements: Iterable[Measurement]) -> list[Measurement]:
    if isinstance(measurements, Measurements):
        raise InputError("measurements: expected Measurement objects, got Measurements")
    listed = list(measurements)
    as_measurements(listed)  # refuses anything else
    return sorted(listed, key=lambda m: m.stamp_ns)


def mistaken_for_noise(
    measurements: Sequence[Measurement],
    told: FusionConfig,
    fitted: FusionConfig,
    options: TableOptions,
) -> str | None:
    """Return the mistake that the noise of a fit hides; None if it seems to be real noise.

    A fit explains every mistake as noise. It is a mistake if its correction makes the measurements
    agree, either under the noise before the fit, or ten times better under the fitted one; or if
    the bearings of the radar carry no information any more.

    Parameters
    ----------
    measurements : sequence of Measurement
        In the order of their times.
    told, fitted : FusionConfig
        Configuration before and after the fit.
    options : TableOptions
        Options with which the measurements were read.
    """
    before = implausible(measurements, told, options)
    shown = before.shown if before is not None else ()
    if not shown:
        config = fitted.model_copy(update={"sensor_noise": "configured"})
        found = _ratio(run(measurements, config))
        head = measurements[:HEAD]
        shown = () if found is None else tuple(_repairs(head, config, options, found[0], found[0]))
    bearing = fitted.radar_std[1]
    if not shown and bearing > WIDEST_BEARING and bearing > told.radar_std[1]:
        likely = "; ".join(CAUSES[word] for word in ("degrees", "clockwise", "platform"))
        shown = (
            f"bearings with a noise of {bearing:.3g} rad tell nothing. Likely causes: {likely}",
        )
    return either(shown) or None


def either(causes: Sequence[str]) -> str:
    """Return causes that fit equally well as one text."""
    if len(causes) < 2:
        return "".join(causes)
    return f"either {', or '.join(causes)}: the data cannot tell which"


def _ratio(result: Run) -> tuple[float, int, int] | None:
    """Sum of the least NIS over its expected value; degrees of freedom and count of all NIS."""
    degrees = np.isfinite(result.innovations).sum(axis=1)
    compared = np.isfinite(result.nis) & (degrees > 0)
    nis, degrees = result.nis[compared], degrees[compared]
    if len(nis) < LEAST:
        return None
    kept = np.argsort(nis / degrees)[: int(np.ceil(KEPT * len(nis)))]
    total = int(degrees.sum())
    return float(nis[kept].sum()) / (KEPT_SUM * total), total, len(nis)


def _quantile(probability: float, degrees: int) -> float:
    """Quantile of the sum of the least NIS, relative to its expected value."""
    effective = max(1, int(degrees / KEPT_SPREAD))
    return chi2_quantile(probability, degrees=effective) / effective


def _scatter(measurements: Sequence[Measurement], config: FusionConfig) -> float:
    """Variance of LiDAR positions in its own frame, divided by the variance of its noise.

    Motion of target and platform adds to it: with correct noise it is not less than about 1.
    """
    rows = [m for m in measurements[:HEAD] if m.sensor == "lidar" and np.isfinite(m.values).all()]
    told = [
        np.square(config.lidar_std[:2]) if m.covariance is None else np.diag(m.covariance)[:2]
        for m in rows
    ]
    variance = np.var([m.values[:2] for m in rows], axis=0) / np.mean(told, axis=0)
    return float(np.mean(variance))


def _changed(
    measurements: Sequence[Measurement], sensor: str, change: Change
) -> Sequence[Measurement]:
    return [change(m) if m.sensor == sensor else m for m in measurements]


def _repairs(
    measurements: Sequence[Measurement],
    config: FusionConfig,
    options: TableOptions,
    ratio: float,
    limit: float,
) -> list[str]:
    """Texts of the mistakes whose correction reduces the NIS most, and below `limit`.

    It must fall to a tenth; for an error of a clock a third is enough if it was above `limit`.
    """
    known = {m.sensor for m in measurements}
    found = []
    # Without lengths of another sensor a smaller unit makes every error smaller: it would explain
    # all mistakes.
    has_ranges = any("range" in (m.measures or ()) for m in measurements)
    of_lengths = lengths(options) if "lidar" in known and has_ranges else []
    for sensor, text, change in [*repairs(options), *of_lengths]:
        if sensor in known:
            again = _ratio(run(_changed(measurements, sensor, change), config))
            if again is not None and again[0] <= min(limit, ratio / 10):
                found.append((again[0], text))
    late = None if found else _clock(measurements[:CLOCK_HEAD], config)
    if late is not None:
        again = _ratio(run(_changed(measurements, late[0], later(-late[1])), config))
        less = 3 if ratio > limit else 10
        if again is not None and again[0] <= min(limit, ratio / less):
            found.append((again[0], _clock_text(*late, options.clock.get(late[0], 0.0))))
    # Those about as good as the best one cannot be told apart from it.
    least = min(found, default=(0.0, ""))[0]
    shown = [text for value, text in sorted(found) if value <= 2 * least]
    length_texts = {text for _, text, _ in of_lengths}
    if not length_texts.isdisjoint(shown):
        # A smaller unit makes errors smaller, too: that a fit is better than expected says nothing,
        # and one sensor in kilometres looks like the other in millimetres. The likeliest is first.
        units = [one for one in found if one[1] in length_texts and one[0] <= max(2 * least, 2.0)]
        shown = [text for _, text in sorted(units, key=lambda one: abs(np.log(one[0])))]
    bearings = [
        abs(float(m.values[m.measures.index("bearing")]))
        for m in measurements
        if m.measures is not None and "bearing" in m.measures
    ]
    largest = max((value for value in bearings if np.isfinite(value)), default=0.0)
    in_degrees = options.angle_unit == "deg" or any("degrees" in text for text in shown)
    if ratio > limit and largest > TURN and not in_degrees:
        shown.append(
            f"bearings up to {largest:.4g} are more than a turn of radians: degrees"
            ' (angle_unit="deg")'
        )
    return shown


def _rates(
    measurements: Sequence[Measurement], config: FusionConfig, options: TableOptions, limit: float
) -> list[str]:
    """Texts of units of range rates that the ranges show and that reduce the NIS below `limit`."""
    changes = rate_repairs(measurements, options)
    before = _ratio(run(measurements, config)) if changes else None
    if before is None:
        return []
    found = []
    for text, change in changes:
        again = _ratio(run(_changed(measurements, "radar", change), config))
        if again is not None and again[0] <= min(limit, before[0]):
            found.append((again[0], text))
    return [text for _, text in sorted(found)]


def _clock_text(sensor: SensorName, further: float, told: float) -> str:
    ahead = round(told + further, 3)
    if ahead == 0:
        return f'the clocks of the sensors agree (leave out clock={{"{sensor}": {told:g}}})'
    what = "ahead of" if ahead > 0 else "behind"
    text = f"the clock of the {sensor} is {abs(ahead):g} s {what} the others"
    return f'{text} (clock={{"{sensor}": {ahead:g}}})'


def _clock(
    measurements: Sequence[Measurement], config: FusionConfig
) -> tuple[SensorName, float] | None:
    """Return the sensor whose clock is most likely wrong, and by how much it is ahead [s]."""
    known = sorted({m.sensor for m in measurements})
    sensors: list[SensorName] = [name for name in known if name in ("lidar", "radar")]
    if len(known) < 2:
        return None

    def cost(sensor: SensorName, ahead: float) -> float:
        found = _ratio(run(_changed(measurements, sensor, later(-ahead)), config))
        return np.inf if found is None else found[0]

    # Of two sensors either may be wrong; the radar, which often has a clock of its own, is named.
    sensor: SensorName = "radar" if "radar" in sensors else sensors[0]
    costs = {ahead: cost(sensor, ahead) for late in LATE for ahead in (late, -late)}
    best = min(costs, key=lambda ahead: costs[ahead])
    # The grid is coarse: a golden section would not help where the cost has several minima.
    finer = {best + step: cost(sensor, best + step) for step in 0.1 * best * np.arange(-4, 5)}
    return sensor, round(float(min(finer, key=lambda ahead: finer[ahead])), 3)


CAUSES: Mapping[str, str] = {
    "clockwise": "a clockwise or mirrored azimuth (bearings and yaws count counter-clockwise"
    " from x)",
    "degrees": "degrees instead of radians",
    "several targets": "several targets in one table",
    "latitude": "latitude and longitude taken as metres",
    "noise": "noise of the sensors, or of the target's motion, that is set much too small"
    " (set lidar_std=..., or find it with `config fit`)",
    "unit": 'a column in another unit, of lengths or speeds (scale={"COLUMN": FACTOR})',
    "platform": "a platform that moves or turns, of which no pose or gyro tells",
    "clock": "clocks of the sensors that differ",
}
"""What is likely, by a short name."""
ANY_CAUSE = tuple(CAUSES.values())
