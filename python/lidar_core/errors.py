"""Exceptions. Every class is also the builtin that a caller would expect."""


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
    """A broker or server cannot be reached; the text says what to start or to name."""


class InternalError(LidarCoreError, RuntimeError):
    """A bug in lidar_core; the object that raised it refuses further calls."""
