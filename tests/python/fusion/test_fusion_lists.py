"""Lists of Continental radars and of nuScenes, and texts of tables that cannot be read."""

import json
import shutil

import numpy as np
import pytest

from lidar_core.errors import FormatError
from lidar_core.fusion import (
    read_continental,
    read_measurements,
    read_nuscenes_boxes,
    read_nuscenes_radar,
)
from lidar_core.runs import fuse

SWEEP = "n015-2018-07-24-11-22-45+0800__RADAR_FRONT__{us}.pcd"
FIELDS = "x y z dyn_prop vx vy invalid_state ambig_state"


def objects(second, x, y=2.0, speed=-3.0, stds=0.1, name="objects"):
    """A message of an ARS548 with one object."""
    return f"""header:
  stamp: {{sec: {second // 10}, nanosec: {second % 10 * 100_000_000}}}
  frame_id: front
{name}:
  - object_id: 4
    position: {{x: {x}, y: {y}, z: 0.5}}
    position_std: {{x: {stds}, y: {stds}, z: 0.1}}
    position_covariance_xy: 0.0
    relative_velocity: {{x: {speed}, y: 0.0, z: 0.0}}
    relative_velocity_std: {{x: 0.2, y: 0.2, z: 0.0}}
    relative_velocity_covariance_xy: 0.0
"""


def sweep(folder, k, rows):
    """A radar sweep as nuScenes writes it, but in ASCII."""
    us = 1_532_402_927_000_000 + 77_000 * k
    types = "F F F I F F I I"
    head = (
        f"VERSION 0.7\nFIELDS {FIELDS}\nSIZE 4 4 4 1 4 4 1 1\nTYPE {types}\nCOUNT 1 1 1 1 1 1 1 1"
    )
    size = f"WIDTH {len(rows)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\nDATA ascii\n"
    text = "\n".join(" ".join(map(str, row)) for row in rows)
    path = folder / SWEEP.format(us=us)
    path.write_text(f"{head}\n{size}{text}\n")
    return path


# Continental


def test_recorded_lists_of_continental_radars_are_read(recordings):
    folder = recordings / "formats/nebula_continental_radar"
    (found,) = read_continental(next((folder / "ars548").glob("*_object.yaml")))
    first = found.measurements[0]
    place = np.array([10.1338, 4.85423])
    rate = place @ [-0.9102, 0.542119] / np.hypot(*place)
    values = [np.hypot(*place), np.arctan2(place[1], place[0]), rate]
    np.testing.assert_allclose(first.values, values, rtol=1e-12)
    # nearly across the line of sight, the bearing is as wrong as the place
    assert first.covariance is not None
    assert 0.05 < np.sqrt(first.covariance[0, 0]) < 0.1
    assert (len(found.measurements), found.source) == (50, "some_object_frame objects")
    (near,) = read_continental(next((folder / "srr520").glob("*_near_detection.yaml")))
    assert near.measurements[0].values.tolist() == [4.81074, 0.344959, -0.0293251]
    (standing,) = read_continental(next((folder / "srr520").glob("*_object.yaml")))
    place, own = np.array([26.9082, 1.72125]), 6.78121
    rate = standing.measurements[0].values[2]
    np.testing.assert_allclose(rate, -own * place[0] / np.hypot(*place), rtol=1e-5)


def test_messages_of_a_stream_are_fused_as_many_targets(tmp_path):
    text = "---\n".join(objects(k, 30 - 0.3 * k) for k in range(30))
    (tmp_path / "radar.yaml").write_text(text)
    run = fuse(tmp_path / "radar.yaml", None, tmp_path / "run", picture=False, mcap=False)
    assert (run.summary["format"], run.summary["tracks"]) == ("Continental", 1)
    assert run.summary["scans"] == {"front objects": 30}


