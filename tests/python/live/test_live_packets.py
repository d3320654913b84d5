"""Packets of sensors, straight from the network."""

import json
import socket
import struct
import threading
import time
from collections import Counter
from contextlib import closing
from http.server import BaseHTTPRequestHandler, HTTPServer

import numpy as np
import pytest
from ros_files import packets_of

import lidar_core.io as lc_io
from lidar_core.errors import FormatError, LinkError
from lidar_core.io import PoseOptions, ReadOptions
from lidar_core.io.files.udp import datagrams
from lidar_core.io.messages.livox_packets import LivoxStream
from lidar_core.io.messages.velodyne import VelodyneStream
from lidar_core.io.ouster.stream import OusterStream, sensor_at
from lidar_core.io.records import Findings
from lidar_core.live.config import LiveConfig
from lidar_core.live.loop import LiveLoop
from lidar_core.live.poses import LivePoses
from lidar_core.live.sources.inbox import Inbox
from lidar_core.live.sources.sensor_clock import SensorClock
from lidar_core.live.sources.udp import UdpSource
from lidar_core.messages import Scan
from lidar_core.runs.streams.choice import open_source

PATIENCE_S = 60
DRIVE = "3d/ouster/OS-1-128_v2.3.0_1024x10_lb_n3"
BEGIN_NS = 5_000_000_000


def send(source, packets, pause_s=0.0005):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor:
        for packet in packets:
            sensor.sendto(packet, ("127.0.0.1", source.port))
            time.sleep(pause_s)  # a busy machine would lose some


def received(source, inbox, packets, is_enough):
    """Scans of packets that are sent again until there are enough: some may be lost."""
    found, end = [], time.monotonic() + PATIENCE_S
    while not is_enough(found):
        assert time.monotonic() < end, len(found)
        for packet in packets:
            send(source, [packet])
            found += [item.record.decode()[0] for item in inbox.take(0).scans]
        time.sleep(0.05)
        found += [item.record.decode()[0] for item in inbox.take(0).scans]
    return found


def test_packets_of_a_velodyne_become_scans(recordings):
    pytest.importorskip("velodyne_decoder")
    packets = packets_of(recordings / "3d/velodyne_mrpt/sample_velodyne_vlp16_gps.pcap")

    def make(found):
        return VelodyneStream(ReadOptions(), found)

    with closing(UdpSource(0, make)) as source:
        inbox = Inbox(max_poses=1)
        with pytest.raises(LinkError, match=f"port {source.port} cannot be opened.*livox:PORT$"):
            UdpSource(source.port, make, kind="livox")
        source.start(inbox)
        assert source.silence().startswith(f"no packet came to port {source.port}; check the dest")
        send(source, [b"no packet"])
        found = received(
            source,
            inbox,
            [packet for _, packet in packets[:200]],
            lambda scans: any(15_000 < len(scan.points) < 20_000 for scan in scans),
        )
    assert source.silence() == f"packets come to port {source.port}, but no scan is complete"
    assert inbox.rejected == {source.name: 1}
    (note,) = source.findings.notes
    assert note.endswith("other sensors need their drivers")
    assert abs(found[-1].stamp_ns - time.time_ns()) < 60 * 10**9


def test_packets_of_an_ouster_give_the_scans_of_their_capture(recordings):
    """Stamps are by the clock of this machine, points and times within a scan are the same."""
    path = recordings / f"{DRIVE}.pcap"
    packets = [item.data for item in datagrams(path)]
    source = open_source(
        f"ouster:{path.with_name('OS-1-128_v2.3.0_1024x10.json')}@0",
        None,
        rate=None,
        read=ReadOptions(),
        live=None,
        pose="static",
        topics=None,
    )
    with closing(source):
        inbox = Inbox(max_poses=1)
        source.start(inbox)
        found = received(
            source,
            inbox,
            packets,
            lambda scans: any(np.isfinite(scan.points[..., 0]).sum() > 107_000 for scan in scans),
        )
        notes = source.findings.notes
    with lc_io.open_recording(path) as recording:
        whole = [message for message in recording if isinstance(message, Scan)]
    live = max(found, key=lambda scan: np.isfinite(scan.points[..., 0]).sum())
    (same,) = [scan for scan in whole if np.array_equal(scan.points, live.points, equal_nan=True)]
    np.testing.assert_array_equal(live.no_return, same.no_return)
    np.testing.assert_array_equal(
        live.point_time_ns - live.stamp_ns, same.point_time_ns - same.stamp_ns
    )
    assert abs(live.stamp_ns - time.time_ns()) < 60 * 10**9
    assert any("PTP" in note for note in notes)


