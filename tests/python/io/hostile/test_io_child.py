"""Readers in a child: the same messages as in this process, and its end is an error here."""

import os
import signal
import socket
import struct
import subprocess
import sys
import time
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from ros_files import Ros
from small_messages import assert_same_fields, make_pose, make_scan

import lidar_core as lc
from lidar_core.errors import FormatError, InputError, LimitError
from lidar_core.io import open_recording, read_cloud, read_columns, trusted_files, write_recording
from lidar_core.io.child import client, server, wire
from lidar_core.io.child.recording import ChildRecording
from lidar_core.io.child.trust import HAS_CHILDREN
from lidar_core.io.records import Findings, Record, Topic
from lidar_core.messages import LaserScan

pytestmark = pytest.mark.skipif(not HAS_CHILDREN, reason="no child processes with limits here")
BASE_NS = 1_700_000_000_000_000_000
RECORDED = (
    *("2d/datmo/overtake_red.bag", "2d/leg_tracker/positive_6.bag", "people/corridor/example3"),
    *("formats/derived_rosbag2/sick_rms_lms_mcap", "formats/pointcloudset_tree/test_tree.las"),
    *("3d/ndt_omp_pair", "3d/velodyne_mrpt/sample_velodyne_vlp16_gps.pcap"),
    *("3d/nebula/velodyne/vlp16/1673400471837873222", "3d/nebula/velodyne/vlp16"),
)
BREAKS = {
    "abort": ("os.abort()", FormatError, r"its reader crashed \(SIGABRT\)"),
    "crash": ("signal.raise_signal(signal.SIGSEGV)", FormatError, r"\(SIGSEGV\)"),
    "cpu": ("signal.raise_signal(signal.SIGXCPU)", LimitError, "s of processor time"),
    "killed": ("os.kill(os.getpid(), signal.SIGKILL)", LimitError, "memory ran out"),
    "exit": ("os._exit(0)", FormatError, "ended without an answer"),
    "memory": ("[bytearray(2**28) for _ in range(9)]", LimitError, "more memory than available"),
    "bug": ("{}['key']", FormatError, "KeyError: 'key'"),
    "system": ("os._exit", FormatError, "cannot be read"),
    "loud": ("print('x' * 10**6); os.write(2, b'x' * 10**6); 1 / 0", FormatError, "ZeroDiv"),
}


def same(one, other):
    """Two recordings have the same messages, topics, findings and summary."""
    with one, other:
        assert one.topics() == other.topics()
        assert one.format == other.format
        pairs = 0
        for left, right in zip(one, other, strict=True):
            assert_same_fields(left, right)
            pairs += 1
        assert one.skipped == other.skipped
        assert one.noticed() == other.noticed()
        assert one.first_stamp() == other.first_stamp()
        assert one.info() == other.info()
    return pairs


def both(path, **values):
    far, near = (
        open_recording(path, trusted=False, **values),
        open_recording(path, trusted=True, **values),
    )
    assert isinstance(far, ChildRecording)
    assert not isinstance(near, ChildRecording)
    return far, near


@pytest.mark.ci_cases("[!2]*", "2d/leg*")
@pytest.mark.parametrize("name", RECORDED)
def test_a_recording_is_the_same_in_a_child(recordings, name):
    same(*both(recordings / name))


@pytest.mark.ci_cases(".bag-own", ".mcap-recorded", "-counted")
@pytest.mark.parametrize("stamps", ["own", "recorded", "counted"])
@pytest.mark.parametrize("ending", [".bag", ".mcap", ""])
def test_what_is_written_is_read_the_same(tmp_path, ending, stamps):
    items = []
    for number in range(300):  # more than are sent ahead
        stamp = BASE_NS + number * 10**8
        items += [make_pose(number, stamp), make_scan(number, stamp_ns=stamp)]
        items.append(LaserScan(stamp, np.ones(9, np.float32), 0, 0.1, 0, 9, topic="/scan"))
    write_recording(tmp_path / f"a{ending}", items)
    assert same(*both(tmp_path / f"a{ending}", stamps=stamps)) == 900


