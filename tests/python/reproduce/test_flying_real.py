"""Real sequences as drivers deliver them: how they are unpacked, where targets fly, what counts."""

import io
import tarfile
from dataclasses import replace

import numpy as np
import pytest

from lidar_core import sim
from lidar_core.errors import ConfigError, FormatError, LimitError
from lidar_core.io import PosedScan
from lidar_core.messages import Scan
from lidar_core.reproduce import Request, item_named
from lidar_core.reproduce.flying import real
from lidar_core.reproduce.flying.real_data import sequences
from lidar_core.reproduce.flying.real_data.inserted_targets import (
    CLEARANCE,
    DISTANCES,
    EDGE_DEG,
    TARGETS,
    drawn_flights,
    inserted,
    real_scans,
    with_targets,
)
from lidar_core.reproduce.flying.real_data.lost_returns import drawn_patches, with_losses
from lidar_core.reproduce.flying.real_data.reported import false_tracks
from lidar_core.reproduce.flying.real_data.scores import matches, scores
from lidar_core.reproduce.flying.real_data.sequences import (
    RealSequence,
    sequence_named,
    sequence_scans,
)
from lidar_core.sim.insertion.inserted import SolidTarget

ROOM = RealSequence("room", "room.tar.xz", elevation_deg=(-25.0, 25.0), range_max=60.0)


def room_scan(targets=(), seed=0):
    """Scan of a sensor in a hall; rays without return are dropped."""
    scene = sim.Scene(
        bodies=[
            sim.Body(shape=sim.Box(size=(0.4, 30.0, 12.0)), position=(14.0, 0.0, 4.0)),
            sim.Body(shape=sim.Box(size=(30.0, 0.4, 12.0)), position=(0.0, 14.0, 4.0)),
            sim.Body(shape=sim.Box(size=(40.0, 40.0, 0.4)), position=(0.0, 0.0, -3.0)),
        ],
        targets=targets,
        lidar=sim.LidarModel.preset("hdl-32e", range_std=0.0),
        sensor=sim.Hover(position=(0.0, 0.0, 0.0)),
        scans=1,
    )
    return sim.Simulator(scene, seed=seed).scan(0)


@pytest.fixture(scope="module")
def room():
    scan = room_scan().scan
    items = [
        PosedScan(replace(scan, stamp_ns=number * 100_000_000), np.eye(4)) for number in range(4)
    ]
    return real_scans(items)


# Archives


def archive_of(folder, files):
    path = folder / "3d" / "room.tar.xz"
    path.parent.mkdir(parents=True, exist_ok=True)
    with tarfile.open(path, "w:xz") as archive:
        for name, data in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    return RealSequence("room", "3d/room.tar.xz")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("LIDAR_CORE_DATA", str(tmp_path / "data"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "cache"))
    (tmp_path / "cache").mkdir()
    return tmp_path / "data"


def test_tables_of_an_archive_are_scans_in_their_order_with_rings(folder):
    rows = [b"1,2,3,7,4\n5,6,7,8,9\n", b"2,2,3,7,4\n1,1,1,1,31\n3,3,3,1,0\n"]
    names = ("velo_lidar/000002.csv", "velo_lidar/000010.csv")
    sequence = archive_of(folder, dict(zip(names, rows, strict=True)))
    for _ in range(2):  # unpacked, then from the folder of the first time
        items = list(sequence_scans(sequence))
        assert [len(item.scan.points) for item in items] == [2, 3]
        assert [item.scan.stamp_ns for item in items] == [0, 100_000_000]
        assert items[1].scan.ring.tolist() == [4, 31, 0]
        assert items[0].scan.points[1].tolist() == [5, 6, 7]
        assert items[0].scan.intensity.tolist() == [7, 8]


def test_an_archive_that_reaches_out_of_its_folder_is_refused(folder, tmp_path):
    sequence = archive_of(folder, {"../../outside.csv": b"1,2,3,4,5\n"})
    with pytest.raises(FormatError, match=r"room\.tar\.xz.*cannot be unpacked"):
        list(sequence_scans(sequence))
    assert not list(tmp_path.rglob("outside.csv"))


def test_an_archive_that_unpacks_to_too_much_is_refused(folder, monkeypatch):
    monkeypatch.setattr(sequences, "LARGEST", 10)
    sequence = archive_of(folder, {"velo_lidar/1.csv": b"1,2,3,4,5\n" * 2})
    with pytest.raises(LimitError, match=r"room\.tar\.xz.*10 bytes"):
        list(sequence_scans(sequence))


