"""Uses: what `config --use` writes, and that the map of posts is better where it is meant to be."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from lidar_core import ConfigError, sim
from lidar_core.circles import CirclesConfig, Scanner
from lidar_core.cli import app
from lidar_core.config import Config
from lidar_core.flying import FlyingConfig, SensorConfig
from lidar_core.fusion import FusionConfig
from lidar_core.parameters import MODELS, model_named
from lidar_core.reproduce.circles.runs import MapRun, config_of, mapped
from lidar_core.use_cases import USES, use_named

SEED = 1107


def run(*arguments):
    return CliRunner().invoke(app, [str(one) for one in arguments])


@pytest.mark.parametrize("name", USES)
def test_a_use_differs_from_the_defaults_and_is_written_whole(name, tmp_path):
    use, path = USES[name], tmp_path / "use.toml"
    config = use.config()
    assert isinstance(config, Config)
    assert use.model in MODELS
    assert config != model_named(use.model)()
    assert run("config", "init", "--use", name, "-o", path).exit_code == 0
    assert type(config).read(path) == config
    shown = run("config", "show", "--use", name, "--json")
    assert json.loads(shown.stdout) == config.model_dump(mode="json")


def test_a_use_goes_with_a_sensor_and_with_a_file(tmp_path):
    path = tmp_path / "far.toml"
    done = run("config", "init", "--use", "long-range", "--preset", "os2-128", "-o", path)
    assert done.exit_code == 0, done.output
    expected = FlyingConfig.long_range().model_copy(
        update={"sensor": SensorConfig.preset("os2-128")}
    )
    assert FlyingConfig.read(path) == expected
    done = run("config", "show", "--use", "posts", "--preset", "tim571", "--json")
    shown = CirclesConfig.load(json.loads(done.stdout))
    assert shown == CirclesConfig.posts(scanner=Scanner.load({"preset": "tim571"}))
    path.write_text("acceleration_noise = 0.25\n")
    shown = json.loads(run("config", "show", path, "--use", "turning-sensor", "--json").stdout)
    assert (shown["model"], shown["acceleration_noise"]) == ("ctrv-drone", 0.25)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (
            ["--use", "post"],
            f"expected one of {', '.join(USES)}, got 'post'; did you mean posts?",
        ),
        (["--use", "boats"], "got 'boats'"),
        (["--use", "posts", "--model", "flying"], "posts is for circles, got --model flying"),
        (["--use", "posts", "--mode", "paper"], "posts works only in best mode, got --mode paper"),
        (
            ["--use", "turning-sensor", "--preset", "vlp-16"],
            "preset: the model fusion has no presets",
        ),
    ],
)
@pytest.mark.parametrize("command", ["show", "init"])
def test_what_is_no_use_is_refused(command, arguments, text):
    done = run("config", command, *arguments)
    assert isinstance(done.exception, ConfigError)
    assert text in str(done.exception)


def test_no_other_name_is_meant_where_none_is_near():
    with pytest.raises(ConfigError) as refusal:
        use_named("indoor-fleet")
    assert "did you mean" not in str(refusal.value)


@pytest.mark.nightly
def test_trunks_keep_their_numbers_and_places():
    scene = sim.circle_scenes.trees(SEED, scans=640)
    base = config_of(scene, "")
    posts = CirclesConfig.posts(scanner=base.scanner)
    runs = [MapRun.of(mapped(scene, config, seed=SEED, scans=640)) for config in (base, posts)]
    switches = [one.switches() for one in runs]
    present = [np.divide(*one.presence()) for one in runs]
    errors = [seen_errors(one) for one in runs]
    assert switches[1] <= 1 < 5 < switches[0]
    assert present[1] >= present[0] > 0.99
    assert errors[1] < errors[0] < 0.02


def seen_errors(of):
    """Root mean square error of the places of what is in sight [m]."""
    wrong = [of.errors(one)[of.is_visible[:, one], :2] for one in range(of.row.shape[1])]
    wrong = np.concatenate(wrong)
    return np.sqrt(np.square(wrong[np.isfinite(wrong[:, 0])]).sum(axis=1).mean())


@pytest.mark.parametrize("seed", [SEED, SEED + 1])
def test_a_robot_among_trunks_touches_none(seed):
    simulator = sim.Simulator(sim.circle_scenes.trees(seed), seed=0)
    for number in range(0, 600, 40):
        made = simulator.sweep(number)
        way = made.truth.center - made.world_from_lidar[:2, 3]
        assert (np.linalg.norm(way, axis=1) - made.truth.radius).min() > 0.6
    assert made.truth.center.shape == (30, 2)


def test_a_turning_sensor_is_for_recordings_without_poses(tmp_path):
    table, config = tmp_path / "drone.csv", tmp_path / "use.toml"
    assert run("simulate", "overflight", "-o", table, "--scans", 30).exit_code == 0
    assert run("config", "init", "--use", "turning-sensor", "-o", config).exit_code == 0
    plain = ("--no-picture", "--no-mcap", "--config", config)
    done = run("fuse", table, "-o", tmp_path / "run", *plain)
    assert isinstance(done.exception, ConfigError)
    assert "ctrv-drone does not use poses of the platform" in str(done.exception)
    assert not (tmp_path / "run").exists()
    rows = [line.split(",") for line in table.read_text().splitlines()]
    kept = [k for k, name in enumerate(rows[0]) if not name.startswith(("pose", "true"))]
    table.write_text("\n".join(",".join(row[k] for k in kept) for row in rows))
    assert run("fuse", table, "-o", tmp_path / "run", *plain).exit_code == 0


def test_a_file_of_another_use_is_told_as_such(tmp_path):
    config, recording = tmp_path / "posts.toml", tmp_path / "a.npz"
    assert run("config", "init", "--use", "posts", "-o", config).exit_code == 0
    assert run("simulate", "demo", "-o", recording, "--scans", 1).exit_code == 0
    done = run("detect", recording, "-o", tmp_path / "run", "--config", config)
    assert isinstance(done.exception, ConfigError)
    told = f"{config}: holds values of circles, expected those of flying"
    assert str(done.exception) == told
    for more in (("--use", "long-range"), ("--model", "flying")):
        assert str(run("config", "show", config, *more).exception) == told


def test_a_turning_sensor_is_told_by_its_gyro():
    assert FusionConfig.turning_sensor() == FusionConfig(
        model="ctrv-drone", gyro="input", acceleration_noise=1.0
    )
