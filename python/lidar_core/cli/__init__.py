"""The `lidar-core` command: a file per command; heavy imports stay inside the functions."""

import signal
import sys
import traceback
import warnings
from collections.abc import Callable
from functools import partial
from importlib import import_module
from io import TextIOWrapper
from typing import Annotated, Any

import typer

from lidar_core.cli import config, train
from lidar_core.cli.shared.common import help_text, printing, stoppable, with_trust
from lidar_core.cli.shared.voice import Command, Commands, print_error, voice, with_voice
from lidar_core.errors import (
    LidarCoreError,
    OdometryWarning,
    PluginWarning,
    PoseFrameWarning,
    TruthWarning,
)

READING = ("info", "convert", "detect", "circles", "fuse", "evaluate", "view", "live")
"""Commands that read recordings, tables and clouds."""

app = typer.Typer(
    name="lidar-core",
    cls=Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=True,
    context_settings={"auto_envvar_prefix": "LIDAR_CORE"},
)

for _file in (
    "demo",
    "info",
    "convert",
    "simulate",
    "detect",
    "circles",
    "fuse",
    "results.evaluate",
    "doctor",
    "reproduce",
    "results.view",
    "results.report",
    "results.events",
    "batch",
    "live",
):
    _command = import_module(f"lidar_core.cli.{_file}").command
    _name = _file.rpartition(".")[2]
    _told = help_text(_command)
    if _name in READING:
        _command = with_trust(_command)
    app.command(_name, help=_told, cls=Command)(with_voice(stoppable(_command)))
app.command("export", help=help_text(train.export), cls=Command)(
    with_voice(stoppable(train.export))
)
app.add_typer(config.app, name="config")
app.add_typer(train.app, name="train")


def _print_version() -> None:
    from lidar_core import __version__

    print(f"lidar-core {__version__}")


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=printing(_print_version),
            is_eager=True,
            allow_from_autoenv=False,  # LIDAR_CORE_VERSION may say something else
            help="Print the version.",
        ),
    ] = False,
) -> None:
    """Detect flying objects, map round obstacles and fuse LiDAR with radar."""


def main() -> None:
    """Run the command; expected errors end in one readable line and exit status 2.

    SIGTERM, by which services and robots stop programs, is treated as Ctrl-C: files are completed.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    for told_as_note in (OdometryWarning, PoseFrameWarning):
        warnings.simplefilter("ignore", told_as_note)
    warnings.formatwarning = partial(_formatted, warnings.formatwarning)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a pipe on Windows knows few letters
            stream.reconfigure(errors="replace")
    try:
        app()
    except (LidarCoreError, OSError, MemoryError) as error:
        print_error(_text(error))
        if voice().is_verbose:
            traceback.print_exception(error)
        sys.exit(2)


def _formatted(
    usual: Callable[..., str], message: Warning | str, category: type[Warning], *place: Any
) -> str:
    """Format a warning: one line if a user can cause or fix it, else with its place in the code."""
    if issubclass(category, PluginWarning | TruthWarning):
        return f"warning: {message}\n"
    return usual(message, category, *place)


def _text(error: Exception) -> str:
    """Return the text of an error, after the name of the file if the system states it."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, MemoryError):
        return f"takes more memory than available: {error}".rstrip(": ")
    return str(error)
