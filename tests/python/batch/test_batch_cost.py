"""What a batch adds to the runs themselves: waits for the disk, and time of the processor."""

import errno
import os
import resource
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import pytest
from commands import invoke

import lidar_core as lc
from lidar_core.batch import BatchJob, Failure, JobRecord, jobs_of
from lidar_core.batch.config import BatchConfig
from lidar_core.errors import ConfigError
from lidar_core.io import remote
from lidar_core.io.files import atomic
from lidar_core.io.files.atomic import synced_together, unsynced, written_whole
from lidar_core.run_folder import lock, unlock
from lidar_core.runs.batch_jobs import Batch, _begin
from lidar_core.runs.jobs.commands import check_commands
from lidar_core.runs.jobs.passage import PREFIX, passage, remove_abandoned

MOST = 1.05
"""Of the time of a bare loop. Source: goal of a batch of 1,000 short recordings."""
posix = pytest.mark.skipif(os.name != "posix", reason="names of open files, and their folders")


@pytest.fixture
def synced(monkeypatch):
    """Paths that were brought to the disk, in order."""
    paths = []
    monkeypatch.setattr(atomic, "_sync", paths.append)
    monkeypatch.setattr(atomic, "_sync_folder", paths.append)
    return paths


def write(path, text):
    with written_whole(path) as temporary:
        temporary.write_text(text)


@posix
def test_files_of_a_block_are_on_the_disk_at_its_end(tmp_path, synced):
    with synced_together():
        write(tmp_path / "a", "1")
        write(tmp_path / "b", "2")
        write(tmp_path / "a", "3")
        write(tmp_path / "gone", "4")
        (tmp_path / "gone").unlink()
        assert (tmp_path / "a").read_text() == "3"
        assert synced == []
    assert synced == [tmp_path / "a", tmp_path / "b", tmp_path]


@posix
def test_after_a_block_that_fails_each_file_is_synced_again(tmp_path, synced):
    @synced_together()
    def failing():
        write(tmp_path / "a", "1")
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        failing()
    assert synced == []
    write(tmp_path / "b", "2")
    assert len(synced) == 2
    assert synced[1] == tmp_path


def recording(folder, scans):
    file = folder / "walk.csv"
    done = invoke("simulate", "overflight", "-o", file, "--scans", scans)
    assert done.exit_code == 0, done.output
    return file


def batch_of(folder, file, count, more=""):
    """A batch of equal jobs."""
    jobs = folder / "jobs.toml"
    jobs.write_text(
        f'[[jobs]]\nname = "walk"\ncommands = ["fuse {file} -o {{output}}/run{more}"]\n'
        f"rows = [{', '.join(f'{{number = {number}}}' for number in range(count))}]\n".replace(
            "{output}/run", "{output}/run-{number}"
        )
    )
    return jobs


@posix
def test_a_job_waits_for_the_disk_as_often_as_its_runs_and_last_for_its_record(tmp_path, synced):
    """The record says "done": what it speaks of is on the disk before."""
    file = recording(tmp_path, 3)
    lc.runs.fuse(file, None, tmp_path / "bare", picture=False, mcap=False)
    bare = len(synced)
    jobs = jobs_of(
        BatchConfig.read(batch_of(tmp_path, file, 1, " --no-picture --no-mcap")), tmp_path
    )
    batch = Batch.of(tmp_path / "out", jobs, is_fresh=True)
    synced.clear()
    (name,) = batch.jobs
    _begin(batch.folder / name, batch._record(name))
    assert synced == []
    task = batch._task(name, 1)
    record = task.function(**task.arguments)
    assert (record.status, record.error) == ("done", "")
    *before, note, folder = synced
    assert folder == batch.folder / name
    assert note.name.startswith(".job.json.")
    written = {one for one in (batch.folder / name).rglob("*") if one.is_file()}
    written |= set((batch.folder / "tracks").iterdir())
    unsynced = written - set(before)
    assert {one.name for one in unsynced} == {"job.json", "log.txt"}
    assert len(synced) <= bare


