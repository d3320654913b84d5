"""Saved states of detectors, trackers and maps: what was saved goes on to the same bits."""

import copy
import pickle
import struct
import zlib

import numpy as np
import pytest

from lidar_core import VoxelMap, VoxelMapConfig
from lidar_core.errors import ConfigError, FormatError
from lidar_core.flying import FlyingConfig, FlyingObjectDetector, PointCloudTracker, TrackerConfig

HALF = np.array([9.0, 8.0, 3.0])
"""Half the edges of a room [m]."""


def rays():
    azimuth, elevation = np.meshgrid(np.linspace(-np.pi, np.pi, 180), np.linspace(-0.6, 0.6, 32))
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)


def room_scan(k, directions):
    """A room with an open ceiling part, and a ball that flies through it."""
    with np.errstate(divide="ignore"):
        walls = (HALF / abs(directions)).min(axis=-1)
    middle = np.array([4.0 - 0.15 * k, 1.0 + 0.02 * k, 0.4])
    along = directions @ middle
    aside = middle @ middle - along**2
    ball = along - np.sqrt(np.maximum(0.3**2 - aside, 0))
    ranges = np.where((aside < 0.3**2) & (along > 0), np.minimum(walls, ball), walls)
    ranges = ranges + np.random.default_rng(k).normal(0, 0.01, ranges.shape)
    is_sky = (directions[..., 2] > 0.35) & (directions[..., 0] > 0)
    return (np.where(is_sky, np.nan, ranges)[..., None] * directions).astype(np.float32)


def pose(k, aside):
    world_from_lidar = np.eye(4)
    world_from_lidar[:3, 3] = [1000.0 + 0.05 * k, aside, 2.0]
    return world_from_lidar


def frame_bits(frame):
    found, tracks = frame.detections, frame.tracks
    parts = (frame.point_class, found.position, found.covariance, tracks.id, tracks.position)
    return [part.tobytes() for part in parts], frame.status


def run_detector(detector, numbers, directions):
    """Bits of the frames and of the map after scans of two LiDARs."""
    bits = []
    for k in numbers:
        sensor = ("front", "rear")[k % 2]
        scan, stamp = room_scan(k, directions), 1_000_000_000 + k * 50_000_000
        frame = detector.process(scan, pose(k, k % 2), stamp, sensor=sensor)
        bits.append(frame_bits(frame))
    return bits, detector._detector.map_bytes(), detector.health()


def ways(thing, folder, **options):
    """The object again, by every way there is."""
    thing.save(folder / "state", **options)
    yield type(thing).load(folder / "state")
    yield type(thing).from_bytes(thing.to_bytes())
    yield copy.copy(thing)
    yield copy.deepcopy(thing)
    yield pickle.loads(pickle.dumps(thing))


@pytest.mark.ci_cases("tracks-best")
@pytest.mark.parametrize("config", [FlyingConfig(), FlyingConfig.paper()], ids=["best", "paper"])
@pytest.mark.parametrize("saved_after", [7, 36], ids=["burn-in", "tracks"])
def test_a_detector_goes_on_to_the_same_bits(config, saved_after, tmp_path):
    directions = rays()
    detector = FlyingObjectDetector(config, threads=2)
    detector.set_teammates([7], [[1000.0, 3.0, 2.0]])
    run_detector(detector, range(saved_after), directions)
    before = detector.to_bytes()
    again = list(ways(detector, tmp_path))
    numbers = range(saved_after, saved_after + 12)
    expected = run_detector(detector, numbers, directions)
    assert all(run_detector(other, numbers, directions) == expected for other in again)
    assert len(detector.tracks_at(1_000_000_000 + numbers[-1] * 50_000_000).id) or saved_after == 7
    # Equal states give equal bytes, and what a copy does changes nothing else.
    assert FlyingObjectDetector.from_bytes(before).to_bytes() == before
    assert [other.to_bytes() for other in again] == [detector.to_bytes()] * len(again)


def test_a_copy_of_a_detector_is_on_its_own():
    detector = FlyingObjectDetector()
    run_detector(detector, range(3), rays())
    before = detector.to_bytes()
    other = copy.copy(detector)
    run_detector(other, range(3, 6), rays())
    other.set_teammates([1], [[0.0, 0.0, 0.0]])
    other.reset()
    assert detector.to_bytes() == before
    assert detector.health().processed == 3


def test_a_held_scan_is_remembered(tmp_path):
    detector, directions = FlyingObjectDetector(), rays()
    run_detector(detector, range(30), directions)
    smaller = 0.5 * room_scan(30, directions)  # all of it lies in free space
    frame = detector.process(smaller, pose(30, 0), 4_000_000_000, sensor="front")
    assert frame.status.map_pose_mismatch
    for other in ways(detector, tmp_path):
        assert other.reanchor()
        assert not other.reanchor()


def test_a_detector_of_another_configuration_is_refused():
    detector = FlyingObjectDetector()
    content = detector.to_bytes().replace(b'"range_std"', b'"rangestd_"')
    body = content[:-4]
    with pytest.raises(ConfigError, match="rangestd_"):
        FlyingObjectDetector.from_bytes(body + struct.pack("<I", zlib.crc32(body)))
    with pytest.raises(FormatError, match="expected the state of a FlyingObjectDetector"):
        FlyingObjectDetector.from_bytes(VoxelMap().to_bytes())


