"""`python -m hostile.memory`: every kind of work under limits of memory that are too small for it.

Every try is a child: it makes its object, lowers its address space to what it has plus some, works,
raises the limit again, and looks at the object. An error must be typed and leave the object as it
was; nothing of this package may abort.
"""

import argparse
import hashlib
import os
import resource
import signal
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

STEP = 64
"""Between two limits, and above the start for the first [MiB]."""
LIMITS = 20
Prepared = tuple[Callable[[], object], Callable[[], bytes]]
"""The work, and the state of the object that it must leave alone when it fails."""


def _cloud(count: int, reach: float = 60.0) -> Any:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(count, 3))
    return (points / np.linalg.norm(points, axis=1)[:, None] * reach).astype(np.float32)


def opened(folder: Path, size: float) -> Prepared:
    """Scans of a recording, all of them kept."""
    from lidar_core.io import open_recording, trusted_files, write_recording
    from lidar_core.messages import Scan

    path, points = folder / "scans.npz", _cloud(int(400_000 * size))
    write_recording(path, (Scan(n * 10**8, points) for n in range(6)))

    def work() -> object:
        with trusted_files(), open_recording(path) as recording:
            return list(recording)

    return work, bytes


def integrated(folder: Path, size: float) -> Prepared:
    """Rays into a voxel map."""
    from lidar_core.flying.voxel_map import VoxelMap

    world = VoxelMap()
    points, classes = _cloud(int(300_000 * size)), np.ones(int(300_000 * size), np.uint8)
    return lambda: world.integrate(points, classes, np.zeros(3)), world.to_bytes


def reaching_far(folder: Path, size: float) -> Prepared:
    """Few rays through very many blocks, on four threads: the blocks take more than the rays."""
    from lidar_core.flying.voxel_map import VoxelMap

    world, count = VoxelMap(threads=4), int(20_000 * size)
    points, classes = _cloud(count, 90.0), np.ones(count, np.uint8)
    return lambda: world.integrate(points, classes, np.zeros(3)), world.to_bytes


def processed(folder: Path, size: float) -> Prepared:
    """A scan through the detector; `health` counts a refused one, the core does not."""
    from lidar_core.flying import FlyingObjectDetector

    detector = FlyingObjectDetector()
    detector.process(_cloud(2000, 5.0), np.eye(4), 0)
    points = _cloud(int(300_000 * size))
    return lambda: detector.process(points, np.eye(4), 10**8), detector._detector.to_state


def tracked(folder: Path, size: float) -> Prepared:
    """Clouds into the buffer of a tracker, and late detections through them."""
    from lidar_core.flying import PointCloudTracker

    tracker = PointCloudTracker()
    points = _cloud(int(1_000_000 * size))
    tracker.new_detections(points[:50].astype(float), 0)

    def work() -> None:
        tracker.new_point_cloud(points, np.empty((0, 3), np.float32), 10**8)

    return work, tracker.to_bytes


def saved(folder: Path, size: float) -> Prepared:
    """A map and a whole state into files."""
    from lidar_core.flying import FlyingObjectDetector

    detector = FlyingObjectDetector()
    detector.make_static_map()
    detector.process(_cloud(int(60_000 * size)), np.eye(4), 0)

    def work() -> None:
        detector.save_map(folder / "map.lcvm")
        detector.save(folder / "state.lcst")
        detector.save_static_map(folder / "static.lcvm")
        detector.load_map(folder / "map.lcvm")

    return work, detector._detector.to_state


def inferred(folder: Path, size: float) -> Prepared:
    """Circles of many sweeps at once by a network; onnxruntime's arena is there before."""
    from lidar_core.circles import CircleDetector

    detector = CircleDetector()
    bearings = np.radians(np.arange(-10, 10.25, 0.25))
    miss = np.sin(bearings) * 4.0
    root = np.sqrt(np.maximum(0.3**2 - miss**2, 0))
    row = np.where(abs(miss) < 0.3, np.cos(bearings) * 4.0 - root, np.inf).astype(np.float32)
    rows = np.repeat(row[None], int(200_000 * size), axis=0)
    detector.detect(rows[:4], bearings)
    return lambda: detector.detect(rows, bearings), bytes


def clustered(folder: Path, size: float) -> Prepared:
    """Labels of a cloud."""
    from lidar_core import cluster_points

    points = _cloud(int(2_000_000 * size))
    return lambda: cluster_points(points, max_distance=0.1, min_points=1), bytes


def looked_up(folder: Path, size: float) -> Prepared:
    """States and values of places in a map, and places set in it."""
    from lidar_core.flying.voxel_map import VoxelMap

    world = VoxelMap()
    world.set_occupied(_cloud(1000, 5.0))
    points = _cloud(int(3_000_000 * size), 20.0)

    def work() -> object:
        found = world.state_at(points), world.values_at(points)
        world.set_occupied(points)
        return found

    return work, world.to_bytes


