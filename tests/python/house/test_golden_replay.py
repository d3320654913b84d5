"""The golden replay: fixed scenes of every capability give the results that they gave before."""

import numpy as np
import pytest

from golden import digest
from golden.digest import Record, differences
from golden.recordings_replay import READ
from golden.scenes import FILES, played, read, threads_of
from lidar_core.circles import Circles

CASES = [
    pytest.param(file, scene, threads, id=f"{file}: {scene}, {threads}")
    for file, scenes in FILES.items()
    for scene in scenes
    for threads in threads_of(file, scene)
]
CURE = "if this change is intended: make golden, and a line in the changelog"


@pytest.mark.parametrize(("file", "scene", "threads"), CASES)
def test_results_are_those_of_the_golden_files(file, scene, threads):
    expected = digest.golden(file)[scene]
    got = digest.under_old_names(played(file, scene, threads), expected, digest.renames())
    found = differences(f"{file}: {scene}", expected, got)
    assert not found, "\n".join([*found, CURE])


@pytest.mark.parametrize("name", READ)
def test_what_is_read_is_that_of_the_golden_files(recordings, name):
    expected = digest.golden("recordings")[name]
    got = digest.under_old_names(read(name, recordings), expected, digest.renames())
    found = differences(name, expected, got)
    assert not found, "\n".join([*found, CURE])


def test_the_golden_files_hold_the_scenes_and_no_others():
    for file, scenes in (FILES | {"recordings": READ}).items():
        assert set(digest.golden(file)) == set(scenes), f"{file}: {CURE}"


def test_every_rename_is_of_a_name_in_the_golden_files():
    files = [*FILES, "recordings"]
    paths = {path for file in files for scene in digest.golden(file).values() for path in scene}
    for old in digest.renames():
        assert any(digest.holds(path, old) for path in paths), f"renames.toml: no {old}"


# The replay sees what changes


def entries(values, **options):
    record = Record()
    for value in values:
        record.add("frame/center", value, **options)
    return record.entries()


CENTERS = [np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[1.5, 2.5]]), np.zeros((0, 2))]


@pytest.mark.parametrize(
    "change",
    [
        lambda array: array + np.spacing(array),
        lambda array: array[::-1],
        lambda array: array.T,
        lambda array: array[:1],
        lambda array: -array,
        lambda array: np.where(array == 3, np.nan, array),
        lambda array: array.astype(int),
    ],
    ids=["last bit", "order", "axes", "a row less", "sign", "not a number", "kind"],
)
def test_a_changed_array_is_named_with_its_record(change):
    changed = [change(CENTERS[0]), *CENTERS[1:]]
    (line,) = differences("scene", entries(CENTERS), entries(changed))
    assert line.startswith("scene: frame/center: 1 of 3 records differ, the first is 0")


def test_zero_and_minus_zero_differ_and_all_nan_are_one():
    assert differences("scene", entries([0.0]), entries([-0.0]))
    other = np.array([np.nan]).view(np.uint64) + 1
    assert not differences("scene", entries([np.nan]), entries([other.view(np.float64)[0]]))


def test_the_width_of_numbers_is_no_result():
    wide, narrow = np.arange(3, dtype=np.int64), np.arange(3, dtype=np.uint8)
    assert not differences("scene", entries([wide]), entries([narrow]))
    halves = np.array([0.5, 0.25])
    assert not differences("scene", entries([halves]), entries([halves.astype(np.float32)]))


def test_records_and_fields_that_come_or_go_are_named():
    one, two = entries(CENTERS), entries(CENTERS[:2])
    assert differences("scene", one, two) == [
        "scene: frame/center: 3 records became 2; shapes float[2, 2] float[1, 2] float[0, 2]"
        " became float[2, 2] float[1, 2]"
    ]
    assert differences("scene", one, {}) == ["scene: frame/center: is gone"]
    assert "make golden" in differences("scene", {}, one)[0]


def test_networks_are_compared_by_tolerance():
    value = np.linspace(1, 2, 6)
    before = entries([value], near=True)
    assert not differences("scene", before, entries([value * (1 + 4e-6)], near=True))
    moved = value + np.array([0, 1e-4, 0, 0, 0, -1e-4])
    (line,) = differences("scene", before, entries([moved], near=True))
    assert line.startswith("scene: frame/center: value 1 of record 0, 1.2")
    (line,) = differences("scene", before, entries([value * 1.001], near=True))
    assert "the sum of record 0" in line


def test_of_other_inputs_nothing_else_is_said():
    """Then the simulator has changed, and not what is fed by it."""
    scenes = []
    for shift in (0.0, 0.1):
        record = Record()
        record.add("inputs/points", CENTERS[0] + shift)
        record.add("frame/center", CENTERS[0] * (1 + shift))
        scenes.append(record.entries())
    found = differences("scene", *scenes)
    assert [line.split(":")[1].strip() for line in found] == ["inputs/points", ""]
    assert "and 1 results of them" in found[1]


def test_dataclasses_are_taken_field_by_field():
    record = Record()
    record.add("circles", Circles(np.zeros((1, 3)), np.zeros((1, 3, 3)), np.zeros(1, np.int64)))
    assert set(record.entries()) == {
        "circles/parameters",
        "circles/covariance",
        "circles/n_hits",
        "circles/is_fallback",
    }


def test_renamed_fields_are_found_under_their_old_names():
    record = Record()
    record.add("frame/status/burn_in_open", True)
    record.add("frame/kind", 1)
    record.add("shape/kind", 2)
    old = Record()
    old.add("frame/status/gate_open", True)
    old.add("frame/kind", 1)
    old.add("shape/sort", 2)
    renamed = {"status/gate_open": "status/burn_in_open", "sort": "kind"}
    known = old.entries()
    got = digest.under_old_names(record.entries(), known, renamed)
    assert differences("scene", known, got) == []
    assert digest.under_old_names(record.entries(), known, {}) == record.entries()


def test_a_parameter_of_the_detector_shows_in_the_replay():
    """One scene with one value changed by a hundredth: the map and the classes are named."""
    from golden.flying_replay import play_deskewed
    from lidar_core.flying import FlyingConfig

    changed, record = FlyingConfig(), Record()
    voxels = changed.voxel_map.model_copy(update={"ray_gain": 1.01})
    play_deskewed(record, 1, changed.model_copy(update={"voxel_map": voxels}))
    found = differences("yard", digest.golden("flying")["yard, best"], record.entries())
    named = {line.split(": ")[1] for line in found}
    assert "map/file/values" in named
    assert not any(name.startswith("inputs/") for name in named)
