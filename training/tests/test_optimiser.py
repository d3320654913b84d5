"""Muon: steps whose singular values are about 1."""

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from torch import nn

from lidar_core_training.optimiser import Optimiser, orthogonal

SHAPES = [(20, 90), (40, 40), (60, 15)]
NEAR_1 = (0.65, 1.25)  # where the iteration leaves singular values that were not small


@pytest.mark.parametrize("shape", SHAPES)
def test_singular_values_are_moved_to_one(shape):
    random = np.random.default_rng(76)
    left, _ = np.linalg.qr(random.normal(size=(shape[0], shape[0])))
    right, _ = np.linalg.qr(random.normal(size=(shape[1], shape[1])))
    short = min(shape)
    given = left[:, :short] * np.geomspace(3.0, 0.1, short) @ right[:, :short].T
    found = orthogonal(torch.from_numpy(given)).numpy() / max(1.0, shape[0] / shape[1]) ** 0.5
    inner = left[:, :short].T @ found @ right[:, :short]
    values = np.diag(inner)
    assert_allclose(inner, np.diag(values), atol=1e-9)
    assert values.min() > NEAR_1[0]
    assert values.max() < NEAR_1[1]


def test_nothing_to_learn_is_no_step():
    assert not orthogonal(torch.zeros(4, 9)).any()


def test_a_matrix_is_found():
    random = np.random.default_rng(77)
    true = torch.from_numpy(random.normal(size=(6, 6)))
    inputs = torch.from_numpy(random.normal(size=(200, 6)))
    layer = nn.Linear(6, 6).double()
    optimiser = Optimiser(layer, [layer.weight], rate=0.0)
    steps = 300
    for step in range(steps):
        loss = (layer(inputs) - inputs @ true.T).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step(5e-3 * (1 - step / steps))
    assert_allclose(layer.weight.detach(), true, atol=0.01)
