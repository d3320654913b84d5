"""Made packets of Ouster sensors: order, loss, several sensors, files that do not fit."""

import json
import struct
from itertools import pairwise

import numpy as np
import pytest
from ros_files import Ros
from rosbags.typesys import get_types_from_msg
from udp_captures import capture, ethernet, ipv4, udp

import lidar_core.io as lc_io
from lidar_core.errors import FormatError, LimitError
from lidar_core.io.ouster.packets import FrameCollector, PacketLayout
from lidar_core.io.ouster.sensor import parse_sensor
from lidar_core.messages import Pose, Scan

ROWS, COLUMNS, IN_PACKET = 4, 64, 16
PROFILE = "RNG15_RFL8_NIR8"
BEGIN_NS = 1_700_000_000_000_000_000


def metadata(**values):
    return {
        "beam_altitude_angles": [10.0, 5.0, 0.0, -5.0],
        "beam_azimuth_angles": [1.0, 0.5, 0.0, -0.5],
        "prod_line": "OS-0-4",
        "prod_sn": "122",
        "udp_port_lidar": 7502,
        "lidar_mode": "1024x10",
        "data_format": {
            "columns_per_frame": COLUMNS,
            "columns_per_packet": IN_PACKET,
            "pixels_per_column": ROWS,
            "pixel_shift_by_row": [2, 1, 0, 0],
            "udp_profile_lidar": PROFILE,
            "column_window": [0, COLUMNS - 1],
        },
        **values,
    }


def sensor(**values):
    return parse_sensor(json.dumps(metadata(**values)), "a.json", max_points=10**6)


def packet(frame, first, *, serial=122, metres=2, valid=True):
    """One packet; its pixels measure as many metres, rounded to the 8 mm of the profile."""
    head = struct.pack("<HH", 1, frame % 2**16) + bytes(3) + serial.to_bytes(5, "little")
    column_data = struct.pack("<I", metres * 125 | 9 << 16) * ROWS
    data = head.ljust(32, b"\0")
    for column in range(first, first + IN_PACKET):
        stamp = BEGIN_NS + (frame * COLUMNS + column) * 1_000_000
        data += struct.pack("<QHH", stamp, column, int(valid)) + column_data
    return data + bytes(32)


def packets(frame, **values):
    return [packet(frame, first, **values) for first in range(0, COLUMNS, IN_PACKET)]


def ros_with_packets(version):
    files = Ros(version)
    for package in ("ouster_ros", "ouster_sensor_msgs"):
        name = f"{package}/msg/PacketMsg"
        if name not in files.store.fielddefs:
            files.store.register(get_types_from_msg("uint8[] buf", name))
    return files


def frames_of(stream, **values):
    collector = FrameCollector(PacketLayout(sensor(**values), "a"))
    frames = [frame for one in stream for frame in collector.add(one)]
    return frames + collector.rest(), collector.late


def test_a_frame_is_there_with_its_last_packet():
    collector = FrameCollector(PacketLayout(sensor(), "a"))
    counts = [len(collector.add(one)) for one in packets(1) + packets(2)]
    assert counts == [0, 0, 0, 1] * 2


def test_numbers_of_frames_begin_again():
    frames, late = frames_of(packets(2**16 - 1) + packets(2**16) + packets(2**16 + 1))
    assert (len(frames), late) == (3, 0)
    assert all(frame.is_received.all() for frame in frames)


def test_packets_may_come_in_any_order_within_a_frame_and_twice():
    first, second, third, fourth = packets(1)
    frames, late = frames_of([third, first, fourth, second, second, *packets(2)])
    assert (len(frames), late) == (2, 0)
    assert frames[0].is_received.all()
    assert (np.diff(frames[0].stamps_ns) == 1_000_000).all()


def test_a_lost_packet_leaves_its_columns_out():
    frames, _ = frames_of(packets(1)[:2] + packets(1)[3:] + packets(2))
    missing = np.flatnonzero(~frames[0].is_received)
    np.testing.assert_array_equal(missing, np.arange(2 * IN_PACKET, 3 * IN_PACKET))
    assert (frames[0].ranges[:, missing] == 0).all()
    assert frames[1].is_received.all()


@pytest.mark.parametrize("length", [1, 2, 3])
def test_frames_that_come_again_are_counted(length):
    """A capture of a few frames, sent in a loop: all its frames look late or repeated."""
    collector = FrameCollector(PacketLayout(sensor(), "a"))
    loop = [one for number in range(length) for one in packets(number)]
    found = [len(collector.add(one)) for _ in range(4) for one in loop]
    assert sum(found) == length
    assert collector.refused == 3 * length


def test_single_packets_that_come_again_are_no_frame():
    collector = FrameCollector(PacketLayout(sensor(), "a"))
    for number in range(1, 5):
        first, *rest = packets(number)
        for one in [first, *rest, rest[0], *packets(number - 1)[:2]]:
            collector.add(one)
    assert collector.late == 8
    assert collector.refused == 0


