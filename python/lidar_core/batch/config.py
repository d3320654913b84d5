"""Configuration of a batch: commands, run once for every combination of the listed values."""

import glob
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Self, TypeAlias

from pydantic import Field, model_validator

from lidar_core.config import Config
from lidar_core.errors import ConfigError, LimitError
from lidar_core.io.remote import fetched, is_remote, matching
from lidar_core.io.tables.columns import read_columns

Value: TypeAlias = str | int | float | bool
OUTPUT = "output"
MOST_JOBS = 100_000
"""Largest number of jobs of one group. Source: limits table of SECURITY.md."""
_PLACE = re.compile(r"\{(\w*)\}")


class BatchGroup(Config):
    """Jobs that differ in the values of {NAME} in their commands.

    A job is one value of every entry of `grid`, `ranges` and `files`, with one of `rows`; {output}
    is the folder of the job.
    """

    name: str = Field(
        pattern=r"^[A-Za-z0-9][\w.-]*$",
        max_length=60,
        description="Start of the folder names of its jobs (no unit).",
    )
    commands: tuple[str, ...] = Field(
        min_length=1, description="Commands without `lidar-core`, one after the other (no unit)."
    )
    grid: dict[str, tuple[Value, ...]] = Field(
        default_factory=dict, description="Values of {NAME} (no unit)."
    )
    ranges: dict[str, tuple[int, int]] = Field(
        default_factory=dict,
        description="Whole numbers, from the first up to the second (no unit).",
    )
    files: dict[str, str] = Field(
        default_factory=dict,
        description="Files and folders, as patterns with * and **, from the folder of the batch"
        " file, or addresses such as s3://bucket/*.mcap (no unit).",
    )
    rows: tuple[dict[str, Value], ...] | str = Field(
        default=(),
        description="Values that belong together, or a table of them: a .csv or .parquet file,"
        " from the folder of the batch file, or an address such as s3://bucket/a.csv (no unit).",
    )

    @model_validator(mode="after")
    def _names_are_known_and_used(self) -> Self:
        if isinstance(self.rows, str):
            return self  # the table has the names: `jobs_of` looks at them
        self._check(self.rows)
        return self

    def _check(self, rows: Sequence[Mapping[str, Value]]) -> None:
        named = [*self.grid, *self.ranges, *self.files, *(rows[0] if rows else ())]
        twice = sorted({name for name in named if named.count(name) > 1})
        if twice or OUTPUT in named:
            raise ValueError(f"expected every name once, none of them output, got {named}")
        empty = [name for name, values in self.grid.items() if not values]
        empty += [name for name, (first, end) in self.ranges.items() if first >= end]
        if empty:
            raise ValueError(f"expected at least one value, got none for {', '.join(empty)}")
        if any(set(row) != set(rows[0]) for row in rows):
            raise ValueError("rows: expected the same names in every row")
        used = {name for command in self.commands for name in _PLACE.findall(command)}
        missing, unused = sorted(used - {OUTPUT, *named}), sorted(set(named) - used)
        if missing or unused:
            told = [f"{{{name}}} has none" for name in missing]
            told += [f"no command uses {{{name}}}" for name in unused]
            raise ValueError(
                "expected a value for every {NAME} of the commands and no others:"
                f" {', '.join(told)}"
            )
        for command in self.commands:
            shlex.split(command)

    def rows_from(self, folder: Path) -> Sequence[Mapping[str, Value]]:
        """Return the rows; those of a table are checked like those of the batch file.

        Raises
        ------
        ConfigError
            The table has no rows, or other names than the commands.
        """
        if not isinstance(self.rows, str):
            return self.rows
        rows = _rows_of(self.rows, folder)
        try:
            if not rows:
                raise ValueError("expected rows, got none")
            self._check(rows)
        except ValueError as error:
            raise ConfigError(f"jobs.{self.name}.rows: {self.rows}: {error}") from None
        return rows


