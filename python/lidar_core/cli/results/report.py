"""`lidar-core report`: a run as one HTML file."""

from pathlib import Path
from typing import Annotated

import typer


def command(
    run: Annotated[Path, typer.Argument(help="Folder that detect, circles, fuse or demo wrote.")],
    *,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="File to write; default: report.html in the folder."),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(help="Ground truth, as for evaluate; default: that of the folder."),
    ] = None,
) -> None:
    """Write RUN as one HTML file: 3-D view, pictures, errors, NEES, NIS, times, configuration.

    The file works offline and sends no data.
    """
    from lidar_core.viz.report import write_report

    print(write_report(run, output, truth=truth))
