"""The command line: every command explains itself, errors end in one line and status 2."""

import json
import os
import subprocess
import sys
from itertools import pairwise

import pytest
from typer.main import get_command
from typer.testing import CliRunner

import lidar_core
from lidar_core.cli import app, doctor
from lidar_core.parameters import MODELS, model_named
from lidar_core.runs.settings import merged

COMMANDS = sorted(
    [*(command.name for command in app.registered_commands)]
    + [group.name for group in app.registered_groups]
)
CONFIG = ["init", "schema", "show"]
HEAVY = ["matplotlib", "onnxruntime", "pyarrow", "rosbags", "scipy", "torch"]
WITH_PAPER_MODE = ["flying"]


def run(*arguments):
    """What `lidar-core ARGUMENTS` does, in a process of its own."""
    program = "from lidar_core.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


def output_of(*arguments):
    """What a command prints; it must succeed."""
    result = CliRunner().invoke(app, list(map(str, arguments)))
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.mark.parametrize(
    "command",
    [*([name] for name in COMMANDS), *(["config", name] for name in CONFIG)],
    ids=" ".join,
)
def test_every_command_explains_itself(command):
    text = output_of(*command, "--help")
    assert "Usage:" in text
    body = text.partition("Usage:")[2].splitlines()
    assert any(line.strip() for line in body[1:4]), f"{command} has no description"


@pytest.mark.parametrize(
    "command",
    [*([name] for name in COMMANDS), *(["config", name] for name in CONFIG)],
    ids=" ".join,
)
def test_every_help_text_keeps_its_unit(command, monkeypatch):
    """A word in brackets is a style to the library that prints the help, unless it is escaped."""
    monkeypatch.setenv("COLUMNS", "300")
    here = get_command(app)
    for name in command:
        here = here.commands[name]
    text = output_of(*command, "--help")
    for option in here.params:
        written = (getattr(option, "help", None) or "").replace("\\[", "[")
        assert " ".join(written.split()) in text


def test_the_commands_are_those_of_the_guide():
    assert {"config", "demo", "detect", "doctor", "evaluate", "info", "simulate"} <= set(COMMANDS)


def test_version():
    assert output_of("--version") == f"lidar-core {lidar_core.__version__}\n"


def test_the_package_imports_numpy_and_hardly_more():
    """Modules in place of seconds: the same on a slow machine."""
    program = (
        "import sys, numpy\nbefore = set(sys.modules)\nimport lidar_core\n"
        "print(*sorted(set(sys.modules) - before))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    added = done.stdout.split()
    assert len(added) <= 12
    assert {name.partition(".")[0] for name in added} <= {
        "lidar_core",
        "numpy",
        *sys.stdlib_module_names,
    }


@pytest.mark.parametrize("command", [[one.name] for one in app.registered_commands])
def test_help_fills_the_width_and_leaves_room_to_read(command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    shown = output_of(*command, "--help").splitlines()
    (end, *_) = (number for number, line in enumerate(shown) if line.startswith("╭"))
    prose = [line.strip() for line in shown[2:end]]
    for line, after in pairwise(prose):
        assert not (line and after) or len(line) + len(after.split()[0]) >= 78
    assert len(shown) < 115  # `live`, which has the most options


@pytest.mark.nightly
def test_output_fits_an_encoding_of_few_letters(tmp_path):
    """As that of a pipe on Windows."""
    program = "from lidar_core.cli import main; main()"
    for encoding in ("cp1252", "ascii"):
        done = subprocess.run(
            [
                sys.executable,
                "-c",
                program,
                "demo",
                "--scans",
                "2",
                "--no-picture",
                "-o",
                str(tmp_path / encoding),
            ],
            capture_output=True,
            check=False,
            timeout=120,
            env=os.environ | {"PYTHONIOENCODING": encoding},
        )
        assert done.returncode == 0, done.stderr
        assert b"##" in done.stdout
        assert "▪".encode() not in done.stdout


def test_a_name_in_other_letters_is_told_all_the_same(tmp_path):
    program = "from lidar_core.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", program, "info", "飛行.bag"],
        capture_output=True,
        check=False,
        timeout=60,
        cwd=tmp_path,
        env=os.environ | {"PYTHONIOENCODING": "cp1252"},
    )
    assert done.returncode == 2
    assert done.stderr.startswith(b"error: ??.bag: no such file or folder")


