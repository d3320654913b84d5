"""Configuration models: ranges, units, dotted paths, TOML there and back."""

import importlib
import inspect
import pkgutil
import re
import typing

import pytest
from pydantic import ValidationError

import lidar_core
from lidar_core import ConfigError, VoxelMap, VoxelMapConfig
from lidar_core.circles import CirclesConfig, Scanner
from lidar_core.config import Config, _fields
from lidar_core.evaluation import EvaluationConfig
from lidar_core.flying import FlyingConfig
from lidar_core.fusion import FusionConfig, MultiTargetConfig, TableOptions
from lidar_core.io import PoseOptions, ReadOptions
from lidar_core.parameters import MODELS, model_named, models_within

UNIT = re.compile(r"\[[^\]]+\]|no unit")


def models():
    """Every public configuration model of the package."""
    for found in pkgutil.walk_packages(lidar_core.__path__, "lidar_core."):
        importlib.import_module(found.name)
    pending, known = [Config], []
    while pending:
        model = pending.pop()
        pending.extend(model.__subclasses__())
        if model is not Config and model.__module__.startswith("lidar_core"):
            known.append(model)
    return sorted(set(known), key=lambda model: f"{model.__module__}.{model.__name__}")


def is_tag(annotation):
    """A field with one possible value tells models apart."""
    return typing.get_origin(annotation) is typing.Literal and len(typing.get_args(annotation)) == 1


def holds_models(annotation):
    arguments = typing.get_args(annotation)
    if arguments:
        return any(map(holds_models, arguments))
    return isinstance(annotation, type) and issubclass(annotation, Config)


@pytest.mark.parametrize("model", models(), ids=lambda model: model.__name__)
def test_every_field_states_what_it_is_and_its_unit(model):
    assert model.__doc__
    bare = {
        name: field.description
        for name, field in model.model_fields.items()
        if not holds_models(field.annotation)
        and not is_tag(field.annotation)
        and not UNIT.search(field.description or "")
    }
    assert bare == {}


def with_defaults():
    return [
        model
        for model in models()
        if not any(field.is_required() for field in model.model_fields.values())
    ]


@pytest.mark.parametrize("model", with_defaults(), ids=lambda model: model.__name__)
def test_defaults_pass_their_own_checks_and_the_round_trip(model, tmp_path):
    for config in [model(), *([model.paper()] if hasattr(model, "paper") else [])]:
        assert model.load(config.model_dump()) == config
        path = tmp_path / "config.toml"
        path.write_text(config.to_toml(), encoding="utf-8")
        assert model.read(path) == config
        assert model.model_json_schema()["additionalProperties"] is False
    with pytest.raises(ValidationError, match="frozen"):
        model().__setattr__(next(iter(model.model_fields)), 1)


def test_an_unknown_key_is_named_with_its_path():
    with pytest.raises(ConfigError) as refusal:
        VoxelMapConfig(voxel_sise=0.2)
    assert str(refusal.value) == "voxel_sise: no such parameter, got 0.2; did you mean voxel_size?"
    with pytest.raises(ConfigError) as refusal:
        FlyingConfig.load({"voxel_map": {"voxel_sise": 0.2}})
    assert str(refusal.value) == (
        "voxel_map.voxel_sise: no such parameter, got 0.2; did you mean voxel_size?"
    )
    with pytest.raises(ConfigError, match=r"^qqq: no such parameter, got 1$"):
        VoxelMapConfig(qqq=1)