class BatchConfig(Config):
    """A batch: groups of jobs."""

    jobs: tuple[BatchGroup, ...] = Field(default=(), description="Groups of jobs (no unit).")

    @model_validator(mode="after")
    def _groups_have_names(self) -> Self:
        names = [group.name for group in self.jobs]
        if len(set(names)) < len(names):
            raise ValueError(f"expected different names of groups, got {names}")
        return self


@dataclass(frozen=True, slots=True)
class BatchJob:
    """Commands with their values.

    Attributes
    ----------
    group : str
        Name of the group.
    values : dict
        Value of every {NAME}.
    commands : tuple of tuple of str
        Arguments of each command, with {output} not yet replaced.
    """

    group: str
    values: dict[str, Value]
    commands: tuple[tuple[str, ...], ...]

    def commands_into(self, folder: Path) -> tuple[tuple[str, ...], ...]:
        """Return the commands with `folder` in place of {output}."""
        return tuple(
            tuple(part.replace(f"{{{OUTPUT}}}", str(folder)) for part in command)
            for command in self.commands
        )


def jobs_of(config: BatchConfig, folder: Path) -> list[BatchJob]:
    """Return every job in the order of the file; file patterns are relative to `folder`.

    Raises
    ------
    ConfigError
        No file matches a pattern, or the batch has no group.
    """
    if not config.jobs:
        raise ConfigError("jobs: expected at least one group of jobs, got none")
    return [job for group in config.jobs for job in _of_group(group, folder)]


def _of_group(group: BatchGroup, folder: Path) -> Iterator[BatchJob]:
    choices: dict[str, tuple[Value, ...]] = {
        name: _matching(group.name, name, pattern, folder) for name, pattern in group.files.items()
    }
    choices |= group.grid
    rows = group.rows_from(folder)
    counts = [len(values) for values in choices.values()]
    counts += [end - first for first, end in group.ranges.values()]
    if (count := prod(counts) * max(len(rows), 1)) > MOST_JOBS:
        raise LimitError(
            f"jobs.{group.name}: {count} jobs of all combinations, limit {MOST_JOBS}; give fewer"
            " values in grid, ranges, files and rows, or split it into several batches"
        )
    choices |= {name: tuple(range(*limits)) for name, limits in group.ranges.items()}
    for row in rows or ({},):
        for chosen in product(*choices.values()):
            values = {**row, **dict(zip(choices, chosen, strict=True))}
            yield BatchJob(
                group.name, values, tuple(_filled(text, values) for text in group.commands)
            )


def _matching(group: str, name: str, pattern: str, folder: Path) -> tuple[str, ...]:
    if is_remote(pattern):
        addresses = matching(pattern)
        if not addresses:
            raise ConfigError(f"jobs.{group}.files.{name}: nothing matches {pattern}")
        return tuple(addresses)
    found = sorted(glob.glob(pattern, root_dir=folder, recursive=True))
    if not found:
        raise ConfigError(f"jobs.{group}.files.{name}: nothing matches {folder / pattern}")
    return tuple(str(folder / one) for one in found)


def _rows_of(table: str, folder: Path) -> list[dict[str, Value]]:
    """Read the rows of a table, by the names of its columns; nested values become texts."""
    with TemporaryDirectory(prefix="lidar-core-table-") as scratch:
        place = fetched(table, Path(scratch)) if is_remote(table) else folder / table
        columns = read_columns(place)
    lists = [values.tolist() for values in columns.values()]
    return [
        {
            name: value if isinstance(value, str | int | float | bool) else str(value)
            for name, value in zip(columns, row, strict=True)
        }
        for row in zip(*lists, strict=True)
    ]


def _filled(command: str, values: Mapping[str, Value]) -> tuple[str, ...]:
    """Split a command into arguments, then fill in the values, which may contain spaces."""

    def value(match: re.Match[str]) -> str:
        if match[1] == OUTPUT:
            return match[0]
        held = values[match[1]]
        return str(held).lower() if isinstance(held, bool) else str(held)

    return tuple(_PLACE.sub(value, part) for part in shlex.split(command))