@posix
@pytest.mark.skipif(find_spec("fsspec") is None, reason="fsspec is not installed")
def test_a_job_whose_results_go_elsewhere_does_not_wait_for_this_disk(tmp_path, synced):
    """Its folder is removed here. What is written here afterwards is on the disk again."""
    file = recording(tmp_path, 3)
    jobs = jobs_of(
        BatchConfig.read(batch_of(tmp_path, file, 1, " --no-picture --no-mcap")), tmp_path
    )
    batch = Batch.of(tmp_path / "out", jobs, is_fresh=True, remote="memory://elsewhere")
    (name,) = batch.jobs
    synced.clear()
    task = batch._task(name, 1)
    record = task.function(**task.arguments)
    assert (record.status, record.error) == ("done", "")
    assert synced == []
    held = remote.matching(f"memory://elsewhere/{name}/**/*.*")
    assert {one.rpartition("/")[2] for one in held} >= {"job.json", "log.txt", "run.toml"}
    write(tmp_path / "a", "1")
    assert len(synced) == 2


@pytest.mark.skipif(find_spec("fsspec") is None, reason="fsspec is not installed")
def test_a_job_whose_process_died_before_it_began_is_told_at_the_address(tmp_path):
    jobs = jobs_of(BatchConfig.read(batch_of(tmp_path, recording(tmp_path, 3), 1)), tmp_path)
    batch = Batch.of(tmp_path / "out", jobs, is_fresh=True, remote="memory://dead")
    (name,) = batch.jobs
    batch._failed(name, Failure(ChildProcessError("no result")))
    (held,) = remote.texts(f"memory://dead/{name}/job.json").values()
    assert JobRecord.parsed(held).status == "failed"


def test_the_parser_of_a_command_forgets_the_arguments_of_other_jobs():
    def check(*command):
        check_commands(BatchJob("g", {}, (command,)))

    check("detect", "a.bag", "-o", "{output}/run", "--json", "{output}/a.json")
    check("detect", "a.bag", "-o", "{output}/run")
    check("train", "circles", "-o", "{output}/run")
    with pytest.raises(ConfigError, match=r"expected \{output\}"):
        check("detect", "a.bag", "-o", "elsewhere/run")
    with pytest.raises(ConfigError, match=r"expected \{output\}"):
        check("detect", "a.bag")
    check("detect", "a.bag", "-o", "{output}/run")


def test_unsynced_ends_with_its_block(tmp_path, synced):
    @unsynced()
    def failing():
        write(tmp_path / "a", "1")
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        failing()
    assert synced == []
    assert (tmp_path / "a").read_text() == "1"
    write(tmp_path / "b", "2")
    assert synced[-1] == tmp_path


