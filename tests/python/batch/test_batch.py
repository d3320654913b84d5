"""`lidar_core.batch` and `lidar-core batch`: many jobs, whatever becomes of some of them."""

import json
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pytest
from commands import running
from hypothesis import given
from hypothesis import strategies as st
from repository import ROOT
from typer.testing import CliRunner

from lidar_core import ConfigError
from lidar_core.batch import (
    BatchConfig,
    BatchGroup,
    JobRecord,
    Task,
    completed,
    jobs_of,
    write_results,
)
from lidar_core.batch.results import flat
from lidar_core.cli import app
from lidar_core.io import read_columns
from lidar_core.run_folder import build_digest
from lidar_core.runs.batch_jobs import Batch
from lidar_core.runs.jobs import run as job_run

SCENE = """
scans = 2
[lidar]
preset = "vlp-16"
[[bodies]]
shape = {kind = "plane"}
"""


def told(*, number, how):
    """A task that ends in one of several ways."""
    if how == "result":
        return 2 * number
    if how == "error":
        raise ValueError(f"number {number}")
    if how == "strange":
        raise Strange(1, 2)
    if how == "unsendable":
        return lambda: number
    if how == "sleep":
        time.sleep(60)
    os._exit(number)
    return None


class Strange(Exception):  # noqa: N818
    """Cannot be made again from what is sent of it."""

    def __init__(self, one, two):
        super().__init__("strange")


def tasks(*how):
    return [Task(str(n), told, {"number": n, "how": one}) for n, one in enumerate(how)]


@pytest.mark.nightly
@pytest.mark.parametrize("workers", [1, 3])
def test_a_task_that_fails_leaves_the_others_alone(workers):
    ways = ["result", "error", "result", "death", "strange", "unsendable", "result"]
    found = dict(completed(tasks(*ways), workers=workers))
    assert sorted(found) == list(range(7))
    assert {n: found[n] for n in (0, 2, 6)} == {0: 0, 2: 4, 6: 12}
    failures = {n: found[n].error for n in (1, 3, 4, 5)}
    assert isinstance(failures[1], ValueError)
    assert str(failures[1]) == "number 1"
    assert str(failures[3]) == "no result: its process ended with status 3"
    assert all(isinstance(failures[n], ChildProcessError) for n in (3, 4, 5))


def test_closing_ends_what_runs():
    ends = completed(tasks("result", "sleep", "sleep"), workers=2)
    assert next(ends) == (0, 0)
    start = time.monotonic()
    ends.close()
    assert time.monotonic() - start < 30


def test_an_unknown_executor_is_refused():
    with pytest.raises(ConfigError, match="executor: expected one of local, ray, got 'dask'"):
        next(completed([], workers=1, executor="dask"))


def group(**values):
    return BatchGroup.load({"name": "g", **values})


def test_jobs_are_every_combination_with_every_row(tmp_path):
    for name in ("b b.bin", "a.bin"):
        (tmp_path / name).write_text("")
    made = jobs_of(
        BatchConfig(
            jobs=(
                group(
                    commands=[
                        "info {file} --x {mode}",
                        "detect '{file}' -o {output}/{seed} --set a={flag}",
                    ],
                    grid={"flag": [True, 0.5]},
                    ranges={"seed": [3, 5]},
                    files={"file": "*.bin"},
                    rows=[{"mode": "one two"}, {"mode": "three"}],
                ),
            )
        ),
        tmp_path,
    )
    assert len(made) == 2 * 2 * 2 * 2
    first = made[0]
    assert first.values == {
        "mode": "one two",
        "file": str(tmp_path / "a.bin"),
        "flag": True,
        "seed": 3,
    }
    assert first.commands[0] == ("info", str(tmp_path / "a.bin"), "--x", "one two")
    assert first.commands_into(Path("out"))[1] == (
        "detect",
        str(tmp_path / "a.bin"),
        "-o",
        "out/3",
        "--set",
        "a=true",
    )
    assert len({job.commands for job in made}) == len(made)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"commands": []}, "at least 1 item"),
        ({"commands": ["info {a}"]}, "a value for every {NAME} .*: {a} has none$"),
        ({"commands": ["info"], "grid": {"a": [1]}}, "every {NAME} .*: no command uses {a}$"),
        (
            {"commands": ["info {a}"], "grid": {"a": [1]}, "ranges": {"a": [0, 1]}},
            "every name once",
        ),
        ({"commands": ["info {a}"], "rows": [{"a": 1}, {"b": 1}]}, "the same names in every row"),
        ({"commands": ["info {a}"], "grid": {"a": []}}, "at least one value, got none for a"),
        ({"commands": ["info {a}"], "ranges": {"a": [3, 3]}}, "at least one value, got none for a"),
        ({"commands": ["info {a}"], "ranges": {"a": [4, 3]}}, "at least one value, got none for a"),
        ({"commands": ["info '"]}, "No closing quotation"),
        ({"commands": ["info"], "name": "../x"}, "pattern"),
    ],
)
def test_a_group_that_cannot_be_done_is_refused(values, text):
    with pytest.raises(ConfigError, match=text):
        group(**values)


