"""Clouds and maps in single files: what goes in comes out, checked with other programs' numbers."""

import hashlib
import struct

import laspy
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from typer.testing import CliRunner

import lidar_core as lc
import lidar_core.io
from lidar_core.cli import app
from lidar_core.errors import ConfigError, FormatError, InputError, LimitError
from lidar_core.io.poses.posed import posed_scans
from lidar_core.messages import Pose, Scan

POINTS = hnp.arrays(
    np.float64, st.tuples(st.integers(1, 60), st.just(3)), elements=st.floats(-900, 900)
)


def keys_of(points, resolution):
    return np.unique(np.round(points / resolution - 0.5).astype(np.int64), axis=0)


@settings(max_examples=60, deadline=None)
@given(points=POINTS, resolution=st.sampled_from([0.05, 0.25, 1.0]))
def test_octomap_holds_the_voxels_of_the_points(tmp_path_factory, points, resolution):
    path = tmp_path_factory.mktemp("tree") / "a.bt"
    lc.io.write_cloud(path, points, resolution=resolution)
    cloud = lc.io.read_cloud(path)
    assert cloud.resolution == resolution
    wanted = np.unique(np.floor(points / resolution).astype(np.int64), axis=0)
    np.testing.assert_array_equal(keys_of(cloud.points, resolution), wanted)
    assert len(cloud.points) == len(wanted)


def test_octomap_of_a_building_has_the_voxels_that_octomap_finds(recordings):
    """Number and digest of the occupied voxels, from pyoctomap 1.2.2 (OctoMap's own library)."""
    cloud = lc.io.read_cloud(recordings / "formats" / "octomap" / "geb079.bt")
    keys = keys_of(cloud.points, 0.08)
    assert len(cloud.points) == len(keys) == 185_673
    digest = hashlib.sha256(keys.astype("<i4").tobytes()).hexdigest()
    assert digest == "71535355d45d12dac05b898392d21de1de243e268a6d09a448b93dbf5d2d8071"


def test_octomap_files_are_as_octomap_writes_them(tmp_path):
    """One voxel, at the upper side of the middle in x, y and z: child 7, then 0 fifteen times."""
    path = lc.io.write_cloud(tmp_path / "a.bt", [[0.1, 0.2, 0.3]], resolution=0.5)
    head, _, data = path.read_bytes().partition(b"data\n")
    assert head == b"# Octomap OcTree binary file\nid OcTree\nsize 17\nres 0.5\n"
    inner_7, inner_0, occupied_0 = 3 << 14, 3, 2
    assert struct.unpack("<16H", data) == (inner_7, *[inner_0] * 14, occupied_0)


def test_a_leaf_above_the_lowest_level_stands_for_all_below(tmp_path):
    path = tmp_path / "a.bt"
    nodes = [3 << 14, *[3] * 12, 2]  # occupied at depth 14: edges of 4 voxels
    head = b"# Octomap OcTree binary file\n# by hand\nid OcTree\nsize 15\nres 1\ndata\n"
    path.write_bytes(head + struct.pack(f"<{len(nodes)}H", *nodes))
    cloud = lc.io.read_cloud(path)
    np.testing.assert_array_equal(
        np.unique(cloud.points, axis=0),
        np.stack(np.meshgrid(*[np.arange(4) + 0.5] * 3, indexing="ij"), -1).reshape(-1, 3),
    )


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"# Octomap OcTree file\nid OcTree\ndata\n", "expected a binary OcTree of OctoMap"),
        (b"# Octomap OcTree binary file\nid ColorOcTree\nres 1\ndata\n", "expected a binary"),
        (
            b"# Octomap OcTree binary file\nid OcTree\nres nan\ndata\n",
            "expected a finite resolution > 0, got nan m",
        ),
        (b"# Octomap OcTree binary file\nid OcTree\nres x\ndata\n", "cannot be read"),
        (
            b"# Octomap OcTree binary file\nid OcTree\nres 1\ndata\n\x03\x00",
            "ends early, at node 1",
        ),
        (
            b"# Octomap OcTree binary file\nid OcTree\nres 1\ndata\n" + b"\x03\x00" * 17,
            "deeper than 16 levels",
        ),
        (
            b"# Octomap OcTree binary file\nid OcTree\nres 1\ndata\n\x02\x00\x02\x00",
            "1 nodes belong to no tree",
        ),
    ],
)
def test_broken_trees_are_refused(tmp_path, data, text):
    (tmp_path / "a.bt").write_bytes(data)
    with pytest.raises(FormatError, match=text):
        lc.io.read_cloud(tmp_path / "a.bt")