def test_a_late_packet_is_dropped_and_does_not_end_the_frame():
    late_one = packets(1)[-1]
    first, *rest = packets(2)
    frames, late = frames_of([*packets(1)[:-1], first, late_one, *rest])
    assert (len(frames), late) == (2, 1)
    assert frames[1].is_received.all()


def test_a_sensor_that_began_again_is_followed():
    frames, late = frames_of(packets(900) + packets(3) + packets(4))
    assert (len(frames), late) == (3, 0)


@pytest.mark.parametrize(("window", "needed"), [([16, 47], 2), ([56, 7], 2), ([8, 23], 2)])
def test_a_window_of_columns_needs_fewer_packets(window, needed):
    """A window may pass the end of the frame."""
    data = metadata()["data_format"] | {"column_window": window}
    collector = FrameCollector(PacketLayout(sensor(data_format=data), "a"))
    starts = sorted({column // 16 * 16 for column in np.r_[window[0], window[1]].tolist()})
    sent = [packet(1, first) for first in starts]
    assert len(sent) == needed
    assert [len(collector.add(one)) for one in sent] == [0, 1]


def test_invalid_columns_are_no_measurements():
    frames, _ = frames_of(packets(1, valid=False))
    assert not frames[0].is_received.any()


def test_the_second_return_of_a_beam_is_read_if_asked_for(tmp_path):
    """A beam without second return is no ray without return: the first may have hit something."""
    data = metadata()["data_format"] | {"udp_profile_lidar": "RNG15_RFL8_NIR8_DUAL"}
    words = [struct.pack("<I", metres * 125 | 9 << 16) for metres in (2, 5, 0)]
    stream = []
    for first in range(0, COLUMNS, IN_PACKET):
        single = packet(1, first)
        body = b""
        for column in range(IN_PACKET):
            at = 32 + column * (12 + 4 * ROWS)
            second = words[2] if (first + column) % 2 else words[1]
            body += single[at : at + 12] + (words[0] + second) * ROWS
        stream.append((7502, single[:32] + body + bytes(32)))
    path = written(tmp_path, stream, data_format=data)
    found = {}
    for name in ("first", "second"):
        with lc_io.open_recording(path, returns=name) as recording:
            (found[name],) = (one for one in recording if isinstance(one, Scan))
            assert any("second returns are" in note for note in recording.findings.notes)
    ranges = np.linalg.norm(found["second"].points, axis=-1)
    assert np.all(np.abs(ranges[:, ::2] - 5.0) < 0.05)
    assert np.isnan(ranges[:, 1::2]).all()
    assert not found["second"].no_return.any()
    assert np.all(np.abs(np.linalg.norm(found["first"].points, axis=-1) - 2.0) < 0.05)


def test_a_second_return_that_no_packet_holds_is_refused(tmp_path):
    path = written(tmp_path, [(7502, one) for one in packets(1)])
    with pytest.raises(FormatError, match=r"RNG15_RFL8_NIR8 has one return per beam; expected"):
        lc_io.open_recording(path, returns="second")


def written(folder, stream, **values):
    (folder / "a.json").write_text(json.dumps(metadata(**values)))
    return capture(folder / "a.pcap", [ethernet(ipv4(udp(data, port))) for port, data in stream])


def test_of_several_sensors_the_one_of_the_file_is_read(tmp_path):
    """By its serial number; the others send to other ports."""
    others = [(7600, one) for one in packets(1, serial=5, metres=9)]
    own = [(7601, one) for one in packets(1)]
    path = written(tmp_path, [one for pair in zip(others, own, strict=True) for one in pair])
    with lc_io.open_recording(path) as recording:
        (scan,) = (message for message in recording if isinstance(message, Scan))
        assert any("packets of 2 sensors" in note for note in recording.findings.notes)
    # Beams of an OS-0 begin 28 mm before their range ends to count, 36 mm above the origin.
    distance = np.linalg.norm(scan.points, axis=-1)
    assert np.all(np.abs(distance - 2.0) < 0.05)


def test_the_file_of_another_sensor_is_told(tmp_path):
    path = written(tmp_path, [(7502, one) for one in packets(1, serial=5)])
    with lc_io.open_recording(path) as recording:
        list(recording)
        assert any("of sensor 5, a.json of 122" in note for note in recording.findings.notes)


def test_a_file_of_another_size_is_refused_with_what_is_there(tmp_path):
    data = metadata()["data_format"] | {"udp_profile_lidar": "RNG19_RFL8_SIG16_NIR16"}
    path = written(tmp_path, [(7502, one) for one in packets(1)], data_format=data)
    with pytest.raises(FormatError, match=r"no packets of 1024 bytes, which .*a\.json.*4 of 512"):
        lc_io.open_recording(path)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"data_format": {"udp_profile_lidar": "RNG99"}, "lidar_mode": "512x10"}, "64"),
        ({"beam_altitude_angles": []}, "no beam_altitude_angles"),
        ({"beam_altitude_angles": ["a"]}, "ValueError"),
        ({"beam_azimuth_angles": [[1.0] * 4] * 4}, "16 azimuth angles"),
        ({"beam_azimuth_angles": [float("nan")] * 4}, "no beam_azimuth_angles"),
        ({"lidar_to_sensor_transform": [1.0] * 15}, "reshape"),
        ({"prod_sn": "x"}, "ValueError"),
    ],
)
def test_metadata_that_make_no_sense_are_refused(change, what):
    with pytest.raises(FormatError, match=r"a\.json") as caught:
        sensor(**change)
    assert what in str(caught.value)