def test_the_batch_of_the_guide_can_be_done(tmp_path):
    text = (ROOT / "docs/batch.md").read_text(encoding="utf-8")
    example, remote = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    assert BatchConfig.load(tomllib.loads(remote)).jobs[0].files["file"].startswith("s3://")
    (tmp_path / "recordings").mkdir()
    for name in ("a.bag", "b.bag"):
        (tmp_path / "recordings" / name).write_text("")
    jobs = jobs_of(BatchConfig.load(tomllib.loads(example)), tmp_path)
    assert len(jobs) == 2 * 2 + 100 * 2
    Batch.of(tmp_path / "out", jobs, is_fresh=False)
    (program,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    (tmp_path / "program.py").write_text(program)
    done = subprocess.run(
        [sys.executable, tmp_path / "program.py"], capture_output=True, text=True, check=True
    )
    assert sorted(done.stdout.split("\n")[:-1]) == [f"{n} {n * n}" for n in range(8)]


def test_a_pattern_without_files_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="jobs: expected at least one group of jobs, got none"):
        jobs_of(BatchConfig(), tmp_path)
    config = BatchConfig(jobs=(group(commands=["info {f}"], files={"f": "*.bag"}),))
    with pytest.raises(ConfigError, match=r"jobs\.g\.files\.f: nothing matches .*\*\.bag"):
        jobs_of(config, tmp_path)


def test_patterns_are_seen_from_a_folder_of_any_name(tmp_path):
    folder = tmp_path / "a[1]*"
    folder.mkdir()
    (folder / "x.bag").write_text("")
    (tmp_path / "y.bag").write_text("")
    for pattern, found in (("*.bag", folder / "x.bag"), (f"{tmp_path}/*.bag", tmp_path / "y.bag")):
        config = BatchConfig(jobs=(group(commands=["info {f}"], files={"f": pattern}),))
        (job,) = jobs_of(config, folder)
        assert job.values["f"] == str(found)


numbers = st.none() | st.integers(-9, 9) | st.booleans() | st.text("ab", max_size=3)
trees = st.recursive(numbers, lambda inner: st.dictionaries(st.text("xyz", min_size=1), inner))


@pytest.mark.nightly
@given(st.dictionaries(st.text("xyz", min_size=1), trees))
def test_flat_keeps_every_leaf_at_its_path(tree):
    for path, value in flat(tree).items():
        held = tree
        for name in path.split("."):
            held = held[name]
        assert held == value


def test_rows_of_a_list_go_by_their_names():
    rows = {"rows": [{"name": "recall@10m", "paper": None, "best_mode": 0.5}], "list": [1, 2]}
    assert flat(rows) == {"rows.recall@10m.paper": None, "rows.recall@10m.best_mode": 0.5}


