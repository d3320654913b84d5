"""What a live run keeps and tells: recordings, Arrow, metrics."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from threading import Event
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest
from commands import command_line
from typer.testing import CliRunner

import lidar_core as lc
from lidar_core.cli import app
from lidar_core.errors import ConfigError, FormatError, LinkError
from lidar_core.io.records import Record, Topic
from lidar_core.live import tape as tape_module
from lidar_core.live.metrics import MetricsServer, metrics_text
from lidar_core.live.stats import Delay, Report
from lidar_core.live.tape import Tape
from lidar_core.messages import Pose, Scan
from lidar_core.runs.streams.choice import check_files

CLOUDS = Topic("/cloud", "", "scan")
SCANS = 12


def cloud(number):
    points = np.random.default_rng(number).normal(size=(200, 3)).astype(np.float32) * 5
    return Scan(number * 10**8, points, "lidar", topic="/cloud")


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """A short flight with drones and its poses."""
    path = tmp_path_factory.mktemp("flight") / "a.npz"
    few = ["--sensor", "os1-32", "--scans", str(SCANS)]
    arguments = ["simulate", "demo", "-o", str(path), *few]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    return path


def messages_of(path, kind):
    with lc.io.open_recording(path) as recording:
        return [message for message in recording if isinstance(message, kind)]


@pytest.mark.parametrize("ending", ["npz", "mcap"])
def test_a_tape_keeps_every_message_and_decodes_it_once(tmp_path, ending):
    path, calls = tmp_path / f"a.{ending}", []

    def decode(number):
        calls.append(number)
        return [cloud(number)]

    tape = Tape(path)
    kept = [
        tape.keep(Record(CLOUDS, number, lambda number=number: decode(number)))
        for number in range(20)
    ]
    assert [record.decode()[0].stamp_ns for record in kept] == [n * 10**8 for n in range(20)]
    tape.close()
    tape.close()
    assert sorted(calls) == list(range(20))
    assert tape.lost == 0
    scans = messages_of(path, Scan)
    assert [scan.stamp_ns for scan in scans] == [n * 10**8 for n in range(20)]
    np.testing.assert_array_equal(scans[3].points, cloud(3).points)


@pytest.mark.parametrize("ending", ["mcap", "bag"])
@pytest.mark.parametrize("known", [True, False])
def test_a_tape_keeps_the_times_of_arrival_if_they_are_known(tmp_path, ending, known):
    tape, late = Tape(tmp_path / f"a.{ending}", has_arrivals=known), 70_000_000
    for number in range(5):
        arrival = number * 10**8 + late
        tape.keep(Record(CLOUDS, arrival, lambda number=number: [cloud(number)]))
    tape.close()
    with lc.io.open_recording(tape.path) as recording:
        times = [(scan.stamp_ns, arrival) for scan, arrival in recording.arrivals()]
    assert times == [(n * 10**8, n * 10**8 + known * late) for n in range(5)]


@pytest.mark.parametrize("name", ["a.mcap", "a.bag"])
def test_a_tape_keeps_odometry_of_two_bodies_apart(tmp_path, name):
    """Both name the same frames, so as transforms they would be one motion."""
    tape = Tape(tmp_path / name)
    for topic, y in (("/wheels", 0.0), ("/lidar_odometry", 3.0)):
        matrix = np.eye(4)
        matrix[1, 3] = y
        pose = Pose(10**9, "odom", "base_link", matrix, topic=topic)
        kind = Topic(topic, "nav_msgs/msg/Odometry", "pose")
        tape.keep(Record(kind, 10**9, lambda pose=pose: [pose]))
    tape.close()
    with lc.io.open_recording(tape.path) as recording:
        found = {pose.topic: (pose.child_frame_id, pose.matrix[1, 3]) for pose in recording}
    assert found == {"/wheels": ("base_link", 0.0), "/lidar_odometry": ("base_link", 3.0)}


def test_a_replay_of_what_a_replay_recorded_is_the_same_stream(tmp_path):
    """Transforms that are sent ahead of their times are there when a scan needs them."""
    begin, second = 1_700_000_000 * 10**9, 10**9
    with lc.io.RosWriter(tmp_path / "a") as writer:
        for number in range(16):
            at = begin + number * second // 20
            pose = Pose(at + second // 5, "world", "lidar", np.eye(4))
            writer.write(pose, log_time_ns=at)
            scan = replace(cloud(number), stamp_ns=at - second // 50)
            writer.write(scan, log_time_ns=at + 1000)
    arguments = ["live", "--replay", tmp_path / "a", "--record", tmp_path / "b.mcap"]
    first = told(arguments, tmp_path)
    again = told(["live", "--replay", tmp_path / "b.mcap"], tmp_path)
    for one in (first, again):  # at the pace of the recording: a busy machine drops scans
        assert one["processed"] >= 8
        lost = [count for why in ("without_pose", "dropped") for count in one[why].values()]
        assert one["processed"] + sum(lost) == 16
    stored = []
    for path in ("a", "b.mcap"):
        with lc.io.open_recording(tmp_path / path) as recording:
            stored.append([(one.stamp_ns, arrival) for one, arrival in recording.arrivals()])
    assert len(stored[0]) == 32
    assert stored[1] == stored[0]


def told(arguments, folder):
    options = ["--json", str(folder / "told.json"), "--stream", "pose_wait=0.3"]
    done = CliRunner().invoke(app, [*map(str, arguments), *options])
    assert done.exit_code == 0, done.output
    return json.loads((folder / "told.json").read_text())


KILLED = """
import os, signal, sys
from pathlib import Path
import numpy as np
from lidar_core.io.records import Record, Topic
from lidar_core.live.tape import Tape
from lidar_core.messages import Scan

