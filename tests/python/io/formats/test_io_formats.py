"""Round trips, broken files and limits of every format that needs no sensor library."""

import errno
import io as bytes_io
import lzma
import os
import shlex
import struct
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer as McapFile
from pydantic import AfterValidator, create_model
from pypcd4 import Encoding, PointCloud
from ros_files import Ros
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from small_messages import BASE_NS, assert_same_fields, make_pose, make_scan

import lidar_core as lc
import lidar_core.io
from lidar_core.errors import ConfigError, FormatError, InputError, LimitError
from lidar_core.io import hints
from lidar_core.io.files.compressed import unpack_zstd, zstd_data
from lidar_core.io.files.guard import reading
from lidar_core.messages import Pose, Scan

CLOUD = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "t"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u4"],
        "offsets": [0, 4, 8, 16, 20],
        "itemsize": 32,
    }
)
CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
STORAGES = [(1, "bag"), (2, "sqlite3"), (2, "mcap")]


def read_all(path, **options):
    with lc.io.open_recording(path, **options) as recording:
        return list(recording)


def outcome(path, errors):
    """Text of the error, or None, and the messages."""
    try:
        return None, read_all(path)
    except errors as error:
        return str(error), []


# --- lidar_core's own npz -------------------------------------------------------------------


def test_npz_round_trip_is_exact(tmp_path):
    pose = make_pose(is_static=True)
    with_covariance = Pose(BASE_NS, "map", "base", np.eye(4), np.eye(6) * 0.1, topic="/odom")
    bare = Scan(BASE_NS + 10, np.ones((3, 3), np.float32), topic="/points")
    written = [pose, with_covariance, make_scan(), bare, make_scan(1, (7,), BASE_NS + 20)]
    lc.io.write_npz(tmp_path / "a.npz", iter(written))
    read = read_all(tmp_path / "a.npz")
    assert len(read) == len(written)
    for before, after in zip(written[2:], read[2:], strict=True):
        assert_same_fields(before, after)
    for before, after in zip(written[:2], read[:2], strict=True):
        np.testing.assert_array_equal(before.matrix, after.matrix)
        assert before.is_static == after.is_static
    assert read[0].covariance is None
    np.testing.assert_array_equal(read[1].covariance, with_covariance.covariance)


def test_npz_opens_with_numpy(tmp_path):
    scan = make_scan()
    lc.io.write_npz(tmp_path / "a.npz", [scan])
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        np.testing.assert_array_equal(archive["scan_000000_points"], scan.points)


def test_a_bare_npz_of_points_is_one_scan(tmp_path):
    np.savez(tmp_path / "bare.npz", points=np.arange(12.0).reshape(4, 3))
    (scan,) = read_all(tmp_path / "bare.npz")
    assert scan.points.dtype == np.float32
    assert scan.points.shape == (4, 3)


def test_a_folder_of_npz_is_one_recording(tmp_path):
    for number in (1, 0, 2):
        scan = make_scan(number, stamp_ns=BASE_NS + number)
        lc.io.write_npz(tmp_path / f"{number}.npz", [scan])
    assert [scan.stamp_ns - BASE_NS for scan in read_all(tmp_path)] == [0, 1, 2]


def test_pickled_arrays_are_never_loaded(tmp_path):
    np.savez(tmp_path / "evil.npz", points=np.array([{"a": 1}], dtype=object))
    with pytest.raises(FormatError, match="array points"):
        read_all(tmp_path / "evil.npz")


def test_an_array_that_claims_more_than_it_holds(tmp_path):
    header = bytes_io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f4", "fortran_order": False, "shape": (2**40, 3)}
    )
    with zipfile.ZipFile(tmp_path / "big.npz", "w") as archive:
        archive.writestr("points.npy", header.getvalue() + bytes(12))
    with pytest.raises(FormatError, match="data has another size"):
        read_all(tmp_path / "big.npz")


def test_a_zip_bomb_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("points.npy", bytes(80 * 2**20))
    with pytest.raises(LimitError, match="max_record_bytes"):
        read_all(tmp_path / "bomb.npz")


def test_arrays_that_do_not_fit_the_points(tmp_path):
    np.savez(tmp_path / "bad.npz", points=np.zeros((4, 3), "f4"), no_return=np.zeros(3, bool))
    with pytest.raises(InputError, match=r"no_return: expected shape \(4,\), got \(3,\)"):
        read_all(tmp_path / "bad.npz")


def test_an_interrupted_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.npz"
    lc.io.write_npz(path, [make_scan()])
    before = path.read_bytes()

    def interrupted():
        yield make_scan(1)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        lc.io.write_npz(path, interrupted())
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["a.npz"]


# --- MCAP with Foxglove messages ------------------------------------------------------------


def test_mcap_round_trip(tmp_path):
    written = [make_pose(1, is_static=True), make_pose(2), make_scan()]
    written += [make_scan(3, (7,), BASE_NS + 10)]
    lc.io.write_mcap(tmp_path / "a.mcap", written)
    read = read_all(tmp_path / "a.mcap")
    assert len(read) == len(written)
    for before, after in zip(written[2:], read[2:], strict=True):
        assert_same_fields(before, after)
    for before, after in zip(written[:2], read[:2], strict=True):
        np.testing.assert_allclose(after.matrix, before.matrix, rtol=0, atol=1e-11)
        assert (after.frame_id, after.child_frame_id) == ("map", "base")
        assert after.is_static == before.is_static