def test_a_small_tree_cannot_ask_for_much_memory(tmp_path):
    data = b"# Octomap OcTree binary file\nid OcTree\nres 1\ndata\n\x02\x00"
    (tmp_path / "a.bt").write_bytes(data)
    with pytest.raises(LimitError, match="tree of occupied voxels of 35184372088832"):
        lc.io.read_cloud(tmp_path / "a.bt")


@settings(max_examples=30, deadline=None)
@given(points=POINTS)
def test_pcd_and_ply_give_the_points_back(tmp_path_factory, points):
    folder = tmp_path_factory.mktemp("clouds")
    single = points.astype(np.float32)
    lc.io.write_cloud(folder / "a.pcd", points)
    is_point = single.any(axis=1)  # zeros are what drivers write where there is none
    found = lc.io.read_cloud(folder / "a.pcd").points
    np.testing.assert_array_equal(found, single[is_point])
    lc.io.write_cloud(folder / "a.ply", points)
    np.testing.assert_array_equal(lc.io.read_cloud(folder / "a.ply").points, points)
    loaded = trimesh.load(folder / "a.ply")
    np.testing.assert_array_equal(np.asarray(loaded.vertices), points)


def test_the_surface_of_a_mesh_is_covered(tmp_path):
    trimesh.creation.box((2.0, 1.0, 0.5)).export(tmp_path / "box.stl")
    points = lc.io.read_cloud(tmp_path / "box.stl", spacing=0.1).points
    assert (np.abs(points) <= np.array([1, 0.5, 0.25]) + 1e-9).all()
    on_surface = np.isclose(np.abs(points), [1, 0.5, 0.25]).any(axis=1)
    assert on_surface.all()
    place = np.random.default_rng(0).uniform(-1, 1, (500, 2)) * [1, 0.5]
    top = np.column_stack([place, np.full(500, 0.25)])
    nearest = np.min(np.linalg.norm(top[:, None] - points[None], axis=2), axis=1)
    assert nearest.max() <= 0.1
    with pytest.raises(LimitError, match=r"a point every 1e-05 m"):
        lc.io.read_cloud(tmp_path / "box.stl", spacing=1e-5)
    with pytest.raises(InputError, match="spacing: expected a finite number > 0, got 0"):
        lc.io.read_cloud(tmp_path / "box.stl", spacing=0)


def write_las(path, points):
    header = laspy.LasHeader(point_format=0, version="1.2")
    header.offsets, header.scales = np.floor(points.min(axis=0)), [0.001] * 3
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = points.T
    cloud.intensity = np.arange(len(points)) % 100
    cloud.write(path)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_las_keeps_its_millimetres_far_from_the_origin(tmp_path, suffix):
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 50, (200, 3)) + np.array([551_152.0, 5_249_119.0, 300.0])
    path = tmp_path / f"a{suffix}"
    write_las(path, points)
    np.testing.assert_allclose(lc.io.read_cloud(path).points, points, atol=0.0006)
    with lc.io.open_recording(path) as recording:
        pose, scan = list(recording)
    assert isinstance(pose, Pose)
    assert isinstance(scan, Scan)
    np.testing.assert_array_equal(pose.matrix[:3, 3], [551_000, 5_249_000, 0])
    np.testing.assert_allclose(scan.points + pose.matrix[:3, 3], points, atol=0.0006)
    np.testing.assert_array_equal(scan.intensity, np.arange(200) % 100)


def test_real_clouds_have_the_size_that_their_headers_state(recordings):
    for name, count in {
        "formats/pointcloudset_tree/test_tree.las": 11_631,
        "3d/ouster/OS-1-128_v2.3.0_1024x10_lb_n3_map-000.ply": 155_000,
        "formats/pointcloudset_tree/test_tree.pcd": 102_236,
    }.items():
        assert lc.io.read_cloud(recordings / name).points.shape == (count, 3)
        with lc.io.open_recording(recordings / name) as recording:
            scans = [message for message in recording if isinstance(message, Scan)]
        assert [len(scan.points) for scan in scans] == [count]


