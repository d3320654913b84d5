"""Configuration files of earlier versions, and `lidar-core config migrate`."""

import tomllib

import pytest
from commands import invoke

from lidar_core.circles import CirclesConfig
from lidar_core.config import Config
from lidar_core.errors import ConfigError
from lidar_core.flying import FlyingConfig
from lidar_core.fusion.config import FusionConfig
from lidar_core.parameters import MODELS, model_named, models_within
from lidar_core.sim import Rosette, Scene
from lidar_core.util.migration import migrated

OLD = {
    "target_radius": 0.3,
    "forget_distance": 50.0,
    "tracker": {"process_position": 0.7, "merge_speed": 2.0},
    "seed": {"standing_shift": 0.1, "burn_in_scans": 12},
}


def test_a_file_keeps_what_still_is_a_parameter_and_values_that_have_moved():
    before = {**OLD, "tracker": dict(OLD["tracker"])}
    values, changes = migrated(FlyingConfig, OLD)
    assert before == OLD
    assert values == {
        "forget_distance": 50.0,
        "tracker": {"process_std": [0.7, *FlyingConfig().tracker.process_std[1:]]},
        "seed": {"burn_in_scans": 12},
    }
    assert sorted((change.place, change.value) for change in changes) == [
        ("seed.standing_shift", 0.1),
        ("target_radius", 0.3),
        ("tracker.merge_speed", 2.0),
        ("tracker.process_position", 0.7),
    ]
    FlyingConfig.load(values)


def test_several_values_that_moved_into_one_list_meet_there():
    values, _ = migrated(FlyingConfig, {"tracker": {"radius_max": 9.0, "radius_min": 0.4}})
    assert values == {"tracker": {"radius_limits": [0.4, 9.0]}}


@pytest.mark.parametrize("order", [("min", "max"), ("max", "min")])
def test_values_that_moved_into_a_list_without_default_meet_there(order):
    old = {"min": -20.0, "max": 25.0}
    pattern = {f"elevation_{end}_deg": old[end] for end in order}
    values, _ = migrated(Rosette, pattern)
    assert values == {"elevation_deg": [-20.0, 25.0]}
    assert Rosette.load(values).elevation_deg == (-20.0, 25.0)


def test_a_value_of_each_entry_goes_into_all_of_them():
    usual = CirclesConfig().map.modes
    values, _ = migrated(CirclesConfig, {"map": {"mode_weight": 0.5}})
    found = CirclesConfig.load(values).map.modes
    assert [entry[1] for entry in found] == [0.5] * len(usual)
    assert [entry[::2] for entry in found] == [entry[::2] for entry in usual]


@pytest.mark.parametrize(
    ("model", "old"),
    [
        (FlyingConfig, {"tracker": {"radius_max": 9.0, "radius_limits": [0.1]}}),
        (FlyingConfig, {"tracker": {"radius_max": 9.0, "radius_limits": 3}}),
        (CirclesConfig, {"map": {"mode_weight": 0.5, "modes": [0.1]}}),
    ],
)
def test_a_list_that_is_wrong_is_told_by_the_reading(model, old):
    values, changes = migrated(model, old)
    assert len(changes) == 1
    with pytest.raises(ConfigError, match=r"radius_limits|modes"):
        model.load(values)


def test_tables_of_a_chosen_kind_are_found():
    sensor = {"kind": "stop_and_go", "start": [0, 0, 1], "velocity": [1, 0, 0], "ramp": 2.0}
    values, (change,) = migrated(Scene, {"sensor": sensor})
    assert (change.place, change.value) == ("sensor.ramp", 2.0)
    assert "ramp" not in values["sensor"]
    assert Scene.load(values).sensor.velocity == (1, 0, 0)


def test_the_number_of_an_entry_is_part_of_the_place():
    motion = {"kind": "stop_and_go", "start": [0, 0, 1], "velocity": [1, 0, 0], "ramp": 2.0}
    still = {"kind": "hover", "position": [5, 0, 1]}
    targets = [{"motion": still, "shape": {}}, {"motion": motion, "shape": {}}]
    _, (change,) = migrated(Scene, {"targets": targets})
    assert change.place == "targets.1.motion.ramp"


def test_what_is_wrong_otherwise_stays_wrong():
    values, changes = migrated(FlyingConfig, {"nonsense": 1, "target_radius": 0.3})
    assert (values, len(changes)) == ({"nonsense": 1}, 1)
    assert migrated(FlyingConfig, {"seed": 3}) == ({"seed": 3}, ())
    assert migrated(FlyingConfig, FlyingConfig().model_dump()) == (FlyingConfig().model_dump(), ())


@pytest.mark.parametrize("name", MODELS)
def test_every_parameter_that_a_model_had_can_go(name):
    """Values are numbers, as most were; where one has moved to, it may not fit."""
    for model in models_within(model_named(name)):
        old = dict.fromkeys(model.removed, 0.5)
        values, changes = migrated(model, old)
        assert {change.place for change in changes} == set(old)
        assert not values.keys() & old.keys()


def old_file(folder):
    file = folder / "old.toml"
    file.write_text('model = "ca"\nloss_window = 12\n')
    return file


def test_the_error_names_the_command_and_the_command_writes_a_file_that_loads(tmp_path):
    file, new = old_file(tmp_path), tmp_path / "new.toml"
    cure = f"`lidar-core config migrate {file} -o NEW` writes"
    told = rf"loss_window: is no parameter any more: .*\n{cure}"
    with pytest.raises(ConfigError, match=told):
        FusionConfig.read(file)
    shown = invoke("config", "show", file)
    assert isinstance(shown.exception, ConfigError)
    assert "config migrate" in str(shown.exception)
    done = invoke("config", "migrate", file, "-o", new)
    assert done.exit_code == 0, done.output
    assert "loss_window = 12: the NIS is averaged over 10 measurements" in done.stderr
    assert FusionConfig.read(new) == FusionConfig(model="ca")
    assert invoke("config", "show", new).exit_code == 0
    again = invoke("config", "migrate", new)
    assert again.stderr == f"{new}: nothing to change\n"
    assert tomllib.loads(again.stdout) == {"model": "ca"}
    refused = invoke("config", "migrate", file, "-o", new)
    assert "--overwrite" in str(refused.exception)


def test_errors_of_this_version_do_not_name_the_command(tmp_path):
    file = tmp_path / "new.toml"
    file.write_text("loss_windows = 12\n")
    with pytest.raises(ConfigError) as refused:
        FusionConfig.read(file)
    assert "migrate" not in str(refused.value)
    refused = invoke("config", "migrate", file, "--model", "fusion")
    assert "loss_windows: no such parameter" in str(refused.exception)


def test_migrated_knows_every_way_in_which_parameters_have_moved():
    from lidar_core.util import migration

    told = [
        reason
        for name in MODELS
        for model in models_within(model_named(name))
        if issubclass(model, Config)
        for reason in model.removed.values()
        if reason.startswith("write it as")
    ]
    assert len(told) > 5
    assert all(migration._MOVED.fullmatch(reason) for reason in told), told
