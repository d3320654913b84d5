"""Parts that commands share: consoles, progress, pictures, results for people and machines."""

import json
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import wraps
from inspect import Parameter, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import typer

from lidar_core.cli.shared.voice import Pace, tell, voice
from lidar_core.errors import LidarCoreError
from lidar_core.util.reasons import kind_of
from lidar_core.util.rows import Row
from lidar_core.util.threads import all_threads

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from lidar_core.runs.result import OnProgress, RunResult

SLOW_MS = 10.0  # times below are printed with more digits
REASONS = 3  # that a table shows for rejected scans
NOTHING_CAME = 3
"""Exit status of a live run to which no scan ever came."""
INTERRUPTED = 130
"""Exit status after Ctrl-C or SIGTERM."""
READ, WRITTEN = "Input", "Output"
"""Groups of options in a `--help`: each is a table as wide as its own names need."""


Mode = Literal["best", "paper"]
Threads: TypeAlias = Annotated[
    int,
    typer.Option(
        min=1,
        default_factory=all_threads,
        show_default="all",
        envvar="LIDAR_CORE_THREADS",
        help="Number of threads; the result is the same.",
    ),
]
OverwriteFile: TypeAlias = Annotated[
    bool, typer.Option("--overwrite", help="Replace an existing file.")
]


def check_new(*files: Path, overwrite: bool) -> None:
    """Refuse, before any work, to replace files that exist; folders have rules of their own.

    Raises
    ------
    FileExistsError
        One of the files exists, and `overwrite` is false.
    """
    for file in () if overwrite else files:
        if file.is_file():
            raise FileExistsError(f"{file}: exists; --overwrite replaces it")


def make_parents(file: Path) -> None:
    """Make the missing folders of the path of a file to write."""
    file.parent.mkdir(parents=True, exist_ok=True)


def _writable(file: Path | None) -> Path | None:
    """Refuse, before any work, a file that cannot be written; its folder may be made later."""
    from lidar_core.io.files.atomic import check_place

    if file is not None and str(file) != "-" and file.parent.exists():
        check_place(file)
    return file


JsonFile: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--json",
        callback=_writable,
        help="Also write the result as JSON; - prints it instead of the table.",
    ),
]


def printing(show: Callable[[], None]) -> Callable[[bool], None]:
    """Make the callback of an option that prints something instead of running the command."""

    def called(is_wanted: bool) -> None:
        if is_wanted:
            show()
            raise typer.Exit

    return called


def help_text(command: Callable[..., None]) -> str:
    """Return the `--help` text of a command, each paragraph as one line."""
    paragraphs = (command.__doc__ or "").split("\n\n")
    return "\n\n".join(" ".join(one.split()) for one in paragraphs)


_TRUSTED = "Parse files in this process, without limits; only for files that you trust."

OPTIONS = {
    **{
        name: name.replace("_", "-")
        for name in (
            "allow_origin",
            "angle_unit",
            "association",
            "capability",
            "checkpoint",
            "fixed_frame",
            "force",
            "gate",
            "mcap",
            "metadata",
            "model",
            "mounting",
            "odom",
            "overwrite",
            "pose",
            "repeat",
            "replay",
            "resume",
            "scan_rate",
            "stamps",
            "time_unit",
            "trusted",
        )
    },
    "allow_untrusted": "trust-model",
    "cloud": "cloud",
    "clouds": "cloud",
    "columns": "column",
    "scan": "scan",
    "source": "in",
    "topics": "topic",
}
"""Options of commands by the arguments of functions whose errors name them."""
ARGUMENT = re.compile(
    rf"(?<![\w-])(?<!--topic )(?<!--column )({'|'.join(OPTIONS)})=(?!=)(True\b|\"(\w+)\"|)"
)
_PAIR = r'"(\w+)": \[?"?([\w.+-]+)"?\]?'
PAIR = re.compile(_PAIR)
PAIRS = re.compile(rf"(?:(column|topic)s|(azimuth|clock|scale))=\{{({_PAIR}(?:, {_PAIR})*)\}}")
PREFIXES = {
    "source": "--in",
    "source, replay": "--in, --replay:",
    "outputs": "--out",
    "rate": "--rate:",
    "stream": "--stream",
    "values": "--set",
}
UNUSED = re.compile(
    r"(: |; )(column|topic|time_unit|angle_unit|azimuth|clock|scale|association)s?"
    r" (does not|applies)"
)
PREFIX = re.compile(rf"^({'|'.join(PREFIXES)}): ")
VALUE = re.compile(r'\bset (?=[\w."]+=)')