def test_frames_that_an_ouster_sends_again_are_rejected_with_a_reason(recordings):
    """As of a capture of one scan, sent in a loop."""
    path = recordings / f"{DRIVE}.pcap"
    sensor = sensor_at(str(path.with_name("OS-1-128_v2.3.0_1024x10.json")), ReadOptions())
    stream = OusterStream(sensor, ReadOptions(), Findings())
    packets = [item.data for item in datagrams(path)]
    source, told = UdpSource(0, lambda _: stream), []
    with closing(source):
        loop = LiveLoop(
            source,
            lambda _: None,
            LivePoses(PoseOptions(pose="static"), LiveConfig()),
            [],
            LiveConfig(),
            on_reason=told.append,
        )
        for packet in packets * 3:
            source._take(packet, loop.inbox)
        loop._read(loop.inbox.take(0.0))
    assert loop.stats.rejected.total() == 2 * sum_of_frames(stream, packets)
    assert len(loop.stats.rejected) == len(told) == 1
    assert "came again, or after a later one" in told[0]


def sum_of_frames(stream, packets):
    """Number of frames of which most packets are there."""
    numbers = [stream._layout.frame_number(one) for one in packets if stream._layout.is_lidar(one)]
    return sum(count > 32 for count in Counter(numbers).values())


def test_the_sensor_itself_tells_its_metadata(recordings):
    text = (recordings / "3d/ouster/OS-1-128_v2.3.0_1024x10.json").read_bytes()

    class Sensor(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200 if self.path == "/api/v1/sensor/metadata" else 404)
            self.end_headers()
            self.wfile.write(text)

        def log_message(self, *_):
            pass

    server = HTTPServer(("127.0.0.1", 0), Sensor)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    sensor = sensor_at(f"127.0.0.1:{server.server_port}", ReadOptions())
    assert (sensor.product, sensor.rows, sensor.port) == ("OS-1-128", 128, 7502)
    server.shutdown()
    server.server_close()
    with pytest.raises(LinkError, match="no sensor answers at http://127"):
        sensor_at(f"127.0.0.1:{server.server_port}", ReadOptions())


def test_packets_of_another_ouster_are_told(recordings):
    sensor = sensor_at(str(recordings / "3d/ouster/OS-2-128-U1_v2.3.0_1024x10.json"), ReadOptions())
    stream = OusterStream(sensor, ReadOptions(), Findings())
    packet = next(item.data for item in datagrams(recordings / f"{DRIVE}.pcap"))
    with pytest.raises(FormatError, match="8448 bytes are not a packet of 24832"):
        stream.scan(0, packet, place="a")
    own = next(iter(datagrams(recordings / "3d/ouster/OS-2-128-U1_v2.3.0_1024x10.pcap"))).data
    changed = own[:7] + bytes([own[7] ^ 1]) + own[8:]
    with pytest.raises(FormatError, match=r"packets are of sensor \d+, not of 992210000957"):
        stream.scan(0, changed, place="a")


def livox(stamp_ns, points, kind=1, *, interval=960, length=None):
    """A packet of SDK 2; points as the kind has them, each with reflectivity 7 and tag 0."""
    form = {0: "<6f", 1: "<iiiBB", 2: "<hhhBB", 3: "<IHHBB"}[kind]
    body = b"".join(struct.pack(form, *point, 7, 0) for point in points)
    size = 36 + len(body) if length is None else length
    head = struct.pack("<BHHHHBBB12xIQ", 0, size, interval, len(points), 0, 0, kind, 0, 0, stamp_ns)
    return head + body


