"""The network that finds all circles of a scan: what it is shown, and what its votes mean."""

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from lidar_core.circles import DatasetConfig, Scanner, make_samples
from lidar_core.circles.crowds import crowds
from lidar_core.errors import FormatError
from lidar_core_training.config import TrainConfig
from lidar_core_training.export import export
from lidar_core_training.networks import parameter_count
from lidar_core_training.one_step import (
    LEAST_RAYS,
    Found,
    OneStepNet,
    grouped,
    loss_of,
    shown,
    truth_of,
)
from lidar_core_training.train import train

SCANNER = Scanner()
SURE = 20.0  # logit of a ray that knows


@pytest.fixture(scope="module")
def made():
    samples = make_samples(DatasetConfig.continuous(circles=1), count=24, seed=1075)
    return crowds(samples, SCANNER, per_scan=6, walls=2, seed=1)


def votes(made):
    answer = truth_of(made, SCANNER)
    answer[:, 0] = np.where(answer[:, 0] > 0, SURE, -SURE)
    return answer


def test_it_is_small():
    assert parameter_count(OneStepNet()) == 18_028


def test_it_sees_hits_and_steps(made):
    given = shown(made.scans, SCANNER)
    assert given.shape == (4, 4, 1081)
    assert np.isfinite(given).all()
    assert_allclose(given[:, 0] > 0, np.isfinite(made.scans))
    assert_allclose(given[:, 2, 1:], given[:, 3, :-1])
    assert OneStepNet()(torch.from_numpy(given)).shape == (4, 4, 1081)


def test_true_votes_give_the_circles_back(made):
    for scan, owner, answer in zip(made.scans, made.owner, votes(made), strict=True):
        rays = np.bincount(owner[owner >= 0], minlength=len(made.circles))
        expected = made.circles[rays >= LEAST_RAYS]
        found = grouped(answer, scan, SCANNER)
        assert len(found) == len(expected)
        assert_allclose(
            found[np.argsort(found[:, 0])], expected[np.argsort(expected[:, 0])], atol=1e-4
        )


def test_true_votes_cost_nothing_and_walls_teach_no_circle(made):
    truth = torch.from_numpy(truth_of(made, SCANNER))
    hits = torch.from_numpy(np.isfinite(made.scans).astype(np.float32))
    answer = torch.from_numpy(votes(made))
    assert float(loss_of(answer, truth, hits)) < 1e-6
    other = (answer + 1.0).requires_grad_()
    (slope,) = torch.autograd.grad(loss_of(other, truth, hits), other)
    on_walls = (hits > 0) & (truth[:, 0] == 0)
    assert not slope[:, 1:].transpose(1, 2)[on_walls].any()
    assert not slope.transpose(1, 2)[hits == 0].any()


def test_precision_and_recall():
    counted = Found()
    true = np.array([[1.0, 0.0, 0.3], [4.0, 0.0, 0.3], [0.0, 5.0, 0.2]])
    counted.add(np.array([[1.0, 0.05, 0.3], [4.5, 0.0, 0.3]]), true)
    counted.add(np.zeros((0, 3)), np.zeros((0, 3)))
    result = counted.summary()
    assert (result["precision"], result["recall"]) == (1 / 2, 1 / 3)
    assert result["mse"] == pytest.approx(0.05**2 / 3)
    assert result["mae"] == pytest.approx(0.05 / 3)


def test_a_run_tells_what_was_found_beside_the_pipeline(tmp_path):
    config = TrainConfig.load(
        {
            "network": "one-step",
            "threads": 1,
            "batch_size": 64,
            "epochs": 1,
            "seed": 78,
            "per_scan": 4,
            "walls": 1,
            "datasets": [DatasetConfig.continuous(circles=400).model_dump(mode="json")],
        }
    )
    (test,) = train(config, tmp_path)["test"]
    assert test["circles"]["scans"] == 20
    assert test["circles"]["pipeline"]["recall"] > 0.8
    assert 0 <= test["circles"]["one-step"]["recall"] <= 1
    with pytest.raises(FormatError, match="the experiment"):
        export(tmp_path, tmp_path / "m.onnx")
