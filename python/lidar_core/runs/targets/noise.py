"""Noise of a run on one target that is found from its recordings."""

from collections.abc import Iterable, Sequence, Set
from pathlib import Path

import numpy as np

from lidar_core.errors import InputError
from lidar_core.fusion import FusionConfig, MeasurementLog, Measurements, MultiTargetConfig
from lidar_core.fusion.plausibility import mistaken_for_noise
from lidar_core.fusion.tuning import MODELS, fit_likeliest, with_models
from lidar_core.runs.settings import ConfigChoice, file_values

SETTLED = 10
"""Measurements of every recording that a fit of noise leaves out, since the filter starts."""


def names_told(
    config: FusionConfig | MultiTargetConfig | ConfigChoice | None, ways: Iterable[str]
) -> frozenset[str]:
    """Return the names of values that the user chose, `ways` included; a fit keeps them.

    A configuration that was made in Python chooses its model, also that of the defaults.

    Raises
    ------
    ConfigError
        The file of a choice cannot be used.
    """
    if not isinstance(config, ConfigChoice | None):
        return frozenset({"model", *config.model_fields_set, *ways})
    choice = config or ConfigChoice()
    named = {value.partition("=")[0].rpartition(".")[2].strip() for value in choice.values}
    in_file = () if choice.file is None else file_values(Path(choice.file), "fusion")
    of_mode = ("model",) if choice.mode == "paper" else ()
    return frozenset({*named, *in_file, *of_mode, *ways})


def text_of_fit(config: FusionConfig, told: Set[str]) -> str:
    """Return the results of a fit as text, for the notes of a run."""
    names = ["acceleration_noise", "turn_noise", "lidar_std", "radar_std"]
    values = {name: np.atleast_1d(getattr(config, name)) for name in names}
    noise = ", ".join(
        f"{name} {' '.join(f'{one:.3g}' for one in numbers)}" for name, numbers in values.items()
    )
    likelier = f"model {config.model}, the likelier one of {' and '.join(MODELS)}; "
    model = "" if _is_model_told(told) else likelier
    return f"found: {model}{noise}; sensor_noise {config.sensor_noise}"


def _is_model_told(told: Set[str]) -> bool:
    return not {"model", "method"}.isdisjoint(told)


def fitted(
    logs: Sequence[tuple[Path, MeasurementLog]],
    config: FusionConfig,
    *,
    told: Set[str],
    force: bool,
) -> FusionConfig:
    """Return `config` with fitted noise, and the likelier model unless it is among `told`.

    Raises
    ------
    InputError
        As for `fit_config`.
    """
    ordered = [
        (place, sorted(log.measurements, key=lambda one: one.stamp_ns), log.options)
        for place, log in logs
    ]
    for place, measurements, _ in ordered:
        if len(measurements) <= SETTLED:
            raise InputError(
                f"{place}: expected more than {SETTLED} measurements to find noise from,"
                f" got {len(measurements)}"
            )
    try:
        found = fit_likeliest(
            [Measurements(rows) for _, rows, _ in ordered],
            [config] if _is_model_told(told) else with_models(config),
            believes="sensor_noise" not in told,
        )
    except InputError as error:
        places = ", ".join(str(place) for place, *_ in ordered)
        raise InputError(f"{places}: {error}") from error
    for place, measurements, options in () if force else ordered:
        mistake = mistaken_for_noise(measurements, config, found, options)
        if mistake is not None:
            raise InputError(
                f"{place}: the measurements contain a mistake that noise cannot explain. The data"
                f" shows: {mistake}."
                " force=True continues anyway"
            )
    return found
