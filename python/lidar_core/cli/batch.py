"""`lidar-core batch`: commands over many recordings, seeds and values."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from lidar_core.cli.shared.common import (
    INTERRUPTED,
    JsonFile,
    consoles,
    shown_progress,
    write_json,
)
from lidar_core.cli.shared.voice import tell as say
from lidar_core.util.threads import all_threads

if TYPE_CHECKING:
    from rich.table import Table

    from lidar_core.batch import JobRecord

FAILED = 1
"""Exit status if a job failed."""
FRESH = "Run every job again, even finished ones."
EXECUTOR = (
    "local: processes of this machine; ray: the Ray cluster that RAY_ADDRESS names (extra cluster)."
)


def command(
    jobs: Annotated[Path, typer.Argument(help="Batch file (TOML): groups of jobs.")],
    *,
    output: Annotated[
        str,
        typer.Option(
            "--output",
            "-o",
            help="Folder or s3://bucket/folder for the tables and a folder per job.",
        ),
    ] = "runs/batch",
    executor: Annotated[Literal["local", "ray"], typer.Option(help=EXECUTOR)] = "local",
    workers: Annotated[
        int,
        typer.Option(
            min=1,
            default_factory=all_threads,
            show_default="all",
            help="Number of jobs that run at the same time.",
        ),
    ],
    fresh: Annotated[bool, typer.Option("--fresh", help=FRESH)] = False,
    json: JsonFile = None,
) -> None:
    """Run the jobs of JOBS; finished jobs are kept, unless their inputs or commands changed.

    Ctrl-C leaves complete files; the same command continues. Exit status 1 if a job failed.
    """
    from lidar_core import runs

    out, errors = consoles(json)

    def tell(record: "JobRecord") -> None:
        if record.status == "failed":
            text = f"{output.rstrip('/')}/{record.job}: {record.error}"
            say(errors, text)

    with shown_progress(errors, counts="jobs") as on_progress:
        result = runs.batch(
            jobs,
            output,
            executor=executor,
            workers=workers,
            fresh=fresh,
            on_progress=on_progress,
            on_job=tell,
        )
    summary = result.summary
    write_json(summary, json)
    out.print(_table(result.records))
    out.print(
        f"{summary['results']}: {len(result.records)} of {summary['jobs']} jobs,"
        f" {summary['kept']} done before",
        highlight=False,
        soft_wrap=True,
    )
    if result.ended_by is not None:
        errors.print("interrupted: run the same command to resume")
        raise typer.Exit(INTERRUPTED)
    if summary["failed"]:
        raise typer.Exit(FAILED)


def _table(records: "Sequence[JobRecord]") -> "Table":
    from rich.table import Table

    table = Table("group")
    for name in ("done", "failed", "s per job"):
        table.add_column(name, justify="right")
    for group in dict.fromkeys(record.group for record in records):
        rows = [record for record in records if record.group == group]
        done = [record.seconds for record in rows if record.status == "done"]
        mean = f"{sum(done) / len(done):.1f}" if done else "-"
        table.add_row(group, str(len(done)), str(len(rows) - len(done)), mean)
    return table
