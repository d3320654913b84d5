"""Runs: exact resume, several processes, exports, and what a detector says of exported models."""

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

import lidar_core_training
from lidar_core.circles import CircleDetector, DatasetConfig, Scanner, make_samples
from lidar_core.errors import ConfigError, FormatError
from lidar_core_training import checkpoint
from lidar_core_training.config import TrainConfig
from lidar_core_training.curves import draw
from lidar_core_training.export import PARITY, export
from lidar_core_training.tasks import Batch, Data, resident
from lidar_core_training.train import Group, Run, train

CIRCLES = {"kind": "continuous", "draws": 1, "split_by": "circle", "circles": 400}
SMALL = {"threads": 1, "batch_size": 32, "epochs": 2, "seed": 73, "datasets": [CIRCLES]}
CONFIGS = {
    "cnn": TrainConfig.load(
        {**SMALL, "network": "cnn", "schedule": "one-cycle", "gradient_limit": 5.0}
    ),
    "paper-cnn": TrainConfig.load(
        {
            **SMALL,
            "network": "paper-cnn",
            "optimiser": "muon",
            "parts": 2,
            "batch_size": 16,
            "validation_samples": 20,
            "datasets": [CIRCLES | {"circles": 150}],
        }
    ),
}
STEPS_TO_STOP = 5


class PulledPlugError(Exception):
    """As if somebody had pulled the plug."""


