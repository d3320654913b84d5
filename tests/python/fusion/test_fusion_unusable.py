"""Measurements that a filter cannot use: refused or counted, with the reason; times stay times."""

from functools import partial

import numpy as np
import pytest
from commands import invoke, json_of

from lidar_core.errors import InputError
from lidar_core.fusion import (
    FusionConfig,
    Measurement,
    Measurements,
    TargetFilter,
    run,
    run_batch,
    smooth,
)
from lidar_core.fusion.unusable import lacks_heights, reasons
from lidar_core.io.tables.columns import read_columns
from lidar_core.runs import fuse

command, result_of = partial(invoke, "fuse"), partial(json_of, "fuse")
STEP = 10**8


def table(folder, lines):
    path = folder / "table.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def flat(folder, count=30):
    return table(
        folder, ["t_ns,x,y", *(f"{k * STEP},{5 + 0.1 * k},{2 + 0.05 * k}" for k in range(count))]
    )


@pytest.mark.parametrize(
    ("options", "cure"),
    [
        (("--model", "ctrv-3d"), "use --model ctrv, or add"),
        (("--model", "cv-3d", "--fit-noise"), "use --model cv, or add"),
        (("--method", "imm", "--set", 'imm_models=["cv-3d"]'), "use models in the plane, or add"),
    ],
)
def test_places_without_a_height_start_no_target_in_space(tmp_path, options, cure):
    out = command(flat(tmp_path), "-o", tmp_path / "run", *options)
    assert isinstance(out.exception, InputError), out.output
    assert cure in str(out.exception)
    assert "--column z=NAME" in str(out.exception)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("seen", "model"),
    [
        ([Measurement(0, "lidar", [1.0, 2.0])], "ctrv"),
        ([Measurement(0, "lidar", [1.0, 2.0]), Measurement(1, "lidar", [1.0, 2.0, 3.0])], "cv-3d"),
        ([Measurement(0, "radar", [5.0, 0.1, 0.2, 1.0])], "cv-3d"),
        ([Measurement(0, "radar", [0.1, 0.2], measures=["bearing", "elevation"])], "cv-3d"),
    ],
)
def test_one_height_is_enough_and_planes_need_none(seen, model):
    assert lacks_heights(seen, FusionConfig(model=model)) is None


def test_one_height_starts_a_target_that_x_and_y_then_correct(tmp_path):
    lines = ["t_ns,x,y,z", "0,5,2,1", *(f"{k * STEP},{5 + 0.1 * k},2," for k in range(1, 30))]
    summary = fuse(
        table(tmp_path, lines), None, tmp_path / "run", model="cv-3d", picture=False
    ).summary
    assert summary["outcomes"] == {"started": 1, "updated": 29}
    assert summary["invalid"] == {}


def test_invalid_measurements_have_their_reason_in_summary_and_table(tmp_path):
    lines = ["t_ns,bearing", *(f"{k * STEP},0.{k}" for k in range(10))]
    path = table(tmp_path, lines)
    told = {"no position to start from: a radar needs range and bearing": 10}
    summary = result_of(path, "-o", tmp_path / "a", "--no-picture")
    assert summary["invalid"] == told
    assert summary["duration"] == pytest.approx(0.9)
    printed = command(path, "-o", tmp_path / "b", "--no-picture").output
    assert "no position to start from" in printed
    assert "0.9 s" in printed
    states = read_columns(next((tmp_path / "a").glob("states.*")))
    np.testing.assert_array_equal(states["t_ns"], STEP * np.arange(10))
    right = command(flat(tmp_path), "-o", tmp_path / "c", "--no-picture").output
    assert "no position to start from" not in right
    assert "30 lidar" in right


@pytest.mark.parametrize(
    ("measurement", "model", "told"),
    [
        (Measurement(0, "radar", [-1.0, 0.1, 0.0]), "cv", "ranges of 0 or less"),
        (Measurement(0, "lidar", [np.nan, 1.0]), "cv", "not finite"),
        (Measurement(0, "lidar", [1.0, 1.0]), "cv-3d", "no height to start from"),
        (Measurement(0, "radar", [1.0, 1.0, 0.0]), "cv-3d", "range, bearing and elevation"),
        (Measurement(0, "radar", [0.1], measures=["elevation"]), "cv", "elevation alone"),
        (Measurement(0, "radar", [5.0, 0.1, np.pi / 2, 0.0]), "cv", "overhead"),
    ],
)
def test_every_reason_is_that_of_the_filter(measurement, model, told):
    config = FusionConfig(model=model)
    outcomes = run([measurement], config).outcomes
    (reason,) = reasons([measurement], outcomes, config)
    assert told in reason


def test_rows_before_the_first_state_have_the_times_of_their_measurements():
    early = [Measurement(k * STEP, "radar", [0.1], measures=["bearing"]) for k in (2, 0, 1)]
    seen = [*early, *(Measurement(k * STEP, "lidar", [0.1 * k, 1.0]) for k in range(3, 6))]
    expected = (STEP * np.arange(6)).tolist()
    config = FusionConfig(model="cv")
    assert run(seen, config).stamps_ns.tolist() == expected
    assert smooth(seen, config).stamps_ns.tolist() == expected
    for one in run_batch([seen, Measurements(seen)], config):
        assert one.stamps_ns.tolist() == expected
    kept = Measurements.from_arrays([7, 5], ["lidar"] * 2, [[np.nan, 1.0], [np.nan, 2.0]])
    assert run(kept, config).stamps_ns.tolist() == [5, 7]


@pytest.mark.parametrize(
    ("measurement", "outcome", "accepted"),
    [
        (Measurement(7 * STEP, "radar", [5, np.nan, 0]), "invalid", False),
        (Measurement(7 * STEP, "radar", [0.1], measures=["bearing"]), "invalid", False),
        (Measurement(7 * STEP, "gyro", [0.1]), "told", True),
    ],
)
def test_a_step_before_the_first_state_has_the_time_of_its_measurement(
    measurement, outcome, accepted
):
    flt = TargetFilter(FusionConfig(model="cv"))
    step = flt.step(measurement)
    assert (step.stamp_ns, step.outcome, step.accepted) == (7 * STEP, outcome, accepted)
    assert (step.state, step.covariance, step.innovation, step.nis) == (None,) * 4
    first = flt.step(Measurement(8 * STEP, "lidar", [1.0, 2.0]))
    assert (first.stamp_ns, first.outcome) == (8 * STEP, "started")
    # With a state, it is the time of that state.
    assert flt.step(Measurement(9 * STEP, "lidar", [np.nan, 2.0])).stamp_ns == 8 * STEP
