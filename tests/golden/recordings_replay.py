"""What every reader makes of the recordings of `LIDAR_CORE_DATA`: their first messages."""

import tarfile
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable
from functools import partial
from itertools import islice
from pathlib import Path

from golden.digest import Record
from lidar_core.fusion import read_autoferry, read_laser_radar
from lidar_core.io import open_recording, posed_laser_scans, read_cloud
from lidar_core.messages import Pose

MESSAGES = 250
"""Messages that are looked at."""
KEPT = {"Scan": 2, "LaserScan": 5, "Pose": 10}
"""Messages of a topic that are kept."""
SCANS = 15
"""Of one file of many measurements."""
RECORDINGS = (
    "2d/datmo/intersection.bag",
    "2d/datmo/parallel.bag",
    "2d/leg_tracker/demo_stationary_simple_environment.bag",
    "2d/leg_tracker/positive_6.bag",
    "2d/leg_tracker/positive_6_extracted.bag",
    "2d/obstacle_detector/scans_demo.bag",
    "2d/radish/mit-csail.clf.bz2",
    "2d/sick_rms_lms/rms_1xxx_lms_1xx_movement_off.bag",
    "3d/nebula/hesai/64/1673403880898440686.pcd",
    "3d/nebula/velodyne/vlp16/1673400471837873222",
    "3d/nebula/velodyne/vls128/1614315746471294674/1614315746471294674_0.db3",
    "3d/ndt_omp_pair",
    "3d/sequences/robosense_placeholder/100002.pcd",
    "3d/ouster/512x10_raw.bag",
    "3d/ouster/OS-0-32-U1_v2.2.0_1024x10.pcap",
    "3d/ouster/OS-1-128_v2.3.0_1024x10_lb_n3.osf",
    "3d/ouster/osf_fw_3.2_10scans.osf",
    "3d/velodyne_mrpt/sample_velodyne_hdl32.pcap",
    "3d/velodyne_mrpt/sample_velodyne_vlp16_gps.pcap",
    "formats/derived_rosbag2/datmo_intersection_mcap",
    "formats/derived_rosbag2/sick_rms_lms_mcap/sick_rms_lms_mcap.mcap",
    "formats/derived_rosbag2/sick_rms_lms_sqlite3",
    "people/corridor/example1",
)
ARCHIVES = (
    "3d/sequences/livox_hap_outdoor/scans.tar.xz",
    "3d/sequences/livox_horizon_sway/scans.tar.xz",
    "3d/sequences/rs16_office/scans.tar.xz",
)
CLOUDS = (
    "3d/ouster/OS-1-128_v2.3.0_1024x10_lb_n3_map-000.ply",
    "formats/octomap/geb079.bt",
    "formats/pointcloudset_tree/test_tree.las",
    "formats/pointcloudset_tree/test_tree.pcd",
)
POSED = {
    "formats/derived_rosbag2/datmo_intersection_mcap": {
        "mounting": ["ego_pose laser -0.12 0 0 0 0 0"]
    },
    "2d/sick_rms_lms/rms_1xxx_lms_1xx_movement_off.bag": {"pose": "static"},
}
"""Planar recordings, and options by which their poses are known."""
PATHS = frozenset({"topic"})


def _read(record, data, name):
    """The first messages of every topic."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with open_recording(data / name) as recording:
            topics = [(topic.name, topic.type, topic.kind) for topic in recording.topics()]
            record.add("topics", topics)
            _add_messages(record, recording)


def _add_messages(record, recording):
    seen = Counter()
    for message in islice(recording, MESSAGES):
        kind = type(message).__name__
        place = (kind, message.topic, message.is_static if isinstance(message, Pose) else None)
        seen[place] += 1
        if seen[place] <= KEPT[kind]:
            record.add(f"{kind}/topic", message.topic)
            record.add(kind, message, skip=PATHS)


def _read_archive(record, data, name):
    """The first two clouds of an archive, as a folder."""
    with tempfile.TemporaryDirectory() as place, tarfile.open(data / name, "r|xz") as archive:
        for member in islice((one for one in archive if one.isfile()), 2):
            content = archive.extractfile(member)
            if content is not None:
                (Path(place) / Path(member.name).name).write_bytes(content.read())
        with open_recording(place) as recording:
            for scan in recording:
                record.add("Scan", scan, skip=PATHS)


def _read_cloud(record, data, name):
    cloud = read_cloud(data / name)
    record.add("points", cloud.points)
    record.add("resolution", cloud.resolution)


def _read_posed(record, data, name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with open_recording(data / name) as recording:
            for item in islice(posed_laser_scans(recording, **POSED[name]), SCANS):
                record.add("posed/stamp_ns", item.scan.stamp_ns)
                record.add("posed/world_from_lidar", item.world_from_lidar, near=True)
                record.add("posed/pose_stamps_ns", item.pose_stamps_ns)


def _read_laser_radar(record, data, name):
    found = read_laser_radar(data / name)
    _add_measurements(record, found.measurements)
    record.add("truth", found.truth)


def _read_autoferry(record, data, name):
    for scan in read_autoferry(data / name)[:SCANS]:
        record.add("scan", {"stamp_ns": scan.stamp_ns, "source": scan.source})
        record.add("scan/sensor", scan.sensor)
        record.add("scan/truth", {str(name): place for name, place in scan.truth.items()})
        _add_measurements(record, scan.measurements, near=True)


def _add_measurements(record, measurements, *, near=False):
    for one in measurements:
        record.add("measurement/stamp_ns", one.stamp_ns)
        record.add("measurement/sensor", one.sensor)
        record.add("measurement/values", one.values, near=near)
        record.add("measurement/covariance", one.covariance, near=near)


FUSION: dict[str, Callable[..., None]] = {
    "fusion/obj_pose-laser-radar-synthetic-input.txt": _read_laser_radar,
    "fusion/sample-laser-radar-measurement-data-1.txt": _read_laser_radar,
    "2d/autoferry/scenario13/scenario13_detections.json": _read_autoferry,
    "2d/autoferry/scenario2/scenario2_detections.json": _read_autoferry,
}

READ: dict[str, Callable[[Record, Path], None]] = (
    {name: partial(_read, name=name) for name in RECORDINGS}
    | {name: partial(_read_archive, name=name) for name in ARCHIVES}
    | {name: partial(_read_cloud, name=name) for name in CLOUDS}
    | {f"{name}, posed": partial(_read_posed, name=name) for name in POSED}
    | {name: partial(read, name=name) for name, read in FUSION.items()}
)
