"""Good files of every format: made here, and those of LIDAR_CORE_DATA."""

import json
import os
import shutil
import traceback
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path

import numpy as np

from hostile import entries

LARGEST = 12 * 2**20
"""Files of the recordings above this are left out: a read of them takes longer than a limit."""
UNREADABLE = (".xz", ".png", ".md", ".mat", ".yaml")
BASE_NS = 1_700_000_000_000_000_000


@dataclass(frozen=True)
class Seed:
    """A good file, what reads it, and the files that have to be beside it."""

    name: str
    data: bytes
    entries: tuple[entries.Entry, ...]
    beside: dict[str, bytes] = field(default_factory=dict)

    @property
    def kind(self) -> str:
        """Format, for counting: all have the same share of the mutants."""
        return "".join(Path(self.name).suffixes[-2:]).lower() if "." in self.name else self.name


def seeds_of(folder: Path, data: Path | None) -> dict[str, list[Seed]]:
    """Seeds by format; `folder` is used to make some."""
    found = defaultdict(list)
    for seed in [*_generated(folder), *(_recorded(data) if data is not None else [])]:
        found[Path(seed.name).suffix.lower() or seed.name].append(seed)
    return dict(sorted(found.items()))


def data_folder() -> Path | None:
    named = os.environ.get("LIDAR_CORE_DATA")
    return Path(named) if named and Path(named).is_dir() else None


def _recorded(root: Path) -> list[Seed]:
    found = []
    for path in sorted(root.rglob("*")):
        if not path.is_file() or path.suffix in UNREADABLE or path.stat().st_size > LARGEST:
            continue
        readers = entries.entries_of(path.name)
        if readers:
            beside = {}
            if path.suffix in (".pcap", ".json") and path.with_suffix(".json").exists():
                other = path.with_suffix(".json" if path.suffix == ".pcap" else ".pcap")
                if other.exists():
                    beside[other.name] = other.read_bytes()
                    readers = [lambda at: entries.recording(at.with_suffix(".pcap")), *readers]
            found.append(Seed(path.name, path.read_bytes(), tuple(readers), beside))
    return found


def _generated(folder: Path) -> list[Seed]:
    folder.mkdir(parents=True, exist_ok=True)
    makers: list[Callable[[Path], None]] = [
        *(_recordings, _ros, _clouds, _laser, _tables, _states, _maps, _configs, _packed),
    ]
    for maker in makers:
        place = folder / maker.__name__.strip("_")
        place.mkdir()
        _in_a_child(maker, place)
    found = [
        Seed(path.name, path.read_bytes(), tuple(readers))
        for path in sorted(path for path in folder.rglob("*") if path.is_file())
        if (readers := entries.entries_of(path.name))
    ]
    return found + _in_folders(folder)


def _in_a_child(maker: Callable[[Path], None], place: Path) -> None:
    """Call `maker` in a process of its own: threads that it starts would not survive a fork."""
    child = os.fork()
    if child == 0:
        try:
            maker(place)
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    if os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]):
        raise RuntimeError(f"{maker.__name__}: cannot make its files")


def _scan(number: int, rows: int = 60):
    from lidar_core.messages import Scan

    rng = np.random.default_rng(number)
    points = rng.normal(0, 9, (rows, 3)).astype(np.float32)
    none = rng.random(rows) < 0.2
    points[none] = np.nan
    stamp = BASE_NS + number * 10**8
    return Scan(
        stamp_ns=stamp,
        points=points,
        frame_id="lidar",
        no_return=none,
        directions=np.tile(np.float32([1, 0, 0]), (rows, 1)),
        point_time_ns=stamp + np.arange(rows) * 1000,
        intensity=rng.random(rows).astype(np.float32),
        ring=np.arange(rows).astype(np.uint16) % 16,
        topic="/points",
    )


def _messages():
    from lidar_core.messages import LaserScan, Pose

    for number in range(4):
        stamp = BASE_NS + number * 10**8
        yield Pose(stamp, "world", "lidar", np.eye(4), topic="/tf")
        yield _scan(number)
        yield LaserScan(stamp, np.ones(90, np.float32), -1.0, 0.02, 0.1, 9.0, topic="/scan")


def _recordings(folder: Path) -> None:
    from lidar_core.io import write_recording

    for ending in (".npz", ".mcap", ".bag", ""):
        write_recording(folder / f"recording{ending}", _messages())