def test_records_may_be_decoded_late_twice_or_in_two_passes(tmp_path):
    items = [make_scan(number, stamp_ns=BASE_NS + number * 10**8) for number in range(400)]
    write_recording(tmp_path / "a.mcap", items)
    far, near = both(tmp_path / "a.mcap")
    with far, near:
        kept = list(far.records())
        for record, expected in zip(kept, near.records(), strict=True):
            assert record.time_ns == expected.time_ns
        for number in (399, 0, 250, 0):
            (found,) = kept[number].decode()
            (expected,) = list(islice(near.records(), number + 1))[number].decode()
            assert_same_fields(found, expected)
        passes = zip(far, far.records(frozenset({"scan"})), far, strict=True)
        for one, record, other in islice(passes, 200):
            assert_same_fields(one, other)
            assert_same_fields(one, record.decode()[0])
        assert_same_fields(next(iter(far)), next(iter(near)))


def test_messages_of_ros_are_parsed_the_same(tmp_path):
    ros = Ros(2)
    values = (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0)
    items = [
        ("/odom", BASE_NS + k * 10**8, ros.odometry(BASE_NS + k * 10**8, "odom", "base", values))
        for k in range(200)
    ]
    path = ros.write(tmp_path / "b", items, "mcap")
    far = lc.fusion.read_bag(path)
    with trusted_files():
        near = lc.fusion.read_bag(path)
    assert len(far) == len(near) == 200
    for one, other in zip(far, near, strict=True):
        assert one.stamp_ns == other.stamp_ns
        np.testing.assert_array_equal(one.measurements[0].values, other.measurements[0].values)


