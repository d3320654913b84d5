"""Base of the configuration models: TOML in and out, JSON Schema, errors with dotted paths."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import tomli_w
from pydantic import BaseModel, ConfigDict, ValidationError

from lidar_core.errors import ConfigError


class Config(BaseModel):
    """Base of every configuration model: unknown keys fail, every problem is reported at once."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise _config_error(type(self).__name__, error) from error

    @classmethod
    def load(cls, values: Mapping[str, Any]) -> Self:
        """Validate values that come from a file or a command line.

        Raises
        ------
        ConfigError
            One line per problem: dotted path, what was expected, what was received.
        """
        return cls(**values)

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a TOML file.

        Raises
        ------
        ConfigError
            The file is no TOML, or a value is unknown or outside its range.
        """
        try:
            with Path(path).open("rb") as file:
                values = tomllib.load(file)
        except tomllib.TOMLDecodeError as error:
            raise ConfigError(f"{path}: expected TOML: {error}") from error
        return cls.load(values)

    def to_toml(self) -> str:
        """Every value, as TOML that `read` accepts."""
        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True))


def _config_error(model: str, error: ValidationError) -> ConfigError:
    problems = (
        f"{'.'.join(map(str, problem['loc'])) or model}: {problem['msg']}, got {problem['input']!r}"
        for problem in error.errors()
    )
    return ConfigError("\n".join(problems))