def test_a_map_becomes_known_to_the_detector(tmp_path):
    """A wall as OctoMap's file: the detector takes its voxels for occupied for good."""
    wall = np.stack(np.meshgrid([5.0], np.arange(-3, 3, 0.1), np.arange(0, 3, 0.1)), -1)
    lc.io.write_cloud(tmp_path / "wall.bt", wall.reshape(-1, 3), resolution=0.1)
    assert (
        CliRunner()
        .invoke(app, ["simulate", "demo", "-o", str(tmp_path / "r.npz"), "--scans", "1"])
        .exit_code
        == 0
    )
    done = CliRunner().invoke(
        app,
        [
            "detect",
            str(tmp_path / "r.npz"),
            "-o",
            str(tmp_path / "run"),
            "--map",
            str(tmp_path / "wall.bt"),
            "--no-picture",
            "--no-mcap",
        ],
    )
    assert done.exit_code == 0, done.output
    known = lc.VoxelMap.load(tmp_path / "run" / "map.lcvm")
    centres = wall.reshape(-1, 3) + np.array([0.05, 0, 0.05])
    assert (known.state_at(centres) == 3).all()
    turned = CliRunner().invoke(
        app, ["convert", str(tmp_path / "run" / "map.lcvm"), str(tmp_path / "map.bt")]
    )
    assert turned.exit_code == 0, turned.output
    again = lc.io.read_cloud(tmp_path / "map.bt")
    assert again.resolution == known.config.voxel_size
    np.testing.assert_array_equal(
        keys_of(again.points, 0.25), np.unique(np.floor(known.occupied_points() / 0.25), axis=0)
    )


def test_what_cannot_be_written_or_read_is_refused(tmp_path):
    with pytest.raises(
        ConfigError,
        match=r"unknown suffix '\.xyz'; formats for a cloud or map: \.bt \(OctoMap\), \.pcd",
    ):
        lc.io.write_cloud(tmp_path / "a.xyz", [[0, 0, 0]])
    with pytest.raises(InputError, match=r"resolution: \.bt needs the edge"):
        lc.io.write_cloud(tmp_path / "a.bt", [[0, 0, 0]])
    with pytest.raises(InputError, match=r"within 3276\.8 m of the origin, got .* in row 1"):
        lc.io.write_cloud(tmp_path / "a.bt", [[0, 0, 0], [9e9, 0, 0]], resolution=0.1)
    with pytest.raises(InputError, match="points"):
        lc.io.write_cloud(tmp_path / "a.ply", [[np.nan, 0, 0]])
    (tmp_path / "a.ply").write_bytes(b"ply\nnonsense")
    with pytest.raises(FormatError, match=r"a\.ply"):
        lc.io.read_cloud(tmp_path / "a.ply")
    (tmp_path / "a.abc").write_bytes(b"x")
    with pytest.raises(FormatError, match=r"unknown format '\.abc'; readable are"):
        lc.io.read_cloud(tmp_path / "a.abc")
    assert sorted(item.name for item in tmp_path.iterdir()) == ["a.abc", "a.ply"]


@pytest.mark.parametrize(
    ("name", "cure"),
    [
        ("a.bt", "detect --map"),
        ("metadata.yaml", "open the folder"),
        ("a.txt", "pose=FILE"),
        ("a.mat", "save its tables as CSV"),
        ("a.csv", "lidar-core fuse"),
    ],
)
def test_files_that_are_no_recordings_are_told_apart(tmp_path, name, cure):
    (tmp_path / name).write_bytes(b"x")
    with pytest.raises(FormatError, match=cure):
        lc.io.open_recording(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "cure"),
    [("a.bag.xz", "unpack first: unxz -k "), ("a.dat", "readable are")],
)
def test_a_folder_of_packed_recordings_says_how_they_are_unpacked(tmp_path, name, cure):
    (tmp_path / name).write_bytes(b"x")
    with pytest.raises(FormatError) as told:
        lc.io.open_recording(tmp_path)
    assert cure in str(told.value)
    assert ("unpack" in str(told.value)) == name.endswith(".xz")


def test_a_cut_file_of_a_folder_says_how_the_others_are_read(tmp_path):
    """A single cut file has no others. With `recover` or moved away, the rest is read."""
    folder = cut_folder(tmp_path, 6, [1, 3])
    with lc.io.open_recording(folder) as recording, pytest.raises(FormatError) as told:
        list(recording)
    assert str(told.value).startswith(f"{folder}: 2 of 6 files cannot be read: 1.pcd, 3.pcd; ")
    assert f"; the first: {folder / '1.pcd'}: " in str(told.value)
    assert f"convert {folder} recovered.npz --recover" in str(told.value)
    with lc.io.open_recording(folder, recover=True) as recording:
        found = [one for one in recording if isinstance(one, Scan)]
        notes = recording.noticed().notes
    assert [one.points[0, 0] for one in found] == [1, 3, 5, 6]
    assert [one.stamp_ns for one in found] == [0, 200_000_000, 400_000_000, 500_000_000]
    (lost,) = [one for one in notes if "cannot be read" in one]
    assert lost.startswith(f"{folder}: 2 of 6 files cannot be read: 1.pcd, 3.pcd; ")
    assert lost.endswith("; what cannot be read is left out")
    moved = (folder / "1.pcd").rename(tmp_path / "1.pcd")
    (folder / "3.pcd").unlink()
    with lc.io.open_recording(folder) as recording:
        assert sum(isinstance(one, Scan) for one in recording) == 4
    with lc.io.open_recording(moved) as alone, pytest.raises(FormatError) as told:
        list(alone)
    assert "files cannot be read" not in str(told.value)


