"""Compressed data that grows without measure: refused before memory or disk is filled."""

import bz2
import tempfile

import numpy as np
import pytest
import zstandard

import lidar_core as lc
from lidar_core.errors import FormatError, LimitError
from lidar_core.io.files import compressed
from lidar_core.io.files.compressed import bounded_decompressor, unpack_zstd, zstd_data

MIB = 2**20
RATIO = "compressed bytes become more than 1000 times as many"


def zstd_of_zeros(size):
    """A frame that grows by some 30,000, with its size stated as zstd does."""
    return zstandard.ZstdCompressor(level=1).compress(bytes(size))


def zstd_bomb(packed):
    """A frame of about `packed` bytes made of blocks that repeat one byte: 32,768 times as many."""
    head = zstandard.FRAME_HEADER + bytes([0b0000_0000, (17 - 10) << 3])  # a window of 128 KiB
    block = (128 * 1024 << 3 | 1 << 1).to_bytes(3, "little") + b"\0"
    last = (128 * 1024 << 3 | 1 << 1 | 1).to_bytes(3, "little") + b"\0"
    return head + block * ((packed - len(head)) // 4 - 1) + last


@pytest.mark.parametrize("name", ["a_0.mcap.zstd", "a_0.db3.zstd"])
def test_a_zstd_file_of_100_kb_writes_no_more_than_the_cap(tmp_path, monkeypatch, name):
    """It wrote 3.2 GiB before; the cap is 1,000 times what it has."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    path = tmp_path / name
    path.write_bytes(zstd_bomb(100_000))
    written = []
    check = compressed.check_ratio

    def watched(size, packed, place):
        written.extend(file.stat().st_size for file in temporary.rglob("*.*") if file.is_file())
        check(size, packed, place)

    monkeypatch.setattr(compressed, "check_ratio", watched)
    with pytest.raises(LimitError, match=f"{name}: \\d+ {RATIO}"):
        lc.io.open_recording(path, trusted=True)  # watched in this process
    assert 50 * MIB < max(written) <= 1000 * path.stat().st_size
    assert not list(temporary.iterdir())


def test_up_to_1_mib_any_ratio_is_read(tmp_path):
    assert zstd_data(zstd_of_zeros(MIB), "a", 64 * MIB) == bytes(MIB)
    assert bounded_decompressor(bz2.decompress, "a", 64 * MIB)(bz2.compress(bytes(MIB))) == bytes(
        MIB
    )
    (tmp_path / "a.zstd").write_bytes(zstd_of_zeros(MIB))
    assert unpack_zstd(tmp_path / "a.zstd", tmp_path / "a", 64 * MIB) == MIB


@pytest.mark.parametrize("kind", ["zstd", "lz4", "bz2"])
def test_chunks_and_messages_grow_by_1000_at_most(kind):
    if kind == "zstd":
        with pytest.raises(LimitError, match=RATIO):
            zstd_data(zstd_of_zeros(40 * MIB), "chunk 1", 64 * MIB)
    elif kind == "bz2":
        with pytest.raises(LimitError, match=RATIO):
            bounded_decompressor(bz2.decompress, "chunk 1", 64 * MIB)(bz2.compress(bytes(40 * MIB)))
    else:  # LZ4 grows by 255 at most: what it packs is never refused for this
        frame = pytest.importorskip("lz4.frame")
        packed = frame.compress(bytes(40 * MIB))
        assert len(compressed.lz4_data(packed, "chunk 1", 64 * MIB)) == 40 * MIB


def test_a_mcap_chunk_that_grows_without_measure_is_refused(tmp_path):
    """A chunk of zeros in a file that states its sizes truly."""
    from mcap.writer import CompressionType, Writer

    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=60 * MIB, compression=CompressionType.ZSTD)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/ByteMultiArray", "ros2msg", b"byte[] data")
        channel = writer.register_channel("/a", "cdr", schema)
        writer.add_message(channel, 1, bytes(50 * MIB), 1)
        writer.finish()
    assert path.stat().st_size < 10_000
    with pytest.raises(LimitError, match=RATIO), lc.io.open_recording(path) as recording:
        list(recording.records())


@pytest.mark.nightly
def test_a_carmen_log_that_grows_without_measure_is_refused(tmp_path):
    """4 GiB of text were unpacked from 3 kB before."""
    path = tmp_path / "a.clf.bz2"
    path.write_bytes(bz2.compress(b"# nothing\n" * 800_000))
    assert path.stat().st_size < 6_000
    with pytest.raises(LimitError, match=rf"a\.clf\.bz2, line \d+: \d+ {RATIO}"):
        list(lc.io.open_recording(path))


def test_recordings_that_were_packed_well_are_still_read(tmp_path):
    """Scans without any return are mostly zeros: they are within the cap in every packing."""
    scans = np.zeros((20, 2048, 16), np.uint8)
    scans[:, ::64] = np.random.default_rng(0).integers(0, 255, (20, 32, 16))
    packed = zstandard.ZstdCompressor().compress(scans.tobytes())
    assert zstd_data(packed, "a", 64 * MIB) == scans.tobytes()
    with pytest.raises(FormatError, match="ends early"):
        zstd_data(packed[:-3], "a", 64 * MIB)