def test_counts_by_reason_have_a_sum_and_a_column_per_kind_of_reason(tmp_path):
    """Of two recordings, whose reasons name their own stamps."""
    reason = "world -> laser is known from {} to {} ns, not at {} ns ({} s before the first)"
    told = [
        {"without_pose": {reason.format(5, 9, 3, 0.723): 2, reason.format(5, 9, 4, 0.1): 1}},
        {"without_pose": {reason.format(-5, 80, 1, 1e-3): 4, "no scans": 1}},
        {"without_pose": {}, "scans": {"rejected": {"stamp_ns: expected > 7, got 3": 2}}},
    ]
    made = [
        JobRecord(str(n), "g", "k", "done", numbers=flat(one, "detect"))
        for n, one in enumerate(told)
    ]
    table = read_columns(write_results(tmp_path / "r.csv", made))
    kind = "detect.without_pose." + reason.format("#", "#", "#", "#")
    assert list(table)[6:] == [
        "detect.without_pose",
        kind,
        "detect.without_pose.no scans",
        "detect.scans.rejected",
        "detect.scans.rejected.stamp_ns: expected > #, got #",
    ]
    assert table["detect.without_pose"].tolist() == [3, 5, 0]
    assert [int(count) for count in table[kind][:2]] == [3, 4]


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_the_table_has_a_column_per_number(tmp_path, suffix):
    if suffix == ".parquet":
        pytest.importorskip("pyarrow")
    path = write_results(
        tmp_path / f"r{suffix}",
        [
            JobRecord("a", "g", "k", "done", 1.5, values={"seed": 1}, numbers={"n": 1, "t": "x"}),
            JobRecord("b", "g", "l", "failed", 0.5, "no", values={"seed": 2}, numbers={"n": 2.5}),
        ],
    )
    columns = read_columns(path)
    assert list(columns) == [
        "job",
        "group",
        "key",
        "status",
        "seconds",
        "error",
        "value.seed",
        "n",
        "t",
    ]
    assert columns["n"].tolist() == [1.0, 2.5]
    assert columns["value.seed"].tolist() == [1, 2]


@pytest.fixture
def batch(tmp_path):
    """A batch file of three jobs, the last of which fails."""
    (tmp_path / "scene.toml").write_text(SCENE)
    file = tmp_path / "jobs.toml"
    file.write_text(f"""
[[jobs]]
name = "good"
commands = [
    "simulate {{scene}} -o {{output}}/made.npz --seed {{seed}}",
]
files.scene = "scene.toml"
ranges.seed = [1000, 1002]
[[jobs]]
name = "bad"
commands = ["info {tmp_path}/nothing.npz"]
""")
    return file


def run_batch(file, *more):
    out = file.parent / "out"
    return CliRunner().invoke(app, ["batch", str(file), "-o", str(out), "--workers", "2", *more])


def records(folder):
    return {path.parent.name: json.loads(path.read_text()) for path in folder.glob("*/job.json")}


@pytest.mark.nightly
def test_what_is_done_is_left_alone_and_failures_are_told(batch):
    folder = batch.parent / "out"
    first = run_batch(batch, "--json", str(batch.parent / "r.json"))
    assert first.exit_code == 1, first.output
    summary = json.loads((batch.parent / "r.json").read_text())
    assert (summary["jobs"], summary["done"], summary["kept"]) == (3, 2, 0)
    ((failed, error),) = summary["failed"].items()
    assert failed.startswith("bad-")
    assert "nothing.npz: no such file or folder" in error
    columns = read_columns(Path(summary["results"]))
    assert columns["status"].tolist() == ["done", "done", "failed"]
    assert columns["value.seed"][:2].tolist() == [1000, 1001]
    assert (columns["simulate.scans"][:2] == 2).all()
    made = {path: path.stat().st_mtime_ns for path in folder.glob("good-*/made.npz")}
    assert len(made) == 2
    again = run_batch(batch, "--json", str(batch.parent / "r.json"))
    assert again.exit_code == 1
    assert json.loads((batch.parent / "r.json").read_text())["kept"] == 2
    assert {path: path.stat().st_mtime_ns for path in folder.glob("good-*/made.npz")} == made
    (batch.parent / "scene.toml").write_text(SCENE.replace("scans = 2", "scans = 3"))
    assert run_batch(batch).exit_code == 1
    assert sorted(
        one["numbers"].get("simulate.scans")
        for one in records(folder).values()
        if one["status"] == "done"
    ) == [2, 2, 3, 3]


