"""Circle maps against the truth: in the plane, with radii, through files and the command."""

import csv
import json

import numpy as np
import pytest
from circle_states import Circles
from typer.testing import CliRunner

import lidar_core.io
from lidar_core.cli import app
from lidar_core.errors import FormatError
from lidar_core.evaluation import Estimates, Truth, evaluate, read_prediction, read_truth

SCANS, STEP_NS = 40, 50_000_000
TRUE_RADIUS, OFFSET, RADIUS_ERROR = 0.3, (0.03, -0.04), 0.01


def maps():
    """One element that is 0.05 m away from its object, and 0.01 m too large."""
    spread = np.diag([0.03, 0.04, 1.0, 1.0, 0.01]) ** 2
    for number in range(SCANS):
        t = number * STEP_NS * 1e-9
        yield Circles(
            id=np.array([7]),
            center=np.array([[3 + t + OFFSET[0], 1 + OFFSET[1]]]),
            velocity=np.array([[1.0, 0.0]]),
            radius=np.array([TRUE_RADIUS + RADIUS_ERROR]),
            covariance=spread[None],
            age=np.array([t]),
            visible=np.array([True]),
            stamp_ns=number * STEP_NS,
        )


@pytest.fixture
def files(tmp_path):
    table = lidar_core.io.write_circles_table(tmp_path / "circles.csv", maps())
    truth = tmp_path / "a.truth.csv"
    columns = (
        "t_ns",
        "target_id",
        "kind",
        "x",
        "y",
        "vx",
        "vy",
        "radius",
        "hits",
        "sensor_x",
        "sensor_y",
        "sensor_z",
    )
    with truth.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(columns)
        for number in range(SCANS):
            t = number * STEP_NS * 1e-9
            rows.writerow(
                [number * STEP_NS, 1, "cylinder", 3 + t, 1, 1, 0, TRUE_RADIUS, 20, 0, 0, 1.0]
            )
    return table, truth


def test_what_is_not_round_has_no_radius_to_compare(files):
    table, truth = files
    first, *rows = truth.read_text().splitlines()
    person = [
        row.replace(f",{TRUE_RADIUS},", ",nan,").replace("cylinder", "person") for row in rows[:-1]
    ]
    truth.write_text("\n".join([first, *person, rows[-1]]) + "\n")
    scores = evaluate(read_truth(truth), tracks=read_prediction(table).tracks).tracks
    assert scores.position_error.count == SCANS
    assert scores.radius_error.count == 1
    truth.write_text(truth.read_text().replace(",nan,", ",inf,"))
    with pytest.raises(FormatError, match="radius"):
        read_truth(truth)


def test_errors_of_centres_radii_and_velocities(files):
    table, truth = files
    prediction = read_prediction(table)
    assert prediction.is_planar
    scores = evaluate(read_truth(truth), tracks=prediction.tracks).tracks
    assert scores.position_error.rmse == pytest.approx(0.05)
    assert scores.radius_error.mean == pytest.approx(RADIUS_ERROR)
    assert scores.velocity_error.largest == pytest.approx(0)
    assert scores.position_nees.degrees == 2
    assert scores.position_nees.mean == pytest.approx(2)
    assert scores.state_nees.degrees == 4
    assert scores.state_nees.mean == pytest.approx(2)


def test_heights_of_a_truth_in_space_are_left_out(files, tmp_path):
    table, truth = files
    with truth.open() as file:
        rows = list(csv.reader(file))
    rows = [[*row, "z" if n == 0 else "1.5"] for n, row in enumerate(rows)]
    with truth.open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    found = read_truth(truth, is_planar=True)
    np.testing.assert_array_equal(found.position[:, 2], 0)
    np.testing.assert_array_equal(found.sensor[:, 2], 0)
    assert read_truth(truth).radius is None
    scores = evaluate(found, tracks=read_prediction(table).tracks).tracks
    assert scores.position_error.rmse == pytest.approx(0.05)


def test_the_command_prints_radius_errors(files):
    table, truth = files
    out = CliRunner().invoke(
        app, ["evaluate", str(table), str(truth), "--burn-in", "0", "--json", "-"]
    )
    assert out.exit_code == 0, out.output
    tracks = json.loads(out.stdout)["track_scores"]
    assert tracks["n_found"] == SCANS
    assert tracks["radius_error"]["mean"] == pytest.approx(RADIUS_ERROR)
    assert "radius error" in CliRunner().invoke(app, ["evaluate", str(table), str(truth)]).stdout


def test_a_table_without_heights_and_radii_is_incomplete(tmp_path):
    (tmp_path / "a.csv").write_text("t_ns,track_id,x,y\n1,2,3,4\n")
    with pytest.raises(FormatError, match="no column z"):
        read_prediction(tmp_path / "a.csv")


def test_radii_are_scored_where_both_are_known():
    stamps = np.zeros(1, np.int64)
    truth = Truth(stamps, np.array([1]), np.zeros((1, 3)), np.ones(1, bool), radius=np.ones(1))
    estimates = Estimates(stamps, np.zeros((1, 3)), np.array([1]), radius=np.array([0.75]))
    assert evaluate(truth, tracks=estimates).tracks.radius_error.mean == -0.25
    bare = Estimates(stamps, np.zeros((1, 3)), np.array([1]))
    assert evaluate(truth, tracks=bare).tracks.radius_error is None
