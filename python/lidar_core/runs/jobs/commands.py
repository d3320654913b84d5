"""Commands that a job may contain: they end by themselves, and write to the folder of the job."""

import os
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, cast

from typer import BadParameter
from typer.main import get_command

from lidar_core.batch import BatchJob
from lidar_core.batch.config import OUTPUT
from lidar_core.errors import ConfigError, unknown

COMMAND_LINE = "lidar_core.cli:app"
"""Runs the commands of a job. Found by name: the command line is built on `lidar_core.runs`."""
OVERFLIGHT = "overflight"
"""Scene of `simulate` that takes no threads."""
WITHOUT = ("batch", "view")
"""Commands that are no jobs: they do not end by themselves, or would start jobs of their own."""
UsageError = cast("type[Exception]", BadParameter.__base__)
"""What a parser raises; typer hands out this one of its errors alone."""
WRITTEN = {("export", "model")}
"""Arguments, besides those called output, that name what a command writes."""

NAMES = {"events": "events.csv", "report": "report.html"}
"""Names for what commands write; others write to what is named like the command."""


def options_of(command: str) -> set[str]:
    """Options of a command that take a value."""
    parameters = _commands()[command].params
    return {name for one in parameters if not getattr(one, "is_flag", False) for name in one.opts}


@cache
def command_line() -> Any:
    """Return the command line with all commands; it is built only once, because that is slow."""
    return get_command(resolve_name(COMMAND_LINE))


def _commands() -> Mapping[str, Any]:
    known: Mapping[str, Any] = vars(command_line())["commands"]
    return known


def check_commands(job: BatchJob) -> None:
    """Reject commands that cannot be jobs, or not be parsed, or write outside of the job's folder.

    Raises
    ------
    ConfigError
        A command is one of these.
    """
    known = sorted(set(_commands()) - set(WITHOUT))
    for command in job.commands:
        if not command or command[0] not in known:
            named = command[0] if command else ""
            cure = "; leave it out" if named == "lidar-core" else ""
            raise ConfigError(f"{unknown(f'jobs.{job.group}.commands', named, known)}{cure}")
        try:
            written = _written(command)
        except UsageError as error:
            told: Any = error
            raise ConfigError(
                f"jobs.{job.group}.commands: {' '.join(command)!r}: {told.format_message()}"
            ) from error
        outside = [(where, value) for where, value in written if not _is_inside(value)]
        if outside:
            where, value = outside[0]
            name = NAMES.get(command[0], command[0])
            cure = f", such as {where} {{{OUTPUT}}}/{name}" if value is None else ""
            raise ConfigError(
                f"jobs.{job.group}.commands: expected {{{OUTPUT}}} in {' '.join(command)!r}, as the"
                f" beginning of {where}{cure}; files elsewhere are not part of the job"
            )


def _written(command: Sequence[str]) -> list[tuple[str, str | None]]:
    """Return the options and arguments of a command that name its output files, with their values.

    The value of an option that is not given is None: its default is outside of the job's folder.

    Raises
    ------
    UsageError
        An option or an argument is unknown, or one is missing. Values are not checked: that may
        need files that earlier commands write.
    """
    known = _commands()[command[0]]
    below: Mapping[str, Any] = getattr(known, "commands", {})
    words = 2 if len(command) > 1 and command[1] in below else 1
    known, parser = _parser(*command[:words])
    arguments = list(command[words:])
    values, rest, _ = parser.parse_args(arguments)
    if rest:
        raise UsageError(f"Got unexpected extra argument: {' '.join(map(str, rest))}")
    found = []
    for one in known.params:
        value = values.get(one.name)
        if value is None and one.required and one.param_type_name == "argument":
            raise UsageError(f"Missing argument: {str(one.name).upper()}")
        if one.name == "output" or (command[0], one.name) in WRITTEN:
            found.append((max(one.opts, key=len), None if value is None else str(value)))
        elif "--json" in one.opts and value not in (None, False, True) and str(value) != "-":
            found.append(("--json", str(value)))
    return found


@cache
def _parser(name: str, below: str | None = None) -> tuple[Any, Any]:
    """Return a command, or its subcommand `below`, and its parser; made once for all jobs."""
    known = _commands()[name]
    if below is not None:
        known = known.commands[below]
    context = known.make_context(below or name, [], resilient_parsing=True)
    context.resilient_parsing = False
    return known, known.make_parser(context)


def _is_inside(value: str | None) -> bool:
    """Return whether a path is in the folder of the job."""
    if value is None or not value.startswith(f"{{{OUTPUT}}}"):
        return False
    folder = Path(os.sep) / "job"
    place = Path(os.path.normpath(value.replace(f"{{{OUTPUT}}}", str(folder))))
    return place.is_relative_to(folder)
