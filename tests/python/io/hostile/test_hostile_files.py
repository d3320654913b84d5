"""Files made to do harm: every one ends in a typed error that names it, and soon."""

import json
import sqlite3
import struct
import subprocess
import sys
import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from ros_files import Ros

from lidar_core.batch import BatchConfig, jobs_of
from lidar_core.errors import ConfigError, FormatError, InputError, LimitError
from lidar_core.evaluation import read_prediction
from lidar_core.flying import FlyingConfig, FlyingObjectDetector
from lidar_core.io import open_recording, read_cloud, read_columns, write_recording
from lidar_core.io.files.guard import reading
from lidar_core.io.poses.pose_files import read_poses
from lidar_core.messages import LaserScan, Scan
from lidar_core.runs.settings import run_config

BASE_NS = 1_700_000_000_000_000_000
SWEEP = LaserScan(1, np.ones(9, np.float32), 0, 0.1, 0, 9)


def messages_of(path):
    with open_recording(path) as recording:
        return list(recording)


@pytest.mark.parametrize("time", ["1e20", "1700000000000000000", "-1e300", "9" * 40])
def test_a_time_of_a_tum_file_beyond_int64_is_refused(tmp_path, time):
    path = tmp_path / "poses.txt"
    path.write_text(f"1.0 0 0 0 0 0 0 1\n{time} 0 0 0 0 0 0 1\n")
    with pytest.raises(FormatError, match=r"poses\.txt, pose 1: expected a time in seconds"):
        read_poses(path)


def test_comments_of_a_tum_file_are_no_poses(tmp_path):
    path = tmp_path / "poses.txt"
    path.write_text("  # t x y z\n\n1.5 0 0 0 0 0 0 1 # here\n2.5 0 0 0 0 0 0 1\n")
    stamps, matrices = read_poses(path)
    assert stamps.tolist() == [1_500_000_000, 2_500_000_000]
    assert len(matrices) == 2


@pytest.mark.parametrize("time", ["1e20", "nan", "inf"])
def test_a_time_of_a_sequence_beyond_int64_is_refused(tmp_path, time):
    for number in range(2):
        np.ones((3, 4), np.float32).tofile(tmp_path / f"{number}.bin")
    (tmp_path / "times.txt").write_text(f"0.0\n{time}\n")
    with pytest.raises(FormatError, match=r"times\.txt: expected times in seconds"):
        messages_of(tmp_path)


def test_a_name_that_is_no_time_of_int64_is_a_number(tmp_path):
    path = tmp_path / "9999999999999999999.bin"
    np.ones((3, 4), np.float32).tofile(path)
    (scan,) = messages_of(path)
    assert scan.stamp_ns == 0


def stl_of(corner):
    triangle = np.zeros(1, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    triangle["corners"][0] = [[0, 0, 0], [1, 0, 0], corner]
    return bytes(80) + struct.pack("<I", 1) + triangle.tobytes()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_mesh_with_corners_that_are_not_finite_is_refused(tmp_path, bad):
    path = tmp_path / "bad.stl"
    path.write_bytes(stl_of([0, 1, bad]))
    with pytest.raises(FormatError, match=r"bad\.stl: a corner of the surface is not finite"):
        read_cloud(path)


@pytest.mark.parametrize("corner", [7, -5])
def test_a_face_that_names_no_vertex_is_refused(tmp_path, corner):
    path = tmp_path / "bad.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        f"0 0 0\n1 0 0\n0 1 0\n3 0 1 {corner}\n"
    )
    with pytest.raises(FormatError, match=r"bad\.ply: "):
        read_cloud(path)


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ("no_return x y", "no field z"),
        ("no_return", "no field x, y, z"),
        ("x y z dx no_return", "no field dy, dz"),
    ],
)
def test_a_cloud_with_some_of_our_fields_is_refused(tmp_path, fields, told):
    names = fields.split()
    ones = " ".join("1" for _ in names)
    head = (
        f"VERSION .7\nFIELDS {fields}\nSIZE {'4 ' * len(names)}\nTYPE {'F ' * len(names)}\n"
        f"COUNT {ones}\nWIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA ascii\n"
    )
    path = tmp_path / "own.pcd"
    path.write_text(head + f"{ones}\n{ones}\n")
    with pytest.raises(FormatError, match=told):
        messages_of(path)


