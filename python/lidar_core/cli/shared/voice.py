"""Messages of a command: as text or JSON lines, quiet or verbose."""

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import wraps
from inspect import Parameter, signature
from io import TextIOBase
from typing import TYPE_CHECKING, Annotated, Any, Literal, TextIO

import typer
from typer.core import TyperCommand, TyperGroup

from lidar_core.errors import without_prefix

if TYPE_CHECKING:
    from rich.console import Console

Style = Literal["text", "json"]
LOG = "Log"
"""Group of these options in a `--help`."""
EVERY_S, EVERY_VERBOSE_S = 60.0, 5.0
"""Time between two lines about progress where there is no terminal."""
_LEVELS = ("error", "warning", "note")
_OPTIONS: dict[str, tuple[Any, Any]] = {
    "log": (
        Style,
        typer.Option(
            "--log",
            envvar="LIDAR_CORE_LOG",
            help="Messages as text or as JSON lines.",
            rich_help_panel=LOG,
        ),
    ),
    "quiet": (
        bool,
        typer.Option(
            "--quiet",
            "-q",
            envvar="LIDAR_CORE_QUIET",
            help="Print only errors: no table, notes or progress.",
            rich_help_panel=LOG,
        ),
    ),
    "verbose": (
        bool,
        typer.Option(
            "--verbose",
            "-v",
            envvar="LIDAR_CORE_VERBOSE",
            help="Print versions, more progress, and the traceback of an error.",
            rich_help_panel=LOG,
        ),
    ),
}
_DEFAULTS = {"log": "text", "quiet": False, "verbose": False}


@dataclass(frozen=True, slots=True)
class Voice:
    """Form of messages that the options select.

    Attributes
    ----------
    style : str
        Form of standard error: "text", or "json" for one object per line.
    is_quiet, is_verbose : bool
        Only errors; more than usual.
    """

    style: Style = "text"
    is_quiet: bool = False
    is_verbose: bool = False

    @property
    def every_s(self) -> float:
        """Time between two lines about progress where there is no terminal [s]."""
        return EVERY_VERBOSE_S if self.is_verbose else EVERY_S


_chosen = Voice()


def voice() -> Voice:
    """Return the form of messages of the command that runs, or ran last."""
    return _chosen


def entry(text: str, **fields: Any) -> str:
    """Return one JSON line: time, level, text and further fields."""
    level = next((one for one in _LEVELS if text.startswith(f"{one}:")), "info")
    known = {
        "time": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "level": "info" if level == "note" else level,
        "text": text,
    }
    return json.dumps({**known, **fields}, default=str)


class JsonLines(TextIOBase):
    """A text stream whose lines become JSON objects."""

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._begun = stream, ""

    def write(self, text: str) -> int:
        """Buffer text; write the complete lines."""
        *lines, self._begun = (self._begun + text).split("\n")
        for line in lines:
            if line.strip():
                self.say(line.strip())
        return len(text)

    def say(self, text: str, **fields: Any) -> None:
        """Write one object."""
        self._stream.write(entry(text, **fields) + "\n")
        self._stream.flush()

    def close(self) -> None:
        """Write the last incomplete line; the stream stays open."""
        if self._begun.strip():
            self.write("\n")


def tell(console: "Console", text: str, **fields: Any) -> None:
    """Write a message to standard error; `fields` has its values for programs."""
    if isinstance(sys.stderr, JsonLines) and console.stderr and not console.quiet:
        sys.stderr.say(" ".join(text.split()), **fields)
    else:
        console.print(text, markup=False, highlight=False, soft_wrap=True)


class Command(TyperCommand):
    """Command without names of environment variables in its help."""

    def __init__(self, *arguments: Any, **values: Any) -> None:
        super().__init__(*arguments, **values)
        for option in self.params:
            if option.envvar is None:
                option.show_envvar = False  # type: ignore[attr-defined]


class Commands(TyperGroup):
    """Group of all commands; errors of values are as short as those of the package."""

    def invoke(self, ctx: Any) -> Any:
        """Parse the arguments of a command, also of one in a group below, and run it."""
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            error.message = without_prefix(error.message)
            raise


def with_voice(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options --log, --quiet and --verbose to a command."""

    @wraps(command)
    def called(*arguments: Any, **options: Any) -> None:
        log, quiet, verbose = (options.pop(name) for name in _OPTIONS)
        with _speaking(Voice(log, quiet, verbose)):
            command(*arguments, **options)

    known = signature(command)
    only = Parameter.KEYWORD_ONLY
    own = [
        Parameter(name, only, default=_DEFAULTS[name], annotation=Annotated[kind, option])
        for name, (kind, option) in _OPTIONS.items()
    ]
    parameters = [*known.parameters.values(), *own]
    called.__signature__ = known.replace(parameters=parameters)  # type: ignore[attr-defined]
    return called


@contextmanager
def _speaking(chosen: Voice) -> Iterator[None]:
    global _chosen  # noqa: PLW0603 one command runs in a process
    _chosen = chosen
    if chosen.style == "text":
        _greet()
        yield
        return
    lines = JsonLines(sys.stderr)
    with redirect_stderr(lines):
        _greet()
        try:
            yield
        finally:
            lines.close()


def _greet() -> None:
    if not _chosen.is_verbose:
        return
    import platform

    from lidar_core import __version__

    command = " ".join(sys.argv[1:])
    print(
        f"lidar-core {__version__}, Python {platform.python_version()},"
        f" {platform.platform()}: {command}",
        file=sys.stderr,
    )


def print_error(text: str) -> None:
    """Print the last line of a command, an error."""
    line = f"error: {text}"
    print(entry(line) if _chosen.style == "json" else line, file=sys.stderr)


class Pace:
    """Printer of lines about progress for logs: one per minute for every step."""

    def __init__(self, console: "Console", counts: str) -> None:
        self._console, self._counts, self._every_s = console, counts, _chosen.every_s
        self._begun: dict[str, float] = {}
        self._told: dict[str, float] = {}

    def show(self, what: str, done: int, total: int | None) -> None:
        """Report the progress of a step if enough time has passed since the last report."""
        now = time.monotonic()
        begun = self._begun.setdefault(what, now)
        if now - self._told.setdefault(what, begun) < self._every_s:
            return
        self._told[what] = now
        if total is not None and done > total:
            total = None  # an item does every part once, however little was asked for
        rate = done / (now - begun)
        of = "" if total is None else f" of {total}"
        left_s = None if total is None or not rate else round((total - done) / rate)
        left = "" if left_s is None else f", {left_s} s left"
        tell(
            self._console,
            f"{what}: {done}{of} {self._counts}, {rate:.1f} per second{left}",
            step=what,
            done=done,
            total=total,
            per_second=round(rate, 3),
            seconds_left=left_s,
        )