tape = Tape(Path(sys.argv[1]))
for number in range(200):
    points = np.full((1000, 3), number, dtype=np.float32) + np.random.rand(1000, 3)
    scan = Scan(number * 10**8, points.astype(np.float32), "lidar", topic="/cloud")
    tape.keep(Record(Topic("/cloud", "", "scan"), number, lambda scan=scan: [scan]))
while not tape._waiting.empty():
    pass
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(os.name != "posix", reason="SIGKILL is of POSIX")
def test_a_killed_recording_keeps_all_but_its_end(tmp_path):
    path, partial = tmp_path / "a.mcap", tmp_path / "a.partial.mcap"
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False, timeout=60)
    assert done.returncode == -9
    assert [file.name for file in tmp_path.iterdir()] == [partial.name]
    options = lc.io.ReadOptions(recover=True)
    with lc.io.open_recording(partial, options=options) as recording:
        scans = [message for message in recording if isinstance(message, Scan)]
    assert [scan.stamp_ns for scan in scans] == [n * 10**8 for n in range(len(scans))]
    lost_bytes = (200 - len(scans)) * scans[0].points.nbytes
    assert 0 < lost_bytes <= 300_000  # the last chunk, and what the thread was at
    (tmp_path / "other").write_bytes(b"precious")
    partial.unlink()
    partial.symlink_to(tmp_path / "other")
    with lc.io.McapWriter(path, tracks_frame="map", is_live=True) as writer:
        with pytest.raises(FileExistsError, match="another process writes this recording"):
            lc.io.McapWriter(path, tracks_frame="map", is_live=True)
        writer.write(scans[0])
    assert (tmp_path / "other").read_bytes() == b"precious"
    path.unlink()
    partial.write_bytes(b"")
    with pytest.raises(
        ConfigError, match=r"a\.partial\.mcap: exists, left by a run that was killed"
    ):
        check_files([], None, None, path, overwrite=False)
    check_files([], None, None, path, overwrite=True)


def test_a_recording_that_ends_leaves_no_partial_file(tmp_path):
    tape = Tape(tmp_path / "a.mcap")
    tape.keep(Record(CLOUDS, 0, lambda: [cloud(0)]))
    tape.close()
    assert [file.name for file in tmp_path.iterdir()] == ["a.mcap"]


def test_what_cannot_be_read_is_left_out_of_the_tape_and_told_to_the_loop(tmp_path):
    def broken():
        raise FormatError("broken")

    tape = Tape(tmp_path / "a.npz")
    kept = [tape.keep(Record(CLOUDS, 0, decode)) for decode in (broken, lambda: [cloud(1)])]
    for _ in range(2):
        with pytest.raises(FormatError, match="broken"):
            kept[0].decode()
    tape.close()
    assert len(messages_of(tmp_path / "a.npz", Scan)) == 1


def test_a_slow_disk_loses_records_and_does_not_wait(tmp_path, monkeypatch):
    written, gate = [], Event()

    def slow(path, messages, *, odometry):
        gate.wait(60)
        written.extend(messages)

    monkeypatch.setattr(tape_module, "write_arrivals", slow)
    tape = Tape(tmp_path / "a.npz")
    for number in range(tape_module.MOST_WAITING + 30):
        tape.keep(Record(CLOUDS, number, lambda number=number: [cloud(number)]))
    assert tape.lost == 30
    gate.set()
    tape.close()
    assert len(written) == tape_module.MOST_WAITING