def test_jobs_of_two_workers_and_of_one_are_the_same(batch):
    run_batch(batch)
    two = {path.parent.name: path.read_bytes() for path in batch.parent.glob("out/*/made.npz")}
    assert run_batch(batch, "--workers", "1", "--fresh").exit_code == 1
    one = {path.parent.name: path.read_bytes() for path in batch.parent.glob("out/*/made.npz")}
    assert one == two


@pytest.mark.parametrize("text", ["batch x.toml", "view run", "nothing", ""])
def test_what_is_no_job_is_refused(tmp_path, text):
    file = tmp_path / "jobs.toml"
    file.write_text(f'[[jobs]]\nname = "a"\ncommands = ["{text}"]\n')
    out = run_batch(file)
    assert isinstance(out.exception, ConfigError)
    assert "jobs.a.commands: expected one of " in str(out.exception)
    assert not (tmp_path / "out").exists()


ELSEWHERE = {
    "simulate demo -o a.npz": "--output",
    "simulate demo -o a.npz --json {output}/a.json": "--output",
    "simulate demo --json={output}/a.json -oa.npz": "--output",
    "simulate demo -o {output}/../a.npz": "--output",
    "simulate demo -o x/{output}/a.npz": "--output",
    "detect {output}/a.npz -o run": "--output",
    "convert a.bag b.bag": "output",
    "convert {output}/a.bag b.bag": "output",
    "convert a.bag b.bag --json {output}/a.json": "output",
    "export {output}/run model.onnx": "model",
    "evaluate a b --json scores.json": "--json",
    "convert a.bag {output}/b.bag --json {output}/../../a.json": "--json",
    "train circles -c a.toml -o run": "--output",
    "demo": "--output, such as --output {output}/demo",
    "report {output}/run": "--output, such as --output {output}/report.html",
    "events distance<20 {output}/run": "--output, such as --output {output}/events.csv",
}
"""Commands that write outside of the folder of the job, and by what."""


@pytest.mark.parametrize("text", ELSEWHERE)
def test_a_command_that_writes_elsewhere_is_refused(tmp_path, text):
    file = tmp_path / "jobs.toml"
    file.write_text(f'[[jobs]]\nname = "a"\ncommands = ["info a.bag", "{text}"]\n')
    out = run_batch(file)
    assert isinstance(out.exception, ConfigError)
    told = str(out.exception)
    assert f"jobs.a.commands: expected {{output}} in '{text}'" in told
    assert f"as the beginning of {ELSEWHERE[text]}; files elsewhere are not part" in told
    assert not (tmp_path / "out").exists()
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize(
    "text",
    [
        "simulate demo --output={output}/a.npz --json -",
        "convert a.bag {output}/b.bag",
        "evaluate {output}/run truth.csv --json {output}/scores.json",
        "info a.bag",
        "train circles -c a.toml -o {output}",
        "detect a.npz -o{output}/run --mode of-no-such-name",
    ],
)
def test_what_stays_in_the_folder_of_the_job_is_no_matter_of_the_check(text):
    config = BatchConfig.load({"jobs": [{"name": "a", "commands": [text]}]})
    (job,) = jobs_of(config, Path())
    batch = Batch.of(Path("out"), [job], is_fresh=True)
    assert len(batch.jobs) == 1


MISTYPED = {
    "detect a.npz -o {output}/run --nonsense": "No such option: --nonsense",
    "detect a.npz -o {output}/run --pose": "Option '--pose' requires an argument",
    "convert a.bag {output}/b.bag c.bag": "Got unexpected extra argument: c.bag",
    "detect -o {output}/run": "Missing argument: RECORDING",
}
"""Commands that no value can cure."""


@pytest.mark.parametrize("text", MISTYPED)
def test_a_command_that_cannot_be_parsed_is_one_error_before_the_first_job(tmp_path, text):
    file = tmp_path / "jobs.toml"
    commands = json.dumps(["simulate demo --seed {seed} -o {output}/a.npz", text])
    file.write_text(f'[[jobs]]\nname = "a"\ncommands = {commands}\nranges.seed = [0, 3]\n')
    out = run_batch(file)
    assert isinstance(out.exception, ConfigError)
    assert str(out.exception).startswith(f"jobs.a.commands: {text!r}: {MISTYPED[text]}")
    assert list(tmp_path.iterdir()) == [file]