def test_what_is_no_table_or_no_such_text_is_told_in_plain_words():
    with pytest.raises(ConfigError, match=r"^voxel_map: expected a table of parameters, got 0\.5$"):
        FlyingConfig.load({"voxel_map": 0.5})
    with pytest.raises(ConfigError) as refusal:
        ReadOptions(point_time="t:fortnight:start")
    assert str(refusal.value) == (
        "point_time: expected a text such as auto, none, t:ns:start, timestamp:s:absolute,"
        " got 't:fortnight:start'"
    )
    with pytest.raises(ConfigError) as refusal:
        PoseOptions(mounting=("a b 1 2",))
    assert str(refusal.value) == (
        "mounting: expected texts PARENT FRAME x y z roll pitch yaw; 'a b 1 2' has 2 numbers,"
        " expected 6, got ('a b 1 2',)"
    )


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("base laser 0 0 0 0 0", "has 5 numbers, expected 6"),
        ("base laser 0 0 0 0 0 0 0", "has 7 numbers, expected 6"),
        ("base", "has 0 numbers, expected 6"),
        ("base laser 0 0 0 0 0 left", "could not convert string to float: 'left'"),
    ],
)
def test_a_mounting_with_missing_numbers_says_how_many(text, told):
    with pytest.raises(ConfigError, match=told):
        PoseOptions(mounting=(text,))
    PoseOptions(mounting=("base laser 0 0 0 0 0 0",))


@pytest.mark.parametrize(
    "value", [-1, "0.1", None, [], [0.1], [0.1, "a"], ["a", 0.1, 0.1], [0.1] * 4, {"x": 1}]
)
def test_a_list_of_one_of_several_lengths_is_told_once_in_plain_words(value):
    with pytest.raises(ConfigError) as refused:
        FusionConfig(lidar_std=value)
    told = f"lidar_std: expected a list of 2 or 3 numbers such as [0.15, 0.15], got {value!r}"
    assert str(refused.value) == told
    with pytest.raises(ConfigError) as refused:
        MultiTargetConfig(target={"radar_std": 1}, birth_distance=-1)
    first, *others = str(refused.value).splitlines()
    told = "expected a list of 3 or 4 numbers such as [0.3, 0.03, 0.3], got 1"
    assert first == f"target.radar_std: {told}"
    assert [text.split(":")[0] for text in others] == ["birth_distance"]


def test_a_name_that_a_table_must_not_contain_is_told_in_plain_words():
    with pytest.raises(ConfigError) as refused:
        TableOptions(azimuth={"radar": "clockwise", "bearing": "left"})
    assert str(refused.value).splitlines() == [
        "azimuth: expected the name 'bearing', 'pose_yaw', 'turn_rate' or 'lidar', got 'radar'",
        "azimuth.bearing: Input should be 'clockwise' or 'compass', got 'left'",
    ]


@pytest.mark.parametrize("value", [[0.1, 0.2], [0.1, 0.2, 0.3], (1, 1)])
def test_lists_of_each_length_are_taken(value):
    assert FusionConfig(lidar_std=value).lidar_std == tuple(value)


def test_a_parameter_of_another_table_is_told_with_its_path():
    with pytest.raises(ConfigError) as refusal:
        FlyingConfig(voxel_size=1)
    assert str(refusal.value) == (
        "voxel_size: no such parameter, got 1; did you mean voxel_map.voxel_size?"
    )
    with pytest.raises(ConfigError, match=r"did you mean voxel_map\.voxel_size\?$"):
        FlyingConfig.load({"classify": {"voxel_siez": 1}})


def test_what_contradicts_itself_is_told_without_the_whole_table():
    with pytest.raises(ConfigError) as refusal:
        VoxelMapConfig(g_unk=-800.0)
    assert str(refusal.value).startswith("VoxelMapConfig: expected g_free <= threshold_unc")
    assert "{" not in str(refusal.value)


def test_all_problems_are_reported_at_once():
    with pytest.raises(ConfigError) as refusal:
        FlyingConfig.load(
            {"voxel_map": {"voxel_size": -1.0, "ray_unit": "feet"}, "classify": {"min_points": 0}}
        )
    lines = str(refusal.value).splitlines()
    assert sorted(line.partition(":")[0] for line in lines) == [
        "classify.min_points",
        "voxel_map.ray_unit",
        "voxel_map.voxel_size",
    ]
    told = "Input should be greater than or equal to 0.01 m: lengths are in metres, got -1.0"
    assert f"voxel_map.voxel_size: {told}" in lines