def test_an_error_in_the_middle_comes_where_it_comes_in_this_process(tmp_path):
    items = [make_scan(number, stamp_ns=BASE_NS + number * 10**8) for number in range(40)]
    write_recording(tmp_path / "a.bag", items)
    data = bytearray((tmp_path / "a.bag").read_bytes())
    at = data.index(b"os_sensor", len(data) // 2)
    data[at - 4 : at] = struct.pack("<I", 2**31)
    (tmp_path / "a.bag").write_bytes(data)
    far, near = both(tmp_path / "a.bag")
    texts = []
    for one in (far, near):
        got = []
        with one, pytest.raises(FormatError) as caught:
            got.extend(message.stamp_ns for message in one)
        texts.append((got, str(caught.value)))
    assert texts[0] == texts[1]
    assert len(texts[0][0]) > 5


@pytest.fixture
def fresh(tmp_path, monkeypatch):
    """Readers that find modules of the test before the libraries."""
    place = tmp_path / "modules"
    place.mkdir()
    monkeypatch.syspath_prepend(str(place))
    client._FORKER._forget()
    yield place
    client._FORKER._forget()


def broken_pcd(folder, place, work):
    lines = (
        f"if name.startswith('__'): raise AttributeError(name)\n    {work}\n    raise OSError('no')"
    )
    (place / "pypcd4.py").write_text(f"import os, signal\ndef __getattr__(name):\n    {lines}\n")
    path = folder / "a.pcd"
    head = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\n"
    path.write_text(f"{head}VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 1\nDATA ascii\n1 2 3\n")
    return path


@pytest.mark.ci_cases("crash", "killed", "memory", "bug")
@pytest.mark.parametrize("name", BREAKS)
def test_a_library_that_breaks_is_an_error_that_names_the_file(tmp_path, fresh, name, capfd):
    work, kind, told = BREAKS[name]
    path = broken_pcd(tmp_path, fresh, work)
    with pytest.raises(kind, match=told) as caught:
        list(open_recording(path, trusted=False))
    assert "a.pcd" in str(caught.value)
    with pytest.raises(kind, match=told):
        read_cloud(path, trusted=False)
    assert capfd.readouterr() == ("", "")
    good = tmp_path / "good.mcap"
    write_recording(good, [make_scan()])
    with open_recording(good, trusted=False) as recording:
        assert len(list(recording)) == 1  # the next file is read all the same


@pytest.mark.nightly
def test_a_library_that_never_ends_is_ended(tmp_path, fresh):
    path = broken_pcd(tmp_path, fresh, "while True: pass")
    start = time.process_time()
    with pytest.raises(LimitError, match="takes more than 10 s of processor time"):
        read_cloud(path, trusted=False)
    assert time.process_time() - start < 2


def received(frame):
    ours, theirs = socket.socketpair()
    ours.settimeout(5)
    with ours, theirs:
        theirs.sendall(frame)
        return wire.receive(ours)


@pytest.mark.parametrize(
    ("frame", "kind"),
    [
        (struct.pack("<II", 2**31, 0), LimitError),
        (struct.pack("<II", 2, 2**31), LimitError),
        (struct.pack("<IIQ", 2, 1, 2**40) + b"{}", LimitError),
        (struct.pack("<II", 5, 0) + b"{\xff}xx", FormatError),
        (struct.pack("<II", 6, 0) + b"[" * 6, FormatError),
        (struct.pack("<II", 10**5, 0) + b"[" * 10**5, FormatError),
    ],
)
def test_a_frame_that_is_none_is_refused(frame, kind):
    with pytest.raises(kind):
        received(frame)


@pytest.mark.parametrize(
    "text",
    [
        b'{"~": "array", "v": ["<f4", 9]}',
        b'{"~": "array", "v": ["O", 1]}',
        b'{"~": "array", "v": ["<f4", -1]}',
        b'{"~": "Scan", "v": []}',
        b'{"~": "objects", "s": [7], "v": []}',
    ],
)
def test_a_child_that_was_taken_over_can_send_values_only(text):
    with pytest.raises(FormatError, match="a frame breaks its format"):
        received(struct.pack("<IIQ", len(text), 1, 4) + text + bytes(4))


def test_every_kind_of_value_crosses(tmp_path):
    ours, theirs = socket.socketpair()
    given = {
        "a": np.arange(6, dtype="<u2").reshape(2, 3),
        "large": np.arange(5000, dtype=">f8"),
        "text": np.array(["a", "bc"]),
        "objects": np.array([None, "x", 3], object),
        "empty": np.zeros((0, 3), np.float32),
        "bytes": b"\x00\xff",
        "~": [1, None, 2.5, float("inf"), True, "ü"],
        "scan": make_scan(),
    }
    with ours, theirs:
        wire.send(theirs, given)
        got = wire.receive(ours)
    assert got.keys() == given.keys()
    assert_same_fields(got.pop("scan"), given.pop("scan"))
    for name, value in given.items():
        if isinstance(value, np.ndarray):
            assert got[name].shape == value.shape
            np.testing.assert_array_equal(got[name], value)
        else:
            assert got[name] == value


def test_tables_are_read_the_same(tmp_path):
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    table = {"t_ns": [1, 2], "name": ["a", "b"], "x": [0.5, float("nan")]}
    parquet.write_table(pa.table(table), tmp_path / "a.parquet")
    far = read_columns(tmp_path / "a.parquet", trusted=False)
    near = read_columns(tmp_path / "a.parquet", trusted=True)
    assert far.keys() == near.keys()
    for name, column in near.items():
        assert far[name].dtype == column.dtype
        np.testing.assert_array_equal(far[name], column)


def readers_of(process):
    """Processes whose parents' parents, or parents, are `process`."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        found.append((int(folder.name), int(words[1]), words[0]))
    children = {one for one, parent, _ in found if parent == process}
    return children | {one for one, parent, _ in found if parent in children}


@pytest.mark.skipif(sys.platform != "linux", reason="looks at /proc")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_readers_end_with_their_caller(tmp_path, number):
    write_recording(tmp_path / "a.mcap", [make_scan(k, stamp_ns=k) for k in range(300)])
    program = (
        "import sys, time; from lidar_core.io import open_recording\n"
        "opened = open_recording(sys.argv[1], trusted=False); next(iter(opened))\n"
        "print('ready', flush=True); time.sleep(60)"
    )
    command = [sys.executable, "-c", program, str(tmp_path / "a.mcap")]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        assert process.stdout.readline() == "ready\n"
        readers = readers_of(process.pid)
        assert len(readers) == 2  # the one that forks, and one reader
        process.send_signal(number)
        process.wait()
    until = time.monotonic() + 20
    while any(Path(f"/proc/{one}").exists() for one in readers):
        assert time.monotonic() < until
        time.sleep(0.05)


def test_a_closed_recording_says_so(tmp_path):
    write_recording(tmp_path / "a.mcap", [make_scan()])
    recording = open_recording(tmp_path / "a.mcap", trusted=False)
    recording.close()
    recording.close()
    with pytest.raises(FormatError, match="the recording is closed"):
        list(recording)


def test_a_fork_has_readers_of_its_own(tmp_path):
    write_recording(tmp_path / "a.mcap", [make_scan()])
    program = (
        "import os, sys; from lidar_core.io import open_recording\n"
        "read = lambda: len(list(open_recording(sys.argv[1], trusted=False)))\n"
        "assert read() == 1\n"
        "child = os.fork()\n"
        "if not child: os._exit(10 + read())\n"
        "assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 11\n"
        "assert read() == 1"
    )
    subprocess.run([sys.executable, "-c", program, str(tmp_path / "a.mcap")], check=True)


def test_whoever_forks_readers_may_be_killed(tmp_path):
    write_recording(tmp_path / "a.mcap", [make_scan()])
    for _ in range(2):
        with open_recording(tmp_path / "a.mcap", trusted=False) as recording:
            assert len(list(recording)) == 1
        process = client._FORKER._process
        os.kill(process.pid, signal.SIGKILL)
        process.wait()


def test_files_of_our_own_formats_are_read_here(tmp_path):
    write_recording(tmp_path / "a.npz", [make_scan()])
    with open_recording(tmp_path / "a.npz", trusted=False) as recording:
        assert not isinstance(recording, ChildRecording)
    with trusted_files():
        write_recording(tmp_path / "a.mcap", [make_scan()])
        with open_recording(tmp_path / "a.mcap") as recording:
            assert not isinstance(recording, ChildRecording)
    cloud = lc.io.write_cloud(tmp_path / "a.ply", np.ones((3, 3)))
    with pytest.raises(InputError, match="spacing"):
        read_cloud(cloud, spacing=-1.0, trusted=False)  # errors cross as what they are


def test_paths_are_relative_to_the_folder_of_the_caller(tmp_path, monkeypatch):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        write_recording("a.mcap", [make_scan()])
        with open_recording("a.mcap", trusted=False) as recording:
            assert len(list(recording)) == 1
            assert recording.info().path == "a.mcap"
        Path("b.ply").write_bytes(b"ply\n")
        with pytest.raises(FormatError, match=r"^b\.ply: "):
            read_cloud("b.ply", trusted=False)


def test_who_wants_only_the_first_records_does_not_wait_for_others(monkeypatch):
    """Batches grow from 4 records to 128; each stream begins anew."""
    monkeypatch.setattr(server.limits, "allow_cpu", lambda _: None)
    monkeypatch.setattr(server.wire, "send", lambda *_: 0)
    read = []

    class Long:
        def records(self, _):
            for number in range(10_000):
                read.append(number)
                yield Record(Topic("/a", "b", "scan", 10_000), number, list)

        def noticed(self):
            return Findings()

    reader = server.Reader(None)
    reader._recording = Long()

    def batches(stream, count):
        sizes = []
        for _ in range(count):
            read.clear()
            reader._more(stream, None)
            sizes.append(len(read))
        return sizes

    assert batches(0, 7) == [4, 8, 16, 32, 64, 128, 128]
    assert batches(1, 2) == [4, 8]
    reader._stop(0)
    assert batches(0, 1) == [4]