def test_a_damaged_archive_and_one_without_scans_are_refused(folder):
    sequence = archive_of(folder, {"readme.txt": b"nothing"})
    with pytest.raises(FormatError, match="found none"):
        list(sequence_scans(sequence))
    (folder / sequence.source).write_bytes(b"no archive")
    with pytest.raises(FormatError, match="cannot be unpacked"):
        list(sequence_scans(sequence))


def test_without_the_recordings_the_item_names_their_variable(monkeypatch, tmp_path):
    for value in (None, str(tmp_path)):
        if value is None:
            monkeypatch.delenv("LIDAR_CORE_DATA", raising=False)
        else:
            monkeypatch.setenv("LIDAR_CORE_DATA", value)
        with pytest.raises(ConfigError, match="LIDAR_CORE_DATA"):
            item_named("flying-real").run(Request(seed=0, scans=20, threads=1))


# Recordings


LONG = ("radiate_tiny_foggy",)  # a table of text per scan


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.nightly if name in LONG else ())
        for name in sorted(real.LENGTHS)
    ],
)
def test_every_sequence_is_read_whole_with_its_poses(name, recordings, monkeypatch):
    monkeypatch.setenv("LIDAR_CORE_DATA", str(recordings))
    items = list(sequence_scans(sequence_named(name)))
    assert len(items) == real.LENGTHS[name]
    stamps = np.array([item.scan.stamp_ns for item in items])
    assert (np.diff(stamps) > 0).all()
    if name == "rs16_office":  # files 199 to 439: the numbers are rotations at 10 Hz
        assert stamps[-1] - stamps[0] == 240 * 10**8
    way = np.array([item.world_from_lidar.reshape(-1, 4, 4)[0, :3, 3] for item in items])
    steps = np.linalg.norm(np.diff(way, axis=0), axis=1)
    if sequence_named(name).pose == "static":
        assert (steps == 0).all()
    else:  # a car without jerks
        assert steps.min() > 0.3
        assert np.abs(np.diff(steps)).max() < 0.5


# Targets


@pytest.mark.parametrize("name", sorted(TARGETS))
def test_an_inserted_target_gives_the_returns_of_a_simulated_one(room, name):
    centre = np.array([3.5, 1.0, -0.8])
    there = sim.Target(shape=TARGETS[name], motion=sim.Hover(position=tuple(centre)))
    expected = room_scan((there,)).truth.hits[0]
    rng = np.random.default_rng(0)
    scan, hits = inserted(room[0], [(SolidTarget(TARGETS[name]), centre)], 60.0, rng)
    assert expected > 10
    assert abs(hits[0] - expected) <= 0.1 * expected
    near = np.linalg.norm(scan.points - centre, axis=1) < 0.5
    assert near.sum() == hits[0]


def test_a_target_before_the_sky_is_met_by_rays_that_the_driver_dropped(room):
    centre = np.array([-6.0, -1.0, 0.8])  # nothing stands behind it
    rng = np.random.default_rng(0)
    scan, hits = inserted(room[0], [(SolidTarget(TARGETS["sphere"]), centre)], 60.0, rng)
    there = sim.Target(shape=TARGETS["sphere"], motion=sim.Hover(position=tuple(centre)))
    expected = room_scan((there,)).truth.hits[0]
    assert abs(hits[0] - expected) <= 0.1 * expected
    assert len(scan.points) == len(room[0].item.scan.points) + hits[0]
    assert len(scan.ring) == len(scan.points)


def test_flights_are_the_same_for_a_seed_in_view_and_clear_of_every_return(room):
    flights = [drawn_flights(room, ROOM, np.random.default_rng(seed)) for seed in (3, 3, 4)]
    assert set(flights[0]) == set(TARGETS)
    for name in TARGETS:
        offsets = [one[name].offset for one in flights]
        assert (offsets[0] == offsets[1]).all()
        assert (offsets[0] != offsets[2]).any()
    made, places, hits = with_targets(room, flights[0], ROOM, np.random.default_rng(5))
    assert len(made) == len(room)
    points = room[0].item.scan.points.astype(np.float64)
    for place in places.reshape(-1, 3):
        distance = np.linalg.norm(place)
        assert DISTANCES[0] <= distance <= DISTANCES[1]
        elevation = np.rad2deg(np.arcsin(place[2] / distance))
        assert ROOM.elevation_deg[0] + EDGE_DEG <= elevation <= ROOM.elevation_deg[1] - EDGE_DEG
        assert np.linalg.norm(points - place, axis=1).min() >= CLEARANCE
    assert (hits >= 3).mean() > 0.7


def test_lost_patches_take_returns_away_and_add_none(room):
    made = with_losses(room, drawn_patches(room, np.random.default_rng(2)))
    before, after = room[0].item.scan, made[0].scan
    assert 0.5 * len(before.points) < len(after.points) < 0.99 * len(before.points)
    assert set(map(tuple, after.points.tolist())) <= set(map(tuple, before.points.tolist()))
    assert len(after.ring) == len(after.points)


