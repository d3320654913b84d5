"""`lidar-core batch`: commands over many recordings, seeds and values."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from lidar_core.cli.common import (
    INTERRUPTED,
    JsonFile,
    all_threads,
    consoles,
    progress_on,
    write_json,
)

if TYPE_CHECKING:
    from rich.table import Table

    from lidar_core.batch import JobRecord

FAILED = 1
"""Exit status if a job failed."""
FRESH = "Do every job again, also those that are done."
EXECUTOR = "Processes of this machine, or Ray (extra cluster): the cluster that RAY_ADDRESS names."


def command(
    jobs: Annotated[Path, typer.Argument(help="Batch file (TOML): groups of jobs.")],
    *,
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="Folder: results.parquet, a folder per job."),
    ] = Path("runs/batch"),
    executor: Annotated[Literal["local", "ray"], typer.Option(help=EXECUTOR)] = "local",
    workers: Annotated[
        int,
        typer.Option(
            min=1, default_factory=all_threads, show_default="all", help="Jobs at a time."
        ),
    ],
    fresh: Annotated[bool, typer.Option("--fresh", help=FRESH)] = False,
    json: JsonFile = None,
) -> None:
    """Do the jobs of JOBS; what is done already is left as it is, unless something changed.

    Ctrl-C leaves whole files; the same command goes on. Exit status 1 if a job failed.
    """
    from lidar_core.batch import BatchConfig, jobs_of
    from lidar_core.cli.batch_job import Batch
    from lidar_core.run_folder import lock, unlock

    out, errors = consoles(json)
    config = BatchConfig.read(jobs)
    batch = Batch.of(output, jobs_of(config, jobs.parent), is_fresh=fresh)
    output.mkdir(parents=True, exist_ok=True)
    lock(output)
    was_stopped = False
    with progress_on(errors, counts="jobs") as progress:
        task = progress.add_task("batch", total=len(batch.jobs), completed=len(batch.kept))
        try:
            for record in batch.run(executor=executor, workers=workers):
                progress.advance(task)
                if record.status == "failed":
                    errors.print(
                        f"{output / record.job}: {record.error}",
                        markup=False,
                        highlight=False,
                        soft_wrap=True,
                    )
        except KeyboardInterrupt:
            was_stopped = True
    table = batch.write({"batch": config}, jobs)
    unlock(output)
    records = batch.records()
    result = summary(records, kept=len(batch.kept), jobs=len(batch.jobs))
    write_json({**result, "results": str(table)}, json)
    out.print(_table(records))
    out.print(
        f"{table}: {len(records)} of {len(batch.jobs)} jobs, {len(batch.kept)} done before",
        highlight=False,
        soft_wrap=True,
    )
    if was_stopped:
        errors.print("interrupted: the same command goes on from here")
        raise typer.Exit(INTERRUPTED)
    if result["failed"]:
        raise typer.Exit(FAILED)


def summary(records: "list[JobRecord]", *, kept: int, jobs: int) -> dict[str, Any]:
    """What came out, as plain values."""
    failed = {record.job: record.error for record in records if record.status == "failed"}
    done = sum(record.status == "done" for record in records)
    return {"jobs": jobs, "done": done, "kept": kept, "failed": failed}


def _table(records: "list[JobRecord]") -> "Table":
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