def as_options(text: str) -> str:
    """Replace names of arguments (`name=value`) in a text by the options of the command."""

    def repeated(found: re.Match[str]) -> str:
        pairs = PAIR.findall(found[3])
        return " ".join(f"--{found[1] or found[2]} {ours}={theirs}" for ours, theirs in pairs)

    text = PREFIX.sub(lambda found: f"{PREFIXES[found[1]]} ", text)
    text = UNUSED.sub(lambda one: f"{one[1]}--{one[2].replace('_', '-')} {one[3]}", text)
    text = VALUE.sub("--set ", PAIRS.sub(repeated, text))

    def option(found: re.Match[str]) -> str:
        name = f"--{OPTIONS[found[1]]}"
        return name if found[2] == "True" else f"{name} {found[3] or ''}"

    return ARGUMENT.sub(option, text)


def stoppable(command: Callable[..., None]) -> Callable[..., None]:
    """Wrap a command: errors name its options, and Ctrl-C gives its exit status."""

    @wraps(command)
    def called(*arguments: Any, **options: Any) -> None:
        try:
            command(*arguments, **options)
        except KeyboardInterrupt:
            print("interrupted: the files that exist are complete", file=sys.stderr)
            raise typer.Exit(INTERRUPTED) from None
        except (LidarCoreError, FileExistsError) as error:
            if error.args and isinstance(error.args[0], str):
                error.args = (as_options(error.args[0]), *error.args[1:])
            raise

    return called


def with_trust(command: Callable[..., None]) -> Callable[..., None]:
    """Add the option --trusted to a command."""

    @wraps(command)
    def called(*arguments: Any, trusted: bool, **options: Any) -> None:
        from lidar_core.io import trusted_files

        with trusted_files(trusted):
            command(*arguments, **options)

    known = signature(command)
    option = typer.Option("--trusted", help=_TRUSTED, rich_help_panel=READ)
    own = Parameter(
        "trusted", Parameter.KEYWORD_ONLY, default=False, annotation=Annotated[bool, option]
    )
    parameters = [*known.parameters.values(), own]
    called.__signature__ = known.replace(parameters=parameters)  # type: ignore[attr-defined]
    return called


def consoles(json_file: Path | None) -> "tuple[Console, Console]":
    """Return the consoles of tables and of progress: `--json -` needs a clean standard output."""
    from rich.console import Console

    quiet = voice().is_quiet
    errors = Console(stderr=True, quiet=quiet)
    return (errors if str(json_file) == "-" else Console(quiet=quiet), errors)


@contextmanager
def shown_progress(console: "Console", *, counts: str = "scans") -> "Iterator[OnProgress]":
    """Return the callback with which runs report progress: each of their steps gets a bar.

    Bars disappear at the end. Without a terminal there is one line per minute.
    """
    if not console.is_terminal or voice().style == "json":
        yield Pace(console, counts).show
        return
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    bars = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(counts),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )
    with bars as progress:
        tasks: dict[str, Any] = {}

        def show(what: str, done: int, total: int | None) -> None:
            if what not in tasks:
                tasks[what] = progress.add_task(what)
            progress.update(tasks[what], completed=done, total=total)

        yield show


