"""`lidar-core view`: a run in a viewer, as a picture, or as a film."""

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from lidar_core.viz.playback import Playback

RERUN_FILE, PAGE_PORT = "run.rrd", 9090
ALLOW_ORIGIN = (
    "Web page of another machine that may connect to the Foxglove server, such as"
    " https://app.foxglove.dev; may be repeated."
)


def command(
    run: Annotated[Path, typer.Argument(help="Folder that detect, circles, fuse or demo wrote.")],
    *,
    rerun: Annotated[
        bool,
        typer.Option(
            "--rerun", help="Show it in rerun's window (extra rerun); this is the default."
        ),
    ] = False,
    web: Annotated[
        bool,
        typer.Option("--web", help="Show it in the browser: rerun's viewer, served on 127.0.0.1."),
    ] = False,
    rrd: Annotated[
        Path | None, typer.Option(help="Write a recording for rerun to this file instead.")
    ] = None,
    foxglove: Annotated[
        bool, typer.Option("--foxglove", help="Play the run to Foxglove on 127.0.0.1, in a loop.")
    ] = False,
    port: Annotated[
        int | None,
        typer.Option(
            min=0, max=65535, help="Port of --web (default 9090) or --foxglove (default 8765)."
        ),
    ] = None,
    allow_origin: Annotated[list[str], typer.Option(help=ALLOW_ORIGIN)] = [],  # noqa: B006
    png: Annotated[
        Path | None,
        typer.Option(help="Draw the scene at one time into this .png; needs no display."),
    ] = None,
    at: Annotated[
        float | None,
        typer.Option(min=0, help="Time of --png, since the start \\[s]."),
    ] = None,
    film: Annotated[
        Path | None, typer.Option(help="Draw the run as a film: .gif, or .mp4 (needs ffmpeg).")
    ] = None,
) -> None:
    """Show RUN: classified scans, objects with IDs, 2 sigma ellipses, velocities and trails."""
    from lidar_core.cli.shared.common import consoles, shown_progress
    from lidar_core.errors import ConfigError
    from lidar_core.viz.playback import Playback
    from lidar_core.viz.playback_picture import draw_film, draw_moment

    _check_single(rerun=rerun, web=web, rrd=rrd, foxglove=foxglove, png=png, film=film)
    if at is not None and png is None:
        raise ConfigError("at: selects the time of --png, got no --png")
    played = Playback(run)
    if png is not None:
        print(draw_moment(played, png, at=at, on_other_time=partial(_tell_time, at)))
    elif film is not None:
        with shown_progress(consoles(None)[1], counts="frames") as on_progress:
            drawn = draw_film(played, film, on_frame=partial(on_progress, "film"))
        print(drawn)
    elif foxglove:
        _serve(played, 8765 if port is None else port, allow_origin)
    elif web:
        _show_page(played, PAGE_PORT if port is None else port)
    elif rrd is not None:
        from lidar_core.viz.rerun_log import write_rerun

        print(write_rerun(played, rrd))
    else:
        _show_window(played)


def _tell_time(asked: float | None, drawn: float, last: float) -> None:
    """Print that the drawn time is not the requested one."""
    from lidar_core.cli.shared.common import consoles
    from lidar_core.cli.shared.voice import tell

    why = "where the run ends" if drawn == last else "the nearest time with a scan"
    tell(consoles(None)[1], f"note: --at {asked:g}: the picture shows {drawn:.2f} s, {why}")


def _check_single(**viewers: object) -> None:
    """Refuse more than one viewer or file."""
    from lidar_core.errors import ConfigError

    chosen = [f"--{name}" for name, value in viewers.items() if value]
    if len(chosen) > 1:
        raise ConfigError(f"view: expected at most one viewer or file, got {', '.join(chosen)}")


def _serve(played: "Playback", port: int, allow_origin: list[str]) -> None:
    from lidar_core.errors import FormatError
    from lidar_core.viz.foxglove_server import serve_foxglove
    from lidar_core.viz.origin_check import allowed_origins

    allowed = allowed_origins(allow_origin)
    if played.recording is None:
        raise FormatError(f"{played.folder}: no run.mcap; the extra viz makes runs write it")

    def print_address(port: int) -> None:
        print(f"ws://127.0.0.1:{port}: open it in Foxglove; Ctrl-C ends", flush=True)

    def print_refusal(reason: str) -> None:
        print(f"refused: {reason}", file=sys.stderr, flush=True)

    serve_foxglove(
        played.recording,
        port=port,
        allowed=allowed,
        on_ready=print_address,
        on_refused=print_refusal,
    )


def _show_page(played: "Playback", port: int) -> None:
    """Serve the run to a browser until Ctrl-C; open the browser if there is a display."""
    import threading
    from tempfile import TemporaryDirectory

    from lidar_core.viz.rerun_feed import file_feed
    from lidar_core.viz.rerun_log import write_rerun
    from lidar_core.viz.rerun_page import RerunPage, open_browser

    with TemporaryDirectory(prefix="lidar-core-view-") as folder:
        page = RerunPage(file_feed(write_rerun(played, Path(folder) / RERUN_FILE)), port=port)
        try:
            print(f"{page.address}: open it in the browser; Ctrl-C ends", flush=True)
            open_browser(page.address)
            threading.Event().wait()
        except KeyboardInterrupt:
            return
        finally:
            page.close()


def _show_window(played: "Playback") -> None:
    from tempfile import TemporaryDirectory

    from lidar_core.errors import ConfigError
    from lidar_core.viz.rerun_log import show_window, write_rerun
    from lidar_core.viz.rerun_process import has_display

    if not has_display():
        raise ConfigError(
            "view: no display: use --web, --foxglove, --png FILE, --film FILE or --rrd FILE"
        )
    with TemporaryDirectory(prefix="lidar-core-view-") as folder:
        status = show_window(write_rerun(played, Path(folder) / RERUN_FILE))
    if status != 0:
        raise typer.Exit(status)
