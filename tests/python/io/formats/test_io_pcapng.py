"""Captures as Wireshark writes them: the same scans as of the pcap they were made from."""

import struct
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import lidar_core as lc
import lidar_core.io
from lidar_core.errors import FormatError
from lidar_core.io.files.pcap import packet_sizes
from lidar_core.io.files.pcapng import AsPcap, packets

dpkt = pytest.importorskip("dpkt")

CAPTURE = "3d/velodyne_mrpt/sample_velodyne_vlp16_gps.pcap"
MICRO, NANO, BINARY = 6, 9, 0x80 | 20
BASE_NS = 1_700_000_000_123_456_000


def block(kind, body, order="<"):
    body += bytes(-len(body) % 4)
    size = struct.pack(f"{order}I", len(body) + 12)
    return struct.pack(f"{order}I", kind) + size + body + size


def section(order="<"):
    return block(0x0A0D0D0A, struct.pack(f"{order}IHHq", 0x1A2B3C4D, 1, 0, -1), order)


def interface(order="<", resolution=None, offset=None):
    options = b""
    if resolution is not None:
        options += struct.pack(f"{order}HHB3x", 9, 1, resolution)
    if offset is not None:
        options += struct.pack(f"{order}HHq", 14, 8, offset)
    options += struct.pack(f"{order}HH", 0, 0) if options else b""
    return block(1, struct.pack(f"{order}HHI", 1, 0, 0) + options, order)


def packet(ticks, data, order="<", number=0):
    head = struct.pack(
        f"{order}IIIII", number, ticks >> 32, ticks & 0xFFFFFFFF, len(data), len(data)
    )
    return block(6, head + data, order)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("name", "resolution"), [("a.pcapng", None), ("a.pcap", NANO)])
def test_a_capture_of_wireshark_gives_the_scans_of_its_pcap(
    recordings, tmp_path, order, name, resolution
):
    with (recordings / CAPTURE).open("rb") as file:
        stored = list(dpkt.pcap.Reader(file))
    ticks = 10 ** (MICRO if resolution is None else resolution)
    path = tmp_path / name
    path.write_bytes(
        b"".join(
            [
                section(order),
                interface(order, resolution),
                block(5, bytes(12), order),
                *(packet(round(stamp * ticks), data, order) for stamp, data in stored),
            ]
        )
    )
    with lc.io.open_recording(recordings / CAPTURE) as expected, lc.io.open_recording(path) as got:
        assert got.format == "Velodyne pcap"
        pairs = list(zip(expected, got, strict=True))
    assert len(pairs) == 4
    for known, scan in pairs:
        np.testing.assert_array_equal(scan.points, known.points)
        assert abs(scan.stamp_ns - known.stamp_ns) < 2000
        np.testing.assert_array_equal(
            scan.point_time_ns - scan.stamp_ns, known.point_time_ns - known.stamp_ns
        )


@given(st.lists(st.integers(0, 2**40), max_size=5), st.sampled_from(["<", ">"]))
def test_dpkt_reads_the_same(tmp_path_factory, ticks, order):
    path = tmp_path_factory.mktemp("a") / "a.pcapng"
    path.write_bytes(
        section(order)
        + interface(order, NANO)
        + b"".join(packet(tick, bytes(k), order) for k, tick in enumerate(ticks))
    )
    got = list(packets(path))
    with path.open("rb") as file:
        expected = list(dpkt.pcapng.Reader(file))
    assert [one.data for one in got] == [data for _, data in expected]
    np.testing.assert_allclose([one.stamp_ns * 1e-9 for one in got], [t for t, _ in expected])
    as_pcap = list(dpkt.pcap.Reader(AsPcap(path)))
    assert [data for _, data in as_pcap] == [data for _, data in expected]
    np.testing.assert_allclose([t for t, _ in as_pcap], [t for t, _ in expected], atol=2e-6)


def test_every_interface_has_its_own_clock_and_sections_begin_anew(tmp_path):
    path = tmp_path / "a.pcapng"
    path.write_bytes(
        b"".join(
            [
                section("<"),
                interface("<"),
                interface("<", BINARY, offset=-5),
                packet(BASE_NS // 1000, b"a"),
                packet(7 << 20 | 1 << 19, b"b", number=1),
                section(">"),
                interface(">", NANO),
                packet(BASE_NS, b"c", ">"),
            ]
        )
    )
    assert [(one.stamp_ns, one.data) for one in packets(path)] == [
        (BASE_NS, b"a"),
        (2_500_000_000, b"b"),
        (BASE_NS, b"c"),
    ]


def test_a_cut_last_packet_is_the_end_and_a_damaged_size_is_not(tmp_path):
    path = tmp_path / "a.pcapng"
    begin = section() + interface(resolution=NANO) + packet(BASE_NS, b"abcde")
    last = packet(BASE_NS + 1, bytes(2000))
    for length in range(1, len(last)):
        path.write_bytes(begin + last[:length])
        told = []
        assert packet_sizes(path, on_cut=told.append) == {5: 1}
        assert told == [
            f"{path}: the capture was cut inside its last packet; the last {length} bytes are left"
            " out"
        ]
        assert [one.data for one in packets(path)] == [b"abcde"]
    far = begin[: len(section() + interface(resolution=NANO)) + 4] + struct.pack("<I", 8000)
    path.write_bytes(far + begin[len(far) :] + last)  # would hide the packet behind it
    with pytest.raises(FormatError, match="byte 60: the file ends inside a block of 8000 bytes"):
        list(packets(path))


def test_cut_heads_are_refused_and_flipped_bytes_raise_nothing_else(tmp_path):
    path = tmp_path / "a.pcapng"
    whole = section() + interface(resolution=NANO) + packet(BASE_NS, b"abcde")
    heads = len(section() + interface(resolution=NANO))
    for length in {*range(1, len(section())), *range(len(section()) + 12, heads)}:
        path.write_bytes(whole[:length])
        with pytest.raises(FormatError, match=r"a\.pcapng, byte \d+: "):
            list(packets(path))
    for position in range(len(whole)):
        for value in (0, 0xFF, whole[position] ^ 1, whole[position] ^ 0x80):
            path.write_bytes(whole[:position] + bytes([value]) + whole[position + 1 :])
            with suppress(FormatError):
                assert all(len(one.data) < len(whole) for one in packets(path))


def test_a_capture_of_an_ouster_says_what_is_missing(tmp_path):
    path = tmp_path / "a.pcapng"
    path.write_bytes(section() + interface() + packet(BASE_NS // 1000, b"a"))
    with pytest.raises(FormatError, match=r"not Velodyne's; for Ouster, put its \.json"):
        lc.io.open_recording(path)


def test_a_packet_of_no_interface_is_refused(tmp_path):
    path = tmp_path / "a.pcapng"
    path.write_bytes(section() + packet(BASE_NS, b"a"))
    with pytest.raises(FormatError, match="byte 28: a broken block: a packet of interface 0"):
        list(packets(path))


def test_a_time_that_pcap_cannot_hold_is_refused(tmp_path):
    path = tmp_path / "a.pcapng"
    for offset, tick in ((-5, 0), (2**32, 0), (2**62, 0)):
        path.write_bytes(section() + interface("<", NANO, offset=offset) + packet(tick, b"a"))
        with pytest.raises(FormatError, match=r"a broken block: a packet at -?\d+ ns"):
            list(packets(path))