def test_ctrl_c_is_told_with_its_exit_status(monkeypatch, tmp_path):
    def stopped(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("lidar_core.io.open_recording", stopped)
    (tmp_path / "a.npz").write_bytes(b"x")
    done = CliRunner().invoke(app, ["convert", str(tmp_path / "a.npz"), str(tmp_path / "b.npz")])
    assert done.exit_code == 130
    assert done.stderr == "interrupted: the files that exist are complete\n"


def test_help_needs_no_heavy_import():
    program = (
        "import sys\nfrom lidar_core.cli import app\n"
        f"sys.exit(', '.join(name for name in {HEAVY} if name in sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert done.stderr.strip() == ""


@pytest.mark.parametrize(
    ("arguments", "others"),
    [
        ("info missing.bag", {"circles", "evaluation", "flying", "fusion", "live", "sim", "viz"}),
        ("detect missing.pcd -o run", {"batch", "circles", "fusion", "live", "sim"}),
        ("circles missing.bag -o run", {"batch", "flying.detector", "fusion", "live", "sim"}),
        ("fuse missing.csv -o run", {"batch", "circles", "flying.detector", "live", "sim"}),
    ],
)
def test_a_command_does_not_import_the_others(arguments, others, tmp_path):
    """They would make half of the time until it says that a file is missing."""
    program = (
        "import sys\nfrom lidar_core.cli import app\n"
        f"try:\n    app({arguments.split()}, standalone_mode=False)\n"
        "except FileNotFoundError:\n    print(*sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    loaded = set(done.stdout.split())
    assert "lidar_core.io" in loaded
    assert loaded.isdisjoint({f"lidar_core.{name}" for name in others})


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["info", "missing.bag"], "missing.bag"),
        (["detect", "missing.pcd", "-o", "run"], "missing.pcd"),
        (["simulate", "missing.toml", "-o", "out.npz"], "missing.toml"),
        (["config", "show", "missing.toml"], "missing.toml"),
        (["config", "show", "--model", "nothing"], "model: expected one of batch, "),
        (["config", "init", "--model", "read", "--mode", "paper"], "read has no paper mode"),
    ],
)
def test_errors_are_one_line_and_status_2(arguments, what, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = run(*arguments)
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert what in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("arguments", [["nonsense"], ["info"], ["config", "show", "--colour"]])
def test_wrong_usage_is_status_2(arguments):
    assert run(*arguments).returncode == 2


@pytest.mark.parametrize(
    "command",
    [["detect", "a.npz", "-o", "run"], ["live"], ["config", "show"], ["config", "fit", "a.csv"]],
    ids=" ".join,
)
def test_a_misspelt_word_is_told_without_words_of_libraries(command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    refused = CliRunner().invoke(app, [*command, "--mode", "pape"])
    assert refused.exit_code == 2
    assert "Invalid value for '--mode': 'pape' is not one of 'best', 'paper'." in refused.output


@pytest.mark.parametrize("name", MODELS)
def test_init_writes_a_file_that_means_the_defaults(name, tmp_path):
    model, path = model_named(name), tmp_path / "config.toml"
    for mode in ["best", "paper"] if name in WITH_PAPER_MODE else ["best"]:
        output_of("config", "init", "--model", name, "--mode", mode, "-o", path, "--overwrite")
        assert model.read(path) == (model() if mode == "best" else model.paper())
        assert output_of("config", "init", "--model", name, "--mode", mode) == path.read_text()


def test_init_explains_every_parameter():
    lines = output_of("config", "init").splitlines()
    for number, line in enumerate(lines):
        if " = " in line and not line.startswith("#"):
            assert lines[number - 1].startswith("# "), line
    assert "# Edge of a voxel, v_s [m]. Allowed: >= 0.01, <= 5." in lines


def test_init_replaces_a_file_only_on_request(tmp_path):
    path = tmp_path / "config.toml"
    path.write_text("mine")
    done = run("config", "init", "-o", path)
    assert (done.returncode, path.read_text()) == (2, "mine")
    assert done.stderr == f"error: {path}: exists; --overwrite replaces it\n"
    done = run("config", "init", "-o", tmp_path / "none" / "a.toml")
    assert done.stderr == f"error: {tmp_path / 'none'}: no such folder, to write a.toml in\n"


def test_show_tells_what_differs(tmp_path):
    path = tmp_path / "config.toml"
    path.write_text("range_std = 0.05\n[voxel_map]\nvoxel_size = 0.5\n")
    shown = json.loads(output_of("config", "show", path, "--json"))
    assert (shown["range_std"], shown["voxel_map"]["voxel_size"]) == (0.05, 0.5)
    table = output_of("config", "show", path, "--changed")
    assert "voxel_map.voxel_size" in table
    assert "range_std" in table
    assert "max_range" not in table  # as `detect --config` has it
    path.write_text("[voxel_map]\nvoxel_size = -1\n")
    done = run("config", "show", path)
    assert done.returncode == 2
    assert done.stderr == (
        f"error: {path}: voxel_map.voxel_size: Input should be greater than or equal to 0.01 m:"
        " lengths are in metres, got -1\n"
    )


def test_show_takes_the_model_from_a_run(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text(
        'command = "x"\n[config.circles]\nmax_deviation = 0.5\n[config.read]\nno_return = "zero"\n'
    )
    table = output_of("config", "show", path, "--changed")
    assert "max_deviation" in table
    assert "no_return" not in table
    shown = json.loads(output_of("config", "show", path, "--model", "read", "--json"))
    assert shown["no_return"] == "zero"


def test_a_folder_of_a_run_stands_for_its_note(tmp_path):
    (tmp_path / "run.toml").write_text("[config.circles]\nmax_deviation = 0.5\n")
    table = output_of("config", "show", tmp_path, "--changed")
    assert "max_deviation" in table
    (tmp_path / "run.toml").unlink()
    done = run("config", "show", tmp_path)
    assert done.stderr == f"error: {tmp_path}/run.toml: No such file or directory\n"


def test_a_file_says_by_its_values_which_model_it_fills(tmp_path):
    path = tmp_path / "scene.toml"
    output_of("config", "init", "--model", "scene", "--preset", "demo", "-o", path)
    shown = json.loads(output_of("config", "show", path, "--json"))
    assert shown["sensor"]["kind"] == "loop"
    table = output_of("config", "show", path, "--changed")
    assert "sensor.straight" in table
    assert f"{len(shown['bodies'])} tables" in table


def test_a_table_of_another_kind_replaces_the_whole_one():
    before = {"motion": {"kind": "hover", "position": [0, 0, 3]}, "scans": 5}
    way = {"kind": "circle", "radius": 2.0}
    assert merged(before, {"motion": way}) == {"motion": way, "scans": 5}
    near = merged(before, {"motion": {"position": [1, 0, 3]}})
    assert near["motion"] == {"kind": "hover", "position": [1, 0, 3]}


def test_help_of_config_lists_every_model():
    for command in ("show", "init", "schema"):
        shown = output_of("config", command, "--help")
        assert [name for name in MODELS if name not in shown] == []


@pytest.mark.parametrize("name", MODELS)
def test_schema_is_the_models_own(name):
    shown = json.loads(output_of("config", "schema", "--model", name))
    assert shown == model_named(name).model_json_schema()


def test_doctor_prints_commands_that_can_be_copied(monkeypatch):
    cure = f"pip install '/{'long/' * 30}lidar-core[train]'"
    report = doctor._report() | {"extras": {"train": {"torch": None}, "io": {"mcap": "1.6"}}}
    monkeypatch.setattr(doctor, "_report", lambda: report)
    monkeypatch.setattr(doctor, "install_command", lambda extra: cure)
    monkeypatch.setenv("COLUMNS", "80")
    lines = CliRunner().invoke(app, ["doctor"]).output.splitlines()
    assert lines[-1] == f"to install train: {cure}"
    assert not any("to install io" in line for line in lines)


def test_doctor_reports_versions_and_extras():
    report = json.loads(output_of("doctor", "--json"))
    assert report["core"] == "works"
    assert report["lidar_core"] == lidar_core.__version__
    assert report["packages"]["numpy"]
    assert set(report["extras"]) >= {"io", "plot", "tables", "velodyne", "viz"}
    assert report["extras"]["plot"].keys() == {"matplotlib"}
    assert "core: works" in output_of("doctor")


def test_doctor_tells_the_machine_and_where_recordings_are(monkeypatch, tmp_path):
    monkeypatch.delenv("LIDAR_CORE_DATA", raising=False)
    report = json.loads(output_of("doctor", "--json"))
    assert 1 <= report["threads"] <= report["cores"]
    assert report["cpu"]["architecture"]
    assert report["recordings"] == {"variable": "LIDAR_CORE_DATA", "folder": None, "exists": False}
    for folder, said in ((tmp_path, str(tmp_path)), (tmp_path / "x", "which is not a folder")):
        monkeypatch.setenv("LIDAR_CORE_DATA", str(folder))
        assert said in output_of("doctor")


def test_doctor_fails_if_the_core_does(monkeypatch):
    monkeypatch.setattr(doctor, "_check_core", lambda: "fails: reason")
    result = CliRunner().invoke(app, ["doctor"])
    assert result.exit_code == 1
    assert "core: fails: reason" in result.output
