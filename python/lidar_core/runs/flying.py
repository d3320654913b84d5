"""Flying objects in a recording: the work of `lidar-core detect`."""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Annotated

from pydantic import Field

from lidar_core.config import checked
from lidar_core.flying import FlyingConfig, FlyingObjectDetector
from lidar_core.io import PoseOptions, ReadOptions, read_cloud
from lidar_core.messages import Scan
from lidar_core.runs.recording import RecordingJob, folder_to_write
from lidar_core.runs.result import OnProgress, RunResult, no_progress
from lidar_core.runs.scans.flying_output import FlyingRun
from lidar_core.runs.settings import ConfigChoice, config_of_run
from lidar_core.runs.static_map import check_static_map, write_static_map


@checked
def detect(
    recording: str | PathLike[str],
    config: FlyingConfig | ConfigChoice | None,
    output: str | PathLike[str],
    *,
    pose: PoseOptions | None = None,
    read: ReadOptions | None = None,
    clouds: Sequence[str] = (),
    repeat: Annotated[int, Field(ge=1)] = 1,
    known_map: str | PathLike[str] | None = None,
    static_map: str | PathLike[str] | None = None,
    threads: int = 1,
    mcap: bool | None = None,
    picture: bool = True,
    overwrite: bool = False,
    checkpoint: Annotated[float, Field(gt=0)] | None = None,
    resume: bool = False,
    on_progress: OnProgress = no_progress,
) -> RunResult:
    """Find and track flying objects in a recording, as `lidar-core detect` does.

    Parameters
    ----------
    recording : str or Path
        File or folder of any format that `lidar_core.io.open_recording` reads.
    config : FlyingConfig, ConfigChoice or None
        Configuration of the detector; None is best mode. Scans that cannot be used are counted,
        unless it sets `on_bad_scan`.
    output : str or Path
        Folder to write: tables of tracks and detections in SI units in the world frame,
        trajectories, the map, summary.json, run.toml, run.mcap, picture.png.
    pose : PoseOptions, optional
        Source of the poses, and part of the recording to use [s].
    read : ReadOptions, optional
        Options for reading the recording.
    clouds : sequence of str
        Topics of the LiDARs; empty for the only one.
    repeat : int
        Number of times that the recording is played: more than one opens the burn-in gate on short
        recordings.
    known_map : str or Path, optional
        Map of an earlier run (.lcvm), or a cloud or mesh in the fixed frame [m].
    static_map : str or Path, optional
        File to write: the map without all that moved, as voxels of 0.1 m (.lcvm) or as points in
        the world frame (.pcd, .ply) [m]. An earlier file is replaced. Processing takes more time
        with it.
    threads : int
        Threads used, >= 1; results do not depend on it.
    mcap : bool, optional
        Write run.mcap for viewers; None: if the extra `viz` is installed.
    picture : bool
        Draw picture.png (extra `plot`).
    overwrite : bool
        Replace an earlier run in the folder.
    checkpoint : float, optional
        Time between two checkpoints in the folder [s], from which a run can continue; run.mcap is
        then not written.
    resume : bool
        Continue from the last checkpoint of a run with the same inputs that was killed or ended
        early; the results are those of an uninterrupted run. Without a checkpoint it starts again.
    on_progress : callable
        Called with the name of the step, the number of scans done, and their total or None.

    Returns
    -------
    RunResult
        Ctrl-C and errors after the first scan end the run early: the folder then holds the scans so
        far, and `ended_by` is the cause; `raise_if_failed` raises it.

    Raises
    ------
    ConfigError
        A value or topic that cannot be used, or a `static_map` that cannot be written.
    FormatError
        The recording cannot be read, or has no poses: no folder is written. Or a checkpoint is
        damaged.
    InputError
        The checkpoint is one of another recording, configuration or build.
    FileExistsError
        The folder holds an earlier run, or files that no run wrote.
    MissingExtraError
        The format, or run.mcap, needs an extra that is not installed.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> import lidar_core as lc
    >>> folder = Path(mkdtemp())
    >>> made = lc.sim.record(lc.sim.scenes.demo(0, scans=2), folder / "street.npz", seed=0)
    >>> result = lc.runs.detect(made.recording, None, folder / "run", mcap=False, picture=False)
    >>> result.summary["scans"]["processed"], "tracks_tum" in result.files
    (2, True)
    """
    source = Path(recording)
    known = None if known_map is None else Path(known_map)
    cleaned = None if static_map is None else Path(static_map)
    if cleaned is not None:
        check_static_map(cleaned, reads=(source, known))
    folder, writes_mcap = folder_to_write(
        output,
        mcap=mcap,
        overwrite=overwrite,
        reads=source,
        checkpoint=checkpoint,
        resume=resume,
    )
    chosen = config_of_run(config, FlyingConfig, "flying")
    job = RecordingJob(
        command="detect",
        sort=Scan,
        recording=source,
        folder=folder,
        config={"flying": chosen},
        read=read or ReadOptions(),
        pose=pose or PoseOptions(),
        topics=tuple(clouds),
        mcap=writes_mcap,
        picture=picture,
        on_progress=on_progress,
        repeat=repeat,
        inputs={"map": known},
        note={"clouds": list(clouds), "repeat": repeat}
        | ({} if cleaned is None else {"static_map": str(cleaned)}),
        checkpoint=checkpoint,
        resume=resume,
    )
    run = FlyingRun(FlyingObjectDetector(chosen, threads=threads), threads=threads)
    if known is not None:
        load_known_map(run.detector, known)
    return job.run(run) if cleaned is None else _with_static_map(job, run, cleaned)


def _with_static_map(job: RecordingJob[Scan], run: FlyingRun, path: Path) -> RunResult:
    run.detector.make_static_map()
    result = job.run(run)
    write_static_map(run.detector, path)
    return result


def load_known_map(detector: FlyingObjectDetector, path: Path) -> None:
    """Load a map of an earlier run, or mark the points of another file as permanently occupied."""
    if path.suffix.lower() == ".lcvm":
        detector.load_map(path)
        return
    spacing = detector.config.voxel_map.voxel_size / 2
    detector.set_occupied(read_cloud(path, spacing=spacing).points)