def test_invalid_detections_and_values_are_left_out(tmp_path):
    head = "header: {stamp: {sec: 1, nanosec: 0}, frame_id: front}\ndetections:\n"
    rows = [
        "{range: 5.0, azimuth_angle: 0.1, elevation_angle: 0.2, range_rate: 1.0}",
        "{range: 5.0, azimuth_angle: 0.1, range_rate: 1.0, invalid_distance: true}",
        "{range: 5.0, azimuth_angle: 0.1, range_rate: 1.0, invalid_range_rate: true}",
        "{range: 0.0, azimuth_angle: 0.1, range_rate: 1.0}",
    ]
    (tmp_path / "one.yaml").write_text(head + "".join(f"  - {row}\n" for row in rows))
    (scan,) = read_continental(tmp_path / "one.yaml")
    assert [m.values.tolist() for m in scan.measurements] == [[5.0, 0.1, 0.2, 1.0], [5.0, 0.1]]
    assert [m.measures for m in scan.measurements][1] == ("range", "bearing")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (objects(0, "far"), "message 1, objects 1: position.x: expected a number, got 'far'"),
        (objects(0, 5.0).replace("position:", "place:"), "objects 1: no key position.x"),
        (objects(0, 5.0, name="obstacles"), "expected a list of objects or of detections"),
        ("objects: [", "cannot be read"),
        ("just text\n", "message 1: expected a list"),
        ("", "no list of a radar in it"),
        (objects(10**12, 5.0), "header.stamp: expected whole seconds and nanoseconds within 64"),
        (objects(0, 5.0).replace("sec: 0", "sec: 1.5", 1), "header.stamp: expected whole seconds"),
    ],
)
def test_what_is_no_list_of_a_radar_is_named(tmp_path, text, told):
    path = tmp_path / "radar.yaml"
    path.write_text(text)
    with pytest.raises(FormatError) as caught:
        read_continental(path)
    assert told in str(caught.value)
    assert str(path) in str(caught.value)


# nuScenes


def test_radar_sweeps_of_nuscenes_are_fused_without_invalid_returns(tmp_path):
    folder = tmp_path / "RADAR_FRONT"
    folder.mkdir()
    for k in range(25):
        target = (20 - 0.5 * k, 3, 0, 0, -6.5, 0, 0, 3)
        sweep(folder, k, [target, (9, 9, 0, 0, 0, 0, 1, 3), (9, 5, 0, 0, 0, 0, 0, 2)])
    scans = read_nuscenes_radar(folder)
    assert [len(scan.measurements) for scan in scans] == [1] * 25
    far, bearing, rate = scans[0].measurements[0].values
    np.testing.assert_allclose([far, bearing], [np.hypot(20, 3), np.arctan2(3, 20)], rtol=1e-6)
    np.testing.assert_allclose(rate, -6.5 * 20 / np.hypot(20, 3), rtol=1e-6)
    assert (scans[1].stamp_ns - scans[0].stamp_ns, scans[0].source) == (77_000_000, "RADAR_FRONT")
    run = fuse(folder, None, tmp_path / "run", picture=False, mcap=False)
    assert (run.summary["format"], run.summary["tracks"]) == ("nuScenes radar", 1)


def test_sweeps_without_times_or_velocities_are_refused(tmp_path):
    path = sweep(tmp_path, 0, [(1, 1, 0, 0, 0, 0, 0, 3)])
    with pytest.raises(FormatError, match="expected a name that ends with __CHANNEL__MICROSEC"):
        read_nuscenes_radar(shutil.copy(path, tmp_path / "front.pcd"))
    path.write_text(path.read_text().replace("vx", "ux"))
    with pytest.raises(FormatError, match="no field vx among"):
        read_nuscenes_radar(path)


def boxes(tokens, **other):
    box = {"translation": [600.0, 1600.0, 1.0], "detection_score": 0.6} | other
    weak = {"translation": [0.0, 0.0, 1.0], "detection_score": 0.05}
    return {"meta": {}, "results": {token: [box, weak] for token in tokens}}