def cut_folder(place, count, cut, ending=".pcd"):
    """A folder with a scan per file, some of them cut."""
    folder = place / "scans"
    folder.mkdir()
    for number in range(count):
        lc.io.write_cloud(folder / f"{number}{ending}", np.ones((50, 3)) * (number + 1))
    for number in cut:
        file = folder / f"{number}{ending}"
        file.write_bytes(file.read_bytes()[:-300])
    return folder


def numbered(folder, names):
    """Stamps of a folder of clouds with these names [0.1 s], and the note about its times."""
    folder.mkdir()
    for name in names:
        lc.io.write_cloud(folder / f"{name}.pcd", np.ones((3, 3)))
    with lc.io.open_recording(folder) as recording:
        stamps = [scan.stamp_ns / 1e8 for scan in recording]
        (note,) = recording.noticed().notes
    return stamps, note.removeprefix("no times.txt and no times in the names: ")


def test_times_follow_numbers_with_gaps_and_a_note_says_so(tmp_path):
    names = ["run2_000199", "run2_000200", "run2_000202", "run2_000439"]
    stamps, note = numbered(tmp_path / "a", names)
    assert stamps == [0, 1, 3, 240]
    assert note == (
        "10 Hz assumed, scan_rate=RATE states another; 4 files have numbers from 199 to 439: 237"
        " numbers are missing, and the times have these gaps; a file times.txt can state other"
        " times"
    )
    (tmp_path / "a" / "times.txt").write_text("0\n1\n2\n3\n")
    with lc.io.open_recording(tmp_path / "a") as recording:
        assert [scan.stamp_ns / 1e9 for scan in recording] == [0, 1, 2, 3]
        assert recording.noticed().notes == []


def test_a_stated_rate_is_not_told_as_assumed(tmp_path):
    folder = tmp_path / "a"
    assert numbered(folder, ["1", "2", "3"])[1] == "10 Hz assumed, scan_rate=RATE states another"
    with lc.io.open_recording(folder, scan_rate=2.0) as recording:
        assert [scan.stamp_ns / 1e9 for scan in recording] == [0, 0.5, 1]
        assert recording.noticed().notes == []
    (folder / "2.pcd").unlink()
    with lc.io.open_recording(folder, scan_rate=10.0) as recording:
        (note,) = recording.noticed().notes
    assert "in the names: 10 Hz as stated; 2 files have numbers from 1 to 3" in note


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (["7", "8", "9", "10"], ""),
        (["a_10", "b_11", "c_13"], ""),
        (["1", "one", "3"], ""),
        (["000000", "000005", "000010"], "0 to 10: 8 numbers are missing, but the files are count"),
        (["1574859771700", "1574859771801", "1574859771899"], "missing, but the files are count"),
        (["0", "1", "999999999999999999"], "missing, but the files are counted without gaps"),
    ],
    ids=["consecutive", "other names", "no number", "every fifth", "milliseconds", "centuries"],
)
def test_numbers_that_do_not_count_scans_give_no_times(tmp_path, names, told):
    stamps, note = numbered(tmp_path / "a", names)
    assert stamps == list(range(len(names)))
    assert ("files" in note) == bool(told)
    assert told in note


def test_a_folder_of_damaged_files_alone_is_refused_and_not_all_are_named(tmp_path):
    folder = cut_folder(tmp_path, 13, range(13))
    for recover in (False, True):
        with (
            pytest.raises(FormatError) as told,
            lc.io.open_recording(folder, recover=recover) as recording,
        ):
            list(recording)
        assert "13 of 13 files" in str(told.value)
        assert "8.pcd, 9.pcd, 3 more; the first: " in str(told.value)
        assert "--recover" not in str(told.value)


def test_poses_and_times_stay_those_of_their_scans_where_files_are_left_out(tmp_path):
    folder = cut_folder(tmp_path, 4, [0, 2])
    (folder / "times.txt").write_text("1\n2\n3\n4\n")
    lines = (f"1 0 0 {number} 0 1 0 0 0 0 1 0\n" for number in range(4))
    (folder / "poses.txt").write_text("".join(lines))
    with lc.io.open_recording(folder, recover=True) as recording:
        posed = list(posed_scans(recording))
    found = [
        (one.scan.stamp_ns, one.scan.points[0, 0], one.world_from_lidar[0, 3]) for one in posed
    ]
    assert found == [(2 * 10**9, 2, 1), (4 * 10**9, 4, 3)]
