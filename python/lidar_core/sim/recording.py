"""A simulated recording on disk, with the truth and the scene beside it."""

import csv
import hashlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import tomli_w

from lidar_core._core import __version__
from lidar_core.errors import ConfigError
from lidar_core.io.files.atomic import written_whole
from lidar_core.io.files.sole import sole_writer
from lidar_core.io.writers import writer_of
from lidar_core.messages import Message, Pose
from lidar_core.objects import TargetTruth
from lidar_core.sim.config import Scene
from lidar_core.sim.lidar import Planar
from lidar_core.sim.simulator import Simulator
from lidar_core.sim.truth import SimulatedScan, SimulatedSweep

Made: TypeAlias = SimulatedScan | SimulatedSweep
"""Scan of a simulator with its truth, of a 3D or of a 2D LiDAR."""

WORLD_FRAME = "world"
POSE_TOPIC = "tf"
TRUTH_COLUMNS = (
    "scan",
    "t_ns",
    "target_id",
    "x",
    "y",
    "z",
    "vx",
    "vy",
    "vz",
    "radius",
    "hits",
    "rays",
    "sensor_x",
    "sensor_y",
    "sensor_z",
)
SWEEP_TRUTH_COLUMNS = (
    "scan",
    "t_ns",
    "target_id",
    "kind",
    "x",
    "y",
    "vx",
    "vy",
    "radius",
    "hits",
    "rays",
    "sensor_x",
    "sensor_y",
    "sensor_z",
)


@dataclass(frozen=True, slots=True)
class Recorded:
    """Files that `record` wrote.

    Attributes
    ----------
    recording, truth, scene, run : Path
        Scans and poses; targets per scan (`TargetTruth`, of a 2D LiDAR `ObjectTruth`, and where
        the sensor was, as CSV); the scene; version, seed, hash.
    scans, points, target_hits : int
        Number of scans, of all points, and of points on targets.
    """

    recording: Path
    truth: Path
    scene: Path
    run: Path
    scans: int
    points: int
    target_hits: int


def messages(scans: Iterable[Made]) -> Iterator[Message]:
    """Order scans and poses by their stamps, as a recording contains them."""
    last = -1
    for made in scans:
        for stamp_ns, matrix in zip(made.pose_stamps_ns.tolist(), made.poses, strict=True):
            if stamp_ns > last:  # a scan starts where the one before ended
                yield Pose(stamp_ns, WORLD_FRAME, made.scan.frame_id, matrix, topic=POSE_TOPIC)
                last = stamp_ns
            if stamp_ns == made.scan.stamp_ns:
                yield made.scan


def record(
    scene: Scene,
    path: str | Path,
    *,
    seed: int,
    scans: int | None = None,
    threads: int = 1,
    on_scan: Callable[[Made], None] = lambda made: None,
) -> Recorded:
    """Simulate `scene` into the recording `path`.

    The files NAME.truth.csv, NAME.scene.toml and NAME.run.toml beside it belong to the same run: no
    other process may write these files at the same time.

    Parameters
    ----------
    scene, seed, scans, threads
        See `Simulator`.
    path : str or Path
        Recording to write; its ending chooses the format, as for `write_recording`. Missing
        folders are made.
    on_scan : callable
        Called after every scan, for a progress display.

    Raises
    ------
    ConfigError
        Another ending, or as for `Simulator`.
    FileExistsError
        Another process or thread is writing a simulation there.
    """
    path = Path(path)
    write = writer_of(path, "messages")
    simulator = Simulator(scene, seed=seed, scans=scans, threads=threads)
    path.parent.mkdir(parents=True, exist_ok=True)
    with sole_writer(path):
        return _write_scans(scene, path, write, simulator, on_scan)


def _write_scans(
    scene: Scene,
    path: Path,
    write: Callable[[Path, Iterable[Message]], object],
    simulator: Simulator,
    on_scan: Callable[[Made], None],
) -> Recorded:
    rows: list[tuple[Any, ...]] = []
    points = 0
    is_planar = isinstance(scene.lidar.pattern, Planar)
    columns = SWEEP_TRUTH_COLUMNS if is_planar else TRUTH_COLUMNS

    def watched() -> Iterator[Made]:
        nonlocal points
        for number in range(simulator.scans):
            made = simulator.sweep(number) if is_planar else simulator.scan(number)
            points += int(np.count_nonzero(made.label >= 0))
            rows.extend(truth_rows(number, made))
            on_scan(made)
            yield made

    write(path, messages(watched()))
    truth, scene_file, run = files_beside(path)
    with (
        written_whole(truth) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        csv.writer(file).writerows([columns, *rows])
    effective = scene.model_copy(update={"scans": simulator.scans})
    for file_path, text in ((scene_file, effective.to_toml()), (run, _run(path, simulator))):
        with written_whole(file_path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    hits = sum(row[columns.index("hits")] for row in rows)
    return Recorded(path, truth, scene_file, run, simulator.scans, points, hits)


def files_beside(path: Path) -> tuple[Path, Path, Path]:
    """Return the truth, scene and run files of the recording `path`, shared by its name.

    Raises
    ------
    ConfigError
        The path has no name.
    """
    if not path.name:
        raise ConfigError(f"{path}: expected the name of a recording")
    truth, scene, run = (
        path.with_suffix(f".{name}") for name in ("truth.csv", "scene.toml", "run.toml")
    )
    return truth, scene, run


def truth_rows(number: int, made: Made) -> Iterator[tuple[Any, ...]]:
    """Yield one row of `TRUTH_COLUMNS` or `SWEEP_TRUTH_COLUMNS` per target of a scan."""
    truth = made.truth
    for target, name in enumerate(truth.id.tolist()):
        if isinstance(truth, TargetTruth):
            place = truth.position[target].tolist()
        else:
            place = [truth.kind[target], *truth.center[target].tolist()]
        yield (
            number,
            made.scan.stamp_ns,
            name,
            *place,
            *truth.velocity[target].tolist(),
            float(truth.radius[target]),
            int(truth.hits[target]),
            int(truth.rays[target]),
            *made.world_from_lidar[:3, 3].tolist(),
        )


def _run(path: Path, simulator: Simulator) -> str:
    with (path / f"{path.name}.mcap" if path.is_dir() else path).open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return tomli_w.dumps(
        {
            "command": "simulate",
            "lidar_core": __version__,
            "numpy": np.__version__,
            "seed": simulator.seed,
            "scans": simulator.scans,
            "recording": path.name,
            "sha256": digest,
        }
    )
