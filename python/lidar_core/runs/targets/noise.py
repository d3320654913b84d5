"""Noise of a run on one target that is found from its recordings."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from lidar_core.errors import InputError
from lidar_core.fusion import FusionConfig, MeasurementLog, Measurements, MultiTargetConfig
from lidar_core.fusion.plausibility import mistaken_for_noise
from lidar_core.fusion.tuning import fit_likeliest, with_models
from lidar_core.runs.settings import ConfigChoice

SETTLED = 10
"""Measurements of every recording that a fit of noise leaves out, since the filter starts."""


def tells_model(
    config: FusionConfig | MultiTargetConfig | ConfigChoice | None, ways: Mapping[str, str]
) -> bool:
    """Whether somebody chose model or method, so that a fit does not."""
    if not isinstance(config, ConfigChoice | None):
        return True
    choice = config or ConfigChoice()
    named = [value.partition("=")[0].rpartition(".")[2].strip() for value in choice.values]
    is_told = not {"model", "method"}.isdisjoint((*named, *ways))
    return is_told or choice.file is not None or choice.mode == "paper"


def fitted(
    logs: Sequence[tuple[Path, MeasurementLog]],
    config: FusionConfig,
    *,
    finds_model: bool,
    force: bool,
) -> FusionConfig:
    """`config` with the noise of recordings, and the likelier model where none is told.

    Raises
    ------
    InputError
        As `fit_config`.
    """
    ordered = [
        (place, sorted(log.measurements, key=lambda one: one.stamp_ns)) for place, log in logs
    ]
    for place, measurements in ordered:
        if len(measurements) <= SETTLED:
            raise InputError(
                f"{place}: expected more than {SETTLED} measurements to find noise from,"
                f" got {len(measurements)}"
            )
    try:
        several = with_models(config) if finds_model else [config]
        found = fit_likeliest([Measurements(rows) for _, rows in ordered], several)
    except InputError as error:
        places = ", ".join(str(place) for place, _ in ordered)
        raise InputError(f"{places}: {error}") from error
    for place, measurements in () if force else ordered:
        mistake = mistaken_for_noise(measurements, config, found)
        if mistake is not None:
            raise InputError(
                f"{place}: noise would have to explain a mistake. The data shows: {mistake}."
                " force=True goes on nevertheless"
            )
    return found