@pytest.fixture(scope="module", params=["cnn", "paper-cnn"])
def run(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    results = train(CONFIGS[request.param], folder)
    return request.param, folder, results


def weights(folder):
    return checkpoint.read_torch(folder / "best.pt")


def last_weights(folder):
    (path,) = folder.glob("weights-*.pt")
    return checkpoint.read_torch(path)


def assert_same(first, second):
    assert first.keys() == second.keys()
    for name, value in first.items():
        assert torch.equal(value, second[name]), name


def test_a_run_leaves_metrics_and_a_test(run):
    name, folder, results = run
    with (folder / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == CONFIGS[name].epochs
    if name == "paper-cnn":
        assert {row["validation_samples"] for row in rows} == {"20"}
    assert {"train_loss", "validation_loss", "validation_mse", "validation_mae"} <= rows[0].keys()
    assert json.loads((folder / "test.json").read_text()) == results
    assert results["test"][0]["errors"]["all"]["mse"] > 0
    draw([{key: float(value) for key, value in row.items()} for row in rows], folder / "a.png")
    assert (folder / "a.png").read_bytes().startswith(b"\x89PNG")


def test_the_same_seed_gives_the_same_weights(run, tmp_path):
    name, folder, _ = run
    train(CONFIGS[name], tmp_path)
    assert_same(last_weights(folder), last_weights(tmp_path))


def test_an_interrupted_run_ends_as_if_nothing_had_happened(run, tmp_path):
    name, folder, results = run
    often = CONFIGS[name].model_copy(update={"checkpoint_minutes": 1e-9})
    steps = []

    def stop(epoch, step, total, loss):
        steps.append(step)
        if len(steps) == min(STEPS_TO_STOP, total - 1):
            raise PulledPlugError

    with pytest.raises(PulledPlugError):
        train(often, tmp_path, on_step=stop)
    assert not (tmp_path / "test.json").exists()
    again = train(often, tmp_path)
    assert_same(last_weights(folder), last_weights(tmp_path))
    assert_same(weights(folder), weights(tmp_path))
    assert again == results


def test_another_configuration_does_not_go_on_with_a_run(run):
    name, folder, _ = run
    with pytest.raises(FormatError, match="another configuration"):
        train(CONFIGS[name].model_copy(update={"learning_rate": 0.5}), folder)


def test_a_damaged_checkpoint_holds_no_code(tmp_path):
    path = tmp_path / "weights.pt"
    torch.save({"a": subprocess.Popen}, path)
    with pytest.raises(Exception, match="Weights only load failed"):
        checkpoint.read_torch(path)


def test_two_processes_train_together(tmp_path):
    config = tmp_path / "c.toml"
    config.write_text(CONFIGS["cnn"].to_toml())
    launcher = [sys.executable, "-m", "torch.distributed.run", "--standalone"]
    program = ["-m", "lidar_core_training", "-c", str(config), "-o", str(tmp_path / "run")]
    command = [*launcher, "--nproc_per_node=2", *program]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""}
    subprocess.run(command, check=True, env=environment, timeout=120, capture_output=True)
    alone = tmp_path / "alone"
    train(CONFIGS["cnn"], alone)
    together = last_weights(tmp_path / "run")
    for name, value in last_weights(alone).items():  # sums in another order
        assert torch.allclose(value, together[name], atol=2e-3), name


def test_exported_models_answer_as_torch_does(run, tmp_path):
    name, folder, _ = run
    target = tmp_path / "m.onnx"
    card = export(folder, target)
    model = onnx.load(target)
    assert (model.opset_import[0].version, model.ir_version <= 10) == (17, True)
    assert card["largest_difference_from_torch"] <= PARITY
    assert card == json.loads((tmp_path / "m.json").read_text())
    assert card["training"]["network"] == name
    assert card["passes"] == len(card["metrics"]) / card["training"]["parts"]
    losses = [row["validation_loss"] for row in card["metrics"]]
    assert losses[int(card["best_epoch"]) - 1] == min(losses)
    samples = make_samples(DatasetConfig.continuous(circles=1), count=20, seed=74)
    found = CircleDetector(str(target), allow_untrusted=True).detect(
        samples.scans(Scanner()), Scanner().bearings()
    )
    assert np.asarray(found).shape == (20, 3)
    assert np.isfinite(np.asarray(found)).all()
    assert (np.linalg.eigvalsh(found.covariance) > 0).all()


def test_a_model_that_is_not_its_cards_is_refused(run, tmp_path):
    _, folder, _ = run
    target = tmp_path / "m.onnx"
    export(folder, target)
    with target.open("ab") as file:
        file.write(b"x")
    with pytest.raises(FormatError, match="expected SHA-256"):
        CircleDetector(str(target))


def test_a_run_begins_with_an_exported_network(run, tmp_path):
    name, folder, results = run
    target = tmp_path / "m.onnx"
    export(folder, target)
    config = CONFIGS[name].model_copy(update={"start": str(target), "learning_rate": 1e-12})
    again = train(config, tmp_path / "again")
    for key, value in weights(folder).items():
        assert torch.allclose(weights(tmp_path / "again")[key], value, atol=1e-6), key
    before, after = (export(one, tmp_path / "n.onnx") for one in (folder, tmp_path / "again"))
    assert after["passes"] == 2 * before["passes"]
    assert after["start"]["passes"] == before["passes"]
    error = again["test"][0]["errors"]["all"]["mse"]
    assert error == pytest.approx(results["test"][0]["errors"]["all"]["mse"], rel=1e-3)


def test_a_run_does_not_begin_with_another_network(run, tmp_path):
    name, folder, _ = run
    target = tmp_path / "m.onnx"
    export(folder, target)
    (other,) = CONFIGS.keys() - {name}
    config = CONFIGS[other].model_copy(update={"start": str(target)})
    with pytest.raises(FormatError, match=r"expected .* of shape"):
        train(config, tmp_path / "run")


def test_only_finished_runs_are_exported(tmp_path):
    with pytest.raises(FormatError, match="expected a finished run"):
        export(tmp_path, tmp_path / "m.onnx")


@pytest.mark.parametrize("name", ["cnn", "one-step", "paper", "paper-more", "paper-short"])
def test_configurations_that_come_with_the_package_are_valid(name):
    path = Path(lidar_core_training.__file__).parent / "configs" / f"{name}.toml"
    assert TrainConfig.read(path).network.startswith(
        name.removesuffix("-short").removesuffix("-more")
    )


def test_parts_of_a_pass_show_every_sample_once(tmp_path):
    config = TrainConfig.load({**SMALL, "network": "cnn", "parts": 3, "epochs": 6})
    train(config, tmp_path)
    run = Run(config, tmp_path, Group.joined(config))
    size = run.steps * config.batch_size
    shown = [run._order(epoch)[:size] for epoch in range(6)]
    for number in (0, 3):
        assert len(np.unique(np.concatenate(shown[number : number + 3]))) == 3 * size
    assert not np.array_equal(shown[0], shown[3])


def test_a_wrong_value_is_named():
    with pytest.raises(ConfigError, match="epochs"):
        TrainConfig(epochs=0)


def test_resident_samples_are_those_that_are_prepared_per_step(run, monkeypatch):
    name, folder, _ = run
    monkeypatch.setattr("lidar_core_training.tasks._PREPARED", 7)  # several parts
    one = Run(CONFIGS[name], folder, Group(0, 1, torch.device("cpu")))
    data, rows = one.data["train"], np.array([0, 3, 8, 11, 40])
    everything = resident(one.task, data, torch.device("cpu"), most_bytes=2**30)
    assert isinstance(everything, Batch)
    assert len(everything.truth) == len(data)
    expected, got = one.task.batch(data, rows), everything.rows(rows)
    for a, b in zip((*expected.inputs, expected.truth), (*got.inputs, got.truth), strict=True):
        torch.testing.assert_close(b, a, rtol=0, atol=0)
    assert torch.equal(got.scale, expected.scale)
    assert resident(one.task, data, torch.device("cpu"), most_bytes=everything.n_bytes // 2) is None
    assert resident(one.task, Data.of([]), torch.device("cpu"), most_bytes=2**30) is None