@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.sampled_from([(0,), (1,), (5,), (2, 3), (3, 1)]),
    dropped=st.sets(st.sampled_from(["no_return", "directions", "point_time_ns", "intensity"])),
)
def test_mcap_and_npz_keep_any_scan(tmp_path_factory, seed, shape, dropped):
    full = make_scan(seed, shape)
    values = {name: getattr(full, name) for name in Scan.__slots__ if name not in dropped}
    scan = Scan(**values)
    folder = tmp_path_factory.mktemp("any")
    lc.io.write_mcap(folder / "a.mcap", [scan])
    lc.io.write_npz(folder / "a.npz", [scan])
    for name in ("a.mcap", "a.npz"):
        (read,) = read_all(folder / name)
        assert_same_fields(scan, read)


def written_until(path, scans, error):
    """Write `scans` and then fail with `error`."""
    with lc.io.McapWriter(path, tracks_frame="map") as writer:
        for scan in scans:
            writer.write(scan)
        raise error


def test_ctrl_c_leaves_a_whole_mcap(tmp_path):
    path = tmp_path / "a.mcap"
    with pytest.raises(KeyboardInterrupt):
        written_until(path, [make_scan()], KeyboardInterrupt)
    assert len(read_all(path)) == 1
    with pytest.raises(ZeroDivisionError):
        written_until(path, [make_scan(), make_scan()], ZeroDivisionError)
    assert len(read_all(path)) == 1
    assert [file.name for file in tmp_path.iterdir()] == ["a.mcap"]


@pytest.mark.parametrize(
    ("scan", "text"),
    [
        (Scan(-1, np.zeros((1, 3), np.float32)), "no negative times"),
        (
            Scan(0, np.zeros((1, 3), np.float32), point_time_ns=np.array([3 * 10**9])),
            "within 2.1 s",
        ),
    ],
)
def test_mcap_refuses_times_it_cannot_hold(tmp_path, scan, text):
    with pytest.raises(InputError, match=text):
        lc.io.write_mcap(tmp_path / "a.mcap", [scan])
    assert not (tmp_path / "a.mcap").exists()


# --- ROS containers -------------------------------------------------------------------------


