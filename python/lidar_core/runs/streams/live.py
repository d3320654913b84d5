"""A live run: scans of a stream, or of a recording in real time, through a pipeline to outputs."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from lidar_core.circles import CirclesConfig
from lidar_core.config import checked
from lidar_core.errors import ConfigError
from lidar_core.flying import FlyingConfig
from lidar_core.io import PoseOptions, ReadOptions
from lidar_core.live import LiveConfig, LiveLoop, Output
from lidar_core.live.poses import LivePoses
from lidar_core.live.sources.source import Source
from lidar_core.live.stats import Report
from lidar_core.live.tape import Tape
from lidar_core.runs.recording import folder_to_write
from lidar_core.runs.result import RunResult
from lidar_core.runs.settings import ConfigChoice
from lidar_core.runs.streams.choice import (
    PipelineChoice,
    check_files,
    open_metrics,
    open_output,
    open_source,
)
from lidar_core.runs.streams.folder import LiveFolder
from lidar_core.viz.origin_check import allowed_origins


@dataclass(frozen=True, slots=True)
class LiveResult(RunResult):
    """Result of a live run.

    Attributes
    ----------
    heard_nothing : bool
        The stream brought no scan that was asked for.
    """

    heard_nothing: bool = False


@checked
def live(
    source: str | None,
    config: FlyingConfig | CirclesConfig | ConfigChoice | None,
    output: str | PathLike[str] | None,
    *,
    replay: str | PathLike[str] | None = None,
    rate: Annotated[float, Field(gt=0)] | None = None,
    outputs: Sequence[str] = (),
    allow_origin: Sequence[str] = (),
    capability: Literal["auto", "flying", "circles"] = "auto",
    clouds: Sequence[str] = (),
    scans: Sequence[str] = (),
    pose: PoseOptions | None = None,
    read: ReadOptions | None = None,
    stream: LiveConfig | None = None,
    known_map: str | PathLike[str] | None = None,
    threads: int = 1,
    allow_untrusted: bool = False,
    seconds: Annotated[float, Field(ge=0)] | None = None,
    record: str | PathLike[str] | None = None,
    metrics: str | None = None,
    overwrite: bool = False,
    checkpoint: Annotated[float, Field(gt=0)] | None = None,
    resume: bool = False,
    on_message: Callable[[str], None] = lambda text: None,
    on_report: Callable[[Report], None] = lambda report: None,
) -> LiveResult:
    """Process scans as they arrive, as `lidar-core live` does; only the newest scan is kept.

    Parameters
    ----------
    source : str or None
        zenoh[:tcp/HOST:PORT], foxglove[:ws://HOST:PORT]; packets of a sensor: velodyne[:PORT],
        ouster:HOST[@PORT], ouster:FILE.json[@PORT], livox[:PORT]; None with `replay`.
    config : FlyingConfig, CirclesConfig, ConfigChoice or None
        Configuration of the pipeline; None is best mode.
    output : str, Path or None
        Folder to write when the run ends, as `detect` and `circles` write it; None for none.
    replay : str or Path, optional
        Recording to play instead of a stream.
    rate : float, optional
        Seconds of the recording per second.
    outputs : sequence of str
        foxglove[:PORT], zenoh[:tcp/HOST:PORT], rerun[:web[:PORT]|:FILE.rrd], mcap:FILE,
        arrow:FILE.
    allow_origin : sequence of str
        Web pages that may connect to a server, besides those of this machine.
    capability : str
        "auto": flying objects if clouds arrive, circles if 2D scans do.
    clouds, scans : sequence of str
        Topics of the LiDARs, 3D or 2D; empty for the first one with a scan.
    pose, read, known_map, threads, allow_untrusted, overwrite
        See `detect` and `circles`.
    checkpoint : float, optional
        Time between two checkpoints of `output` [s]; without run.mcap.
    resume : bool
        Continue with the state and the tables of a run that was interrupted. Scans that arrived in
        between are lost, and older ones are rejected.
    stream : LiveConfig, optional
        Waiting times for poses, and names of topics.
    seconds : float, optional
        Length of the run [s]; without it until the source or Ctrl-C ends it.
    record : str or Path, optional
        Recording to write of everything that comes in; its ending chooses the format.
    metrics : str, optional
        PORT or HOST:PORT at which Prometheus fetches metrics.
    on_message : callable
        Called with texts: source and outputs, refused clients, topics of a stream without wanted
        scans.
    on_report : callable
        Called with a `Report` every second.

    Returns
    -------
    LiveResult
        `ended_by` is a KeyboardInterrupt after Ctrl-C, or an OSError if run.mcap could not be
        completed; the other files are there.

    Raises
    ------
    ConfigError
        An option that cannot be used, or options that contradict each other.
    LinkError
        The source cannot be reached; the folder is written.
    """
    # Longer than other functions: one block opens source, tape, servers and outputs, so that all of
    # them are closed in the reverse order, also if one of them cannot be opened.
    place = None if replay is None else Path(replay)
    reading, settings, poses = read or ReadOptions(), stream or LiveConfig(), pose or PoseOptions()
    allowed = allowed_origins(list(allow_origin))
    chosen = PipelineChoice(
        capability,
        tuple(clouds),
        tuple(scans),
        config,
        None if known_map is None else Path(known_map),
        threads,
        allow_untrusted,
    )
    where = LivePoses(poses, settings)
    path = None if output is None else Path(output)
    taped = None if record is None else Path(record)
    check_files(outputs, place, path, taped, overwrite=overwrite)
    folder = _folder(
        path, chosen, reads=place, overwrite=overwrite, checkpoint=checkpoint, resume=resume
    )
    ended_by: KeyboardInterrupt | OSError | None = None
    files, notes = list[str](), list[str]()
    with ExitStack() as stack:
        topics = chosen.topics(poses.odom)
        listening = open_source(
            source, place, rate=rate, read=reading, live=settings, topics=topics, pose=poses.pose
        )
        stack.callback(listening.close)
        where.on_note = listening.findings.note
        server = None if metrics is None else stack.enter_context(closing(open_metrics(metrics)))
        tape = None if taped is None else stack.enter_context(closing(_tape(taped, listening)))

        def reported(report: Report) -> None:
            if server is not None:
                server.update(report)
            on_report(report)

        def refused(reason: str) -> None:
            on_message(f"refused: {reason}")

        opened: list[Output] = [
            stack.enter_context(
                closing(open_output(text, settings, allowed=allowed, on_refused=refused))
            )
            for text in outputs
        ]
        opened += [] if folder is None else [folder]
        loop: LiveLoop[Any] = LiveLoop(
            listening,
            chosen.pipeline if folder is None else folder.pipeline,
            where,
            opened,
            settings,
            topics=(*clouds, *scans),
            tape=tape,
            on_report=reported,
            on_silence=lambda there: on_message(chosen.silence(listening, there)),
            on_reason=lambda reason: on_message(f"not processed: {reason}"),
        )
        address = None if server is None else server.address
        _announce(listening.name, [item.name for item in opened], address, on_message)
        try:
            loop.run(seconds)
        except KeyboardInterrupt as interrupt:
            ended_by = interrupt
        finally:
            summary = _summary(loop, opened, tape)
            if folder is not None:
                summary, files, notes = folder.write(
                    summary,
                    {"live": settings, "read": reading, "pose": poses},
                    {"recording": place, "map": chosen.known_map},
                )
    if folder is not None and folder.failed is not None:
        ended_by = folder.failed
    return LiveResult(path, summary, tuple(files), tuple(notes), ended_by, loop.heard_nothing)


def _announce(
    source: str, outputs: Sequence[str], metrics: str | None, on_message: Callable[[str], None]
) -> None:
    """Report through `on_message` where scans come from and where results go."""
    on_message(f"from {source}")
    for name in outputs:
        on_message(f"to {name}")
    if metrics is not None:
        on_message(f"metrics at {metrics}")


def _summary(loop: LiveLoop[Any], outputs: Sequence[Output], tape: Tape | None) -> dict[str, Any]:
    names = [item.name for item in outputs]
    summary = {"command": "live", "outputs": names, **loop.summary()}
    if tape is not None:
        summary |= {"recording": str(tape.path), "not_recorded": tape.lost}
    return summary


def _tape(path: Path, listening: Source) -> Tape:
    return Tape(path, has_arrivals=listening.has_arrivals)


def _folder(
    path: Path | None,
    chosen: PipelineChoice,
    *,
    reads: Path | None,
    overwrite: bool,
    checkpoint: float | None,
    resume: bool,
) -> LiveFolder | None:
    """Return the output that writes the run folder at `path`; None if `path` is None."""
    if path is None:
        if checkpoint is not None or resume:
            raise ConfigError("checkpoint, resume: expected an output folder, got none")
        return None
    begun, _ = folder_to_write(
        path, mcap=None, overwrite=overwrite, reads=reads, checkpoint=checkpoint, resume=resume
    )
    return LiveFolder(
        begun, chosen.pipeline, checkpoint=checkpoint, resume=resume, threads=chosen.threads
    )