def test_lost_returns_of_a_driver_that_marks_them_stay_as_marks(room):
    scan = room[0].item.scan
    marked = replace(scan, no_return=np.zeros(len(scan.points), bool))
    scans = real_scans([PosedScan(marked, np.eye(4))])
    after = with_losses(scans, drawn_patches(scans, np.random.default_rng(2)))[0].scan
    assert len(after.points) == len(scan.points)
    assert after.no_return.sum() > 100
    assert np.isnan(after.points[after.no_return]).all()


# What counts


def part_of(rows, places, sensors=None, hits=None):
    """Run of rows (scan, id, place) and targets (S, T, 3)."""
    places = np.asarray(places, float)
    sensors = np.zeros((len(places), 3)) if sensors is None else np.asarray(sensors, float)
    position = np.reshape([row[2] for row in rows], (-1, 3)).astype(float)
    scan = np.array([row[0] for row in rows], np.int64)
    return {
        "scan": scan,
        "id": np.array([row[1] for row in rows], np.int64),
        "position": position,
        "in_body": position - sensors[scan],
        "std": np.full(len(rows), 0.1),
        "sensor": sensors,
        "place": places,
        "hits": np.full(places.shape[:2], 5) if hits is None else np.asarray(hits),
        "seconds": 2.0 + np.arange(len(places)),
        "gate_open": np.ones(len(places), bool),
    }


def test_a_track_and_a_target_are_matched_one_to_one_within_the_gate():
    places = [[[5, 0, 0], [9, 0, 0]]] * 3
    rows = [
        (0, 1, (5.3, 0, 0)),
        (0, 2, (5.1, 0, 0)),  # the nearer one counts
        (1, 1, (5.6, 0, 0)),  # too far
        (2, 3, (9.0, 0.4, 0)),
    ]
    found = matches(part_of(rows, places))
    assert found.tolist() == [[1, -1], [-1, -1], [-1, 3]]


def test_recall_counts_scans_with_returns_and_errors_are_told_along_and_across():
    places = [[[5, 0, 0]]] * 4
    rows = [(0, 1, (5.2, 0.1, 0)), (1, 1, (5.2, 0.1, 0)), (3, 1, (5.2, 0.1, 0)), (3, 9, (8, 8, 0))]
    part = part_of(rows, places, hits=[[5], [5], [5], [2]])
    found = {name: value for name, _, value in scores([part], ["sphere"])}
    assert found["recall"] == pytest.approx(2 / 3)
    assert found["recall, sphere"] == pytest.approx(2 / 3)
    assert found["error, along the line of sight"] == pytest.approx(0.2)
    assert found["error, across it"] == pytest.approx(0.1)
    assert found["error"] == pytest.approx(np.hypot(0.2, 0.1))
    assert found["false_tracks, with targets"] == 1


def test_what_goes_along_with_the_sensor_near_it_is_its_own_body():
    sensors = [(2.0 * number, 0, 0) for number in range(5)]
    places = np.empty((5, 0, 3))
    roof = [(number, 1, (2.0 * number - 1.4, 0.0, -0.3)) for number in range(5)]
    escort = [(number, 2, (2.0 * number, 6.0, 0.0)) for number in range(5)]
    post = [(number, 3, (3.0, 1.0, 0.0)) for number in range(5)]
    found = false_tracks(part_of(roof + escort + post, places, sensors))
    assert {one.number: one.is_own_body for one in found} == {1: True, 2: False, 3: False}


def test_a_track_matched_in_any_scan_is_not_false():
    rows = [(0, 1, (5, 0, 0)), (1, 1, (7, 0, 0)), (1, 2, (9, 0, 0))]
    found = false_tracks(part_of(rows, [[[5, 0, 0]]] * 2), matched=[1])
    assert [one.number for one in found] == [2]


def test_a_scan_of_zeros_gives_its_rows_to_an_inserted_target():
    made = room_scan()
    points = np.concatenate([made.scan.points, np.full((800, 3), np.nan, np.float32)])
    marks = np.arange(len(points)) >= len(made.scan.points)
    scan = Scan(stamp_ns=0, points=points, no_return=marks)
    (prepared,) = real_scans([PosedScan(scan, np.eye(4))])
    centre = np.array([-6.0, -1.0, 0.8])
    rng = np.random.default_rng(0)
    after, hits = inserted(prepared, [(SolidTarget(TARGETS["sphere"]), centre)], 60.0, rng)
    assert hits[0] > 0
    assert len(after.points) == len(points)
    assert after.no_return.sum() == 800 - hits[0]
    assert np.isfinite(after.points[~after.no_return]).all()