def report(
    result: "RunResult", table: "Table", json_file: Path | None, *, notes: Sequence[str] = ()
) -> None:
    """Print the table, notes and files of a run; end the command as the run ended."""
    out, errors = consoles(json_file)
    for note in result.notes:
        tell(errors, as_options(note))
    out.print(table)
    for note in notes:
        out.print(f"note: {as_options(note)}", markup=False, highlight=False, soft_wrap=True)
    out.print(f"{result.folder}: {', '.join(result.files)}", highlight=False, soft_wrap=True)
    write_json({**result.summary, "files": result.files}, json_file)
    if isinstance(result.ended_by, KeyboardInterrupt):
        errors.print("interrupted: the files hold the scans up to here")
        raise typer.Exit(INTERRUPTED)
    result.raise_if_failed()


def left_out(summary: Mapping[str, Any]) -> Iterator[str]:
    """Report the scans of a summary that were not processed, with the reason in words."""
    scans = summary["scans"]
    for count, what in (
        (sum(summary["without_pose"].values()), "without pose"),
        (scans.get("held", 0), "held for their pose"),
    ):
        if count:
            yield f"{count} {what}"
    rejected = Counter(scans["rejected"])
    if rejected:
        yield f"{rejected.total()} rejected: {told_reasons(rejected)}"


def told_reasons(counts: Mapping[str, int]) -> str:
    """Return the most frequent reasons; those that differ only in numbers count as one."""
    kinds, examples = Counter[str](), dict[str, str]()
    for reason, count in counts.items():
        kind = kind_of(reason)
        kinds[kind] += count
        examples.setdefault(kind, reason)
    told = [f"{count} x {examples[kind]}" for kind, count in kinds.most_common(REASONS)]
    more = [f"{len(kinds) - REASONS} more reasons"] if len(kinds) > REASONS else []
    return "; ".join(told + more)


def result_table(title: str, rows: Sequence[Row | None], *, caption: str = "") -> "Table":
    """Make a table of name, value and remark; None draws a line."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(
        title=escape(title),
        title_justify="left",
        title_style="bold",
        show_header=False,
        caption=escape(caption),
        caption_justify="left",
    )
    table.add_column(style="cyan", no_wrap=True)
    table.add_column(justify="right", style="bold", overflow="fold")
    table.add_column(style="dim", overflow="fold")
    for row in rows:
        if row is None:
            table.add_section()
        else:
            table.add_row(*map(escape, row))
    return table


def aligned(columns: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the lines of a table with a header, of any width: other programs process them."""
    widths = [max(map(len, (name, *values))) for name, values in columns.items()]
    rows = [tuple(columns), *zip(*columns.values(), strict=True)]
    return [
        "  ".join(one.ljust(width) for one, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]


def stage_rows(ms_per_scan: Mapping[str, float]) -> list[Row]:
    """Rows of the mean time per scan: the total, then every stage."""
    total = ms_per_scan["total"]
    digits = 0 if total >= SLOW_MS else 2
    stages = [
        Row(f"  {name}", f"{value:.{digits + 1}f} ms", _bar(value / total))
        for name, value in ms_per_scan.items()
        if name != "total" and total > 0
    ]
    rate = f"{1e3 / total:.1f} scans per second" if total > 0 else ""
    return [Row("time per scan", f"{total:.{digits}f} ms", rate), *stages]


def map_rows(size: Mapping[str, int]) -> list[Row]:
    """Rows of the size of a map."""
    return [
        Row(
            "voxels observed",
            f"{size['observed_voxels']:,}",
            f"{size['occupied_voxels']:,} occupied",
        ),
        Row("map memory", f"{size['memory_bytes'] / 2**20:.1f} MiB", ""),
    ]


def _bar(share: float) -> str:
    mark = "▪" if (sys.stdout.encoding or "").lower().startswith("utf") else "#"
    return mark * round(share * 20)


def given_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that the user gave."""
    return {name: value for name, value in options.items() if value not in (None, [])}


def write_json(result: Mapping[str, Any] | list[Any], json_file: Path | None) -> None:
    """Write `result` to the place that `--json` names."""
    if json_file is None:
        return
    text = json.dumps(result, indent=2)
    if str(json_file) == "-":
        print(text)
        return
    from lidar_core.io.files.atomic import written_whole

    make_parents(json_file)
    with written_whole(json_file) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")
