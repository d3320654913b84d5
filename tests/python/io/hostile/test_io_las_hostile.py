"""LAS and LAZ files that lie about their sizes: a typed error or a read, never an abort."""

import json
import struct
import subprocess
import sys
from pathlib import Path

import laspy
import numpy as np
import pytest

import lidar_core as lc
from lidar_core.errors import FormatError, LimitError
from lidar_core.io.files.las import MOST_RECORD, POINTS_PER_BYTE, read_las
from lidar_core.io.options import ReadOptions

FORMATS = {0: "1.2", 3: "1.2", 5: "1.3", 6: "1.4", 7: "1.4", 10: "1.4"}
COUNT = 400
MUTANTS = 20
"""Per format and ending: 1,440 in all."""
BUDGET = 800 * 2**20
"""Address space beyond what the child process needs to start [bytes]."""


def las_file(path, *, version, point_format, count=COUNT, extra=0, seed=0):
    header = laspy.LasHeader(point_format=point_format, version=version)
    header.offsets, header.scales = [5e5, 5e6, 0.0], [0.001] * 3
    if extra:
        header.add_extra_dim(laspy.ExtraBytesParams("own", f"{extra}u1"))
    cloud = laspy.LasData(header)
    points = np.random.default_rng(seed).uniform(0, 50, (count, 3))
    points += np.array([5e5, 5e6, 0.0])
    cloud.x, cloud.y, cloud.z = points.T
    cloud.intensity = np.arange(count) % 1000
    cloud.write(path)
    return points


def laszip_at(data):
    """Where LASzip's record begins in a file."""
    return data.index(b"laszip encoded") + 52


def changed(data, at, form, value):
    return data[:at] + struct.pack(form, value) + data[at + struct.calcsize(form) :]


def mutant(data, rng):
    """One of many ways to break a file: sizes, counts, offsets, bytes, cuts."""
    interesting = [0, 1, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 2, 2**32 - 1]
    points_at = struct.unpack_from("<I", data, 96)[0]
    fields = [
        (94, "<H"),
        (96, "<I"),
        (100, "<I"),
        (104, "<B"),
        (105, "<H"),
        (107, "<I"),
        (points_at, "<q"),
        (len(data) - 8, "<I"),
        (len(data) - 12, "<I"),
    ]
    if b"laszip encoded" in data:
        record = laszip_at(data)
        fields += [(record + at, "<I") for at in (0, 4, 12, 16, 32, 34, 36, 38, 42)]
        (table_at,) = struct.unpack_from("<q", data, points_at)
        if points_at < table_at < len(data) - 8:
            fields += [(table_at + 4, "<I"), (table_at + 8, "<I")] * 2
        fields += [(points_at + 8 + int(at), "<I") for at in rng.integers(0, 120, 6)]
    if data[25] >= 4:
        fields += [(235, "<Q"), (243, "<I"), (247, "<Q")]
    for _ in range(int(rng.integers(1, 4))):
        kind = rng.integers(0, 10)
        if kind < 7:
            at, form = fields[rng.integers(len(fields))]
            if at + struct.calcsize(form) <= len(data):
                top = 2 ** (8 * struct.calcsize(form) - (form == "<q")) - 1
                value = interesting[rng.integers(len(interesting))]
                data = changed(data, at, form, min(value, top))
        elif kind < 9:
            at = int(rng.integers(len(data)))
            data = data[:at] + rng.bytes(1) + data[at + 1 :]
        else:
            data = data[: int(rng.integers(len(data)))]
    return data


CHILD = """
import json, resource, signal, sys, time
from pathlib import Path
import numpy as np
from lidar_core.errors import LidarCoreError
from lidar_core.io import read_cloud
import lazrs
folder, budget = Path(sys.argv[1]), int(sys.argv[2])
pages = int(Path("/proc/self/statm").read_text().split()[0])
resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + budget,) * 2)
resource.setrlimit(resource.RLIMIT_CPU, (240, 240))
for path in sorted(folder.iterdir()):
    started, said = time.process_time(), "read"
    print(path.name, flush=True)
    try:
        read_cloud(path)
    except LidarCoreError as error:
        said = type(error).__name__
        assert path.name in str(error), error
    except BaseException as error:
        said = "untyped " + repr(error)
    print(json.dumps([path.name, said, time.process_time() - started]), flush=True)
"""


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform != "linux", reason="limits of a child process are set by Linux")
def test_mutated_las_and_laz_files_end_in_typed_errors_or_are_read(tmp_path):
    """No abort of the process (it asked for 54 GB), no hang (40 s), no untyped error."""
    folder, rng = tmp_path / "files", np.random.default_rng(20)
    folder.mkdir()
    for suffix in (".las", ".laz"):
        for point_format, version in FORMATS.items():
            good = tmp_path / f"good{suffix}"
            las_file(good, version=version, point_format=point_format, extra=2)
            data = good.read_bytes()
            for number in range(MUTANTS):
                name = f"{point_format:02}_{number:03}{suffix}"
                (folder / name).write_bytes(mutant(data, rng))
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(folder), str(BUDGET)],
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    lines = done.stdout.splitlines()
    assert done.returncode == 0, (done.returncode, lines[-1:], done.stderr[-500:])
    told = [json.loads(line) for line in lines if line.startswith("[")]
    assert len(told) == 2 * len(FORMATS) * MUTANTS
    assert [one for one in told if one[1] not in ("read", "FormatError", "LimitError")] == []
    assert [one for one in told if one[2] > 2.0] == []
    kinds = {one[1] for one in told}
    assert kinds == {"read", "FormatError", "LimitError"}


