"""Covariances of detected circles against the truth, in the scene of the tour, both ways."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from repository import ROOT
from typer.testing import CliRunner

from lidar_core.circles import CirclePipeline, CirclesConfig, Scanner
from lidar_core.cli import app
from lidar_core.evaluation import Consistency, consistency, evaluate, read_prediction, read_truth
from lidar_core.io import open_recording, posed_laser_scans, read_columns

PAGE = ROOT / "docs" / "tour-circles.md"
BOUNDS = (1.6, 2.4)  # 400 values of 2 degrees of freedom lie within 2 +- 0.28 in 99.5 of 100 runs
"""Bounds of the mean NEES of positions in the plane: inflation fails as overconfidence does."""


def run_command(*arguments):
    out = CliRunner().invoke(app, [*map(str, arguments)])
    assert out.exit_code == 0, out.output
    return out.stdout


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    """Recording, truth and run of the tour: a swinging sensor, a post and a barrel that moves."""
    folder = tmp_path_factory.mktemp("hall")
    text = re.search(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[1]
    (folder / "hall.toml").write_text(text)
    run_command("simulate", folder / "hall.toml", "-o", folder / "hall.mcap")
    run_command("circles", folder / "hall.mcap", "-o", folder / "hall", "--no-picture")
    return folder


def detections_nees(prediction, truth) -> Consistency:
    report = evaluate(truth, tracks=prediction.tracks, detections=prediction.detections)
    return report.detections.position_nees


def test_detections_of_the_tour_are_as_far_off_as_their_covariances_say(hall):
    out = run_command("evaluate", hall / "hall", hall / "hall.truth.csv", "--json", "-")
    result = json.loads(out)
    nees = result["detection_scores"]["position_nees"]
    assert nees["count"] == 400
    assert BOUNDS[0] < nees["mean"] < BOUNDS[1]
    assert nees["share_inside"] > 0.9
    assert result["warnings"] == []


def test_the_page_of_the_tour_prints_the_number_of_the_tour(hall):
    shown = re.search(r"NEES of positions +\| +([\d.]+)", PAGE.read_text(encoding="utf-8"))
    result = json.loads(
        run_command("evaluate", hall / "hall", hall / "hall.truth.csv", "--json", "-")
    )
    nees = result["detection_scores"]["position_nees"]["mean"]
    assert float(shown[1]) == pytest.approx(nees, abs=0.02)


@pytest.mark.parametrize(("factor", "size"), [(4.0, "large"), (0.25, "small")])
def test_covariances_that_are_inflated_or_too_small_are_told(hall, factor, size):
    prediction, truth = read_prediction(hall / "hall"), read_truth(hall / "hall.truth.csv")
    right = detections_nees(prediction, truth)
    assert right.warning is None
    wrong = replace(prediction.detections, covariance=factor * prediction.detections.covariance)
    found = detections_nees(replace(prediction, detections=wrong), truth)
    assert not BOUNDS[0] < found.mean < BOUNDS[1]
    assert found.warning.endswith(f"which are too {size}")
    assert f"NEES {found.mean:.2f} where 2 is right" in found.warning


def test_the_command_warns_if_detections_have_no_times_of_their_own(hall):
    """As every run did before: the barrel is held against where it was up to 19 ms earlier."""
    prediction, truth = read_prediction(hall / "hall"), read_truth(hall / "hall.truth.csv")
    timeless = replace(prediction.detections, time_ns=None)
    found = detections_nees(replace(prediction, detections=timeless), truth)
    assert found.mean > 10
    tracks = hall / "hall" / "circles.parquet"
    table = read_columns(tracks)
    small = {
        name: column * 0.1 if name.startswith("cov_") else column
        for name, column in table.items()
        if name not in ("frame_id", "kind")
    }
    np.savez(hall / "small.npz", **small)
    out = run_command("evaluate", hall / "small.npz", hall / "hall.truth.csv")
    assert "warning: tracks: NEES" in out
    assert "which are too small; likely causes" in " ".join(out.split())


def test_a_few_values_are_no_ground_for_a_warning():
    assert consistency([40.0] * 49, degrees=2).warning is None
    assert "too small" in consistency([40.0] * 50, degrees=2).warning
    assert "errors are 200 times as large" in consistency([80_000.0] * 50, degrees=2).warning


def test_every_circle_says_when_it_was_measured(hall):
    with open_recording(hall / "hall.mcap") as recording:
        scans = list(posed_laser_scans(recording))[:5]
    first = scans[0].scan
    scanner = Scanner(first.angle_min, first.angle_increment, len(first.ranges), 0.1, 10.0)
    pipeline = CirclePipeline(CirclesConfig(scanner=scanner))
    for item in scans:
        frame = pipeline.process(item)
        segments, scan = frame.segments, item.scan
        for number, time_ns in enumerate(frame.time_ns.tolist()):
            rays = segments.rays[segments.starts[number] : segments.starts[number + 1]]
            assert time_ns - scan.stamp_ns == pytest.approx(
                rays.mean() * scan.time_increment_ns, abs=1
            )
    still = pipeline.process(scan.ranges, item.world_from_lidar[0], scan.stamp_ns + 10**9)
    assert set(still.time_ns.tolist()) == {still.stamp_ns}