def simulated(folder: Path, size: float) -> Prepared:
    """A scan of many rays."""
    from lidar_core.sim import LidarModel, simulate
    from lidar_core.sim.scenes import demo

    rows = max(int(2_000_000 * size) // 4000, 1)
    pattern = {"kind": "spinning", "columns": 4000}
    elevations = tuple(np.linspace(-30, 30, rows))
    lidar = LidarModel.load({"pattern": {**pattern, "elevations_deg": elevations}})
    scene = demo(scans=1).model_copy(update={"lidar": lidar})
    return lambda: list(simulate(scene, seed=0, scans=1)), bytes


def fused(folder: Path, size: float) -> Prepared:
    """Measurements of one target through a filter, and smoothed."""
    from lidar_core.fusion import Measurements
    from lidar_core.fusion.run import run, smooth

    rows = np.arange(int(200_000 * size))
    places = rows[:, None] * [0.1, 0.05]
    measurements = Measurements.from_arrays(rows * 10**8, np.full(len(rows), "lidar"), places)
    return lambda: (run(measurements), smooth(measurements)), bytes


def assigned(folder: Path, size: float) -> Prepared:
    """Pairs of many with many."""
    from lidar_core.evaluation.matching.assignment import cheapest

    edge = int(2500 * size**0.5)
    costs = np.random.default_rng(0).random((edge, edge))
    return lambda: cheapest(costs, gate=2.0, alone=1e9), bytes


def swept(folder: Path, size: float) -> Prepared:
    """A sweep of very many rays through the pipeline of circles; `health` counts as above."""
    from lidar_core.circles import CirclePipeline, CirclesConfig

    rays = int(100_000 * min(1.0, 5 * size))
    scanner = {"n_beams": rays, "angle_min": -3.1, "angle_increment": 6.2 / rays}
    pipeline = CirclePipeline(CirclesConfig.load({"scanner": scanner}))
    ranges = np.where(np.arange(rays) % 1000 < 500, 4.0, 9.0)
    return lambda: pipeline.process(ranges, np.eye(4), 0), pipeline._pipeline.to_state


WORK = {
    "open": opened,
    "integrate": integrated,
    "reach far": reaching_far,
    "process": processed,
    "track": tracked,
    "save": saved,
    "infer": inferred,
    "cluster": clustered,
    "look up": looked_up,
    "simulate": simulated,
    "fuse": fused,
    "assign": assigned,
    "sweep": swept,
}


def attempt(name: str, extra: int, size: float = 1.0) -> str:
    """Work with `extra` MiB more than at the start; "ok", "typed", or what is wrong."""
    ours, theirs = os.pipe()
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        os.close(ours)
        try:
            with tempfile.TemporaryDirectory() as folder:
                said = _said(WORK[name], Path(folder), extra, size)
            os.write(theirs, said.encode("utf-8", "replace"))
        finally:
            os._exit(0)
    os.close(theirs)
    with os.fdopen(ours, errors="replace") as pipe:
        said = pipe.read()
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        return f"{signal.Signals(os.WTERMSIG(status)).name}"
    return said or "no word"


def _said(prepare: Callable[[Path, float], Prepared], folder: Path, extra: int, size: float) -> str:
    from lidar_core.errors import LidarCoreError

    warnings.simplefilter("ignore")
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    work, state = prepare(folder, size)
    before = hashlib.sha256(state()).digest()
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + extra * 2**20, hard))
    error: BaseException | None = None
    try:
        kept = work()
    except BaseException as raised:
        error = raised.with_traceback(None)
    resource.setrlimit(resource.RLIMIT_AS, (hard, hard))
    if error is None:
        del kept
        return "ok"
    if not isinstance(error, LidarCoreError | MemoryError | OSError):
        return f"untyped {type(error).__name__}: {error}"[:300]
    if type(error).__name__ == "InternalError":
        return f"a panic: {error}"
    if hashlib.sha256(state()).digest() != before:
        return f"changed by {type(error).__name__}: {error}"[:300]
    return "typed"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m hostile.memory", description=__doc__)
    parser.add_argument("--limits", type=int, default=LIMITS)
    parser.add_argument("--step", type=int, default=STEP, help="between limits [MiB]")
    parser.add_argument("--size", type=float, default=1.0, help="of the work")
    parser.add_argument("--work", action="append", default=[], help="only this")
    chosen = parser.parse_args()
    bad = 0
    for name in chosen.work or WORK:
        ended = {}
        for number in range(1, chosen.limits + 1):
            ended[number * chosen.step] = attempt(name, number * chosen.step, chosen.size)
        wrong = {extra: how for extra, how in ended.items() if how not in ("ok", "typed")}
        bad += len(wrong)
        counts = Counter(how.split(":")[0] for how in ended.values())
        print(f"{name}: {dict(counts)}", flush=True)
        for extra, how in wrong.items():
            print(f"    start + {extra} MiB: {how}", flush=True)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
