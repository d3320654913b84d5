"""What each kind of file is read with: every public reader of the package."""

from collections.abc import Callable
from itertools import islice
from pathlib import Path

import numpy as np

MOST_MESSAGES = 400
"""Of one recording: the rest is no different, and takes time."""
Entry = Callable[[Path], object]


def recording(path: Path) -> None:
    from lidar_core.io import open_recording

    with open_recording(path) as opened:
        for message in islice(opened, MOST_MESSAGES):
            repr(message)
        opened.noticed()


def described(path: Path) -> None:
    from lidar_core.io import open_recording

    with open_recording(path, recover=True) as opened:
        opened.info()


def posed(path: Path) -> None:
    """Scans with poses through a detector, as `detect --pose static` has them."""
    from lidar_core.flying import FlyingObjectDetector
    from lidar_core.io import open_recording, posed_scans

    detector = FlyingObjectDetector()
    with open_recording(path) as opened:
        for item in islice(posed_scans(opened, pose="static"), 3):
            scan = item.scan
            detector.process(
                scan.points, item.world_from_lidar, scan.stamp_ns, no_return=scan.no_return
            )


def cloud(path: Path) -> None:
    from lidar_core.io import read_cloud

    read_cloud(path)


def poses(path: Path) -> None:
    from lidar_core.io.poses.pose_files import read_matrices, read_poses

    read_poses(path)
    read_matrices(path)


def columns(path: Path) -> None:
    from lidar_core.io import read_columns

    read_columns(path)


def scored(path: Path) -> None:
    from lidar_core.evaluation import read_prediction, read_truth

    read_prediction(path)
    read_truth(path)


def detections(path: Path) -> None:
    from lidar_core.fusion import read_bag

    read_bag(path)


def laser_radar(path: Path) -> None:
    from lidar_core.fusion import read_laser_radar

    read_laser_radar(path)


def measurements(path: Path) -> None:
    from lidar_core.fusion import read_measurements

    read_measurements(path)


def autoferry(path: Path) -> None:
    from lidar_core.fusion import read_autoferry

    read_autoferry(path)


def objects(path: Path) -> None:
    from lidar_core.fusion import read_delphi

    read_delphi(path)


def voxel_map(path: Path) -> None:
    from lidar_core.flying import FlyingObjectDetector
    from lidar_core.flying.voxel_map import VoxelMap

    detector = FlyingObjectDetector()
    VoxelMap.load(path).occupied_points()
    detector.load_map(path)
    detector.process(np.ones((50, 3), np.float32), np.eye(4), 1)


def saved_state(path: Path) -> None:
    from lidar_core.circles import CircleMap, CirclePipeline
    from lidar_core.flying import FlyingObjectDetector
    from lidar_core.flying.tracker import PointCloudTracker
    from lidar_core.flying.voxel_map import VoxelMap
    from lidar_core.fusion import MultiTargetTracker, TargetFilter

    kinds = {
        "detector": FlyingObjectDetector,
        "tracker": PointCloudTracker,
        "map": VoxelMap,
        "pipeline": CirclePipeline,
        "circles": CircleMap,
        "filter": TargetFilter,
        "many": MultiTargetTracker,
    }
    kind = next((kind for name, kind in kinds.items() if path.name.startswith(name)), None)
    assert kind is not None, path.name
    again = kind.load(path)
    again.to_bytes()
    if isinstance(again, FlyingObjectDetector):
        again.process(np.ones((50, 3), np.float32), np.eye(4), 2**62)


def configuration(path: Path) -> None:
    from lidar_core.batch import BatchConfig
    from lidar_core.circles import CirclesConfig
    from lidar_core.errors import LidarCoreError
    from lidar_core.flying import FlyingConfig
    from lidar_core.fusion import FusionConfig
    from lidar_core.runs.settings import run_config
    from lidar_core.sim import Scene

    errors = []
    for model in (FlyingConfig, CirclesConfig, FusionConfig, Scene, BatchConfig):
        try:
            model.read(path)
        except LidarCoreError as error:
            errors.append(error)
    run_config(FlyingConfig(), "flying", path, [])


def network(path: Path) -> None:
    from lidar_core.circles import CircleNetwork

    CircleNetwork(path, allow_untrusted=True)


def dataset(path: Path) -> None:
    from lidar_core.circles.dataset import open_dataset

    open_dataset(path.parent).read()


def run_folder(path: Path) -> None:
    from lidar_core.evaluation import read_prediction
    from lidar_core.viz.report.document import write_report

    read_prediction(path.parent)
    write_report(path.parent)


def folder(path: Path) -> None:
    recording(path.parent)


CLOUDS = (".pcd", ".ply", ".las", ".laz", ".bin", ".bt", ".lcvm", ".stl", ".obj", ".off", ".glb")
RECORDINGS = (
    *(".bag", ".db3", ".mcap", ".npz", ".pcap", ".pcapng", ".osf", ".clf", ".clf.bz2", ".log"),
    *(".pcd", ".ply", ".las", ".laz", ".bin", ".zstd"),
)


def entries_of(name: str) -> list[Entry]:
    """What reads a file of this name; by its folder where the ending says nothing."""
    lower = name.lower()
    suffix = Path(lower).suffix
    found: list[Entry] = []
    if lower.endswith(RECORDINGS):
        found += [recording, recording, described, posed]
    if suffix in CLOUDS:
        found.append(cloud)
    if suffix in (".bag", ".db3", ".mcap"):
        found.append(detections)
    if suffix in (".txt", ".tum"):
        found += [poses, laser_radar, columns]
    if suffix in (".csv", ".npz", ".parquet"):
        found += [columns, measurements, scored]
    if suffix == ".csv":
        found.append(objects)
    if suffix == ".mcap":
        found.append(columns)
    by_ending = {
        ".lcvm": [voxel_map, voxel_map],
        ".lcst": [saved_state],
        ".toml": [configuration],
        ".json": [autoferry],
        ".onnx": [network],
    }
    return found + by_ending.get(suffix, [])
