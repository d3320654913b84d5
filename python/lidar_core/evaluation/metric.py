"""Registry of metrics, and computation of all of them."""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

from lidar_core.errors import ConfigError, PluginError, PluginWarning
from lidar_core.evaluation.config import EvaluationConfig
from lidar_core.evaluation.matching.pairing import Pairing
from lidar_core.evaluation.types import Estimates, Truth
from lidar_core.plugins import Registry, check_choice, registering_module

Of: TypeAlias = Literal["tracks", "detections", "both"]


@dataclass(frozen=True, slots=True)
class Paired:
    """Input of a metric.

    Attributes
    ----------
    estimates : Estimates
        Tracks or detections.
    truth : Truth
        The targets.
    pairing : Pairing
        Assignment of estimates to targets.
    config : EvaluationConfig
        Configuration of what counts as found.
    """

    estimates: Estimates
    truth: Truth
    pairing: Pairing
    config: EvaluationConfig


Compute: TypeAlias = Callable[[Paired], float | None]


@dataclass(frozen=True, slots=True)
class Metric:
    """One number about tracks or detections.

    Attributes
    ----------
    name : str
        Unique name, for Python and JSON.
    title : str
        Name of the metric in tables.
    unit : str
        Unit of the number; empty if it has none.
    of : str
        Input of the metric.
    compute : callable
        `compute(paired)`; returns None without input.
    module : str
        Module that registers it.
    """

    name: str
    title: str
    unit: str
    of: Of
    compute: Compute
    module: str = ""


METRICS: Registry[Metric] = Registry(
    "metric", "lidar_core.metrics", "lidar_core.evaluation.metrics"
)


def register_metric(
    name: str, title: str, unit: str = "", *, of: Of = "both"
) -> Callable[[Compute], Compute]:
    """Register a function that computes one number from paired estimates and targets.

    `evaluate` and `lidar-core evaluate` report it from then on. Another package names the module
    of its metric as an entry point of the group `lidar_core.metrics`.

    Parameters
    ----------
    name : str
        Unique name, for Python and JSON.
    title : str
        Name of the metric in tables.
    unit : str
        Unit of the number; empty if it has none.
    of : str
        "tracks", "detections" or "both".

    Raises
    ------
    ConfigError
        Another metric has this name, or it is not an identifier.

    Examples
    --------
    >>> @register_metric("matched_share", "matched")  # doctest: +SKIP
    ... def matched_share(paired): ...
    """
    if not name.isidentifier():
        raise ConfigError(f"metric {name!r}: expected a name such as 'longest_segment'")

    check_choice(f"metric {name!r}: of", of, Of)

    def register(compute: Compute) -> Compute:
        METRICS.add(Metric(name, title, unit, of, compute, registering_module()))
        return compute

    return register


def metrics_of(paired: Paired, of: Of) -> dict[str, float | None]:
    """Compute every registered metric of tracks or of detections; return the values by name.

    A metric of another package or of a script that fails, or returns no finite number, is left out
    with a warning.
    """
    found: dict[str, float | None] = {}
    for metric in METRICS.parts():
        if metric.of not in (of, "both"):
            continue
        try:
            with METRICS.calling(metric):
                value = metric.compute(paired)
                if value is not None:
                    value = float(value)
                    if not math.isfinite(value):
                        raise ValueError(f"{metric.name}: expected a finite number, got {value}")
        except PluginError as error:
            warnings.warn(str(error), PluginWarning, stacklevel=2)
            continue
        found[metric.name] = value
    return found