def test_boxes_of_nuscenes_have_the_times_of_their_samples(tmp_path):
    path = tmp_path / "detections.json"
    path.write_text(json.dumps(boxes(["ab", "cd"])))
    with pytest.raises(FormatError, match=r"put sample\.json of nuScenes' tables"):
        read_nuscenes_boxes(path)
    times = [{"token": "cd", "timestamp": 1_500_000}, {"token": "ab", "timestamp": 2_000_000}]
    (tmp_path / "sample.json").write_text(json.dumps(times))
    scans = read_nuscenes_boxes(path)
    assert [scan.stamp_ns for scan in scans] == [1_500_000_000, 2_000_000_000]
    assert [m.values.tolist() for m in scans[0].measurements] == [[600.0, 1600.0]]
    (tmp_path / "sample.json").write_text(json.dumps(times[:1]))
    with pytest.raises(FormatError, match=r"sample ab is not in sample\.json"):
        read_nuscenes_boxes(path)
    path.write_text(json.dumps(boxes(["5"], translation=[1.0, None, 2.0])))
    (tmp_path / "sample.json").unlink()
    with pytest.raises(FormatError, match="sample 5, box 1: "):
        read_nuscenes_boxes(path)


def test_files_with_the_ending_of_a_list_are_told_what_lists_hold(tmp_path):
    (tmp_path / "a.yaml").write_text("name: robot\n")
    with pytest.raises(FormatError, match="expected a list of objects or of detections"):
        fuse(tmp_path / "a.yaml", None, tmp_path / "run")
    (tmp_path / "results.json").write_text('{"results": {"1": [{"size": [1, 1, 1]}]}}')
    with pytest.raises(FormatError, match="sample 1, box 1: expected a box with a translation"):
        read_nuscenes_boxes(tmp_path / "results.json")


# Tables


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.csv", "sep=;\nt_ns;x;y\n0;1,5;2\n"),
        ("a.csv", '"sep=;"\nt_ns;x;y\n0;1,5;2\n'),
        ("a.csv", "t_ns,x,y\n0,1.5,2\n"),
        ("a.csv", "t_ns,x,y,,\n0,1.5,2,,\n\n"),
        ("A.CSV", "t_ns,x,y\n0,1.5,2\n"),
        ("a.tsv", "t_ns\tx\ty\n0\t1.5\t2\n"),
        ("a.TSV", "sep=\t\nt_ns\tx\ty\n0\t1.5\t2\n"),
    ],
)
def test_tables_are_read_whatever_their_ending_and_separator(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    (m,) = read_measurements(tmp_path / name).measurements
    assert (m.sensor, m.values.tolist()) == ("lidar", [1.5, 2.0])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "expected a first line with the names of columns, got none"),
        ("\n\n", "expected a first line with the names of columns, got none"),
        ("t_ns,x,y\n", "no rows below the names of columns"),
        ("t_ns x y\n0 1 2\n", "expected commas, semicolons or tabs between the names of columns"),
        ("t_ns|x|y\n0|1|2\n", "expected commas between the names of columns, got 't_ns|x|y'"),
        ("t_ns;x,y\n0;1,2\n", "expected commas between the names of columns, got 't_ns;x,y'"),
        ("t_ns,x,x\n0,1,2\n", "column 'x' appears twice"),
        (
            "t_ns,x,y\n0,1,2\n1;2;3\n",
            "row 2: expected 3 values with commas between them, as the names of columns have,"
            " got 1 with semicolons: use one of both in all lines",
        ),
        ("t_ns;x;y\n0;1;2\n1,2,3\n", "got 1 with commas: use one of both"),
        ("t_ns,x,y\n0,1,2\n1,2\n", "row 2: expected 3 values with commas between them"),
        ("t_ns,x,y\n0,1,2\n1,2,left\n", "row 2: column y: expected a number, got 'left'"),
        ("t_ns,x,y\n0,1,2\nnoon,2,3\n", "row 2: column t_ns: expected a time"),
    ],
)
def test_tables_that_cannot_be_read_say_where_and_why(tmp_path, text, told):
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(FormatError) as caught:
        read_measurements(path)
    assert told in str(caught.value)
    assert str(path) in str(caught.value)