KINDS = {
    1: [(2000, -1000, 500)] * 96,
    2: [(200, -100, 50)] * 96,
    3: [(round(np.sqrt(5.25) * 1000), 7739, 33343)] * 96,
}
"""The same point, 2, -1, 0.5 m, as each kind has it: mm; cm; mm and hundredths of a degree."""


@pytest.mark.parametrize("kind", KINDS)
def test_packets_of_a_livox_become_scans(kind):
    stream = LivoxStream(ReadOptions(scan_rate=100.0), Findings())
    scans = [
        stream.scan(0, livox(BEGIN_NS + step * 1_000_000, KINDS[kind], kind), place="a")
        for step in range(25)
    ]
    done = [number for number, scan in enumerate(scans) if scan is not None]
    assert done == [10, 20]
    first, second = (scans[number] for number in done)
    assert len(first.points) == 10 * 96
    np.testing.assert_allclose(first.points, [[2.0, -1.0, 0.5]] * 960, atol=2e-3)
    assert (first.stamp_ns, second.stamp_ns) == (BEGIN_NS, BEGIN_NS + 10_000_000)
    # 96 points in 96 microseconds, a packet every millisecond.
    expected = BEGIN_NS + np.arange(10)[:, None] * 1_000_000 + np.arange(96) * 1000
    np.testing.assert_array_equal(first.point_time_ns, expected.reshape(-1))
    assert (first.intensity == 7).all()


def test_rays_of_a_livox_without_return_are_marked():
    points = [(0, 0, 0), (1000, 0, 0)] * 48
    stream = LivoxStream(ReadOptions(scan_rate=1000.0), Findings())
    stream.scan(0, livox(BEGIN_NS, points), place="a")
    scan = stream.scan(0, livox(BEGIN_NS + 10_000_000, points), place="a")
    assert scan.no_return.sum() == np.isnan(scan.points[:, 0]).sum() == 48


@pytest.mark.parametrize(
    "packet",
    [
        b"",
        bytes(36),
        livox(0, KINDS[1], length=99),
        livox(0, KINDS[1])[:-1],
        livox(0, [], 2) + b"a",
    ],
)
def test_what_is_no_packet_of_a_livox_is_refused(packet):
    with pytest.raises(FormatError, match="a Mid-360 or HAP"):
        LivoxStream(ReadOptions(), Findings()).scan(0, packet, place="a")


def test_a_livox_that_starts_again_does_not_mix_times():
    stream = LivoxStream(ReadOptions(), Findings())
    stream.scan(0, livox(10**15, KINDS[1]), place="a")
    scan = stream.scan(0, livox(5, KINDS[1]), place="a")
    assert scan.stamp_ns == 10**15
    assert len(scan.points) == 96


def stamped(stamp_ns):
    points = np.ones((2, 3), np.float32)
    return Scan(stamp_ns, points, "a", point_time_ns=np.array([stamp_ns, stamp_ns + 100]))


def test_clocks_that_agree_are_left_alone():
    scan = stamped(BEGIN_NS)
    assert SensorClock(Findings()).to_local_clock(scan, BEGIN_NS + 3_000_000) is scan


def test_another_clock_is_moved_by_the_fastest_way():
    """Arrivals jitter by up to 20 ms; the difference is that of the fastest so far."""
    clock, difference = SensorClock(Findings()), 7 * 10**18
    delays = [20, 5, 1, 12, 1, 19]
    for number, delay in enumerate(delays):
        scan = stamped(BEGIN_NS + number * 10**8)
        arrival = scan.stamp_ns + 100 + difference + delay * 10**6
        moved = clock.to_local_clock(scan, arrival)
        least = min(delays[: number + 1]) * 10**6
        assert moved.stamp_ns == scan.stamp_ns + difference + least
        assert moved.point_time_ns[1] - moved.stamp_ns == 100


def test_json_of_a_sensor_may_be_any_file(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps({"a": 1}))
    with pytest.raises(FormatError, match="not the metadata of an Ouster sensor"):
        sensor_at(str(tmp_path / "a.json"), ReadOptions())