def _ros(folder: Path) -> None:
    from ros_files import Ros

    fields = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("t", "<u4")]
    rows = np.ones(20, fields)
    for version, storage, name in ((1, "bag", "r.bag"), (2, "sqlite3", "r2"), (2, "mcap", "r3")):
        ros = Ros(version)
        items = []
        for number in range(4):
            stamp = BASE_NS + number * 10**8
            where = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
            tf = ros.transforms([(stamp, "odom", "base", where), (stamp, "base", "lidar", where)])
            items.append(("/tf", stamp, tf))
            items.append(("/points", stamp, ros.cloud(rows, stamp, "lidar")))
            items.append(("/odom", stamp, ros.odometry(stamp, "odom", "base", where)))
        ros.write(folder / name, items, storage)


def _clouds(folder: Path) -> None:
    import laspy
    import trimesh

    from lidar_core.io import write_cloud

    points = np.random.default_rng(0).uniform(-20, 20, (200, 3))
    for ending in (".pcd", ".ply"):
        write_cloud(folder / f"cloud{ending}", points)
    write_cloud(folder / "cloud.bt", points, resolution=0.5)
    np.hstack([points, points[:, :1]]).astype("<f4").tofile(folder / "cloud.bin")
    head = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 3\nHEIGHT 1\n"
    text = head + "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 3\nDATA ascii\n1 2 3\n4 5 6\n7 8 9\n"
    (folder / "ascii.pcd").write_text(text)
    import pypcd4

    packed = pypcd4.PointCloud.from_xyz_points(points.astype(np.float32))
    packed.save(folder / "packed.pcd", pypcd4.Encoding.BINARY_COMPRESSED)
    for version, form in (("1.2", 3), ("1.4", 6)):
        header = laspy.LasHeader(point_format=form, version=version)
        header.scales = [0.001] * 3
        las = laspy.LasData(header)
        las.x, las.y, las.z = points.T
        for ending in (".las", ".laz"):
            las.write(folder / f"cloud{form}{ending}")
    box = trimesh.creation.box()
    for ending in (".stl", ".obj", ".off", ".glb", ".ply"):
        box.export(folder / f"box{ending}")
    box.export(folder / "text.stl", file_type="stl_ascii")
    box.export(folder / "text.ply", encoding="ascii")


def _laser(folder: Path) -> None:
    rows = [f"FLASER 5 1.0 2.0 3.0 4.0 5.0 0 0 0 {k}.0 {k}.0 0 {k}.5 host {k}.5" for k in range(5)]
    (folder / "walk.clf").write_text("# comment\nPARAM laser_front_laser 1\n" + "\n".join(rows))
    poses = "1 0 0 1.5 0 1 0 2 0 0 1 3\n1 0 0 1.6 0 1 0 2 0 0 1 3\n"
    (folder / "kitti.txt").write_text(poses)
    (folder / "tum.txt").write_text("# t x y z\n1.0 0 0 0 0 0 0 1\n2.0 1 0 0 0 0 0 1\n")


