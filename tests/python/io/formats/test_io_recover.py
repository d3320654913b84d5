"""MCAP files that were cut or have broken chunks: what is whole comes out, what is lost is told."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
from small_messages import BASE_NS, assert_same_fields, make_pose, make_scan
from typer.testing import CliRunner

import lidar_core as lc
import lidar_core.io
from lidar_core.cli import app
from lidar_core.errors import FormatError
from lidar_core.io import McapWriter
from lidar_core.messages import Pose, Scan

STEP = 100_000_000


def items(count):
    """Poses and large scans in turn, so that a file has many chunks."""
    for number in range(count):
        stamp_ns = BASE_NS + number * STEP
        yield make_pose(number, stamp_ns)
        yield make_scan(number, shape=(16, 1600), stamp_ns=stamp_ns)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("mcap") / "whole.mcap"
    with McapWriter(path, tracks_frame="world") as writer:
        for item in items(8):
            writer.write(item)
    return path


@pytest.fixture(scope="module")
def messages(whole):
    with lc.io.open_recording(whole) as recording:
        return list(recording)


def recovered(path):
    with lc.io.open_recording(path, recover=True) as recording:
        return list(recording), recording.noticed().notes


def judged(path):
    """How many messages mcap's own reader gives before it fails."""
    count = 0
    with path.open("rb") as file:
        try:
            for _ in NonSeekingReader(file).iter_messages(log_time_order=False):
                count += 1
        except (McapError, ValueError, EOFError, struct.error):
            pass
    return count


def assert_prefix(found, messages):
    for one, other in zip(found, messages, strict=False):
        assert type(one) is type(other)
        assert one.stamp_ns == other.stamp_ns
        if isinstance(one, Scan):
            assert_same_fields(one, other)


def test_a_whole_file_is_read_as_ever(whole, messages):
    found, notes = recovered(whole)
    assert len(found) == len(messages) == 16
    assert_prefix(found, messages)
    assert notes == []


@pytest.mark.nightly
@settings(max_examples=40, deadline=None)
@given(share=st.floats(0.0, 1.0, exclude_max=True))
def test_a_cut_file_gives_what_came_before_the_cut(whole, messages, tmp_path_factory, share):
    data = whole.read_bytes()
    cut = tmp_path_factory.mktemp("cut") / "cut.mcap"
    cut.write_bytes(data[: max(1, int(share * len(data)))])
    with pytest.raises(FormatError), lc.io.open_recording(cut) as opened:
        list(opened)
    found, notes = recovered(cut)
    assert len(found) == judged(cut)
    assert_prefix(found, messages)
    if notes:
        assert f"recovered {len(found)} messages" in notes[0]
    else:
        assert len(found) == len(messages)


def test_a_broken_chunk_is_left_out_and_the_others_are_read(whole, messages, tmp_path):
    data = bytearray(whole.read_bytes())
    broken = tmp_path / "broken.mcap"
    middle = len(data) // 2
    data[middle : middle + 8] = b"\xff" * 8
    broken.write_bytes(data)
    with pytest.raises(FormatError), lc.io.open_recording(broken) as opened:
        list(opened)
    found, notes = recovered(broken)
    assert 0 < len(found) < len(messages)
    stamps = [item.stamp_ns for item in messages if isinstance(item, Scan)]
    kept = [item for item in found if isinstance(item, Scan)]
    for scan in kept:
        assert_same_fields(
            scan, [m for m in messages if isinstance(m, Scan)][stamps.index(scan.stamp_ns)]
        )
    assert any("broken chunks left out" in note for note in notes)


def test_the_refusal_names_the_cure(whole, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[:-100])
    with pytest.raises(
        FormatError, match=r"convert \S+ recovered\.npz --recover \(in Python: recover=True\)"
    ):
        lc.io.open_recording(cut)


@pytest.mark.parametrize("recover", [False, True])
def test_a_file_that_is_no_mcap_is_refused(tmp_path, recover):
    path = tmp_path / "not.mcap"
    path.write_bytes(b"no such thing" * 100)
    with pytest.raises(FormatError, match="not an MCAP file: it begins with b'no such '"):
        lc.io.open_recording(path, recover=recover)


def test_what_holds_no_whole_message_suggests_no_command(whole, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[:300])
    told = CliRunner().invoke(app, ["info", str(cut), "--recover"])
    assert told.exit_code == 0, told.output
    assert "recovered 0 messages" in told.stdout
    assert "the file ends inside a record" in told.stdout
    assert "next:" not in told.stdout
    told = CliRunner().invoke(app, ["convert", str(cut), str(tmp_path / "a.npz"), "--recover"])
    text = str(told.exception)
    assert text.startswith(f"{cut}: no scans or moving poses: recovered 0 messages; the last ")
    assert "bytes are lost" in text


def test_a_whole_file_of_mountings_alone_tells_no_loss(tmp_path):
    path = tmp_path / "mounting.npz"
    lc.io.write_recording(path, [Pose(0, "base", "lidar", np.eye(4), is_static=True)])
    told = CliRunner().invoke(app, ["convert", str(path), str(tmp_path / "a.npz")])
    assert str(told.exception) == f"{path}: no scans or moving poses"


def test_the_commands_recover(whole, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    told = CliRunner().invoke(app, ["info", str(cut), "--recover"])
    assert told.exit_code == 0, told.output
    assert "recovered" in told.stdout
    target = tmp_path / "saved.mcap"
    told = CliRunner().invoke(app, ["convert", str(cut), str(target), "--recover"])
    assert told.exit_code == 0, told.output
    with lc.io.open_recording(target) as recording:
        kinds = [type(item) for item in recording]
    assert kinds.count(Scan) == judged(cut) // 2
    assert kinds.count(Pose) > 0
