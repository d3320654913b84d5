"""Batches on a Ray cluster: two nodes, both on this machine."""

import os
import socket
import time
from pathlib import Path

import pytest

pytest.importorskip("ray")

import ray
from ray.cluster_utils import Cluster
from typer.testing import CliRunner

from lidar_core.batch import Failure, Task, completed
from lidar_core.cli import app
from lidar_core.io import read_columns

pytestmark = pytest.mark.filterwarnings("default")  # Ray's own


@pytest.fixture(scope="module")
def cluster():
    """Two nodes with one processor each; the driver finds them by RAY_ADDRESS."""
    monkey = pytest.MonkeyPatch()
    monkey.setenv("RAY_USAGE_STATS_ENABLED", "0")
    monkey.setenv("PYTHONPATH", str(Path(__file__).parent))  # for the tasks below
    made = Cluster(
        initialize_head=True,
        head_node_args={"num_cpus": 1, "include_dashboard": False},
    )
    made.add_node(num_cpus=1)
    monkey.setenv("RAY_ADDRESS", made.address)
    yield made
    ray.shutdown()
    made.shutdown()
    monkey.undo()


def seen(*, number):
    """Where a task runs; the second one fails, the third one's process dies."""
    if number == 1:
        raise ValueError("one")
    if number == 2:
        os._exit(3)
    time.sleep(1.0)
    return ray.get_runtime_context().get_node_id(), socket.gethostname()


@pytest.mark.nightly
def test_tasks_run_on_both_nodes_and_fail_alone(cluster):
    tasks = [Task(str(number), seen, {"number": number}) for number in range(8)]
    found = dict(completed(tasks, workers=2, executor="ray"))
    assert sorted(found) == list(range(8))
    failed = {number for number, outcome in found.items() if isinstance(outcome, Failure)}
    assert failed == {1, 2}
    assert str(found[1].error) == "one"
    assert isinstance(found[2].error, ChildProcessError)
    assert len({found[number][0] for number in set(found) - failed}) == 2


@pytest.mark.nightly
def test_without_an_address_a_cluster_that_runs_here_is_left_alone(cluster, monkeypatch):
    monkeypatch.delenv("RAY_ADDRESS")
    tasks = [Task(str(number), seen, {"number": number}) for number in (0, 3)]
    found = dict(completed(tasks, workers=2, executor="ray"))
    nodes = {node.node_id for node in cluster.list_all_nodes()}
    assert {found[0][0], found[1][0]}.isdisjoint(nodes)


def test_the_command_gives_the_same_as_on_one_machine(cluster, tmp_path):
    file = tmp_path / "jobs.toml"
    file.write_text("""
[[jobs]]
name = "rain"
commands = ["simulate circles -o {output}/made.npz --seed {seed} --scans 3"]
ranges.seed = [1100, 1103]
""")
    made = {}
    for executor in ("ray", "local"):
        folder = tmp_path / executor
        out = CliRunner().invoke(
            app,
            [
                "batch",
                str(file),
                "-o",
                str(folder),
                "--workers",
                "2",
                "--executor",
                executor,
            ],
        )
        assert out.exit_code == 0, out.output
        made[executor] = {path.parent.name: path.read_bytes() for path in folder.glob("*/made.npz")}
        columns = read_columns(next(folder.glob("results.*")))
        assert columns["simulate.scans"].tolist() == [3, 3, 3]
    assert len(made["ray"]) == 3
    assert made["ray"] == made["local"]
