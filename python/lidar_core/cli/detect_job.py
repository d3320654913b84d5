"""The work of `lidar-core detect`: a recording through the detector, into a run folder."""

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from lidar_core.cli.common import draw, progress_on
from lidar_core.cli.flying_run import FlyingRun
from lidar_core.cli.run_mcap import NAME, RunMcap
from lidar_core.cli.scan_source import ScanSource
from lidar_core.errors import LidarCoreError
from lidar_core.flying import FlyingConfig, FlyingObjectDetector
from lidar_core.io import PoseOptions, ReadOptions
from lidar_core.messages import Scan
from lidar_core.run_folder import RunFolder, fingerprint


@dataclass(frozen=True, slots=True)
class DetectJob:
    """What to read, how, and what to write."""

    recording: Path
    folder: RunFolder
    config: FlyingConfig
    read: ReadOptions
    pose: PoseOptions
    clouds: tuple[str, ...]
    repeat: int
    known_map: Path | None
    threads: int
    writes_mcap: bool
    draws: bool


@dataclass(frozen=True, slots=True)
class DetectResult:
    """What came out, as plain values, and what ended it early, if anything did."""

    summary: dict[str, Any]
    files: tuple[str, ...]
    end: KeyboardInterrupt | LidarCoreError | None


def detect(job: DetectJob, console: Console) -> DetectResult:
    """Process a recording and write the folder.

    Ctrl-C and errors on the way end it early; the folder then holds the scans so far. Errors
    before the first scan are raised, and leave no folder.
    """
    run = FlyingRun(FlyingObjectDetector(job.config, threads=job.threads))
    if job.known_map is not None:
        run.detector.load_map(job.known_map)
    with ScanSource(job.recording, job.read, job.pose, job.clouds, job.repeat, Scan) as source:
        end = _pass_through(job, source, run, console)
        if not run.n_received:
            job.folder.begin()
        summary = {
            "command": "detect",
            "recording": str(job.recording),
            "format": source.format,
            "poses": source.pose_source,
            "frame_id": source.frame_id,
            **run.summary(),
            "without_pose": source.without_pose,
            "notes": source.notes,
            "ended_early": None if end is None else str(end) or "interrupted",
        }
    files = [*run.write(job.folder), "run.toml", "summary.json"]
    job.folder.write_summary(summary)
    _write_note(job, console)
    title = f"{job.recording.name}: {run.n_scans} scans, {len(run.track_ids)} tracks"
    if job.draws and draw(run.view(title), job.folder.path / "picture.png", console):
        files.append("picture.png")
    if (job.folder.path / NAME).exists():
        files.append(NAME)
    return DetectResult(summary, tuple(sorted(files)), end)


def _write_note(job: DetectJob, console: Console) -> None:
    """Write run.toml, with the hashes of everything that was read."""
    files = {"recording": job.recording, "poses": Path(job.pose.pose), "map": job.known_map}
    with console.status("hashing the recording"):
        inputs = {
            name: fingerprint(path)
            for name, path in files.items()
            if path is not None and path.exists()
        }
    job.folder.write_note(
        inputs,
        {"flying": job.config, "read": job.read, "pose": job.pose},
        clouds=list(job.clouds),
        repeat=job.repeat,
    )


def _pass_through(
    job: DetectJob, source: ScanSource[Scan], run: FlyingRun, console: Console
) -> KeyboardInterrupt | LidarCoreError | None:
    """Every scan through the detector; returns what ended it early."""
    try:
        with progress_on(console) as progress, ExitStack() as stack:
            task = progress.add_task("detect", total=source.total)
            mcap = None
            for item in source:
                if not run.n_received:
                    run.frame_id = source.frame_id
                    job.folder.begin()
                    if job.writes_mcap:
                        mcap = stack.enter_context(RunMcap(job.folder, frame_id=run.frame_id))
                frame = run.process(
                    item.scan,
                    item.world_from_lidar,
                    item.pose_stamps_ns,
                    sensor=item.scan.topic or item.scan.frame_id,
                )
                if mcap is not None:
                    mcap.write(item, frame)
                progress.advance(task)
    except KeyboardInterrupt as interrupt:
        return interrupt
    except LidarCoreError as error:
        if not run.n_received:
            raise
        return error
    return None
