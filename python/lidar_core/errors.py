"""Exceptions. Every class is also the builtin that a caller would expect."""

from collections.abc import Iterable
from difflib import get_close_matches

__all__ = [
    "ConfigError",
    "FormatError",
    "InputError",
    "InternalError",
    "LidarCoreError",
    "LimitError",
    "LinkError",
    "MissingExtraError",
    "NumericalError",
    "OdometryWarning",
    "PluginError",
    "PluginWarning",
    "PoseFrameWarning",
    "TruthWarning",
    "closest",
    "did_you_mean",
    "unknown",
    "without_prefix",
]

_OF_PYDANTIC = "Value error, "


class LidarCoreError(Exception):
    """Catches everything this package raises."""


class InputError(LidarCoreError, ValueError):
    """An array has the wrong shape or dtype, or holds a value that cannot be used."""


class FormatError(LidarCoreError, ValueError):
    """A file or message breaks its format; the text names the file and the place."""


class LimitError(LidarCoreError, ValueError):
    """An input exceeds a limit; the text names the limit and the key that raises it."""


class ConfigError(LidarCoreError, ValueError):
    """A parameter is unknown or outside its documented range."""


class NumericalError(LidarCoreError, ArithmeticError):
    """A covariance lost symmetry or positive definiteness."""


class MissingExtraError(LidarCoreError, ImportError):
    """An optional dependency is not installed; the text gives the command that installs it."""


class LinkError(LidarCoreError, ConnectionError):
    """A broker or server cannot be reached; the text states a remedy."""


class PluginError(LidarCoreError, ImportError):
    """A reader, writer or metric of another package is broken; the text names the package."""


class InternalError(LidarCoreError, RuntimeError):
    """A bug in lidar_core; the object that raised it refuses further calls."""


class OdometryWarning(UserWarning):
    """Poses estimated from the scans are missing for some scans, or are doubtful."""


class PluginWarning(UserWarning):
    """A plugin is broken, and left out."""


class PoseFrameWarning(UserWarning):
    """The given poses do not fit the scans, but they fit in another frame."""


class TruthWarning(UserWarning):
    """True places of a recording are missing, so fewer results can be compared."""


def closest(name: str, known: Iterable[str]) -> str | None:
    """Return the entry of `known` that is spelt most like `name`; None if none is similar."""
    return next(iter(get_close_matches(name, list(known), n=1)), None)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return a hint for an unknown name: the entry of `known` that was probably meant."""
    near = closest(name, known)
    return "" if near is None else f"; did you mean {near}?"


def unknown(what: str, name: str, known: Iterable[str]) -> str:
    """Return the error text for an unknown name; `what` is the kind of thing that it names."""
    names = list(known)
    return f"{what}: expected one of {', '.join(names)}, got {name!r}{did_you_mean(name, names)}"


def without_prefix(message: str) -> str:
    """Return the message of a problem that pydantic found, without its words for a ValueError."""
    return message.removeprefix(_OF_PYDANTIC)


def __dir__() -> list[str]:
    return __all__