@pytest.mark.parametrize("value", [float("nan"), float("inf"), "wide", None])
def test_a_number_is_finite(value):
    with pytest.raises(ConfigError, match=r"^voxel_size: "):
        VoxelMapConfig(voxel_size=value)


def test_levels_are_ordered():
    with pytest.raises(ConfigError, match=r"expected g_free <= threshold_uncertain <= g_unk"):
        VoxelMapConfig(g_unk=-800.0)
    with pytest.raises(ConfigError, match=r"^voxel_map: "):
        FlyingConfig.load({"voxel_map": {"g_free": 10.0}})


def test_a_file_that_is_no_toml_is_named(tmp_path):
    path = tmp_path / "broken.toml"
    path.write_text("voxel_size = ", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"broken\.toml: expected TOML: "):
        VoxelMapConfig.read(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match=r"broken\.toml: expected TOML: "):
        VoxelMapConfig.read(path)
    with pytest.raises(FileNotFoundError):
        VoxelMapConfig.read(tmp_path / "missing.toml")


@pytest.mark.parametrize(
    "bad",
    [
        {"bounds": ((1, 1, 1), (0, 2, 2))},
        {"voxel_size": 1e-320},
        {"g_occ": 1e300},
    ],
)
def test_what_the_core_cannot_use_is_a_config_error(bad):
    with pytest.raises(ConfigError):
        VoxelMap(VoxelMapConfig(**bad))


def test_a_map_takes_its_own_configuration_only():
    with pytest.raises(ConfigError, match=r"^config: expected a VoxelMapConfig, got dict$"):
        VoxelMap({"voxel_size": 0.2})


def test_paper_mode_is_table_ii():
    """Notes, section 3: the values that the paper states."""
    paper = FlyingConfig.paper()
    voxels, rules, tracker = paper.voxel_map, paper.classify, paper.tracker
    assert (voxels.voxel_size, voxels.max_range) == (0.25, 20.0)
    assert (voxels.g_occ, voxels.g_unk, voxels.g_free, voxels.initial) == (0, -740, -1000, -740)
    assert (
        voxels.threshold_confident,
        voxels.threshold_tentative,
        voxels.threshold_uncertain,
    ) == (-0.1, -300, -750)
    assert (voxels.ray_unit, voxels.ray_gain, voxels.end_margin) == ("metres", 1.0, 0.0)
    assert voxels.saturation == "paper"
    assert paper.cluster.max_distance == 0.25
    assert (rules.close_distance, rules.search_distance) == (0.7, 3.0)
    assert (rules.shadow, rules.own_voxels, rules.border) == ("paper", "paper", "closed")
    assert rules.max_extent is rules.background_extent is rules.group_distance is None
    assert (paper.separate.min_confident, paper.separate.waits_for_background) == (24, True)
    assert (paper.sensor.min_range, paper.sensor.learn_mask_scans) == (0.0, 0)
    assert rules.max_distance is None
    assert tracker.model_dump()  # its own test holds the values


@pytest.mark.parametrize(
    ("table", "key"),
    [
        ("voxel_map", "max_voxels"),
        ("cluster", "min_points"),
        ("separate", "min_confident"),
        ("seed", "burn_in_scans"),
        ("seed", "standing_scans"),
        ("sensor", "learn_mask_scans"),
        ("cluster", "max_points"),
    ],
)
def test_a_count_that_the_core_cannot_hold_is_named(table, key):
    with pytest.raises(ConfigError, match=rf"^{table}\.{key}: .*less than or equal"):
        FlyingConfig(**{table: {key: 2**70}})