@pytest.mark.parametrize("column", ["data", "timestamp"])
def test_text_in_a_database_is_refused(tmp_path, column):
    ros = Ros(2)
    rows = np.zeros(3, np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")]))
    items = [("/points", BASE_NS + n, ros.cloud(rows, BASE_NS + n, "lidar")) for n in range(3)]
    folder = ros.write(tmp_path / "bag", items, "sqlite3")
    (file,) = folder.glob("*.db3")
    with sqlite3.connect(file) as database:
        database.execute(f"UPDATE messages SET {column} = 'not that' WHERE id = 2")
    database.close()
    with pytest.raises(FormatError, match=r"bag_?.*\.db3, message"):
        messages_of(file)


def npz_with(path, shape, data):
    head = BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(head, header)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("t_ns.npy", head.getvalue() + data)
    return path


def test_a_table_whose_header_promises_a_hundred_billion_rows_is_refused(tmp_path):
    path = npz_with(tmp_path / "table.npz", (100_000_000_000,), bytes(64))
    assert path.stat().st_size < 600
    with pytest.raises(FormatError, match=r"column t_ns: header states float64 \(100000000000,\)"):
        read_columns(path)
    good = npz_with(tmp_path / "good.npz", (8,), bytes(64))
    assert read_columns(good)["t_ns"].tolist() == [0.0] * 8


def compressed_pcd(points, packed, unpacked, data):
    head = (
        f"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {points}\n"
        f"HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA binary_compressed\n"
    )
    return head.encode() + struct.pack("<II", packed, unpacked) + data


@pytest.mark.parametrize(
    ("points", "packed", "unpacked"),
    [(3, 8, 2**32 - 1), (3, 2**32 - 1, 36), (4_000_000, 8, 48_000_000), (3, 8, 35)],
)
def test_a_compressed_pcd_that_lies_about_its_size_is_refused(tmp_path, points, packed, unpacked):
    path = tmp_path / "lie.pcd"
    path.write_bytes(compressed_pcd(points, packed, unpacked, bytes(8)))
    assert path.stat().st_size < 220
    with pytest.raises(FormatError, match=r"lie\.pcd: states \d+ bytes that unpack to"):
        messages_of(path)


def test_a_compressed_pcd_without_its_sizes_is_refused(tmp_path):
    path = tmp_path / "short.pcd"
    path.write_bytes(compressed_pcd(3, 8, 36, b"")[:-4])
    with pytest.raises(FormatError, match="ends before the sizes"):
        messages_of(path)


TOO_MUCH_TOML = {
    "nested": "a = " + "[" * 20_000,
    "tables": "a = " + "{b = " * 20_000,
    "digits": "a = " + "9" * 5_000,
    "letters": b"a = '\xff'",
}


@pytest.mark.parametrize("name", TOO_MUCH_TOML)
def test_toml_beyond_reason_is_refused(tmp_path, name):
    text = TOO_MUCH_TOML[name]
    path = tmp_path / "config.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ConfigError, match=r"config\.toml: expected TOML"):
        FlyingConfig.read(path)
    with pytest.raises(ConfigError, match=r"config\.toml: expected TOML"):
        run_config(FlyingConfig(), "flying", path, [])
    run = tmp_path / "run"
    run.mkdir()
    (run / "run.toml").write_bytes(path.read_bytes())
    (run / "tracks.csv").write_text("t_ns,track_id,x,y,z\n1,1,0,0,0\n")
    with pytest.raises(FormatError, match=r"run\.toml"):
        read_prediction(run)
    if not isinstance(text, bytes):
        with pytest.raises(ConfigError):
            run_config(FlyingConfig(), "flying", None, [text])


def test_a_configuration_longer_than_anybody_writes_is_refused(tmp_path):
    path = tmp_path / "config.toml"
    path.write_text("# nothing\n" * 500_000)
    with pytest.raises(LimitError, match=r"config\.toml: more than 4194304 bytes"):
        FlyingConfig.read(path)


@pytest.mark.parametrize(
    "group",
    [
        {"ranges": {"seed": [0, 10**12]}},
        {"ranges": {"seed": [-(10**30), 10**30]}},
        {"ranges": {"seed": [0, 999], "more": [0, 999]}, "commands": ["demo --seed {seed}{more}"]},
    ],
)
def test_a_batch_of_a_million_million_jobs_is_refused(tmp_path, group):
    made = {"name": "many", "commands": ["demo --seed {seed} -o {output}"], **group}
    config = BatchConfig.load({"jobs": [made]})
    with pytest.raises(LimitError, match=r"jobs\.many: \d+ jobs of all combinations, limit 100000"):
        jobs_of(config, tmp_path)


@pytest.mark.ci_cases("command0")
@pytest.mark.skipif(sys.platform != "linux", reason="names of files are bytes on Linux")
@pytest.mark.parametrize(
    "command",
    [
        ["simulate", "circles", "--scans", "2", "-o", "\udcff.npz"],
        ["demo", "--scans", "2", "--no-picture", "-o", "\udcff"],
        ["config", "init", "-o", "\udcff.toml"],
        ["circles", "in.npz", "--pose", "static", "-o", "\udcff"],
        ["convert", "in.npz", "\udcff.mcap"],
    ],
)
def test_a_name_to_write_that_is_no_utf8_is_refused(tmp_path, command):
    write_recording(tmp_path / "in.npz", [SWEEP])
    done = subprocess.run(
        [sys.executable, "-m", "lidar_core", *command],
        cwd=tmp_path,
        timeout=60,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith(b"error: expected a file name in UTF-8")
    assert done.stderr.count(b"\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["in.npz"]


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are bytes on Linux")
def test_a_recording_whose_name_is_no_utf8_can_be_read(tmp_path):
    path = tmp_path / "\udcff.npz"
    write_recording(tmp_path / "in.npz", [SWEEP])
    (tmp_path / "in.npz").rename(path)
    run = tmp_path / "run"
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "lidar_core",
            "circles",
            str(path),
            "--pose",
            "static",
            "-o",
            str(run),
            "--no-picture",
            "--no-mcap",
        ],
        timeout=60,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "?.npz" in (run / "run.toml").read_text(encoding="utf-8")
    assert json.loads((run / "summary.json").read_text())["scans"]["received"] == 1


@pytest.mark.parametrize("name", ["\udcff", "li\ndar", "\x00"])
def test_a_sensor_whose_name_cannot_be_printed_is_refused(name):
    detector = FlyingObjectDetector()
    with pytest.raises(InputError, match="sensor: expected a name that can be printed"):
        detector.process(np.ones((3, 3), np.float32), np.eye(4), 1, sensor=name)
    assert detector.health().processed == 0


def test_a_configuration_of_a_sensor_whose_name_is_no_text_is_refused():
    with pytest.raises(ConfigError, match="sensors"):
        FlyingConfig(sensors={"\udcff": {}})


def test_a_library_that_runs_out_of_memory_is_a_limit():
    with pytest.raises(LimitError, match=r"a\.pcd: takes more memory than available"):  # noqa: SIM117
        with reading("a.pcd"):
            np.empty(2**62, np.uint8)


def test_a_command_that_runs_out_of_memory_says_so_in_a_line(monkeypatch, capsys):
    from lidar_core import cli

    def nothing_left():
        raise MemoryError("Unable to allocate 7 EiB")

    monkeypatch.setattr(cli, "app", nothing_left)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    assert (
        capsys.readouterr().err
        == "error: takes more memory than available: Unable to allocate 7 EiB\n"
    )


@pytest.mark.parametrize("read", [open_recording, read_columns])
def test_an_archive_that_was_cut_says_so(tmp_path, read):
    write_recording(tmp_path / "a.npz", [SWEEP])
    whole = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FormatError) as raised:
        read(tmp_path / "cut.npz")
    text = str(raised.value)
    assert f"cut.npz: cannot be read: the file ends at byte {len(whole) // 2} without" in text
    assert "seems to be cut off, or is no .npz file" in text
    assert "BadZipFile" not in text


def test_one_scan_of_a_plain_archive_is_still_read(tmp_path):
    path = tmp_path / "points.npz"
    np.savez(path, points=np.ones((4, 3), np.float32))
    (scan,) = messages_of(path)
    assert isinstance(scan, Scan)
    assert Path(path).is_file()
