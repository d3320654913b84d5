"""Uses whose best parameters differ from the defaults, each measured against them."""

from collections.abc import Mapping
from dataclasses import dataclass

from lidar_core.config import Config
from lidar_core.errors import ConfigError, unknown
from lidar_core.parameters import model_named

__all__ = ["USES", "Use", "use_named"]


@dataclass(frozen=True, slots=True)
class Use:
    """One use.

    Attributes
    ----------
    model : str
        Name of the model that it configures, in `lidar_core.parameters.MODELS`.
    title : str
        Purpose.
    maker : str
        Name of the model's class method that makes its configuration.
    """

    model: str
    title: str
    maker: str

    def config(self) -> Config:
        """Complete configuration of the use."""
        made: Config = getattr(model_named(self.model), self.maker)()
        return made


USES: Mapping[str, Use] = {
    "long-range": Use("flying", "flying objects up to 50 m away, for dense LiDARs", "long_range"),
    "posts": Use("circles", "trees, columns, poles: objects that do not move", "posts"),
    "turning-sensor": Use(
        "fusion", "a sensor that turns, without poses but with a gyro", "turning_sensor"
    ),
}
"""By the name that `lidar-core config --use` gives them."""


def use_named(name: str) -> Use:
    """Return the use of this name.

    Raises
    ------
    ConfigError
        There is no such use.
    """
    if name not in USES:
        raise ConfigError(unknown("use", name, USES))
    return USES[name]


def __dir__() -> list[str]:
    return __all__