def ros_messages(ros, count=5):
    rows = np.zeros((2, 8), CLOUD)
    rows["x"] = np.arange(1, 17).reshape(2, 8)
    rows["t"] = np.arange(16).reshape(2, 8) * 6_000_000
    rows[1, 3] = 0
    for number in range(count):
        stamp_ns = BASE_NS + number * 10**8
        yield "/points", stamp_ns, ros.cloud(rows, stamp_ns, "/os")
        pose = [float(number), 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
        yield "/tf", stamp_ns, ros.transforms([(stamp_ns, "map", "os", pose)])


def ros_file(tmp_path, version, storage, count=5):
    ros = Ros(version)
    path = tmp_path / ("a.bag" if storage == "bag" else "a")
    ros.write(path, ros_messages(ros, count), storage)
    if storage == "bag":
        return path
    return next(path.glob("*.db3" if storage == "sqlite3" else "*.mcap"))


@pytest.mark.parametrize(("version", "storage"), STORAGES)
def test_ros_clouds_and_transforms(tmp_path, version, storage):
    messages = read_all(ros_file(tmp_path, version, storage))
    scans = [message for message in messages if isinstance(message, Scan)]
    poses = [message for message in messages if isinstance(message, Pose)]
    assert (len(scans), len(poses)) == (5, 5)
    for number, scan in enumerate(scans):
        stamp_ns = BASE_NS + number * 10**8
        assert (scan.stamp_ns, scan.frame_id, scan.topic) == (stamp_ns, "os", "/points")
        assert scan.points.shape == (2, 8, 3)
        np.testing.assert_array_equal(np.flatnonzero(scan.no_return), [11])
        expected = stamp_ns + np.where(np.arange(16) == 11, 0, np.arange(16)) * 6_000_000
        np.testing.assert_array_equal(scan.point_time_ns, expected)
        assert poses[number].matrix[0, 3] == number


@pytest.mark.ci_cases("1-bag", "2-mcap")
@pytest.mark.parametrize(("version", "storage"), STORAGES)
def test_truncated_ros_recordings_are_refused_or_read_up_to_the_cut(tmp_path, version, storage):
    path = ros_file(tmp_path, version, storage)
    data = path.read_bytes()
    whole = read_all(path)
    assert len(whole) == 10
    refused = 0
    cut = tmp_path / f"cut{path.suffix}"
    for length in range(1, len(data), max(1, len(data) // 20)):
        cut.write_bytes(data[:length])
        text, messages = outcome(cut, FormatError)
        assert text is None or str(cut) in text
        refused += text is not None
        assert len(messages) <= len(whole)
    assert refused > 15


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.bag", "not a ROS 1 bag: it begins with b'hello hel'"),
        ("a.db3", "not an SQLite database: it begins with b'hello hello hell'"),
        ("a.mcap", "not an MCAP file: it begins with b'hello he'"),
        ("a.pcd", "not a PCD file: it begins with b'hello he'"),
    ],
)
def test_a_file_that_is_not_what_its_name_says_is_told_by_its_first_bytes(tmp_path, name, text):
    path = tmp_path / name
    path.write_bytes(b"hello " * 3000)
    with pytest.raises(FormatError) as told:
        read_all(path)
    assert str(told.value) == f"{path}: {text}"


def contents_of(folder):
    """A small file of each format, by its ending."""
    lc.io.write_recording(folder / "whole.npz", [make_scan()])
    with (folder / "whole.mcap").open("wb") as stream:
        writer = McapFile(stream)
        writer.start()
        writer.finish()
    return {
        ".npz": (folder / "whole.npz").read_bytes(),
        ".mcap": (folder / "whole.mcap").read_bytes(),
        ".bag": ros_file(folder, 1, "bag", 1).read_bytes(),
        ".pcap": b"\xd4\xc3\xb2\xa1" + bytes(40),
        ".zst": zstandard.ZstdCompressor().compress(b"a scan"),
        ".zip": b"PK\x03\x04" + bytes(26) + b"scans.csv",
    }


def test_a_file_with_the_ending_of_another_format_is_told_its_own(tmp_path):
    contents = contents_of(tmp_path)
    for ending in (".mcap", ".bag", ".db3", ".pcd", ".pcap", ".npz", ".unknown"):
        for real, data in contents.items():
            path = tmp_path / f"wrong{ending}"
            path.write_bytes(data)
            text, _ = outcome(path, FormatError)
            if real == ending or (real, ending) == (".zip", ".npz"):  # an .npz is a zip, too
                assert text is None or "its content" not in text
                continue
            assert f"; its content looks like {real}: give the file this ending" in text
            right = tmp_path / f"right{real}"
            path.rename(right)
            text, _ = outcome(right, FormatError)
            assert text is None or "its content" not in text


def test_a_header_that_lacks_lines_or_holds_nonsense_is_told_in_one_line(tmp_path):
    path = tmp_path / "a.pcd"
    known = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\n"
    path.write_text(known)
    with pytest.raises(FormatError, match=r"a\.pcd: the header has no POINTS, DATA line"):
        read_all(path)
    path.write_text(known.replace("F F F", "F F Q") + "POINTS 1\nDATA ascii\n1 2 3\n")
    with pytest.raises(FormatError, match=r"ValidationError: type\.2: Input should be") as told:
        read_all(path)
    assert "\n" not in str(told.value)
    assert "pydantic.dev" not in str(told.value)


def test_a_refused_value_of_a_header_is_told_without_words_of_libraries():
    def refuse(value):
        raise ValueError(f"expected a width, got {value}")

    header = create_model("Header", width=Annotated[int, AfterValidator(refuse)])
    with (
        pytest.raises(FormatError, match=r"ValidationError: width: expected a width, got -1$"),
        reading("a.pcd"),
    ):
        header(width=-1)


def test_a_bag_without_its_index_names_the_command_that_makes_one(tmp_path):
    path = ros_file(tmp_path, 1, "bag")
    cut = tmp_path / "cut.bag"
    cut.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(FormatError) as told:
        read_all(cut)
    assert str(told.value) == (
        f"{cut}: the index at the end of the bag is missing or damaged: the bag was not closed,"
        f" or was cut; a new index: rosbag reindex {cut}"
    )
    assert len(read_all(path)) == 10


@pytest.mark.ci_cases("2-mcap")
@pytest.mark.parametrize(("version", "storage"), STORAGES)
def test_flipped_bytes_never_raise_anything_else(tmp_path, version, storage):
    path = ros_file(tmp_path, version, storage, count=2)
    data = path.read_bytes()
    rng = np.random.default_rng(7)
    broken = tmp_path / f"broken{path.suffix}"
    for position in rng.integers(0, len(data), 12):
        value = rng.integers(0, 256)
        broken.write_bytes(data[:position] + bytes([value]) + data[position + 1 :])
        text, _ = outcome(broken, (FormatError, LimitError))
        assert text is None or str(broken) in text


def test_a_large_message_names_the_option(tmp_path):
    for version, storage in STORAGES:
        folder = tmp_path / storage
        folder.mkdir()
        path = ros_file(folder, version, storage)
        with pytest.raises(LimitError, match="raise it with max_record_bytes"):
            read_all(path, max_record_bytes=400)


def test_metadata_without_serialisation_format_does_not_matter(tmp_path):
    path = ros_file(tmp_path, 2, "sqlite3")
    metadata = path.parent / "metadata.yaml"
    metadata.write_text(
        metadata.read_text().replace("serialization_format: cdr", 'serialization_format: ""')
    )
    assert len(read_all(path.parent)) == 10
    metadata.unlink()
    assert len(read_all(path.parent)) == 10


@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_messages_that_ros2_compressed_are_read(tmp_path, storage):
    ros = Ros(2)
    path = tmp_path / "a"
    writer = Writer2(path, version=9, storage_plugin=storage)
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/points", CLOUD_TYPE, typestore=ros.store)
        message = ros.cloud(np.zeros(1000, CLOUD), BASE_NS, "os")
        writer.write(connection, BASE_NS, ros.store.serialize_cdr(message, CLOUD_TYPE))
    (scan,) = read_all(path)
    assert (scan.stamp_ns, scan.points.shape, scan.frame_id) == (BASE_NS, (1000, 3), "os")
    with pytest.raises(LimitError, match=r"decompresses to more than 4000 bytes; .*max_record_by"):
        read_all(path, max_record_bytes=4000)


@pytest.mark.parametrize(("name", "cure"), [("a.bag.zstd", "unzstd"), ("a.bag.gz", "gunzip -k")])
def test_files_that_are_compressed_say_how_to_unpack(tmp_path, name, cure):
    (tmp_path / name).write_bytes(b"x")
    with pytest.raises(FormatError, match=f"compressed; unpack it first: {cure} FILE"):
        lc.io.open_recording(tmp_path / name)


def split_and_packed(folder, storage, *, checksum=False):
    """Two parts of a recording, each compressed as a file; the folder, and the scans."""
    ros, ending = Ros(2), {"sqlite3": "db3", "mcap": "mcap"}[storage]
    folder.mkdir()
    for part in range(2):
        plain = folder.parent / f"plain_{part}"
        stamps = [BASE_NS + (2 * part + k) * 10**8 for k in range(2)]
        ros.write(
            plain,
            [("/points", s, ros.cloud(np.zeros(900, CLOUD), s, "os")) for s in stamps],
            storage,
        )
        (file,) = plain.glob(f"*.{ending}")
        packed = zstandard.ZstdCompressor(write_checksum=checksum).compress(file.read_bytes())
        (folder / f"b_{part}.{ending}.zstd").write_bytes(packed)
    (folder / "metadata.yaml").write_text("compression_mode: FILE\n")
    return folder


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_files_that_ros2_compressed_are_read(tmp_path, storage, monkeypatch):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    folder = split_and_packed(tmp_path / "b", storage, checksum=storage == "mcap")
    with lc.io.open_recording(folder) as recording:
        scans = list(recording)
        assert [topic.count for topic in recording.topics()] == [4]
        assert recording.format.endswith(", unpacked")
        assert len(list(temporary.iterdir())) == 1
    assert [scan.stamp_ns for scan in scans] == [BASE_NS + k * 10**8 for k in range(4)]
    assert not list(temporary.iterdir())
    (first, _) = sorted(folder.glob("*.zstd"))
    assert len(read_all(first)) == 2
    with pytest.raises(LimitError, match=r"unpacks to more than 9000 bytes; .*max_unpacked_bytes"):
        lc.io.open_recording(folder, max_unpacked_bytes=9000)
    assert not list(temporary.iterdir())


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is full")
def test_a_full_disk_names_the_cure(tmp_path):
    source = tmp_path / "b_0.db3.zstd"
    source.write_bytes(zstandard.ZstdCompressor().compress(bytes(10**6)))
    with pytest.raises(
        OSError, match=r"TMPDIR names another folder to unpack .*b_0\.db3"
    ) as caught:
        unpack_zstd(source, Path("/dev/full"), 10**7)
    assert caught.value.errno == errno.ENOSPC


def test_a_packed_file_that_was_cut_is_told_as_cut(tmp_path):
    folder = split_and_packed(tmp_path / "b", "sqlite3", checksum=True)
    file = min(folder.glob("*.zstd"))
    whole = file.read_bytes()
    for kept in (len(whole) - 1, len(whole) - 5, len(whole) // 2, 14):
        file.write_bytes(whole[:kept])
        with pytest.raises(FormatError, match=r"b_0\.db3\.zstd: compressed data ends early"):
            lc.io.open_recording(folder)
    for broken in (b"x", whole[:3], b"x" * 100):
        file.write_bytes(broken)
        with pytest.raises(FormatError, match=r"b_0\.db3\.zstd: cannot be read"):
            lc.io.open_recording(folder)


@pytest.mark.parametrize("checksum", [False, True])
@pytest.mark.parametrize("size", [0, 1, 1000, 300_000])
def test_a_frame_is_whole_or_told_as_cut(checksum, size):
    rng = np.random.default_rng(size)
    for data in (bytes(size), rng.bytes(size), b"a scan, " * (size // 8)):
        frame = zstandard.ZstdCompressor(write_checksum=checksum).compress(data)
        assert zstd_data(frame, "a", 10**6) == data
        streamed = zstandard.ZstdCompressor(write_checksum=checksum).compressobj()
        unsized = streamed.compress(data) + streamed.flush()
        assert zstd_data(unsized, "a", 10**6) == data
        for kept in {len(frame) - 1, len(frame) * 2 // 3, 9} - {len(frame)}:
            with pytest.raises(FormatError, match=r"ends early|cannot be read"):
                zstd_data(frame[:kept], "a", 10**6)
        with pytest.raises(FormatError, match="a: compressed in several pieces; unpack it first"):
            zstd_data(frame + frame, "a", 10**6)


def test_a_compressed_message_that_was_cut_is_told_as_cut(tmp_path):
    ros = Ros(2)
    message = ros.cloud(np.zeros(1000, CLOUD), BASE_NS, "os")
    packed = zstandard.ZstdCompressor().compress(
        bytes(ros.store.serialize_cdr(message, CLOUD_TYPE))
    )
    with Writer2(tmp_path / "a", version=9) as writer:
        connection = writer.add_connection("/points", CLOUD_TYPE, typestore=ros.store)
        writer.write(connection, BASE_NS, packed[:-4])
    with pytest.raises(FormatError, match=r"message 0 on /points: compressed data ends early"):
        read_all(tmp_path / "a")


def test_a_name_that_is_nearly_right_is_told(tmp_path):
    (tmp_path / "flight_2.bag").write_bytes(b"x")
    with pytest.raises(FileNotFoundError, match=r"flihgt_2\.bag: no such .*mean flight_2\.bag\?"):
        lc.io.open_recording(tmp_path / "flihgt_2.bag")
    with pytest.raises(FileNotFoundError, match=r"no such file or folder$"):
        lc.io.open_recording(tmp_path / "nowhere" / "flight_2.bag")


def test_a_topic_that_is_nearly_right_is_told(tmp_path):
    path = tmp_path / "a.npz"
    lc.io.write_recording(path, [make_scan()])
    with (
        lc.io.open_recording(path) as recording,
        pytest.raises(ConfigError, match=r"found /points; did you mean /points\?$"),
    ):
        lc.io.posed_scans(recording, cloud="/point")


def test_scans_of_the_other_sort_name_their_command(tmp_path):
    path = tmp_path / "a.npz"
    lc.io.write_recording(path, [make_scan()])
    with (
        lc.io.open_recording(path) as recording,
        pytest.raises(FormatError, match=r"no 2D scans .*; clouds are for `lidar-core detect`"),
    ):
        lc.io.posed_laser_scans(recording)


def test_a_folder_of_folders_names_those_with_recordings(tmp_path):
    with pytest.raises(FormatError, match=r"no recording in this folder, found no files; readable"):
        lc.io.open_recording(tmp_path)
    for name in ("ouster/a.pcap", "hesai/days/1/b.bag", "packed/c.tar.xz", "pictures/d.png"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_bytes(b"x")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FormatError, match=r"name one of the folders in it: hesai, ouster, packed$"):
        lc.io.open_recording(tmp_path)


def test_a_folder_of_archives_says_how_they_are_unpacked(tmp_path):
    """Archives come first: they may hold the scans, and the other folders hold none."""
    place = tmp_path / "a day"
    (place / "pictures").mkdir(parents=True)
    (place / "pictures" / "1.png").write_bytes(b"x")
    for name in ("01.npz.xz", "notes.txt"):
        (place / name).write_bytes(b"x")
    lc.io.write_recording(tmp_path / "c0.npz", [make_scan()])
    packing = ["tar", "cf", place / "scans.tar", "c0.npz"]
    subprocess.run(packing, cwd=tmp_path, check=True, timeout=60)
    with zipfile.ZipFile(place / "more.zip", "w") as archive:
        archive.write(tmp_path / "c0.npz", "c1.npz")
    with pytest.raises(FormatError) as told:
        lc.io.open_recording(place)
    commands = str(told.value).partition("; unpack first: ")[2].split("; ")
    assert commands == [
        f"unzip '{place}/more.zip' -d '{place}'",
        f"tar xf '{place}/scans.tar' -C '{place}'",
        f"unxz -k '{place}/01.npz.xz'",
    ]
    subprocess.run(shlex.split(commands[1]), check=True, timeout=60)
    with lc.io.open_recording(place) as recording:
        assert [topic.count for topic in recording.topics()] == [1]


def test_archives_in_a_folder_that_must_not_be_written_are_unpacked_here(tmp_path, monkeypatch):
    place, here = tmp_path / "mounted", tmp_path / "here"
    for folder in (place, here):
        folder.mkdir()
    lc.io.write_recording(tmp_path / "c0.npz", [make_scan()])
    packing = ["tar", "cJf", place / "scans.tar.xz", "c0.npz"]
    subprocess.run(packing, cwd=tmp_path, check=True, timeout=60)
    with lzma.open(place / "c1.npz.xz", "wb") as packed:
        packed.write((tmp_path / "c0.npz").read_bytes())
    access = SimpleNamespace(W_OK=os.W_OK, access=lambda path, mode: Path(path) != place)
    monkeypatch.setattr(hints, "os", access)
    with pytest.raises(FormatError) as told:
        lc.io.open_recording(place)
    commands = str(told.value).partition("; unpack first: ")[2].split("; ")
    assert commands == [f"tar xf {place}/scans.tar.xz", f"unxz -c {place}/c1.npz.xz > c1.npz"]
    for command in commands:
        subprocess.run(command, shell=True, cwd=here, check=True, timeout=60)
    assert sorted(one.name for one in here.iterdir()) == ["c0.npz", "c1.npz"]
    with lc.io.open_recording(here / "c1.npz") as recording:
        assert [topic.count for topic in recording.topics()] == [1]


def test_a_folder_of_many_packed_files_names_a_few(tmp_path):
    for number in range(9):
        (tmp_path / f"{number}.pcd.gz").write_bytes(b"x")
    with pytest.raises(FormatError, match=r"gunzip -k [^;]*0\.pcd\.gz; .*3\.pcd\.gz; 5 more$"):
        lc.io.open_recording(tmp_path)


def test_a_folder_of_several_kinds_asks_for_one(tmp_path):
    for name in ("a.pcap", "b.pcap", "map.ply", "notes.txt"):
        (tmp_path / name).write_bytes(b"x")
    with pytest.raises(FormatError) as refusal:
        lc.io.open_recording(tmp_path)
    assert str(refusal.value) == (
        f"{tmp_path}: several kinds of recordings in this folder: 1 of .ply, 2 of .pcap or .pcapng;"
        " name one file, or a folder with one kind"
    )
    (tmp_path / "map.ply").unlink()
    with pytest.raises(FormatError, match=r"several recordings .* name one of a\.pcap, b\.pcap"):
        lc.io.open_recording(tmp_path)


def test_an_unset_quaternion_is_counted_not_used(tmp_path):
    ros = Ros(2)
    messages = list(ros_messages(ros, 2))
    messages.append(("/odom", BASE_NS, ros.odometry(BASE_NS, "map", "base", [0.0] * 7)))
    path = ros.write(tmp_path / "a", messages, "sqlite3")
    with lc.io.open_recording(path) as recording:
        info = recording.info()
    assert "/odom: 1 messages rejected" in info.defects
    assert any("is not a rotation" in defect for defect in info.defects)


def test_definitions_in_a_file_are_not_compiled(tmp_path, monkeypatch):
    """rosbags turns definitions into code; ours come from its own stores alone."""
    from rosbags.typesys.store import Typestore

    path = ros_file(tmp_path, 2, "mcap")
    assert len(read_all(path)) == 10
    monkeypatch.setattr(Typestore, "register", lambda *_: pytest.fail("a file chose code"))
    assert len(read_all(path)) == 10


# --- hostile MCAP ---------------------------------------------------------------------------


def test_mcap_chunks_that_lie_about_their_size(tmp_path):
    path = ros_file(tmp_path, 2, "mcap")
    data = bytearray(path.read_bytes())
    position = data.index(b"\x06", 8)  # the chunk's opcode follows the header record
    while struct.unpack_from("<Q", data, position + 1)[0] > len(data):
        position = data.index(b"\x06", position + 1)
    struct.pack_into("<Q", data, position + 9 + 16, 2**62)
    path.write_bytes(data)
    with pytest.raises((LimitError, FormatError), match=r"a\.mcap"):
        read_all(path)


def test_an_mcap_bomb_is_refused(tmp_path):
    """32 MiB of zeros per message, eight to a chunk: small on disk, large in memory."""
    path = tmp_path / "bomb.mcap"
    with path.open("wb") as stream:
        writer = McapFile(stream, chunk_size=2**31)
        writer.start()
        schema = writer.register_schema("sensor_msgs/msg/PointCloud2", "ros2msg", b"")
        channel = writer.register_channel("/points", "cdr", schema)
        for number in range(8):
            writer.add_message(channel, number, bytes(32 * 2**20), number)
        writer.finish()
    assert path.stat().st_size < 2**20
    with pytest.raises(LimitError, match=r"bomb\.mcap, chunk at byte .* max_record_bytes"):
        read_all(path)


def test_mcap_with_wrong_checksum(tmp_path):
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = McapFile(stream, compression=__import__("mcap.writer").writer.CompressionType.NONE)
        writer.start()
        schema = writer.register_schema("sensor_msgs/msg/PointCloud2", "ros2msg", b"")
        channel = writer.register_channel("/points", "cdr", schema)
        writer.add_message(channel, 0, b"abcdefgh" * 8, 0)
        writer.finish()
    path.write_bytes(path.read_bytes().replace(b"abcdefgh", b"abcdefgX", 1))
    with pytest.raises(FormatError, match="crc"):
        read_all(path)


# --- PCD, KITTI, pcap -----------------------------------------------------------------------


@pytest.mark.parametrize("encoding", list(Encoding)[:3])
def test_pcd_round_trip(tmp_path, encoding):
    rows = np.random.default_rng(0).normal(size=(500, 4)).astype(np.float32)
    PointCloud.from_xyzi_points(rows).save(tmp_path / "1700000000123456789.pcd", encoding=encoding)
    (scan,) = read_all(tmp_path / "1700000000123456789.pcd")
    assert scan.stamp_ns == 1700000000123456789
    if encoding is Encoding.ASCII:
        np.testing.assert_allclose(scan.points, rows[:, :3], rtol=1e-6)
    else:
        np.testing.assert_array_equal(scan.points, rows[:, :3])
        np.testing.assert_array_equal(scan.intensity, rows[:, 3])


@pytest.mark.parametrize("encoding", list(Encoding)[:3])
def test_truncated_pcd_is_refused(tmp_path, encoding):
    rows = np.random.default_rng(0).normal(size=(50, 4)).astype(np.float32)
    path = tmp_path / "0.pcd"
    PointCloud.from_xyzi_points(rows).save(path, encoding=encoding)
    data = path.read_bytes()
    for length in range(1, len(data) - 30, 23):
        path.write_bytes(data[:length])
        with pytest.raises(FormatError, match=r"0\.pcd"):
            read_all(path)


def pcd_header(**changes):
    lines = {
        "VERSION": "0.7",
        "FIELDS": "x y z",
        "SIZE": "4 4 4",
        "TYPE": "F F F",
        "COUNT": "1 1 1",
        "WIDTH": "2",
        "HEIGHT": "1",
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": "2",
        "DATA": "binary",
    }
    return "".join(f"{k} {v}\n" for k, v in (lines | changes).items()).encode() + bytes(24)


@pytest.mark.parametrize(
    ("changes", "error", "text"),
    [
        ({"POINTS": "4000000001", "WIDTH": "4000000001"}, LimitError, "max_points"),
        ({"POINTS": "3", "WIDTH": "3"}, FormatError, "24 bytes of points, the header states 36"),
        ({"HEIGHT": "2"}, FormatError, "width 2 x height 2 is not 2 points"),
        ({"SIZE": "4 4 3"}, FormatError, "cannot be read"),
        ({"FIELDS": "x y"}, FormatError, "0.pcd"),
        ({"COUNT": "1 1 1000000000"}, FormatError, "0.pcd"),
        ({"DATA": "zip"}, FormatError, "cannot be read"),
        ({"WIDTH": "two"}, FormatError, "cannot be read"),
    ],
)
def test_broken_pcd_headers(tmp_path, changes, error, text):
    path = tmp_path / "0.pcd"
    path.write_bytes(pcd_header(**changes))
    with pytest.raises(error, match=text):
        read_all(path)


def test_organised_pcd_keeps_its_shape(tmp_path):
    path = tmp_path / "0.pcd"
    path.write_bytes(pcd_header(WIDTH="1", HEIGHT="2"))
    (scan,) = read_all(path)
    assert scan.points.shape == (2, 1, 3)
    assert scan.no_return.all()


def kitti_folder(tmp_path, *, calibrated):
    (tmp_path / "velodyne").mkdir()
    for number in range(3):
        rows = np.random.default_rng(number).normal(size=(10 + number, 4)).astype("<f4")
        rows.tofile(tmp_path / "velodyne" / f"{number:06d}.bin")
    np.savetxt(tmp_path / "times.txt", [0.0, 0.1037, 0.2075], fmt="%e")
    poses = np.tile(np.eye(4)[:3].reshape(-1), (3, 1))
    poses[:, 11] = [0, 1, 2]  # the camera looks along its z
    np.savetxt(tmp_path / "poses.txt", poses)
    if calibrated:
        turn = "0 -1 0 0.1 0 0 -1 0.2 1 0 0 0.3"  # camera_from_lidar: x forward to z forward
        (tmp_path / "calib.txt").write_text(f"P0: {'0 ' * 12}\nTr: {turn}\n")
    return tmp_path


def test_kitti_folder_with_calibration(tmp_path):
    with lc.io.open_recording(kitti_folder(tmp_path, calibrated=True)) as recording:
        posed = list(lc.io.posed_scans(recording))
    assert [len(item.scan.points) for item in posed] == [10, 11, 12]
    assert [item.scan.stamp_ns for item in posed] == [0, 103_700_000, 207_500_000]
    for number, item in enumerate(posed):
        expected = np.eye(4)
        expected[0, 3] = number  # forward is x in the LiDAR's frame
        np.testing.assert_allclose(item.world_from_lidar, expected, atol=1e-12)


@pytest.mark.parametrize("row", ["0 0 0 0", "2 0 0 0", "nan 0 0 0", "1e200 0 0 0"])
def test_a_calibration_that_is_no_rotation_is_refused(tmp_path, row):
    folder = kitti_folder(tmp_path, calibrated=True)
    (folder / "calib.txt").write_text(f"Tr: 1 0 0 0 {row} 0 0 1 0\n")
    with (
        pytest.raises(FormatError, match=r"calib\.txt, line Tr: camera_from_lidar: expected a"),
        lc.io.open_recording(folder),
    ):
        pass


def test_kitti_without_calibration_takes_the_poses_as_they_are(tmp_path):
    with lc.io.open_recording(kitti_folder(tmp_path, calibrated=False)) as recording:
        posed = list(lc.io.posed_scans(recording))
    assert [item.world_from_lidar[2, 3] for item in posed] == [0, 1, 2]


def test_kitti_file_of_another_layout(tmp_path):
    np.zeros(35, "<f4").tofile(tmp_path / "0.bin")
    with pytest.raises(FormatError, match="140 bytes are not a multiple of 16"):
        read_all(tmp_path / "0.bin")


def test_wrong_number_of_poses_or_times(tmp_path):
    folder = kitti_folder(tmp_path, calibrated=False)
    (folder / "times.txt").write_text("0\n1\n")
    with pytest.raises(FormatError, match=r"times\.txt: 2 lines for 3 scans"):
        read_all(folder)


def test_a_velodyne_capture_that_was_killed_is_read_to_its_last_whole_packet(tmp_path, recordings):
    data = (recordings / "3d/velodyne_mrpt/sample_velodyne_hdl32.pcap").read_bytes()
    path = tmp_path / "cut.pcap"
    for length in (10, 30, 1000):  # no packet is whole
        path.write_bytes(data[:length])
        with pytest.raises(FormatError, match=r"cut\.pcap"):
            read_all(path)
    sizes = []
    for length in (len(data), len(data) - 1, len(data) - 1248, len(data) - 1248 - 15):
        path.write_bytes(data[:length])
        with lc.io.open_recording(path) as recording:
            sizes.append(sum(isinstance(one, Scan) for one in recording))
            told = [one for one in recording.noticed().notes if "cut inside" in one]
        assert len(told) == (length not in (len(data), len(data) - 1264)), told
    assert min(sizes) >= max(sizes) - 1 > 0


def test_a_damaged_packet_in_the_middle_of_a_capture_is_refused(tmp_path, recordings):
    data = bytearray((recordings / "3d/velodyne_mrpt/sample_velodyne_hdl32.pcap").read_bytes())
    path = tmp_path / "bad.pcap"
    at = 24 + 1264 * (len(data) // 1264 - 20)
    for captured in (1_000_000, 200_000, 999):  # too large, beyond the end, beside the next packet
        struct.pack_into("<I", data, at + 8, captured)
        path.write_bytes(data)
        with pytest.raises(FormatError, match=r"bad\.pcap, byte \d+: a packet of"):
            lc.io.open_recording(path)


def test_captures_of_other_packets_are_refused_with_a_cure(tmp_path):
    header = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)
    path = tmp_path / "web.pcap"
    path.write_bytes(header + struct.pack("<IIII", 0, 0, 60, 60) + bytes(60))
    with pytest.raises(FormatError, match=r"not Velodyne's; for Ouster, put its \.json"):
        lc.io.open_recording(path)
    path.write_bytes(header + struct.pack("<IIII", 0, 0, 0xFFFFFFFF, 60))
    with pytest.raises(FormatError, match="byte 24: a packet of 4294967295 bytes"):
        lc.io.open_recording(path)
    path.write_bytes(b"\x0a\x0d\x0d\x0a" + bytes(40))
    with pytest.raises(FormatError, match="byte 0: not a block of pcapng"):
        lc.io.open_recording(path)


# --- anything else --------------------------------------------------------------------------


def test_a_folder_with_one_recording_is_that_recording(tmp_path):
    bag = ros_file(tmp_path, 1, "bag")
    (tmp_path / "LICENSE").write_text("as you like")
    assert len(read_all(tmp_path)) == len(read_all(bag)) == 10
    bag.with_name("b.bag").write_bytes(bag.read_bytes())
    with pytest.raises(FormatError, match=r"several recordings in this folder; name one of a\.bag"):
        read_all(tmp_path)


def test_missing_empty_and_unknown_paths(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such file or folder"):
        lc.io.open_recording(tmp_path / "nothing.bag")
    (tmp_path / "empty.bag").touch()
    with pytest.raises(FormatError, match="the file is empty"):
        lc.io.open_recording(tmp_path / "empty.bag")
    (tmp_path / "sub").mkdir()
    with pytest.raises(FormatError, match="no recording in this folder, found no files"):
        lc.io.open_recording(tmp_path / "sub")


@pytest.mark.parametrize("suffix", ["bag", "db3", "mcap", "npz", "pcap", "pcd", "bin"])
def test_noise_is_refused_in_every_format(tmp_path, suffix):
    path = tmp_path / f"noise.{suffix}"
    path.write_bytes(np.random.default_rng(3).bytes(4097))
    with pytest.raises(FormatError, match="noise"):
        read_all(path)


def test_bz2_bombs_in_bags_are_refused(tmp_path):
    """A bag's chunk may decompress a millionfold."""
    import bz2

    from lidar_core.io.formats.ros import bounded_decompressor

    bomb = bz2.compress(bytes(80 * 2**20))
    with pytest.raises(LimitError, match=r"chunk 1: \d+ compressed bytes become more than 1000"):
        bounded_decompressor(bz2.decompress, "chunk 1", 64 * 2**20)(bomb)
    noise = bz2.compress(np.random.default_rng(0).bytes(2 * 2**20))
    with pytest.raises(LimitError, match="chunk 1: decompresses to more than 1048576 bytes"):
        bounded_decompressor(bz2.decompress, "chunk 1", 2**20)(noise)
    assert bounded_decompressor(bz2.decompress, "chunk 1", 9)(bz2.compress(b"12345")) == b"12345"
    with pytest.raises(FormatError, match="ends early"):
        bounded_decompressor(bz2.decompress, "chunk 1", 9)(bz2.compress(b"12345")[:-4])
    lz4 = pytest.importorskip("lz4.frame")
    packed = lz4.compress(bytes(10**6))
    with pytest.raises(LimitError):
        bounded_decompressor(lz4.decompress, "chunk 1", 10**5)(packed)
    assert bounded_decompressor(lz4.decompress, "chunk 1", 10**6)(packed) == bytes(10**6)


FULL_DISK = """
import resource, sys
import numpy as np
import lidar_core.io as io
from lidar_core.messages import Scan

points = np.random.default_rng(0).random((30_000, 3), np.float32)  # noise is not compressed
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    io.write_mcap(sys.argv[1], (Scan(k, points) for k in range(8)))
except OSError as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no limits on files")
def test_a_full_disk_is_named_and_leaves_no_mcap(tmp_path):
    command = [sys.executable, "-c", FULL_DISK, str(tmp_path / "a.mcap")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert "cannot be written: " in done.stdout
    assert str(tmp_path / "a.mcap") in done.stdout
    assert not list(tmp_path.iterdir())