@pytest.mark.parametrize(("table", "key"), [("voxel_map", "bounds"), ("sensor", "self_box")])
def test_corners_are_in_order(table, key):
    with pytest.raises(ConfigError, match=rf"^{table}\.{key}: .*a lower corner, then an upper"):
        FlyingConfig(**{table: {key: ((1, 1, 1), (-1, 2, 2))}})


def test_a_file_with_a_bad_value_is_named_and_the_value_cut(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text(f"voxel_size = {[*range(1000)]}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"bad\.toml: voxel_size: ") as caught:
        VoxelMapConfig.read(path)
    assert len(str(caught.value)) < 300 + len(str(path))


def lengths():
    """Single lengths [m] of the configurations of the pipelines, with their defaults."""
    for model in (FlyingConfig, CirclesConfig):
        for path, field in _fields(model).items():
            if "[m]" in (field.description or "") and isinstance(field.default, float):
                yield model, path, field.default


def with_value(path, value):
    *tables, name = path.split(".")
    found = {name: value}
    for table in reversed(tables):
        found = {table: found}
    return found


WITHOUT_LIMIT = {"max_deviation"}  # paper mode takes 1e6 for "no limit"


@pytest.mark.parametrize("factor", [100, 1000], ids=["centimetres", "millimetres"])
def test_lengths_in_a_smaller_unit_are_refused(factor):
    """The default of every length, told in centimetres or millimetres, is outside its range."""
    checked = 0
    for model, path, default in lengths():
        if not default or path in WITHOUT_LIMIT:
            continue
        table = path.rpartition(".")[0]  # names a value that does not fit the one beside it
        with pytest.raises(ConfigError, match=rf"^{path}: |^{table}: expected"):
            model.load(with_value(path, factor * default))
        checked += 1
    assert checked > 30


def test_times_in_milliseconds_are_refused():
    """The default of every time, told in milliseconds, is outside its range."""
    checked = 0
    for model in (FlyingConfig, CirclesConfig, FusionConfig, MultiTargetConfig):
        for path, field in _fields(model).items():
            if "[s]" not in (field.description or "") or not isinstance(field.default, float):
                continue
            with pytest.raises(ConfigError, match=rf"^{path}: .* s: times are in seconds, got"):
                model.load(with_value(path, 1000 * field.default))
            checked += 1
    assert checked > 10


def test_a_track_is_not_reported_longer_than_it_is_kept():
    told = r"^tracker: expected report_coast <= max_coast, .*, got 5 and 3 s$"
    with pytest.raises(ConfigError, match=told):
        FlyingConfig.load({"tracker": {"report_coast": 5}})
    assert FlyingConfig.load({"tracker": {"report_coast": 5, "max_coast": 5}})
    assert FlyingConfig.load({"tracker": {"max_coast": 0.3}})


def test_targets_beyond_the_map_are_refused_with_the_cure():
    told = (
        r"^FlyingConfig: expected classify\.max_distance <= voxel_map\.max_range, got 40 and 20 m:"
        r" .* set voxel_map\.max_range=40 or classify\.max_distance=20$"
    )
    with pytest.raises(ConfigError, match=told):
        FlyingConfig.load({"classify": {"max_distance": 40}})
    FlyingConfig.load({"voxel_map": {"max_range": 10}})  # what it reaches is meant to be less
    for classify in ({"max_distance": 10}, {"max_distance": "none"}, {"max_distance": 20}):
        FlyingConfig.load({"classify": classify})
    FlyingConfig.load({"classify": {"max_distance": 40}, "voxel_map": {"max_range": 40}})


def test_a_voxel_of_99_metres_is_refused_with_place_value_and_cure():
    text = r"^voxel_map\.voxel_size: .*less than or equal to 5 m: lengths are in metres, got 99$"
    with pytest.raises(ConfigError, match=text):
        FlyingConfig.load({"voxel_map": {"voxel_size": 99}})
    with pytest.raises(ConfigError, match=text.replace("voxel_map", "", 1).replace("\\.", "", 1)):
        VoxelMap(VoxelMapConfig(voxel_size=99))


WITHOUT_RANGE = {
    *("bounds", "self_box", "center", "position", "start", "end", "velocity", "rotation"),
    *("rotations", "box_min", "box_max", "sensor_distance", "sensor_elevation_deg", "half_size"),
    *("azimuth_start", "azimuth_per_scan", "angle_min", "angle_increment", "phase", "yaw", "reach"),
    *("g_occ", "g_unk", "g_free", "initial", "clock", "seed", "grid", "ranges", "rows"),
    *("threshold_confident", "threshold_tentative", "threshold_uncertain", "max_deviation"),
    *("extra_thresholds", "planes", "positions", "points", "times", "heights", "vertices", "faces"),
    *(("radius", "speed", "yaw_rate")),  # of a circle of the simulator: the sign is a direction
}
"""Places, angles and levels, which may have any value; and what a validator checks."""


def bounds_of(schema, found=()):
    """Every number that a JSON schema allows, with its lower and upper bound."""
    for part in (schema, *schema.get("anyOf", ()), *schema.get("prefixItems", ())):
        if part.get("type") in ("number", "integer"):
            low = part.get("minimum", part.get("exclusiveMinimum"))
            yield low, part.get("maximum", part.get("exclusiveMaximum"))
        if part is not schema and part.get("type") == "array":
            yield from bounds_of(part)
    if isinstance(schema.get("items"), dict):
        yield from bounds_of(schema["items"])


@pytest.mark.parametrize("name", sorted(MODELS))
def test_every_number_has_a_least_and_a_greatest_value(name):
    for model in models_within(model_named(name)):
        properties = model.model_json_schema()["properties"]
        for key, schema in properties.items():
            if key in WITHOUT_RANGE or key in CHECKED_TOGETHER:
                continue
            for low, high in bounds_of(schema):
                assert low is not None, f"{model.__name__}.{key}"
                assert high is not None, f"{model.__name__}.{key}"


CHECKED_TOGETHER = {
    "lidar_std": ([1000, 1], [0.1, 15], [0, 0.1], [-0.1, 0.1]),
    "radar_std": ([30, 2, 101], [0.3, 10, 0.3], [0.3, 0, 0.3]),
    "pose_std": ([0, 0, 10], [0, 0, -0.1], [1000, 0, 0]),
    "lever_arm": ([2000, 0], [0, 0, -2000]),
}


@pytest.mark.parametrize("name", CHECKED_TOGETHER)
def test_deviations_of_sensors_lie_within_what_sensors_have(name):
    for values in CHECKED_TOGETHER[name]:
        told = rf"^{name}: expected values .* lengths are in metres.*, got \["
        with pytest.raises(ConfigError, match=told):
            FusionConfig.load({name: values})
        with pytest.raises(ConfigError, match=told.replace("^", "^target\\.")):
            MultiTargetConfig.load({"target": {name: values}})
    assert FusionConfig(lidar_std=(9.9, 1e-3), radar_std=(50, 3, 3, 9), lever_arm=(-900, 0))


def test_a_limit_is_told_with_its_unit():
    """Also of the values of a list; a limit of zero needs none."""
    for table, told in (
        (
            {"sensor": {"beam_elevations": [-15, 1]}},
            r"tions\.0: .* to -1\.6 rad: angles are in rad",
        ),
        ({"tracker": {"max_coast": 1e9}}, r"max_coast: .* 60 s: times are in seconds, got 1"),
        ({"voxel_map": {"voxel_size": 0.001}}, r"size: .* to 0\.01 m: lengths are in metres, got"),
        ({"voxel_map": {"end_margin": -1}}, r"end_margin: .* or equal to 0, got -1"),
    ):
        with pytest.raises(ConfigError, match=told):
            FlyingConfig.load(table)


def test_modes_and_uses_lie_within_the_ranges_of_lengths():
    for made in (
        FlyingConfig.paper(),
        FlyingConfig.long_range(),
        CirclesConfig.paper(),
        CirclesConfig.posts(),
    ):
        assert type(made).load(made.model_dump()) == made


def test_a_parameter_of_an_earlier_version_is_told_with_what_holds_instead(tmp_path):
    file = tmp_path / "scene.toml"
    sensor = '[sensor]\nkind = "stop_and_go"\nstart = [0, 0, 1]\nvelocity = [1, 0, 0]\n'
    file.write_text(f"{sensor}ramp = 2.0\n")
    told = (
        r"scene\.toml: sensor\.stop_and_go\.ramp: is no parameter any more:"
        r" speeding up and braking take 1 s each; leave it out\n"
    )
    with pytest.raises(ConfigError, match=told):
        lidar_core.sim.Scene.read(file)
    file.write_text(sensor)
    assert lidar_core.sim.Scene.read(file).sensor.velocity == (1, 0, 0)


def test_a_parameter_that_another_table_had_is_only_unknown():
    """A barrel had a radius; a box never had one."""
    target = {"shape": {"kind": "barrel", "radius": 1.0}, "motion": {"kind": "hover"}}
    target["motion"]["position"] = [0, 0, 0]
    with pytest.raises(ConfigError, match=r"barrel\.radius: is no parameter any more: a drum"):
        lidar_core.sim.Scene.load({"targets": [target]})
    target["shape"] = {"kind": "box", "size": [1, 1, 1], "radius": 1.0}
    with pytest.raises(ConfigError, match=r"box\.radius: no such parameter, got 1\.0"):
        lidar_core.sim.Scene.load({"targets": [target]})


def test_a_parameter_that_has_moved_is_told_with_its_new_place():
    told = r"tracker\.process_position: is no parameter any more: write it as the first value of"
    with pytest.raises(ConfigError, match=rf"^{told} process_std$"):
        FlyingConfig.load({"tracker": {"process_position": 0.5}})
    assert FlyingConfig.load({"tracker": {"process_std": [0.5, 0.1, 4.0]}})


def test_no_removed_parameter_is_there():
    for name in MODELS:
        for model in models_within(model_named(name)):
            assert not set(model.removed) & set(model.model_fields)


@pytest.mark.parametrize("model", [FlyingConfig, EvaluationConfig, Scanner, VoxelMapConfig])
def test_help_tells_every_field_and_a_short_signature(model):
    text = " ".join(model.__doc__.split())
    assert "Attributes ----------" in text
    for name, field in model.model_fields.items():
        assert f" {name} : " in text
        assert " ".join((field.description or "").split()) in text
    told = str(inspect.signature(model))
    assert list(inspect.signature(model).parameters) == list(model.model_fields)
    assert "Annotated" not in told + text
    assert len(told) < 1200
    assert "Attributes" not in model.model_json_schema()["description"]


def test_a_model_without_a_text_of_its_own_has_no_description_of_its_fields():
    class Bare(Config):
        depth: int = 1

    assert "depth" in Bare.__doc__
    assert "description" not in Bare.model_json_schema()


def test_help_shows_types_and_defaults_as_they_are_written():
    text = FlyingConfig.__doc__
    assert "range_margin : float, default 2.0\n    Rays clear this much further" in text
    assert "position : {'center', 'paper'}, default 'center'\n" in text
    assert "voxel_map : VoxelMapConfig, default VoxelMapConfig()\n    Occupancy of voxels" in text
    assert "voxel_map=VoxelMapConfig(), " in str(inspect.signature(FlyingConfig))
    assert str(inspect.signature(Scanner)).startswith("(angle_min=")  # also by position
    assert Scanner.__doc__.index("Attributes") < Scanner.__doc__.index("Examples\n--------")
