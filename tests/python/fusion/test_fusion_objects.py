"""Object lists of radars, and tables with other separators."""

import tarfile

import numpy as np
import pytest
from typer.testing import CliRunner

from lidar_core.cli import app
from lidar_core.errors import FormatError
from lidar_core.fusion import read_delphi, read_measurements
from lidar_core.fusion.recordings.delphi import is_delphi
from lidar_core.runs import fuse

NAMES = "time_ns,trackID,scan_index,track_angle_rad,track_range_m,track_range_rate_m_per_s"
START_NS = 1_619_075_998_575_005_952


def lists(folder, scans, name="objects.csv", names=NAMES):
    """A file of scans 50 ms apart, each a list of (slot, angle, range, rate), 0.25 ms per slot."""
    folder.mkdir(exist_ok=True)
    rows = [
        f"{START_NS + 50_000_000 * k + 250_000 * n},{slot},0,{angle},{far},{rate}"
        for k, scan in scans
        for n, (slot, angle, far, rate) in enumerate(scan)
    ]
    (folder / name).write_text("\n".join([names, *rows, ""]))
    return folder / name


def approach(k):
    """A target 40 m ahead to the right that comes at 10 m/s, and an empty slot."""
    return [(8, 0.1, 40 - 0.5 * k, -10.0), (9, 0.0, 0.0, 81.91)]


def test_scans_of_object_lists_have_bearings_to_the_left_and_no_empty_slots(tmp_path):
    scans = [(0, approach(0)), (1, [(8, 0.0, 0.0, 81.91)]), (2, approach(2) + approach(2)[:1])]
    found = read_delphi(lists(tmp_path, scans))
    # A slot that comes again begins another scan, also without a pause.
    assert [len(scan.measurements) for scan in found] == [1, 0, 1, 1]
    assert found[0].stamp_ns == START_NS  # not rounded to what float64 holds
    assert found[0].measurements[0].values.tolist() == [40.0, -0.1, -10.0]
    assert {scan.source for scan in found} == {"radar"}


def test_a_folder_of_object_lists_is_fused_as_many_targets(tmp_path):
    folder = tmp_path / "lists"
    for part in (1, 0):
        lists(folder, [(k, approach(k)) for k in range(20 * part, 20 * part + 20)], f"{part}.csv")
    assert is_delphi(folder)
    told = CliRunner().invoke(
        app, ["fuse", str(folder), "-o", str(tmp_path / "run"), "--no-picture"]
    )
    assert told.exit_code == 0, told.output
    summary = fuse(folder, None, tmp_path / "again", picture=False).summary
    assert (summary["format"], summary["tracks"]) == ("Delphi ESR", 1)
    assert summary["scans"] == {"radar": 40}


@pytest.mark.parametrize(
    ("names", "row", "text"),
    [
        (NAMES.replace("track_angle_rad", "angle"), "1,1,0,0,5,1", "no column track_angle_rad"),
        (NAMES, "1,1,0,left,5,1", "row 1: column track_angle_rad: expected a number, got 'left'"),
        (NAMES, "1,1,0,nan,5,1", "row 1: column track_angle_rad: expected a number, got nan"),
        (NAMES, "1e9,1,0,0,5,1", "row 1: column time_ns: expected whole nanoseconds, got"),
    ],
)
def test_what_is_no_object_list_is_named(tmp_path, names, row, text):
    path = tmp_path / "objects.csv"
    path.write_text(f"{names}\n{row}\n")
    with pytest.raises(FormatError) as caught:
        read_delphi(path)
    assert text in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_recorded_list_is_whole(recordings, tmp_path):
    archive = recordings / "radar/delphi_esr/front_radar_15-19-58_120s.tar.xz"
    with tarfile.open(archive) as files:
        first = files.next()
        content = files.extractfile(first).read()
    (tmp_path / "part.csv").write_bytes(content)
    found = read_delphi(tmp_path / "part.csv")
    assert len(found) == 11  # the first and the last scan are cut
    assert all(0 < len(scan.measurements) <= 64 for scan in found)
    assert np.diff([scan.stamp_ns for scan in found]).min() > 10_000_000


@pytest.mark.parametrize("separator", [";", "\t"])
def test_a_table_may_have_semicolons_or_tabs_and_decimal_commas(tmp_path, separator):
    text = "t_ns,sensor,x,y\n0,L,1.5,-2e1\n5,L,.25,3\n".replace(",", separator)
    for name, content in (("points.csv", text), ("commas.csv", text.replace(".", ","))):
        (tmp_path / name).write_text(content)
        log = read_measurements(tmp_path / name)
        assert [m.values.tolist() for m in log.measurements] == [[1.5, -20.0], [0.25, 3.0]]
    (tmp_path / "short.csv").write_text(f"{text}7{separator}L\n")
    with pytest.raises(
        FormatError, match=r"row 3: expected 4 values with .* between them, .* got 2"
    ):
        read_measurements(tmp_path / "short.csv")


def test_a_text_with_a_comma_stays_what_it_is(tmp_path):
    (tmp_path / "words.csv").write_text("t_ns;sensor;x;y\n0;L,1;1;2\n")
    with pytest.raises(FormatError, match=r"column sensor: expected one of .*got 'L,1'"):
        read_measurements(tmp_path / "words.csv")


def test_a_list_without_rows_is_told(tmp_path):
    with pytest.raises(FormatError, match=r"objects\.csv: no rows in this file"):
        read_delphi(lists(tmp_path / "a", []))


def test_a_table_may_begin_with_a_byte_order_mark(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t_ns,sensor,x,y\n0,L,1.5,-2\n", encoding="utf-8-sig")
    (row,) = read_measurements(path).measurements
    np.testing.assert_array_equal(row.values, [1.5, -2])
    objects = lists(tmp_path / "b", [(0, [(1, 0.1, 20.0, 1.0)])])
    objects.write_text(objects.read_text(), encoding="utf-8-sig")
    assert is_delphi(objects)
    assert len(read_delphi(objects)) == 1