def test_a_command_that_a_job_has_twice_keeps_the_numbers_of_both(batch):
    batch.write_text("""
[[jobs]]
name = "two"
commands = [
    "simulate circles -o {output}/a.npz --scans 2",
    "circles {output}/a.npz -o {output}/run --no-picture --no-mcap",
    "simulate circles -o {output}/b.npz --scans 3",
]
""")
    assert run_batch(batch).exit_code == 0
    columns = read_columns(next(batch.parent.glob("out/results.*")))
    assert (columns["simulate-1.scans"][0], columns["simulate-2.scans"][0]) == (2, 3)
    assert columns["circles.scans.received"].tolist() == [2]
    assert "simulate.scans" not in columns


def test_a_run_whose_objects_cannot_be_collected_is_a_failed_job(tmp_path, monkeypatch):
    """Its commands ended well, but the tables of the batch would lack it."""
    monkeypatch.setattr(job_run, "command_line", lambda: damaged_run)
    work = job_run.Workplace(tmp_path, "a-1")
    (tmp_path / "tracks").mkdir()
    (tmp_path / "tracks" / "a-1.csv").write_text("of an earlier attempt")
    command = ("circles", "x.npz", "-o", str(work.folder / "run"))
    begun = JobRecord("a-1", "a", "k", "running")
    ended = job_run.run_job(
        record=begun,
        commands=[command],
        workplace=work,
        place=Path.cwd(),
        threads=1,
        build=build_digest(),
    )
    assert ended.status == "failed"
    assert "a-1/run: the commands ended, but the objects of this run cannot be coll" in ended.error
    assert "t_ns" in ended.error
    assert not (tmp_path / "tracks" / "a-1.csv").exists()
    assert JobRecord.read(work.folder) == ended


def damaged_run(arguments, *, standalone_mode):
    """A command that leaves a run with a table that lacks its times."""
    del standalone_mode
    folder = Path(arguments[arguments.index("-o") + 1])
    folder.mkdir()
    (folder / "run.toml").write_text("")
    (folder / "tracks.csv").write_text("track_id,x\n1,2.0\n")


def test_threads_are_handed_to_commands_that_take_them(batch):
    batch.write_text("""
[[jobs]]
name = "flight"
commands = [
    "simulate overflight -o {output}/a.csv --scans 20",
    "fuse {output}/a.csv -o {output}/run --no-picture",
    "fuse {output}/a.csv -o {output}/many --association integrated --no-picture",
]
""")
    done = run_batch(batch)
    assert done.exit_code == 0, done.output


def test_files_of_others_are_left_alone(batch):
    run_batch(batch)
    name = next(batch.parent.glob("out/bad-*"))
    (name / "job.json").unlink()
    out = run_batch(batch)
    assert isinstance(out.exception, FileExistsError)
    assert (name / "log.txt").exists()


def test_ctrl_c_leaves_whole_files_and_the_same_command_goes_on(batch):
    batch.write_text(
        batch.read_text()
        .replace("1002", "1004")
        .replace("--seed {seed}", "--seed {seed} --scans 40")
    )
    folder = batch.parent / "out"
    arguments = ("batch", batch, "-o", folder, "--workers", 1)
    with running(*arguments, stderr=subprocess.STDOUT) as process:
        limit = time.monotonic() + 120
        while time.monotonic() < limit and not any(
            one["status"] == "done" for one in records(folder).values()
        ):
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        output = process.communicate(timeout=120)[0]
    assert process.returncode == 130, output
    assert "interrupted: run the same command to resume" in output
    done = [name for name, one in records(folder).items() if one["status"] == "done"]
    assert 1 <= len(done) < 4
    assert set(read_columns(next(folder.glob("results.*")))["job"]) >= set(done)
    before = {name: (folder / name / "made.npz").stat().st_mtime_ns for name in done}
    assert run_batch(batch).exit_code == 1
    assert {name: (folder / name / "made.npz").stat().st_mtime_ns for name in done} == before
    assert sum(one["status"] == "done" for one in records(folder).values()) == 4
