"""Batches whose recordings and results lie on another machine: an S3 server on the loopback."""

import json
import os
import random
import resource
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from commands import invoke

from lidar_core.errors import ConfigError, FormatError, MissingExtraError
from lidar_core.io import read_columns, remote
from lidar_core.runs.catalogue import EVENTS, OBJECTS

RECORDINGS = 6
needs_s3 = pytest.mark.skipif(
    not os.environ.get("CI") and not all(map(find_spec, ("s3fs", "moto", "flask"))),
    reason="s3fs and moto[server] are not installed",
)
needs_fsspec = pytest.mark.skipif(
    not os.environ.get("CI") and find_spec("fsspec") is None, reason="fsspec is not installed"
)
KILLS = 6
PATIENCE_S = 300
MOST = 1.05
"""Time of a batch over that of a bare loop, on a machine without other load: the goal."""


@pytest.fixture(scope="module")
def bucket(tmp_path_factory):
    """Address of a bucket with recordings, on a server of our own."""
    with socket.socket() as place:
        place.bind(("127.0.0.1", 0))
        port = place.getsockname()[1]
    server = subprocess.Popen(
        [sys.executable, "-W", "ignore", "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}",
            "AWS_ACCESS_KEY_ID": "nobody",
            "AWS_SECRET_ACCESS_KEY": "nothing",
            "AWS_DEFAULT_REGION": "us-east-1",
            "AWS_EC2_METADATA_DISABLED": "true",
        }.items():
            patch.setenv(name, value)
        until = time.monotonic() + 60
        while True:
            try:
                urllib.request.urlopen(f"http://127.0.0.1:{port}/moto-api/").close()
                break
            except OSError:
                assert time.monotonic() < until, "the S3 server does not start"
                time.sleep(0.2)
        folder = tmp_path_factory.mktemp("recordings")
        files = pytest.importorskip("s3fs").S3FileSystem()
        files.mkdir("field")
        for seed in range(RECORDINGS):
            file = folder / f"walk {seed}.csv"
            done = invoke("simulate", "overflight", "-o", file, "--seed", seed, "--scans", 40)
            assert done.exit_code == 0, done.output
            files.put_file(str(file), f"field/day/{file.name}")
        yield "s3://field"
    server.terminate()
    server.wait()


def batch_file(folder, files, *, more=""):
    file = folder / "jobs.toml"
    file.write_text(
        '[[jobs]]\nname = "walk"\ncommands = ["fuse {file} -o {output}/run --no-picture --no-mcap"]'
        f'\nfiles.file = "{files}"\n{more}'
    )
    return file


def plain(table):
    """Rows of a table without the times that jobs took, in any order of rows."""
    names = [name for name in table if name not in {"seconds", "time_ms"} and "_ms" not in name]
    rows = zip(*(table[name].tolist() for name in names), strict=True)
    return names, sorted(map(str, rows))


def tables(address, folder):
    """Results, events and objects that a batch left at an address."""
    results = read_columns(remote.fetched(f"{address}/results.parquet", folder / "r"))
    events = read_columns(remote.fetched(f"{address}/events.parquet", folder / "e"))
    places = remote.matching(f"{address}/tracks/*")
    objects = [read_columns(remote.fetched(one, folder / "t")) for one in places]
    assert all(list(one) == list(OBJECTS) for one in objects)
    together = {name: np.concatenate([one[name] for one in objects]) for name in OBJECTS}
    kept = {
        name: values
        for name, values in results.items()
        if not name.endswith("_ms") and "ms_per" not in name and "us_per" not in name
    }
    return plain(kept), plain(events), plain(together)


@needs_s3
def test_a_batch_reads_and_writes_s3(bucket, tmp_path):
    """The tables name the recordings by their addresses; what is done is kept."""
    file = batch_file(tmp_path, f"{bucket}/day/*.csv")
    out = f"{bucket}/out"
    told = tmp_path / "a.json"
    done = invoke("batch", file, "-o", out, "--workers", 2, "--json", told)
    assert done.exit_code == 0, done.output
    summary = json.loads(told.read_text())
    assert (summary["done"], summary["kept"]) == (RECORDINGS, 0)
    assert summary["results"] == f"{out}/results.parquet"
    results = read_columns(remote.fetched(f"{out}/results.parquet", tmp_path))
    assert sorted(results["value.file"].tolist()) == [
        f"{bucket}/day/walk {seed}.csv" for seed in range(RECORDINGS)
    ]
    events = read_columns(remote.fetched(f"{out}/events.parquet", tmp_path))
    assert list(events) == list(EVENTS)
    assert sorted(set(events["recording"].tolist())) == sorted(results["value.file"].tolist())
    names = {
        place.removeprefix(f"{out}/").partition("/")[0] for place in remote.matching(f"{out}/*")
    }
    jobs = names - {"results.parquet", "events.parquet", "batch.toml", "tracks"}
    assert len(jobs) == RECORDINGS
    assert all(name.startswith("walk-walk-") for name in jobs)  # readable: group, file, digest
    for job in jobs:
        held = {place.rpartition("/")[2] for place in remote.matching(f"{out}/{job}/*")}
        assert {"job.json", "log.txt", "run"} <= held
        assert "input" not in held
    again = invoke("batch", file, "-o", out, "--workers", 2, "--json", told)
    assert again.exit_code == 0, again.output
    assert json.loads(told.read_text())["kept"] == RECORDINGS
    asked = invoke("events", "event == 'first_sight'", f"{out}/events.parquet", "--json", "-")
    assert len(json.loads(asked.stdout)) == RECORDINGS
    local = invoke("batch", file, "-o", tmp_path / "here", "--workers", 2)
    assert local.exit_code == 0, local.output
    here = read_columns(tmp_path / "here" / "events.parquet")
    assert plain(here)[1] == plain(events)[1]


def workers_of(process):
    """Processes below that of a batch; none once it has ended."""
    import psutil

    try:
        return psutil.Process(process.pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return []


def ended_by_chance(process, draw):
    """End the batch or one of its workers; return whether the batch itself still runs."""
    import psutil

    workers = workers_of(process)
    try:
        victim = draw.choice([psutil.Process(process.pid), *workers, *workers])
        victim.send_signal(signal.SIGKILL)
    except psutil.NoSuchProcess:
        return process.poll() is None
    return victim.pid != process.pid


def done_despite_kills(file, out, *, kills, seed, calm_s):
    """Do a batch again and again until it is done, with kills while it works.

    Returns its passes and the kills that met it.

    The pauses between them, in which workers run, are together no longer than `calm_s`, the time
    that the batch takes without kills. So all of them meet it on machines of any speed, and half of
    them where the machine becomes faster meanwhile.
    """
    patience = PATIENCE_S + kills + 10 * calm_s
    draw, left, passes, until = random.Random(seed), kills, 0, time.monotonic() + patience
    status = None
    while status != 0:
        assert time.monotonic() < until
        passes += 1
        process = subprocess.Popen(
            [sys.executable, "-m", "lidar_core", "batch", file, "-o", out, "--workers", "2"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        runs = True
        while left and runs:
            while process.poll() is None and not workers_of(process):
                time.sleep(0.02)
            time.sleep(draw.uniform(0, calm_s / kills))
            runs = process.poll() is None
            if runs:
                left -= 1
                runs = ended_by_chance(process, draw)
        status = process.wait(patience)
        assert status in {0, 1, -signal.SIGKILL}
    assert left <= kills // 2
    return passes, kills - left


@pytest.mark.nightly
@needs_s3
@pytest.mark.skipif(find_spec("psutil") is None, reason="psutil is not installed")
def test_kills_of_workers_and_of_the_batch_leave_the_same_tables(bucket, tmp_path):
    """The same command again is all that is done about it."""
    file = batch_file(tmp_path, f"{bucket}/day/*.csv", more="grid.lag = [0, 0.5]\n")
    file.write_text(file.read_text().replace("--no-mcap", "--no-mcap --lag {lag}"))
    calm, rough = f"{bucket}/calm", f"{bucket}/rough"
    began = time.monotonic()
    assert invoke("batch", file, "-o", calm, "--workers", 2).exit_code == 0
    done_despite_kills(file, rough, kills=KILLS, seed=0, calm_s=time.monotonic() - began)
    (tmp_path / "calm").mkdir()
    (tmp_path / "rough").mkdir()
    assert tables(rough, tmp_path / "rough") == tables(calm, tmp_path / "calm")


def processor_s(whose):
    """Processor time of this process, or of those that it has waited for."""
    used = resource.getrusage(whose)
    return used.ru_utime + used.ru_stime


@needs_s3
@pytest.mark.nightly
@pytest.mark.skipif(find_spec("psutil") is None, reason="psutil is not installed")
def test_a_thousand_recordings_with_fifty_kills(bucket, tmp_path, capsys):
    """The same tables as without kills; a batch costs little beside the work itself."""
    import s3fs

    files, folder = s3fs.S3FileSystem(), tmp_path / "walks"
    folder.mkdir()
    for seed in range(1000):
        walk = folder / f"{seed:04}.csv"
        done = invoke("simulate", "overflight", "-o", walk, "--seed", seed, "--scans", 20)
        assert done.exit_code == 0, done.output
        files.put_file(str(walk), f"field/many/{walk.name}")
    file = batch_file(tmp_path, f"{bucket}/many/*.csv")
    began, worked = time.monotonic(), processor_s(resource.RUSAGE_CHILDREN)
    calm = subprocess.run(
        [
            *(sys.executable, "-m", "lidar_core", "batch", file),
            *("-o", f"{bucket}/many-calm", "--workers", "1"),
        ],
        capture_output=True,
        check=False,
    )
    assert calm.returncode == 0, calm.stderr
    took, worked = time.monotonic() - began, processor_s(resource.RUSAGE_CHILDREN) - worked
    began, own = time.monotonic(), processor_s(resource.RUSAGE_SELF)
    for number, name in enumerate(sorted(files.ls("field/many"))):
        walk = tmp_path / "bare.csv"
        files.get_file(name, str(walk))
        out = tmp_path / "bare" / str(number)
        done = invoke("fuse", walk, "-o", out, "--no-picture", "--no-mcap")
        assert done.exit_code == 0, done.output
        files.put(str(out), f"field/bare/{number}", recursive=True)
    bare, own = time.monotonic() - began, processor_s(resource.RUSAGE_SELF) - own
    with capsys.disabled():
        sys.stdout.write(
            f"batch {took:.0f} s, bare loop {bare:.0f} s; of processors {worked:.0f}, {own:.0f} s\n"
        )
    passes, met = done_despite_kills(
        file, f"{bucket}/many-rough", kills=50, seed=1, calm_s=took / 2
    )
    (tmp_path / "calm").mkdir()
    (tmp_path / "rough").mkdir()
    assert tables(f"{bucket}/many-rough", tmp_path / "rough") == tables(
        f"{bucket}/many-calm", tmp_path / "calm"
    )
    with capsys.disabled():
        sys.stdout.write(f"passes {passes}, kills {met}\n")
    assert took <= MOST * bare


@needs_fsspec
def test_files_in_memory_are_listed_fetched_and_stored(tmp_path):
    import fsspec

    memory = fsspec.filesystem("memory")
    memory.pipe({"/a/x.csv": b"1", "/a/b/y.csv": b"22", "/a/z.txt": b"3"})
    assert remote.matching("memory://a/*.csv") == ["memory:///a/x.csv"]
    assert len(remote.matching("memory://a/**/*.csv")) == 2
    assert [size for _, size, _ in remote.file_versions("memory://a")] == [2, 1, 1]
    before = remote.file_versions("memory://a/x.csv")
    time.sleep(0.01)
    memory.pipe("/a/x.csv", b"2")
    assert remote.file_versions("memory://a/x.csv") != before
    place = remote.fetched("memory://a", tmp_path)
    assert (place / "b" / "y.csv").read_bytes() == b"22"
    remote.stored(place, "memory://c", last=("x.csv",))
    assert remote.texts("memory://c/*.csv") == {"memory:///c/x.csv": b"2"}
    remote.stored(tmp_path / "a" / "b", "memory://c")
    assert memory.find("/c") == ["/c/y.csv"]
    assert remote.held_names("memory://a") == {"x.csv", "b", "z.txt"}
    assert remote.held_names("memory://none") == set()
    (place / "z.txt").unlink()
    remote.stored(place, "memory://c", is_replaced=False)
    assert memory.find("/c") == ["/c/b/y.csv", "/c/x.csv", "/c/y.csv"]
    with pytest.raises(FileNotFoundError, match="memory://none: no such file or folder"):
        remote.fetched("memory://none", tmp_path)
    with pytest.raises(FormatError, match="nosuch://a"):
        remote.matching("nosuch://a/*")


def test_without_fsspec_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    with pytest.raises(MissingExtraError, match=r"files of other machines needs .*\[cloud\]"):
        remote.matching("s3://a/*")


def test_jobs_come_from_a_table(tmp_path):
    (tmp_path / "runs.csv").write_text("seed,name\n3,a b\n4,c\n")
    file = tmp_path / "jobs.toml"
    file.write_text(
        '[[jobs]]\nname = "t"\nrows = "runs.csv"\n'
        'commands = ["simulate overflight -o {output}/{name}.csv --seed {seed} --scans 10"]\n'
    )
    done = invoke("batch", file, "-o", tmp_path / "out", "--workers", 1)
    assert done.exit_code == 0, done.output
    made = sorted(path.parent.name[:-9] + "/" + path.name for path in tmp_path.glob("out/*/*.csv"))
    assert [name for name in made if "truth" not in name] == ["t-3-a-b/a b.csv", "t-4-c/c.csv"]
    (tmp_path / "runs.csv").write_text("seed\n3\n")
    refused = invoke("batch", file, "-o", tmp_path / "out", "--workers", 1)
    assert isinstance(refused.exception, ConfigError)
    assert "jobs.t.rows: runs.csv: expected a value for every {NAME}" in str(refused.exception)
    (tmp_path / "runs.csv").write_text("seed,name\n")
    refused = invoke("batch", file, "-o", tmp_path / "out", "--workers", 1)
    assert "jobs.t.rows: runs.csv: expected rows, got none" in str(refused.exception)


def test_names_of_jobs_tell_what_they_are(tmp_path):
    from lidar_core.runs.batch_jobs import NAME_LENGTH, BatchJob, _name

    job = BatchJob("field", {"file": "/data/2026/a b.bag", "mode": "best", "on": True}, ())
    assert _name(job, "0123456789abcdef") == "field-a-b-best-true-01234567"
    long = BatchJob("g", {"text": "x" * 300}, ())
    assert len(_name(long, "0" * 64)) == NAME_LENGTH
    other = BatchJob("g", {"text": "../.."}, ())
    assert Path(_name(other, "0" * 64)).name == "g-00000000"