def test_an_unknown_profile_is_named():
    data = metadata()["data_format"] | {"udp_profile_lidar": "RNG99"}
    with pytest.raises(FormatError, match="profile 'RNG99' are not read; known are LEGACY"):
        PacketLayout(sensor(data_format=data), "a")


def test_a_frame_beyond_the_limit_is_refused():
    with pytest.raises(LimitError, match="max_points"):
        parse_sensor(json.dumps(metadata()), "a", max_points=100)


def test_grouped_metadata_say_the_same():
    flat = metadata()
    grouped = {
        "sensor_info": {name: flat[name] for name in ("prod_line", "prod_sn")},
        "beam_intrinsics": {name: flat[name] for name in flat if name.startswith("beam")},
        "lidar_data_format": flat["data_format"],
        "config_params": {"udp_port_lidar": 7502, "lidar_mode": "1024x10"},
    }
    one, other = sensor(), parse_sensor(json.dumps(grouped), "a", max_points=10**6)
    np.testing.assert_array_equal(one.beams.directions, other.beams.directions)
    np.testing.assert_array_equal(one.beams.offsets, other.beams.offsets)
    assert (one.serial, one.port, one.profile) == (other.serial, other.port, other.profile)


@pytest.mark.parametrize(("version", "storage"), [(1, "bag"), (2, "sqlite3"), (2, "mcap")])
def test_packets_in_ros_recordings_are_scans_beside_transforms(tmp_path, version, storage):
    """Two sensors, each with its metadata, which come after the first packets."""
    files = ros_with_packets(version)
    name = "ouster_sensor_msgs/msg/PacketMsg"
    messages = []
    for node, serial, metres in (("/left", 1, 2), ("/right", 2, 3)):
        for frame in range(3):
            for index, data in enumerate(packets(frame, serial=serial, metres=metres)):
                time_ns = BEGIN_NS + (4 * frame + index) * 25_000_000
                buffer = files.types[name](buf=np.frombuffer(data, np.uint8))
                messages.append((f"{node}/lidar_packets", time_ns, buffer))
        text = files.types["std_msgs/msg/String"](json.dumps(metadata(prod_sn=str(serial))))
        messages.append((f"{node}/metadata", BEGIN_NS + 1, text))
    edges = [
        (BEGIN_NS + t * 10**8, "base", f"{node}/os_sensor", (t, 0, 0, 0, 0, 0, 1))
        for t in range(5)
        for node in ("left", "right")
    ]
    messages.append(("/tf", BEGIN_NS, files.transforms(edges)))
    path = tmp_path / ("a.bag" if storage == "bag" else "a")
    files.write(path, sorted(messages, key=lambda one: one[1]), storage)
    with lc_io.open_recording(path) as recording:
        kinds = {topic.name: topic.kind for topic in recording.topics()}
        found = list(recording)
        again = list(recording)
        posed = list(lc_io.posed_scans(recording, cloud="/right/lidar_packets"))
    assert kinds["/left/lidar_packets"] == kinds["/right/lidar_packets"] == "scan"
    assert sum(isinstance(one, Pose) for one in found) == 10
    scans = [one for one in found if isinstance(one, Scan)]
    assert [
        len([s for s in scans if s.topic == f"/{n}/lidar_packets"]) for n in ("left", "right")
    ] == [3, 3]
    assert len([one for one in again if isinstance(one, Scan)]) == 6
    for scan in scans:
        expected = 2 if scan.topic.startswith("/left") else 3
        assert np.all(np.abs(np.linalg.norm(scan.points, axis=-1) - expected) < 0.05)
        assert scan.frame_id == scan.topic.removesuffix("/lidar_packets")[1:] + "/os_sensor"
        assert scan.intensity.max() == 9
    assert len(posed) == 3
    stamps = [item.scan.stamp_ns for item in posed]
    assert all(later - earlier == COLUMNS * 1_000_000 for earlier, later in pairwise(stamps))


def test_packets_without_metadata_say_what_to_do(tmp_path):
    files = ros_with_packets(2)
    name = "ouster_ros/msg/PacketMsg"
    messages = [
        ("/os/lidar_packets", BEGIN_NS + i, files.types[name](buf=np.frombuffer(data, np.uint8)))
        for i, data in enumerate(packets(1))
    ]
    path = files.write(tmp_path / "a", messages, "mcap")
    with lc_io.open_recording(path) as recording:
        assert any("metadata=FILE" in defect for defect in recording.info().defects)
    (tmp_path / "a.json").write_text(json.dumps(metadata()))
    with lc_io.open_recording(path, metadata=str(tmp_path / "a.json")) as recording:
        assert len([one for one in recording if isinstance(one, Scan)]) == 1