@pytest.mark.parametrize("point_format", list(FORMATS))
@pytest.mark.parametrize("count", [1, 120_001])
@pytest.mark.parametrize("extra", [0, 3])
def test_las_and_laz_of_every_kind_are_read_as_before(tmp_path, point_format, count, extra):
    """Several chunks, extra bytes, one point: the same numbers as laspy gives."""
    for suffix in (".las", ".laz"):
        path = tmp_path / f"a{suffix}"
        points = las_file(
            path, version=FORMATS[point_format], point_format=point_format, count=count, extra=extra
        )
        places, intensity = read_las(path, ReadOptions())
        cloud = laspy.read(path)
        np.testing.assert_array_equal(places, np.stack([cloud.x, cloud.y, cloud.z], axis=1))
        np.testing.assert_allclose(places, points, atol=0.0006)
        np.testing.assert_array_equal(intensity, np.arange(count) % 1000)


@pytest.mark.parametrize("point_format", [0, 6])
def test_laz_with_chunks_of_different_sizes_is_read(tmp_path, point_format):
    """Chunks of 300, 7 and 93 points, whose numbers stand in the table: as COPC has them."""
    import io

    import lazrs

    las_file(tmp_path / "a.las", version=FORMATS[point_format], point_format=point_format)
    las_file(tmp_path / "a.laz", version=FORMATS[point_format], point_format=point_format)
    plain, packed = (tmp_path / "a.las").read_bytes(), (tmp_path / "a.laz").read_bytes()
    record, points_at = laszip_at(packed), struct.unpack_from("<I", packed, 96)[0]
    packed = changed(packed, record + 12, "<I", 2**32 - 1)
    length = 34 + 6 * struct.unpack_from("<H", packed, record + 32)[0]
    vlr = lazrs.LazVlr(packed[record : record + length])
    out = io.BytesIO()
    writer = lazrs.LasZipCompressor(out, vlr)
    first, size = struct.unpack_from("<I", plain, 96)[0], struct.unpack_from("<H", plain, 105)[0]
    rows = np.frombuffer(plain, np.uint8, COUNT * size, first)
    for start, end in ((0, 300), (300, 307), (307, COUNT)):
        writer.compress_many(rows[start * size : end * size])
        writer.finish_current_chunk()
    writer.done()
    body = bytearray(out.getvalue())
    body[:8] = struct.pack("<q", struct.unpack_from("<q", body)[0] + points_at)
    (tmp_path / "b.laz").write_bytes(packed[:points_at] + bytes(body))
    whole, _ = read_las(tmp_path / "a.las", ReadOptions())
    places, _ = read_las(tmp_path / "b.laz", ReadOptions())
    np.testing.assert_array_equal(places, whole)


def test_a_laz_file_states_why_it_is_refused(tmp_path):
    path = tmp_path / "a.laz"
    las_file(path, version="1.4", point_format=6)
    good = path.read_bytes()
    points_at, record = struct.unpack_from("<I", good, 96)[0], laszip_at(good)
    promised = POINTS_PER_BYTE * len(good) + 1

    def refused(data, error, match):
        path.write_bytes(data)
        with pytest.raises(error, match=match) as caught:
            lc.io.read_cloud(path)
        assert "a.laz" in str(caught.value)

    refused(
        changed(good, 247, "<Q", promised),
        LimitError,
        f"{promised} points .* compressed bytes; the limit",
    )
    refused(changed(good, 247, "<Q", 2**60), LimitError, "max_points")
    refused(
        changed(good, points_at + 8 + 30 + 4, "<I", 2**32 - 1),
        FormatError,
        "layers of the chunk at byte .* follow",
    )
    refused(changed(good, record + 32, "<H", 60_000), FormatError, "compressed parts")
    refused(changed(good, record + 12, "<I", 1), FormatError, "compressed data ends early")
    refused(good[: points_at + 60], FormatError, "table of chunks at byte")
    las_file(path, version="1.4", point_format=6, extra=250)
    refused(path.read_bytes(), LimitError, f"280 bytes, limit {MOST_RECORD}; unpack the file")


def test_a_las_file_that_was_cut_is_refused(tmp_path):
    path = Path(tmp_path / "a.las")
    las_file(path, version="1.2", point_format=0)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(FormatError, match=r"400 points of 20 bytes are stated, 7999 bytes follow"):
        lc.io.read_cloud(path)
