"""Columns of a table that nothing reads: a note names them, and what they may be."""

from functools import partial

import pytest
from commands import invoke, json_of

from lidar_core.fusion import TableOptions, read_measurements, write_overflight
from lidar_core.runs import fuse
from lidar_core.sim import Overflight, overfly

command, result_of = partial(invoke, "fuse"), partial(json_of, "fuse")
STEP = 10**8


def table(folder, names, values, count=30):
    path = folder / "table.csv"
    lines = [f"t_ns,{names}", *(f"{STEP * k},{values}" for k in range(count))]
    path.write_text("\n".join(lines) + "\n")
    return path


def unused(folder, names, **options):
    """The note on a table with a LiDAR and these columns."""
    path = table(folder, f"x,y,{names}", ",".join(["5,2", *["1"] * len(names.split(","))]))
    return read_measurements(path, TableOptions(**options)).unused


def test_columns_that_look_like_known_ones_are_named_with_the_option(tmp_path):
    assert unused(tmp_path, "r_m,bearing_deg,range_rate") == (
        "columns r_m, bearing_deg are not used; did you mean"
        ' columns={"range": "r_m", "bearing": "bearing_deg"} angle_unit="deg"?'
    )


@pytest.mark.parametrize(
    ("name", "ours"),
    [
        ("Range", "range"),
        ("Range [m]", "range"),
        ("rangeM", "range"),
        ("distance", "range"),
        ("azimuth_rad", "bearing"),
        ("radial_velocity", "range_rate"),
        ("range_rat", "range_rate"),
        ("elev", "elevation"),
        ("Z", "z"),
        ("gt_x", "true_x"),
    ],
)
def test_usual_names_and_slips_are_known(tmp_path, name, ours):
    found = unused(tmp_path, name)
    assert f'column {name} is not used; did you mean columns={{"{ours}": "{name}"}}?' == found


@pytest.mark.parametrize("name", ["heading", "snr", "intensity", "frame", "vx", "quality"])
def test_other_columns_are_named_without_a_guess(tmp_path, name):
    assert unused(tmp_path, name) == f"column {name} is not used"


def test_long_lists_are_cut(tmp_path):
    found = unused(tmp_path, ",".join(f"extra{k}" for k in range(12)))
    assert found.endswith("extra6, extra7 and 4 more are not used")


@pytest.mark.parametrize(
    "names",
    [
        "range,bearing,range_rate",
        "elevation",
        "true_x,true_y,true_vx,true_vy,true_id,true_heading",
        "cov_x_x,cov_x_y,cov_y_y",
        "z,turn_rate",
        "pose_x,pose_y,pose_yaw,pose_std_x,pose_std_y,pose_std_yaw",
    ],
)
def test_known_columns_give_no_note(tmp_path, names):
    assert unused(tmp_path, names) is None


def test_mapped_columns_give_no_note(tmp_path):
    path = table(tmp_path, "px,py", "5,2")
    assert read_measurements(path, TableOptions(columns={"x": "px", "y": "py"})).unused is None
    path = table(tmp_path, "stamp,x,y", "7,5,2")
    assert read_measurements(path, TableOptions(columns={"t_ns": "stamp"})).unused is None


def test_a_value_whose_sensor_lacks_another_one_is_named(tmp_path):
    path = table(tmp_path, "x,range,bearing,pose_x,lat", "5,5,0.1,1,59")
    assert read_measurements(path).unused == "columns x, pose_x, lat are not used"


def test_places_on_the_earth_and_simulated_flights_give_no_note(tmp_path):
    path = table(tmp_path, "lat,lon,alt", "59.3,10.7,5")
    assert read_measurements(path).unused is None
    write_overflight(tmp_path / "drone.csv", overfly(Overflight(seconds=1.0), seed=0))
    assert read_measurements(tmp_path / "drone.csv").unused is None


@pytest.mark.parametrize("many", [(), ("--association", "integrated")])
def test_the_command_prints_the_note(tmp_path, many):
    path = table(tmp_path, "x,y,r_m,range_rate", "5,2,5.4,0")
    done = command(path, "-o", tmp_path / "run", "--no-picture", *many)
    assert done.exit_code == 0
    note = "note: column r_m is not used; did you mean --column range=r_m?"
    assert note in " ".join(done.stderr.split())


def test_the_table_of_results_tells_what_was_measured(tmp_path):
    path = table(tmp_path, "x,y,range_rate", "5,2,0")
    done = command(path, "-o", tmp_path / "a", "--no-picture")
    lines = [" ".join(line.replace("│", " ").split()) for line in done.output.splitlines()]
    assert "lidar measured x, y" in lines
    assert "radar measured range_rate" in lines
    summary = result_of(path, "-o", tmp_path / "b", "--no-picture")
    assert summary["measured"] == {"lidar": ["x", "y"], "radar": ["range_rate"]}


def test_no_note_is_given_on_a_right_table(tmp_path):
    path = table(tmp_path, "x,y,range,bearing,range_rate", "5,2,5.39,.38,0")
    assert fuse(path, None, tmp_path / "run", picture=False, mcap=False).notes == ()
