"""The circle map of a recording of 2D scans: the work of `lidar-core circles`."""

from collections import Counter
from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import Annotated

from pydantic import Field

from lidar_core.circles import CirclePipeline, CirclesConfig
from lidar_core.circles.scan_layout import check_no_rays, scanner_of
from lidar_core.circles.scanner import layout_name
from lidar_core.config import checked
from lidar_core.io import PoseOptions, ReadOptions, open_recording, posed_laser_scans
from lidar_core.messages import LaserScan
from lidar_core.runs.recording import RecordingJob, folder_to_write
from lidar_core.runs.result import OnProgress, RunResult, no_progress
from lidar_core.runs.scans.circles_output import CirclesRun
from lidar_core.runs.settings import ConfigChoice, config_of_run

SHARE = 0.05  # of a LiDAR's scans that have a length which is no defect


@checked
def circles(
    recording: str | PathLike[str],
    config: CirclesConfig | ConfigChoice | None,
    output: str | PathLike[str],
    *,
    pose: PoseOptions | None = None,
    read: ReadOptions | None = None,
    scans: Sequence[str] = (),
    allow_untrusted: bool = False,
    mcap: bool | None = None,
    picture: bool = True,
    film: bool = False,
    overwrite: bool = False,
    checkpoint: Annotated[float, Field(gt=0)] | None = None,
    resume: bool = False,
    on_progress: OnProgress = no_progress,
) -> RunResult:
    """Map the round obstacles in a recording of 2D scans, as `lidar-core circles` does.

    The scanners are those of the recording, within the range limits of `config.scanner`; scans of
    one length that less than one in twenty have are rejected.

    Parameters
    ----------
    recording, config, output, pose, read, mcap, picture, overwrite, checkpoint, resume, on_progress
        See `detect`; `config` is a `CirclesConfig`.
    scans : sequence of str
        Topics of the 2D LiDARs; empty for the only one.
    allow_untrusted : bool
        Run an ONNX file that was not exported by this user: a model is a program.
    film : bool
        Also draw film.mp4 beside the picture, or film.gif without ffmpeg.

    Returns
    -------
    RunResult
        See `detect`.

    Raises
    ------
    ConfigError, FormatError, InputError, FileExistsError, MissingExtraError
        See `detect`; also if a model is not trusted, or if rays are configured that the recording
        states.
    """
    source = Path(recording)
    folder, writes_mcap = folder_to_write(
        output,
        mcap=mcap,
        overwrite=overwrite,
        reads=source,
        checkpoint=checkpoint,
        resume=resume,
    )
    reading, poses = read or ReadOptions(), pose or PoseOptions()
    chosen = _with_scanners(
        config_of_run(config, CirclesConfig, "circles"), source, reading, scans, poses
    )
    job = RecordingJob(
        command="circles",
        sort=LaserScan,
        recording=source,
        folder=folder,
        config={"circles": chosen},
        read=reading,
        pose=poses,
        topics=tuple(scans),
        mcap=writes_mcap,
        picture=picture or film,
        on_progress=on_progress,
        note={"scans": list(scans)},
        checkpoint=checkpoint,
        resume=resume,
    )
    pipeline = CirclePipeline(chosen, allow_untrusted=allow_untrusted)
    run = CirclesRun(pipeline, picture=picture, film=film, allow_untrusted=allow_untrusted)
    return job.run(run)


def _with_scanners(
    config: CirclesConfig,
    recording: Path,
    read: ReadOptions,
    topics: Sequence[str],
    span: PoseOptions,
) -> CirclesConfig:
    """Return `config` with the scanners of the recording, if it does not name them itself.

    Their ranges are limited to those of `config.scanner`.
    """
    check_no_rays(config)
    found = dict(config.scanners)
    for topic in topics or (None,):
        with open_recording(recording, read) as opened:
            posed = posed_laser_scans(
                opened, cloud=topic, pose="static", start=span.start, end=span.end
            )
            if posed.cloud in config.scanners:
                continue
            layouts = _layouts(item.scan for item in posed)
        for number, scan in enumerate(layouts):
            name = scan.topic or scan.frame_id
            scanner = scanner_of(scan, config, f"{recording}: {name}")
            found.setdefault(layout_name(name, len(scan.ranges)) if number else name, scanner)
    return type(config).load(config.model_dump() | {"scanners": found})


def _layouts(scans: Iterable[LaserScan]) -> list[LaserScan]:
    """Return one scan for each length (number of rays) that is not rare, most frequent first."""
    first: dict[int, LaserScan] = {}
    counts: Counter[int] = Counter()
    for scan in scans:
        first.setdefault(len(scan.ranges), scan)
        counts[len(scan.ranges)] += 1
    usual = [rays for rays, count in counts.most_common() if count >= SHARE * counts.total()]
    return [first[rays] for rays in usual]
