"""Table I, eq. 7 and the likelihood."""

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from lidar_core.circles.estimators.architecture import paper_layers, window_layers
from lidar_core.circles.estimators.windows import MISSING
from lidar_core_training.losses import characteristic_points, four_points, gaussian, whitened
from lidar_core_training.networks import PaperNet, WindowNet, parameter_count

FLOAT32 = 1e-5  # relative rounding of sums over some tens of float32 numbers


def test_table_1_has_the_published_number_of_weights():
    assert parameter_count(PaperNet()) == 1_826_350


def test_layers_of_table_1():
    network = PaperNet()
    scans = torch.zeros(2, 1, 1081)
    lengths = []
    for layer in network.features[::2]:
        scans = layer(scans)
        lengths.append(scans.shape[2])
    assert lengths == [1075, 535, 529, 262, 256, 125]
    assert network(torch.zeros(2, 1, 1081)).shape == (2, 3)
    with pytest.raises(ValueError, match="n_beams"):
        PaperNet(40)


def test_the_strides_of_table_1_leave_out_the_last_four_rays():
    scans = torch.rand(1, 1, 1081, requires_grad=True)
    network = PaperNet()
    answer = network.head(network.features(scans).flatten(1))
    (slope,) = torch.autograd.grad(answer.square().sum(), scans)
    assert not slope[0, 0, -4:].any()
    assert slope[0, 0, -5] != 0


@pytest.mark.parametrize("n_beams", [1081, 360])
def test_skipping_misses_changes_nothing(n_beams):
    random = np.random.default_rng(75)
    scans = np.full((40, 1, n_beams), MISSING, np.float32)
    for scan, width in zip(scans[:, 0], random.integers(1, 120, 40), strict=True):
        first = random.integers(0, n_beams - width)
        scan[first : first + width] = random.uniform(size=width)
    scans[0, 0, :5], scans[1, 0, -3:] = 0.5, 0.5  # at the ends of the field of view
    scans[2], scans[3] = random.uniform(size=n_beams), MISSING
    shown = torch.from_numpy(scans).double()
    network = PaperNet(n_beams).double()
    with torch.no_grad():
        for layer in network.features[::2]:
            layer.bias.uniform_(-0.1, 0.1)
    found, expected = network(shown), network.head(network.features(shown).flatten(1))
    assert_allclose(found.detach(), expected.detach(), rtol=1e-9, atol=1e-12)
    weights = list(network.parameters())
    slopes = (torch.autograd.grad(answer.square().sum(), weights) for answer in (found, expected))
    for first, second in zip(*slopes, strict=True):
        assert_allclose(first, second, rtol=1e-7, atol=1e-9)


def test_the_layers_that_are_told_are_those_of_the_networks():
    paper = PaperNet()
    modules = [*paper.features[::2], *paper.head[::2]]
    for layer, module in zip(paper_layers(1081), modules, strict=True):
        assert layer.parameters == parameter_count(module), layer
    network = WindowNet()
    layers = window_layers(network.ray.out_features, network.enter.out_features)
    assert {layer.name: layer.parameters for layer in layers} == {
        name: parameter_count(module)
        for name, module in network.named_children()
        if parameter_count(module)
    }
    assert [layer.length for layer in paper_layers(1081)][:6] == [1075, 535, 529, 262, 256, 125]


def test_the_small_network_is_small():
    assert parameter_count(WindowNet()) <= 200_000


def test_eq_7_is_three_times_the_mse():
    random = np.random.default_rng(70)
    first, second = torch.from_numpy(random.uniform(-5, 5, (2, 40, 3)).astype(np.float32))
    expected = 3 * float((first - second).square().mean())
    assert float(four_points(first, second)) == pytest.approx(expected, rel=FLOAT32)


def test_characteristic_points_are_where_the_axes_cut_the_circle():
    points = characteristic_points(torch.tensor([[2.0, 1.0, 0.5]]))
    assert_allclose(points[0], [[2.5, 1.0], [2.0, 1.5], [1.5, 1.0], [2.0, 0.5]])


def test_the_likelihood_is_that_of_the_normal_distribution():
    random = np.random.default_rng(71)
    answer = torch.from_numpy(random.uniform(-1, 1, (5, 9)))
    true = torch.from_numpy(random.uniform(-1, 1, (5, 3)))
    std = torch.exp(answer[:, 3:6])
    lower = torch.diag_embed(std)
    lower[:, 1, 0] = answer[:, 6] * std[:, 1]
    lower[:, 2, 0], lower[:, 2, 1] = answer[:, 7] * std[:, 2], answer[:, 8] * std[:, 2]
    normal = torch.distributions.MultivariateNormal(answer[:, :3], scale_tril=lower)
    constant = 1.5 * np.log(2 * np.pi)
    expected = -(normal.log_prob(true) + constant).mean()
    found = gaussian(answer, true, torch.ones(5), 0.0)
    assert float(found) == pytest.approx(float(expected), rel=1e-12)
    assert_allclose(
        whitened(answer, true)[0].square().sum(1),
        normal.covariance_matrix.inverse()
        .matmul((true - answer[:, :3])[:, :, None])[:, :, 0]
        .mul(true - answer[:, :3])
        .sum(1),
        rtol=1e-9,
    )


def test_slots_that_are_not_used_change_nothing():
    random = np.random.default_rng(72)
    network = WindowNet()
    slots = torch.from_numpy(random.uniform(-1, 1, (4, 32, 4)).astype(np.float32))
    slots[:, :, 3] = 1.0
    slots[:, 10:] = 0.0
    context = torch.from_numpy(random.uniform(-1, 1, (4, 21)).astype(np.float32))
    with torch.no_grad():
        assert_allclose(network(slots, context), network(slots[:, :10], context), atol=1e-6)