def test_a_tape_that_cannot_be_written_ends_with_the_reason(tmp_path, monkeypatch):
    def full(path, messages, *, odometry):
        next(messages)
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(tape_module, "write_arrivals", full)
    tape = Tape(tmp_path / "a.npz")
    for number in range(5):
        tape.keep(Record(CLOUDS, number, lambda number=number: [cloud(number)]))
    with pytest.raises(OSError, match="No space left"):
        tape.close()


def test_a_run_keeps_what_came_in_and_streams_its_tracks(flight, tmp_path):
    """The recording gives the same run again, whatever the pace of the first one was."""
    arrow = pytest.importorskip("pyarrow")
    tape, tracks = tmp_path / "kept.npz", tmp_path / "tracks.arrow"
    done = CliRunner().invoke(
        app,
        [
            *("live", "--replay", str(flight), "--rate", "0.5", "--record", str(tape)),
            *("--out", f"arrow:{tracks}", "--metrics", "0", "--json", "-"),
        ],
    )
    assert done.exit_code == 0, done.output
    summary = json.loads(done.stdout)
    assert (summary["recording"], summary["not_recorded"]) == (str(tape), 0)
    original, kept = messages_of(flight, Scan), messages_of(tape, Scan)
    assert [scan.stamp_ns for scan in kept] == [scan.stamp_ns for scan in original]
    for one, other in zip(original, kept, strict=True):
        np.testing.assert_array_equal(one.points, other.points)
    assert len(messages_of(tape, Pose)) == len(messages_of(flight, Pose))
    with arrow.ipc.open_stream(tracks) as reader:
        batches = list(reader)
        assert reader.schema.metadata[b"capability"] == b"flying"
    assert len(batches) == summary["processed"]
    assert {"stamp_ns", "id", "x", "vx", "cov_x_x", "existence"} <= set(batches[0].schema.names)


def test_files_that_are_there_are_not_replaced(flight, tmp_path):
    (tmp_path / "a.npz").write_bytes(b"mine")
    arguments = ["live", "--replay", str(flight), "--record", str(tmp_path / "a.npz")]
    done = subprocess.run(
        command_line(*arguments), capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 2
    assert "--overwrite" in done.stderr
    assert (tmp_path / "a.npz").read_bytes() == b"mine"


REPORT = Report(
    elapsed_s=12.5,
    rate_hz=9.5,
    from_stamp=None,
    from_arrival=Delay(20.0, 45.5),
    counts={"dropped": 3, "without pose": 1, "rejected": 0},
    processed=120,
    objects=2,
    trouble="",
)
LINE = re.compile(r'^[a-z_]+(\{[a-z_]+="[^"]*"(,[a-z_]+="[^"]*")*\})? [-+0-9.e]+$')


def test_metrics_are_text_that_prometheus_reads():
    text = metrics_text(REPORT)
    assert text.endswith("\n")
    lines = text.splitlines()
    values = dict(line.rsplit(" ", 1) for line in lines if not line.startswith("#"))
    assert all(LINE.match(line) for line in lines if not line.startswith("#"))
    assert values["lidar_core_live_scans_total"] == "120"
    assert values['lidar_core_live_scans_left_out_total{reason="without_pose"}'] == "1"
    assert values['lidar_core_live_latency_seconds{since="arrival",quantile="0.95"}'] == "0.0455"
    assert values["lidar_core_live_source_ok"] == "1"
    assert not any('since="stamp"' in name for name in values)
    names = {line.split()[2] for line in lines if line.startswith("# TYPE")}
    assert {name.partition("{")[0] for name in values} == names


def test_metrics_are_served_and_grow():
    server = MetricsServer("127.0.0.1", 0)
    with urlopen(server.address, timeout=10) as answer:
        assert answer.headers["Content-Type"].startswith("text/plain; version=0.0.4")
        assert b"lidar_core_live_up 1\n" in answer.read()
    server.update(REPORT)
    with urlopen(server.address, timeout=10) as answer:
        assert b"lidar_core_live_objects 2\n" in answer.read()
    with pytest.raises(HTTPError):
        urlopen(server.address.replace("metrics", "other"), timeout=10)
    port = int(server.address.split(":")[2].split("/")[0])
    with pytest.raises(LinkError, match="cannot be opened"):
        MetricsServer("127.0.0.1", port)
    server.close()
