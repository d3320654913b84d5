"""Arguments of `lidar_core.runs`; errors name them, and on the command line its options."""

import ast
import re
from pathlib import Path

import numpy as np
import pytest

import lidar_core as lc
from lidar_core import ConfigError, runs
from lidar_core.cli.shared.common import as_options
from lidar_core.runs import ConfigChoice


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"repeat": 0}, "repeat: expected a value greater than or equal to 1, got 0"),
        ({"repeat": 1.5}, "repeat: expected int, got 1.5"),
        ({"pose": "static"}, r"pose: expected PoseOptions \| None, got 'static'"),
        ({"read": {"stamps": "own"}}, r"read: expected ReadOptions \| None, got \{'stamps'"),
        ({"clouds": "/points"}, r"clouds: expected Sequence\[str\], got '/points'"),
        ({"threads": "2"}, "threads: expected int, got '2'"),
        ({"config": "best"}, r"config: expected FlyingConfig \| ConfigChoice \| None, got 'best'"),
        ({"known_map": 3, "mcap": "yes"}, r"known_map: .*\nmcap: expected bool \| None, got 'yes'"),
    ],
)
def test_an_argument_of_another_type_is_refused(tmp_path, values, told):
    with pytest.raises(ConfigError, match=told):
        runs.detect(tmp_path / "none.npz", values.pop("config", None), tmp_path / "run", **values)
    assert not (tmp_path / "run").exists()


def test_arguments_of_the_other_runs_are_checked_too(tmp_path):
    with pytest.raises(ConfigError, match=r"lag: expected float \| None, got '1'"):
        runs.fuse("a.csv", None, tmp_path, lag="1")
    with pytest.raises(ConfigError, match=r"topics: expected Mapping.*got \{'radar': '/front'\}"):
        runs.fuse("a.bag", None, tmp_path, topics={"radar": "/front"})
    with pytest.raises(ConfigError, match="film: expected bool, got 1"):
        runs.circles("a.bag", None, tmp_path, film=1)
    with pytest.raises(ConfigError, match=r"capability: expected Literal\['auto', .*got 'sky'"):
        runs.live("udp", None, None, capability="sky")
    with pytest.raises(ConfigError, match="rate: expected a value greater than 0, got -1"):
        runs.live(None, None, None, replay="a.bag", rate=-1)
    with pytest.raises(ConfigError, match="workers: expected a value greater than or equal to 1"):
        runs.batch("jobs.toml", tmp_path, workers=0)


def test_numbers_of_numpy_are_numbers(tmp_path):
    with pytest.raises(FileNotFoundError):
        runs.detect(tmp_path / "none.npz", None, tmp_path / "run", threads=np.int64(1))


def test_a_missing_argument_is_a_type_error(tmp_path):
    told = r"detect\(recording, config, output, \.\.\.\): missing a required argument: 'output'"
    with pytest.raises(TypeError, match=told):
        runs.detect(tmp_path / "none.npz", "run")


@pytest.mark.parametrize(
    ("run", "value", "told"),
    [
        (runs.circles, "voxel_map.voxel_size=.5", r"got \{'voxel_size': '.5'\}.*of `detect`$"),
        (runs.circles, "burn_in_scans=2", "got 2; it is a parameter of `evaluate`$"),
        (runs.detect, "map.max_coast=1", r"got \{'max_coast': 1\}; .* of `circles`$"),
        (runs.detect, "lidar_std=1", "got 1; it is a parameter of `fuse`$"),
        (runs.circles, "voxel_map.nope=1", r"got \{'nope': 1\}$"),
        (runs.circles, "map.nope=1", r"map\.nope: no such parameter, got 1$"),
        (runs.detect, "voxel_sise=1", r"got 1; did you mean voxel_map\.voxel_size\?$"),
    ],
)
def test_a_parameter_of_another_command_names_it(tmp_path, run, value, told):
    with pytest.raises(ConfigError, match=told):
        run(tmp_path / "none.npz", ConfigChoice(values=(value,)), tmp_path / "run")


def test_a_choice_takes_a_path_as_text(tmp_path):
    file = tmp_path / "best.toml"
    file.write_text("[voxel_map]\nvoxel_size = 0.5\n")
    made = lc.sim.record(lc.sim.scenes.demo(0, scans=1), tmp_path / "a.npz", seed=0)
    run = tmp_path / "run"
    runs.detect(made.recording, ConfigChoice(file=str(file)), run, mcap=False, picture=False)
    assert "voxel_size = 0.5" in (run / "run.toml").read_text()


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"mode": "fast"}, "mode: expected 'best' or 'paper', got 'fast'"),
        ({"file": 3}, "file: expected a path, got 3"),
        ({"values": "a=b"}, "values: expected a tuple of texts, got 'a=b'"),
    ],
)
def test_a_choice_refuses_what_no_run_can_use(values, told):
    with pytest.raises(ConfigError, match=told):
        ConfigChoice(**values)


def test_errors_of_functions_name_arguments(tmp_path):
    (tmp_path / "a.csv").write_text("t_ns,x,y\n0,1,2\n")
    (tmp_path / "a.txt").write_text("L 1 2 0 1 2 0 0\n")
    for name, values, told in (
        ("a.txt", {"association": "nearest"}, "association applies only to many targets"),
        ("a.csv", {"topics": {"radar": ["/front"]}}, "topics does not apply to a table"),
    ):
        with pytest.raises(ConfigError, match=told):
            runs.fuse(tmp_path / name, None, tmp_path / "run", **values)
    with pytest.raises(ConfigError, match="values: voxel_size: expected name=value"):
        runs.detect(tmp_path / "a.npz", ConfigChoice(values=("voxel_size",)), tmp_path / "run")
    for arguments, told in (
        (("nowhere", None), "source: nowhere: expected one of zenoh"),
        ((None, None), "source, replay: expected one of them"),
    ):
        with pytest.raises(ConfigError, match=told):
            runs.live(*arguments, None)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a/run: holds an earlier run; overwrite=True replaces it", "; --overwrite replaces it"),
        ('or pose="static" for a sensor', "or --pose static for a sensor"),
        ('are for capability="circles"', "are for --capability circles"),
        ("say which with mounting='a b 0 0 0 0 0 0'", "which with --mounting 'a b 0"),
        ('name the column with columns={"t_ns": "NAME"}', "column with --column t_ns=NAME"),
        ('with topics={"pose": ["NAME"]}', "with --topic pose=NAME"),
        ('fit (scale={"x": 0.001, "y": 1e-3}; z', "fit (--scale x=0.001 --scale y=1e-3; z"),
        ("scale: no column z", "scale: no column z"),
        ("for any scanner, as in set detector=taubin", "as in --set detector=taubin"),
        ("values: voxel_size: expected name=value", "--set voxel_size: expected name=value"),
        ("source: x: expected one of zenoh", "--in x: expected one of"),
        ("source, use allow_untrusted=True", "source, use --trust-model"),
        ("a frame=3 and a_pose=4 stay", "a frame=3 and a_pose=4 stay"),
    ],
)
def test_errors_of_commands_name_options(text, told):
    assert told in as_options(text)


def test_no_error_of_a_function_names_an_option():
    package = Path(lc.__file__).parent
    named = [
        f"{path.relative_to(package)}: {text.value}"
        for path in package.rglob("*.py")
        if not {"cli", "viz"} & set(path.relative_to(package).parts)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Raise)
        for text in ast.walk(node)
        if isinstance(text, ast.Constant) and re.search(r"(^|[\s(])--[a-z]", str(text.value))
    ]
    assert named == []