def _tables(folder: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    names = "t_ns,track_id,target_id,x,y,z,vx,vy,vz,range,bearing,range_rate,hits"
    rows = np.array([[k * 10**8, 1, 1, *range(1, 7), 5, 0.1, 0.2, 3] for k in range(6)])
    text = "\n".join(",".join(f"{v:g}" for v in row) for row in rows)
    (folder / "table.csv").write_text(f"{names}\n{text}\n")
    header = "time_ns,trackID,track_angle_rad,track_range_m,track_range_rate_m_per_s"
    slots = [f"{k * 5 * 10**7},{k % 3},0.1,{10 + k}.5,-2.5" for k in range(6)]
    (folder / "objects.csv").write_text("\n".join([header, *slots, ""]))
    table = {name: rows[:, n] for n, name in enumerate(names.split(","))}
    for name in ("t_ns", "track_id", "target_id", "hits"):
        table[name] = table[name].astype(np.int64)
    np.savez(folder / "table.npz", **table)
    np.savez_compressed(folder / "packed.npz", **table)
    for how in ("none", "snappy", "zstd", "gzip", "brotli"):
        parquet.write_table(pa.table(table), folder / f"{how}.parquet", compression=how)
    (folder / "L.txt").write_text(
        "L\t1.0\t2.0\t1477010443000000\t1\t2\t3\t4\nR\t1\t0.5\t2\t1477010443100000\t1\t2\t3\t4\n"
    )


def _states(folder: Path) -> None:
    import lidar_core as lc
    from lidar_core.circles import CircleMap, CirclePipeline
    from lidar_core.flying import FlyingObjectDetector
    from lidar_core.flying.tracker import PointCloudTracker
    from lidar_core.flying.voxel_map import VoxelMap

    detector = FlyingObjectDetector()
    for number in range(3):
        detector.process(
            np.float32([[5, y / 10, 0] for y in range(-20, 20)]),
            np.eye(4),
            BASE_NS + number * 10**8,
        )
    detector.save(folder / "detector.lcst")
    PointCloudTracker().save(folder / "tracker.lcst")
    known = VoxelMap()
    known.set_occupied([[1.0, 2.0, 3.0]])
    known.save(folder / "map.lcst", full=True)
    CircleMap().save(folder / "circles.lcst")
    pipeline = CirclePipeline()
    for number in range(4):
        pipeline.process(np.full(1081, 3.0) + (np.arange(1081) < 90), np.eye(4), number * 10**8)
    pipeline.save(folder / "pipeline.lcst")
    target = lc.fusion.TargetFilter()
    for k in range(5):
        target.step(lc.fusion.Measurement(k * 10**8, "lidar", [5.0 + k, 3.0]))
    target.save(folder / "filter.lcst")
    many = lc.fusion.MultiTargetTracker()
    for k in range(5):
        many.process(
            k * 10**8, [lc.fusion.Measurement(k * 10**8, "lidar", [5.0 + k, 3.0])], source="a"
        )
    many.save(folder / "many.lcst")


def _maps(folder: Path) -> None:
    from lidar_core.flying import FlyingObjectDetector

    detector = FlyingObjectDetector()
    points = np.random.default_rng(1).uniform(-6, 6, (300, 3)).astype(np.float32)
    detector.process(points, np.eye(4), BASE_NS)
    detector.save_map(folder / "small.lcvm")


def _configs(folder: Path) -> None:
    import tomli_w

    from lidar_core.circles import CirclesConfig
    from lidar_core.flying import FlyingConfig
    from lidar_core.fusion import FusionConfig

    for model in (FlyingConfig, CirclesConfig, FusionConfig):
        values = model().model_dump(mode="json", exclude_none=True)
        (folder / f"{model.__name__}.toml").write_text(tomli_w.dumps(values))
    (folder / "batch.toml").write_text(
        '[[jobs]]\nname = "a"\ncommands = ["demo --seed {seed} -o {output}"]\n'
        "ranges = { seed = [0, 9] }\n"
    )
    entry = {
        "time": 1.0,
        "sensorID": 1,
        "ownshipPosition": [0.0, 0.0, 0.0],
        "measurement": [[1.0], [2.0]],
    }
    (folder / "own_detections.json").write_text(json.dumps([entry] * 5))


def _packed(folder: Path) -> None:
    """What comes compressed: recordings by file, logs; and the models of the package."""
    import bz2

    import zstandard

    beside = folder.parent
    (folder / "walk.clf.bz2").write_bytes(bz2.compress((beside / "laser/walk.clf").read_bytes()))
    for file in [*beside.glob("ros/r2/*.db3"), *beside.glob("ros/r3/*.mcap")]:
        packed = zstandard.ZstdCompressor().compress(file.read_bytes())
        (folder / f"{file.name}.zstd").write_bytes(packed)
    models = resources.files("lidar_core.circles") / "models"
    for name in ("cnn.onnx", "paper-cnn.onnx"):
        shutil.copyfile(str(models / name), folder / name)


def _in_folders(folder: Path) -> list[Seed]:
    """Files that are read as parts of a folder."""
    kitti = {f"{k:06}.bin": (folder / "clouds/cloud.bin").read_bytes() for k in range(2)}
    poses = "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0\n"
    small = {
        "poses.txt": poses.encode(),
        "times.txt": b"0.0\n0.1\n",
        "calib.txt": b"P0: 1 0\nTr: 1 0 0 0 0 1 0 0 0 0 1 0\n",
    }
    found = [
        Seed(name, data, (entries.folder,), {**kitti, **small, name: data})
        for name, data in small.items()
    ]
    table = (folder / "tables/table.csv").read_bytes()
    note = b'command = "demo"\nscans = 6\n[versions]\nlidar_core = "1"\n'
    run = {"run.toml": note, "tracks.csv": table, "summary.json": b'{"scans": {"received": 6}}'}
    found += [Seed(name, data, (entries.run_folder,), run) for name, data in run.items()]
    return found + _datasets(folder)


def _datasets(folder: Path) -> list[Seed]:
    from lidar_core.circles.dataset import generate
    from lidar_core.circles.dataset_config import DatasetConfig

    place = folder / "dataset"
    config = DatasetConfig(kind="continuous", circles=20, draws=1)
    _in_a_child(lambda place: generate(config, place, seed=1) and None, place)
    files = {file.name: file.read_bytes() for file in place.iterdir() if file.is_file()}
    return [Seed(name, data, (entries.dataset,), files) for name, data in files.items()]
