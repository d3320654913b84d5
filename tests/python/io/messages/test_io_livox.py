"""Clouds of Livox' own message, against rosbags' reading of the whole of it."""

import struct
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ros_files import Ros
from rosbags.typesys import get_types_from_msg

import lidar_core as lc
import lidar_core.io
from lidar_core.errors import FormatError, LimitError
from lidar_core.io.messages.livox import livox_cloud
from lidar_core.messages import Scan

BASE_NS = 1_700_000_000_123_456_789
POINT = (
    "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line"
)
CLOUD = (
    "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n"
    "{}/CustomPoint[] points"
)
PACKAGES = ("livox_ros_driver", "livox_ros_driver2")
MD5 = "e4d6829bdfe657cb6c21a746c86b21a6"
"""Of CustomMsg, as headers that genmsg wrote and bags of others have it."""
SEED = 8100


def ros_with_livox(version):
    ros = Ros(version)
    for package in PACKAGES:
        name = f"{package}/msg/CustomMsg"
        if name not in ros.store.fielddefs:
            ros.store.register(get_types_from_msg(POINT, f"{package}/msg/CustomPoint"))
            ros.store.register(get_types_from_msg(CLOUD.format(package), name))
    return ros


def message_of(ros, package, count, *, seed=SEED, frame_id="livox_frame", stamp_ns=BASE_NS):
    rng = np.random.default_rng(seed)
    make = ros.types[f"{package}/msg/CustomPoint"]
    points = [
        make(
            5000 * k,
            *rng.normal(size=3).astype(np.float32).tolist(),
            *rng.integers(0, 256, 2).tolist(),
            k % 4,
        )
        for k in range(count)
    ]
    return ros.types[f"{package}/msg/CustomMsg"](
        ros.header(stamp_ns, frame_id), stamp_ns, count, 3, np.zeros(3, np.uint8), points
    )


def serialised(ros, message):
    write = ros.store.serialize_ros1 if ros.version == 1 else ros.store.serialize_cdr
    return bytes(write(message, message.__msgtype__))


def test_the_definition_of_the_tests_is_that_of_the_package():
    store = ros_with_livox(1).store
    for package in PACKAGES:
        assert store.generate_msgdef(f"{package}/msg/CustomMsg", ros_version=1)[1] == MD5


@given(st.sampled_from([1, 2]), st.integers(0, 5), st.text(max_size=9), st.booleans())
def test_rows_are_those_of_the_library(version, count, frame_id, is_big):
    ros = ros_with_livox(version)
    frame_id = frame_id.replace("\0", "")
    message = message_of(ros, PACKAGES[0], count, frame_id=frame_id)
    raw = serialised(ros, message)
    if version == 2 and is_big:
        raw = bytes(ros.store.serialize_cdr(message, message.__msgtype__, little_endian=False))
    cloud = livox_cloud(raw, version, place="a", max_points=10)
    assert (cloud.stamp_ns, cloud.frame_id) == (BASE_NS, frame_id)
    for name in cloud.rows.dtype.names:
        expected = [getattr(point, name) for point in message.points]
        np.testing.assert_array_equal(cloud.rows[name], expected)


@pytest.mark.parametrize("version", [1, 2])
def test_every_cut_and_every_false_number_is_refused(version):
    ros = ros_with_livox(version)
    raw = serialised(ros, message_of(ros, PACKAGES[1], 3))
    for length in range(len(raw.rstrip(b"\0"))):
        with pytest.raises(FormatError, match=r"^a: "):
            livox_cloud(raw[:length], version, place="a", max_points=10)
    with pytest.raises(LimitError, match=r"a: a scan of points of 3, limit 2; .* max_points"):
        livox_cloud(raw, version, place="a", max_points=2)
    for position in range(len(raw)):
        broken = bytearray(raw)
        broken[position] ^= 0xFF
        with suppress(FormatError, LimitError):
            assert len(livox_cloud(bytes(broken), version, place="a", max_points=10).rows) <= 10


@pytest.mark.parametrize("package", PACKAGES)
@pytest.mark.parametrize(("version", "storage"), [(1, "bag"), (2, "sqlite3"), (2, "mcap")])
def test_recordings_give_scans_with_the_time_of_every_point(tmp_path, version, storage, package):
    ros = ros_with_livox(version)
    path = tmp_path / ("a.bag" if storage == "bag" else "a")
    count, times = 2000, [BASE_NS + k * 10**8 for k in range(3)]
    messages = [
        ("/livox/lidar", t, message_of(ros, package, count, seed=SEED + k, stamp_ns=t))
        for k, t in enumerate(times)
    ]
    ros.write(path, messages, storage)
    with lc.io.open_recording(path) as recording:
        scans = list(recording)
        (topic,) = recording.topics()
        assert topic.kind == "scan"
        assert (
            recording.noticed()
            .point_time["/livox/lidar"]
            .startswith("offset_time:ns:start detected")
        )
    assert [scan.stamp_ns for scan in scans] == times
    for scan, (_, _, message) in zip(scans, messages, strict=True):
        assert isinstance(scan, Scan)
        assert scan.frame_id == "livox_frame"
        np.testing.assert_array_equal(
            scan.points, np.array([(p.x, p.y, p.z) for p in message.points], np.float32)
        )
        np.testing.assert_array_equal(scan.point_time_ns, scan.stamp_ns + 5000 * np.arange(count))
        np.testing.assert_array_equal(scan.ring, np.arange(count) % 4)
        np.testing.assert_array_equal(scan.intensity, [p.reflectivity for p in message.points])


def test_a_message_of_another_type_behind_the_name_is_refused(tmp_path):
    with pytest.raises(FormatError, match="a: not a CustomMsg of Livox"):
        livox_cloud(struct.pack("<IIII", 0, 0, 0, 2**32 - 1), 1, place="a", max_points=10)