@pytest.mark.parametrize("is_first", [True, False])
def test_a_record_is_never_seen_half_written(tmp_path, monkeypatch, is_first):
    record = JobRecord("a", "group", "key", "running")
    if not is_first:
        record.write(tmp_path)
    before = JobRecord.read(tmp_path)
    whole = Path.write_text
    seen = []

    def halves(path, text, **more):
        whole(path, text[: len(text) // 2], **more)
        seen.append((JobRecord.read(tmp_path), (tmp_path / "job.json").exists()))
        return whole(path, text, **more)

    monkeypatch.setattr(Path, "write_text", halves)
    later = JobRecord("a", "group", "key", "done")
    later.write(tmp_path, is_first=is_first)
    assert seen == [(before, not is_first)]
    assert JobRecord.read(tmp_path) == later
    assert [one.name for one in tmp_path.iterdir()] == ["job.json"]


@posix
def test_a_job_that_begins_again_is_marked_before_its_files_go(tmp_path, monkeypatch):
    """Killed in between, it is not taken for the finished job that it was."""
    jobs = jobs_of(BatchConfig.read(batch_of(tmp_path, recording(tmp_path, 3), 1)), tmp_path)
    batch = Batch.of(tmp_path / "out", jobs, is_fresh=True)
    (name,) = batch.jobs
    folder = batch.folder / name
    folder.mkdir(parents=True)
    JobRecord(name, "walk", batch.keys[name], "done").write(folder)
    (folder / "log.txt").write_text("an earlier job")
    assert list(Batch.of(tmp_path / "out", jobs, is_fresh=False).kept) == [name]

    def killed(path, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "unlink", killed)
    with pytest.raises(KeyboardInterrupt):
        list(batch.run(executor="local", workers=1))
    monkeypatch.undo()
    assert not Batch.of(tmp_path / "out", jobs, is_fresh=False).kept


@posix
def test_a_job_whose_table_another_batch_removed_is_not_taken_for_finished(tmp_path):
    jobs = jobs_of(BatchConfig.read(batch_of(tmp_path, recording(tmp_path, 3), 1)), tmp_path)
    batch = Batch.of(tmp_path / "out", jobs, is_fresh=True)
    (name,) = batch.jobs
    done = JobRecord(name, "walk", batch.keys[name], "done", events=[{"event": "lost"}])
    (batch.folder / name).mkdir(parents=True)
    done.write(batch.folder / name)
    table = batch.folder / "tracks" / f"{name}.csv"
    table.parent.mkdir()
    table.write_text("")
    assert list(Batch.of(tmp_path / "out", jobs, is_fresh=False).kept) == [name]
    table.unlink()
    assert not Batch.of(tmp_path / "out", jobs, is_fresh=False).kept


def abandoned(folder, name):
    """A folder as a killed batch leaves it, some time ago."""
    made = folder / name
    (made / "job" / "input").mkdir(parents=True)
    (made / "job" / "input" / "a.bag").write_text("large")
    os.utime(made, (1e9, 1e9))
    return made


@posix
def test_what_killed_batches_left_on_this_machine_goes(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    left = abandoned(tmp_path, f"{PREFIX}dead")
    with passage() as folder:
        assert not left.exists()
        assert folder.parent == tmp_path
        assert folder.name.startswith(PREFIX)
    assert list(tmp_path.iterdir()) == []


@posix
def test_folders_of_running_batches_and_of_others_stay(tmp_path):
    """Those that are locked, too young to be locked, named otherwise, or links."""
    held = abandoned(tmp_path, f"{PREFIX}held")
    foreign = abandoned(tmp_path, "mine")
    (tmp_path / f"{PREFIX}link").symlink_to(foreign)
    young = tmp_path / f"{PREFIX}young"
    young.mkdir()
    abandoned(tmp_path, "lidar-core-batch-other-machine-of-a-worker")
    own = abandoned(tmp_path, f"{PREFIX}own")
    lock(own)  # by another batch of this process
    os.utime(own, (1e9, 1e9))
    code = (
        "import sys; from pathlib import Path; from lidar_core.run_folder import lock;"
        "lock(Path(sys.argv[1])); print('held', flush=True); sys.stdin.read()"
    )
    command = [sys.executable, "-c", code, held]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout.readline().strip() == b"held"
        before = sorted(tmp_path.rglob("*"))
        remove_abandoned(tmp_path)
        assert sorted(tmp_path.rglob("*")) == before
        other.stdin.close()
        other.wait()
    remove_abandoned(tmp_path)
    assert not held.exists()
    assert own.exists()
    unlock(own)
    remove_abandoned(tmp_path)
    assert not own.exists()


def test_where_nothing_tells_of_locks_folders_stay(tmp_path, monkeypatch):
    fcntl = pytest.importorskip("fcntl")
    left = abandoned(tmp_path, f"{PREFIX}dead")

    def unknown(*_):
        raise OSError(errno.ENOLCK, "no locks")

    monkeypatch.setattr(fcntl, "flock", unknown)
    remove_abandoned(tmp_path)
    assert left.exists()
    monkeypatch.undo()
    remove_abandoned(tmp_path)
    assert not left.exists()


@pytest.mark.nightly
def test_a_batch_costs_hardly_more_than_a_bare_loop(tmp_path):
    """Processor time of one more job against one more run: the start of a worker is paid once."""
    file = recording(tmp_path, 100)

    def spent():
        who = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
        return sum(sum(resource.getrusage(one)[:2]) for one in who)

    def loop(count):
        before = spent()
        for number in range(count):
            lc.runs.fuse(file, None, tmp_path / f"bare-{count}-{number}", overwrite=True)
        return spent() - before

    def batch(count):
        before = spent()
        out = tmp_path / f"out-{count}"
        done = lc.runs.batch(batch_of(tmp_path, file, count), out, workers=1, fresh=True)
        assert done.summary["done"] == count, done.summary
        return spent() - before

    loop(1)
    costs = []
    for _ in range(3):
        bare = (loop(22) - loop(2)) / 20
        costs.append((batch(22) - batch(2)) / 20 / bare)
    assert min(costs) <= MOST, costs
