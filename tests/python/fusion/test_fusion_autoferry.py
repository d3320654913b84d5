"""Reader of the Autoferry recordings: frames, times, truth that is not there."""

import numpy as np
import pytest
from autoferry_files import entry, scenario, standing
from commands import running

from lidar_core.errors import FormatError, TruthWarning
from lidar_core.fusion import read_autoferry


def test_north_and_east_become_y_and_x(tmp_path):
    entries = [
        entry(2, 11.5, [[4.0, 0.0], [10.0, -100.0]]),
        entry(4, 11.0, 0.3),
        entry(1, 10.25, [3.0, 5.0]),
        entry(1, 12.0, []),
    ]
    truth = [[{"targetID": 7, "position": [20.0, 30.0, 0.0], "time": 9.8}], [], [], []]
    scans = read_autoferry(scenario(tmp_path, entries, truth))
    order = [(scan.source, scan.stamp_ns) for scan in scans]
    # less the delays, 0.6 s of the LiDAR and 1.7 s of the radar
    assert order == [
        ("lidar", 9_650_000_000),
        ("radar", 9_800_000_000),
        ("lidar", 11_400_000_000),
    ]
    assert scans[0].measurements[0].values.tolist() == [6.0, 5.0]
    first, second = scans[1].measurements
    assert first.values.tolist() == [11.0, 6.0]
    assert second.values.tolist() == [-99.0, 2.0]
    np.testing.assert_allclose(second.covariance, [[25, 0], [0, 25 + (0.02 * 100) ** 2]], atol=1e-9)
    assert scans[1].truth[7].tolist() == [30.0, 20.0]
    assert scans[2].measurements == []
    assert scans[2].sensor.tolist() == [1.0, 2.0]


def test_true_places_are_those_at_the_time_of_a_scan(tmp_path):
    truth = [
        [{"targetID": 7, "position": [10.0 * time, -time, 0.0], "time": time}]
        for time in (9.0, 10.0, 12.0)
    ]
    entries = [entry(2, 11.7, [4.0, 0.0]), entry(1, 11.6, []), entry(1, 12.1, [])]
    scans = read_autoferry(scenario(tmp_path, entries, truth))
    assert [scan.stamp_ns for scan in scans] == [10_000_000_000, 11_000_000_000, 11_500_000_000]
    places = [scan.truth[7] for scan in scans]
    np.testing.assert_allclose(places, [[-10, 100], [-11, 110], [-11.5, 115]])


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ({"a": 1}, "expected a list"),
        ([{"sensorID": 1}], "entry 0: cannot be read: KeyError"),
        ([entry(time=1e12)], "entry 0: expected a time"),
        ([entry(measurement=[1.0, 2.0, 3.0])], "entry 0"),
        ([entry(own=[1.0])], "entry 0: expected finite positions"),
        ([entry(measurement=[float("nan"), 0.0])], "entry 0: expected finite positions"),
        ([5], "entry 0"),
    ],
)
def test_broken_scenarios_are_told(tmp_path, content, text):
    with pytest.raises(FormatError, match=text):
        read_autoferry(scenario(tmp_path, content))


NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"position": 3}, "cannot be read: TypeError"),
        ({"position": [1.0]}, "expected a position, north and east"),
        ({"position": [[1.0, 2.0], [3.0, 4.0]]}, "expected a position, north and east"),
        ({"time": NAN}, "expected a time in seconds, got nan"),
        ({"time": 1e12}, "expected a time in seconds"),
        ({"targetID": "a"}, "cannot be read: ValueError"),
    ],
)
def test_a_broken_truth_is_told_with_its_entry(tmp_path, change, text):
    entries = [entry(1, time) for time in (10.0, 11.0, 12.0)]
    truth = [standing(one, {1: 0.0}) for one in entries]
    truth[1][0] |= change
    place = scenario(tmp_path, entries, truth)
    with pytest.raises(FormatError, match=rf"_groundTruth.json, entry 1: {text}"):
        read_autoferry(place)


def crossing(count=6):
    """A target that crosses with 2 m/s, seen once in a second at x = 2 t."""
    entries = [entry(1, 10.0 + k, []) for k in range(count)]
    return entries, [standing(one, {7: 2.0 * k}) for k, one in enumerate(entries)]


@pytest.mark.parametrize("bad", [NAN, INF, None])
def test_a_true_place_that_is_not_finite_spoils_no_other(tmp_path, bad):
    entries, truth = crossing()
    good = read_autoferry(scenario(tmp_path, entries, truth))
    truth[2][0]["position"][1] = bad
    place = scenario(tmp_path, entries, truth)
    with pytest.warns(TruthWarning, match=r"entry 2: .* target 7 .*; 1 such places") as told:
        scans = read_autoferry(place)
    assert len(told) == 1
    # 2 s between its neighbours: the place between them is known from these
    for one, other in zip(scans, good, strict=True):
        np.testing.assert_allclose(one.truth[7], other.truth[7], atol=1e-9)


def test_true_places_are_not_made_up_over_a_gap(tmp_path):
    entries, truth = crossing(9)
    for row in (3, 4):  # 3 s from entry 2 to entry 5
        truth[row][0]["position"][1] = NAN
    place = scenario(tmp_path, entries, truth)
    with pytest.warns(TruthWarning) as told:
        scans = read_autoferry(place)
    assert [7 in scan.truth for scan in scans] == [row not in (3, 4) for row in range(9)]
    assert "target 7 has no true place for 3 s, " in str(told[1].message)
    assert "2 scans are without it" in str(told[1].message)
    for row, scan in enumerate(scans):
        if 7 in scan.truth:
            assert scan.truth[7][0] == pytest.approx(2.0 * row)


@pytest.mark.filterwarnings("error")
def test_steps_of_two_seconds_are_bridged_in_silence(tmp_path):
    """The opposite error: what is known well enough is kept."""
    entries, truth = crossing(9)
    later = [entry(2, 11.6 + k) for k in range(4)]  # measured .5 s after the LiDAR
    place = scenario(tmp_path, [entries[0], *later], truth[::2])
    scans = read_autoferry(place)
    assert [scan.stamp_ns // 10**8 for scan in scans] == [94, 99, 109, 119, 129]
    assert [scan.truth[7][0] for scan in scans] == pytest.approx([0, 1, 3, 5, 7])


def test_before_the_first_and_after_the_last_true_place_nothing_is_known(tmp_path):
    entries, truth = crossing(4)
    entries += [entry(1, time) for time in (9.9, 13.1)]
    scans = read_autoferry(scenario(tmp_path, entries, [*truth, truth[0], truth[3]]))
    assert [bool(scan.truth) for scan in scans] == [False, True, True, True, True, False]


def test_a_truth_that_is_missing_is_one_line_of_the_command(tmp_path):
    entries, truth = crossing()
    truth[2][0]["position"][1] = NAN
    place = scenario(tmp_path, entries, truth)
    with running("fuse", place, "-o", tmp_path / "run", "--no-picture", "--no-mcap") as process:
        _, told = process.communicate()
    assert process.returncode == 0, told
    (line,) = [line for line in told.splitlines() if "true place" in line]
    assert line.startswith("warning: ")
    assert "entry 2" in line


def test_a_truth_of_another_length_is_refused(tmp_path):
    with pytest.raises(FormatError, match="expected 1 entries"):
        read_autoferry(scenario(tmp_path, [entry()], []))
