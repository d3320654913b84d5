"""Times of a table that cannot be meant: an error or a note names the option. Right ones do not."""

from functools import partial

import numpy as np
import pytest
from commands import invoke

from lidar_core.errors import InputError
from lidar_core.runs import fit_config, fuse
from lidar_core.runs.targets.times import doubtful_times

command = partial(invoke, "fuse")
STEP = 10**8


def table(folder, times, names="x,y", values="5,2"):
    path = folder / "table.csv"
    path.write_text(f"t_ns,{names}\n" + "".join(f"{time},{values}\n" for time in times))
    return path


def notes(path, folder, **options):
    return " ".join(fuse(path, None, folder / "run", picture=False, **options).notes)


@pytest.mark.parametrize(
    ("times", "told", "cure"),
    [
        ([5] * 30, "all 30 measurements have the same time", 'columns={"t_ns": "NAME"}'),
        ([f"{0.01 * k:.2f}" for k in range(30)], "all 30 measurements", 'time_unit="s"'),
        (range(0, 30 * 50_000, 50_000), "advance by 50 us", 'time_unit="us"'),
        ([k // 10 * 10**9 for k in range(30)], "is too coarse", 'association="integrated"'),
    ],
)
def test_times_that_hardly_advance_are_told_with_the_option(tmp_path, times, told, cure):
    found = notes(table(tmp_path, times), tmp_path)
    assert told in found
    assert cure in found


@pytest.mark.parametrize(
    ("times", "step", "unit", "name"),
    [
        ([f"{0.1 * k:.1f}" for k in range(30)], 1, "s", "seconds"),
        ([f"{0.05 * k:.2f}" for k in range(200)], 1, "s", "seconds"),
        (range(1_700_000_000, 1_700_000_030), 1, "s", "seconds"),
        (range(0, 3000, 100), 100, "ms", "milliseconds"),
        (range(0, 600, 20), 20, "ms", "milliseconds"),
    ],
)
def test_times_in_another_unit_are_refused_with_the_one_that_fits(
    tmp_path, times, step, unit, name
):
    path = table(tmp_path, times)
    told = (
        f"table.csv: the times of the lidar advance by {step} ns: the column of times is not in"
        f' nanoseconds; {name} fit (time_unit="{unit}"). force=True continues anyway'
    )
    for many in ({}, {"association": "integrated"}):
        with pytest.raises(InputError) as refused:
            notes(path, tmp_path, **many)
        assert str(refused.value).endswith(told)
    assert not (tmp_path / "run").exists()
    with pytest.raises(InputError, match=f'time_unit="{unit}"'):
        fit_config(path)
    assert f'{name} fit (time_unit="{unit}")' in notes(path, tmp_path, force=True)
    assert notes(path, tmp_path, time_unit=unit, mcap=False, overwrite=True) == ""


def test_a_told_unit_that_is_wrong_is_replaced(tmp_path):
    path = table(tmp_path, [f"{0.1 * k:.1f}" for k in range(30)])
    with pytest.raises(InputError, match=r'is not in microseconds; seconds fit .time_unit="s"'):
        notes(path, tmp_path, time_unit="us")


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_times_in_their_unit_give_no_note(tmp_path, unit):
    step = {"s": 1, "ms": 100, "us": 10**5, "ns": STEP}[unit]
    path = table(tmp_path, [step * k for k in range(30)])
    assert notes(path, tmp_path, time_unit=unit, mcap=False) == ""


def test_rows_that_hold_several_sensors_and_several_targets_give_no_note(tmp_path):
    names = "x,y,range,bearing,pose_x,pose_y,pose_yaw"
    path = table(tmp_path, [STEP * k for k in range(30)], names, "5,2,5.39,.38,0,0,0")
    assert notes(path, tmp_path, mcap=False) == ""
    twice = table(tmp_path, [STEP * (k // 2) for k in range(60)])
    assert notes(twice, tmp_path, association="integrated", overwrite=True) == ""


def test_two_sensors_of_a_kind_that_measure_at_once_give_no_note():
    """Both have one name in a table; those of one clock are also some hundred nanoseconds apart."""
    once = np.repeat(STEP * np.arange(30), 2)
    assert doubtful_times({"lidar": once}) is None
    assert doubtful_times({"lidar": once + 300 * (np.arange(60) % 2)}) is None
    assert "too coarse" in doubtful_times({"lidar": np.repeat(STEP * np.arange(6), 10)})
    assert "too coarse" in doubtful_times({"lidar": np.repeat(STEP * np.arange(20), [2, 3] * 10)})


def test_a_single_measurement_gives_no_note(tmp_path):
    assert notes(table(tmp_path, [5]), tmp_path) == ""
    assert doubtful_times({}) is None
    assert doubtful_times({"lidar": np.array([1, 1 + STEP]), "radar": np.array([1])}) is None


def test_many_targets_at_one_time_are_told(tmp_path):
    found = notes(table(tmp_path, [5] * 30), tmp_path, association="integrated")
    assert "all 30 measurements have the same time" in found


def test_the_command_names_its_options(tmp_path):
    done = command(table(tmp_path, [5] * 30), "-o", tmp_path / "run", "--no-picture")
    assert done.exit_code == 0
    assert "--column t_ns=NAME, or state its unit with --time-unit s, ms or us" in done.stderr


def test_the_command_ends_with_status_2_for_another_unit(tmp_path):
    done = command(table(tmp_path, range(0, 3000, 100)), "-o", tmp_path / "run", "--no-picture")
    assert isinstance(done.exception, InputError)
    text = "milliseconds fit (--time-unit ms). --force continues anyway"
    assert str(done.exception).endswith(text)


def test_an_implausible_run_also_tells_of_its_times(tmp_path):
    rng = np.random.default_rng(6400)
    path = tmp_path / "far.csv"
    path.write_text("t_ns,x,y\n" + "".join(f"5,{x},{y}\n" for x, y in rng.normal(0, 50, (40, 2))))
    refused = command(path, "-o", tmp_path / "run").exception
    assert "all 40 measurements have the same time" in str(refused)
    assert "the NIS is" in str(refused)