def tracker_bits(tracker, numbers):
    bits = []
    for k in numbers:
        stamp = 1_000_000_000 + k * 100_000_000
        target = np.array([[500.0 + 0.3 * k, 0.1 * k, 5.0], [500.0, 4.0 - 0.2 * k, 3.0]])
        occupied = np.array([[510.0, 9.0, 0.0]])
        tracker.new_point_cloud(target, occupied, stamp, sensor_origin=[500.0, 0.0, 0.0])
        late = target - [[0.3, 0.1, 0.0], [0.0, -0.2, 0.0]]
        tracker.new_detections(late, stamp - 100_000_000)
        tracks = tracker.tracks_at(stamp + 20_000_000)
        bits.append([part.tobytes() for part in (tracks.id, tracks.position, tracks.covariance)])
    return bits


@pytest.mark.parametrize("config", [TrackerConfig(), TrackerConfig.paper()], ids=["best", "paper"])
def test_a_tracker_goes_on_to_the_same_bits(config, tmp_path):
    tracker = PointCloudTracker(config, threads=2)
    tracker_bits(tracker, range(8))
    again = list(ways(tracker, tmp_path))
    expected = tracker_bits(tracker, range(8, 20))
    assert any(len(ids) for ids, *_ in expected)
    for other in again:
        assert tracker_bits(other, range(8, 20)) == expected


def map_bits(voxel_map, numbers, directions):
    bits = []
    for k in numbers:
        points = room_scan(k, directions).reshape(-1, 3) + pose(k, 0)[:3, 3]
        classes = np.where(np.isfinite(points[:, 0]), 1 + (np.arange(len(points)) % 7 == 0), 0)
        stats = voxel_map.integrate(points, classes, pose(k, 0)[:3, 3])
        removed = voxel_map.remove_separate(max_gap=0.6, min_confident=3)
        bits.append((stats, removed))
    return bits, voxel_map._map.to_bytes(), voxel_map.occupied_points().tobytes()


def test_a_map_goes_on_to_the_same_bits(tmp_path):
    directions = rays()
    voxel_map = VoxelMap(VoxelMapConfig(), threads=2, origin=[1000.0, 0.0, 2.0])
    map_bits(voxel_map, range(6), directions)
    again = list(ways(voxel_map, tmp_path, full=True))
    expected = map_bits(voxel_map, range(6, 14), directions)
    for other in again:
        assert map_bits(other, range(6, 14), directions) == expected
        assert other.to_bytes() == voxel_map.to_bytes()


def test_a_map_file_is_read_as_before(tmp_path):
    voxel_map = VoxelMap()
    voxel_map.set_occupied([[1.0, 2.0, 3.0]])
    voxel_map.save(tmp_path / "map.lcvm")
    assert (tmp_path / "map.lcvm").read_bytes()[:4] == b"LCVM"
    known = VoxelMap.load(tmp_path / "map.lcvm", threads=2)
    assert (known.occupied_points() == voxel_map.occupied_points()).all()
    assert (copy.deepcopy(known).occupied_points() == known.occupied_points()).all()


MAKERS = {
    "map": VoxelMap,
    "tracker": PointCloudTracker,
    "detector": FlyingObjectDetector,
}


@pytest.mark.parametrize("name", MAKERS)
def test_damage_is_refused(name):
    thing = MAKERS[name]()
    if name == "map":
        thing.set_occupied([[1.0, 2.0, 3.0]])
    if name == "tracker":
        tracker_bits(thing, range(3))
    content, rng = thing.to_bytes(), np.random.default_rng(0)
    for length in rng.integers(len(content), size=100):
        with pytest.raises(FormatError):
            type(thing).from_bytes(content[:length])
    for place in rng.integers(len(content), size=100):
        damaged = bytearray(content)
        damaged[place] ^= 0x41
        with pytest.raises(FormatError):
            type(thing).from_bytes(bytes(damaged))


def sealed(core):
    return core + struct.pack("<I", zlib.crc32(core))


@pytest.mark.parametrize("name", ["map", "tracker"])
def test_damage_with_right_checksums_is_typed(name):
    """Whoever writes a file by hand gets a typed error or an object that works."""
    thing = MAKERS[name]()
    if name == "map":
        map_bits(thing, range(1), rays()[::8, ::9])
    else:
        tracker_bits(thing, range(3))
    core, rng = thing._state()[0], np.random.default_rng(0)
    whole = thing.to_bytes()
    start = whole.index(core)
    refused = 0
    for _ in range(300):
        damaged = bytearray(core[:-4])
        place = rng.integers(20, len(damaged)) if rng.random() < 0.5 else rng.integers(20, 400)
        damaged[place] = rng.integers(256)
        content = whole[:start] + sealed(bytes(damaged))
        try:
            other = type(thing).from_bytes(sealed(content))
        except (FormatError, ConfigError):
            refused += 1
            continue
        if name == "tracker":
            other.tracks_at(0)
        else:
            other.remove_separate(max_gap=0.6, min_confident=3)
    assert refused > 10
