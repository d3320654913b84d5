"""The items about networks: what their rows are made of."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lidar_core.circles import CircleNetwork, DatasetConfig, Scanner, make_samples
from lidar_core.circles.estimators.architecture import paper_layers, window_layers
from lidar_core.reproduce import Request
from lidar_core.reproduce.circles import detectors, fig5, table1, table3
from lidar_core.reproduce.circles.chord_circles import chord_circles
from lidar_core.reproduce.circles.errors import groups, measures
from reference import chord_circle

EXACT = 1e-9  # rounding of sums over some hundred numbers


def test_layers_are_those_of_table_1():
    layers = paper_layers(1081)
    assert [layer.length for layer in layers] == [1075, 535, 529, 262, 256, 125, 1, 1]
    assert [layer.parameters for layer in layers] == [
        400,
        17_550,
        35_100,
        70_100,
        70_100,
        70_100,
        1_562_625,
        375,
    ]
    assert sum(layer.parameters for layer in layers) == 1_826_350


def test_layers_of_the_small_network_are_those_of_its_card():
    layers = window_layers(*table1.WIDTHS)
    assert sum(layer.parameters for layer in layers) == CircleNetwork("cnn").card["parameters"]


def test_chord_circles_are_those_of_the_oracle():
    config = DatasetConfig.continuous(circles=300)
    samples = make_samples(config, count=300, seed=1060)
    bearings = config.scanner.bearings()
    scans = samples.scans(config.scanner)
    expected = [chord_circle.circle(scan.astype(float), bearings) for scan in scans]
    assert_allclose(chord_circles(scans, bearings), expected, atol=1e-7)


def test_the_chord_circle_of_two_hits_goes_through_them_away_from_the_scanner():
    bearings = np.radians([-3.0, 0.0, 3.0])
    distance = 2 / math.cos(bearings[2])
    (circle,) = chord_circles(np.array([[distance, np.inf, distance]]), bearings)
    half = 2 * math.tan(bearings[2])
    expected = [2 + half / math.sqrt(3), 0, 2 * half / math.sqrt(3)]
    assert_allclose(circle, expected, atol=EXACT)


def test_measures_are_over_all_numbers_and_p99_over_circles():
    errors = np.array([[0.1, -0.1, 0.0], [0.0, 0.0, 0.4]])
    mse, mae, p99 = measures(errors)
    assert mse == pytest.approx(0.18 / 6)
    assert mae == pytest.approx(0.6 / 6)
    assert p99 == pytest.approx(0.2 / 3 + 0.99 * 0.2 / 3)
    assert measures(np.zeros((0, 3))) == [None, None, None]


def test_every_circle_is_in_one_group_by_hits():
    hits = np.array([1, 2, 3, 4, 6, 9, 12, 19, 30, 40, 500])
    is_whole = np.arange(len(hits)) % 2 == 0
    found = groups(hits, is_whole)
    assert (sum(found[name] for name in detectors.BY_HITS) == 1).all()
    assert found["40 or more hits"].tolist() == [False] * 9 + [True] * 2
    assert found["whole, 4 hits or more"].sum() == 4
    assert not (found["cut"] & is_whole).any()


def test_whole_circles_are_inside_of_view_and_range():
    scanner = Scanner()
    samples = make_samples(DatasetConfig.continuous(circles=400), count=400, seed=1061)
    turn = np.linspace(0, 2 * np.pi, 720)
    circles = samples.circles.astype(float)
    x = circles[:, [0]] + circles[:, [2]] * np.cos(turn)
    y = circles[:, [1]] + circles[:, [2]] * np.sin(turn)
    edge = scanner.field_of_view / 2
    is_inside = (np.abs(np.arctan2(y, x)) <= edge).all(axis=1)
    tangent = np.sqrt((circles[:, :2] ** 2).sum(axis=1) - circles[:, 2] ** 2)
    is_near = (tangent <= scanner.range_max) & (np.hypot(x, y).min(axis=1) >= scanner.range_min)
    wrong = samples.is_whole(scanner) != (is_inside & is_near)
    assert wrong.sum() <= 1  # a circle of 720 points is a little too small


def test_the_loss_of_table_3_is_that_of_the_four_points():
    rng = np.random.default_rng(1062)
    errors = rng.normal(size=(50, 3))
    x, y, radius = errors.T
    ends = [(x + radius, y), (x, y + radius), (x - radius, y), (x, y - radius)]
    loss = np.mean([np.square(one).sum(axis=0) for one in ends])
    parts = [{}, {}]
    table3._add(parts[0], "cnn, test", errors[:15])
    table3._add(parts[0], "cnn, test", errors[15:20])
    table3._add(parts[1], "cnn, test", errors[20:])
    found = table3._quantities(parts, "cnn", "test")
    assert_allclose(found, [loss, np.square(errors).mean(), np.abs(errors).mean()], rtol=EXACT)
    table3._add(parts[0], "cnn, 1 hits", errors[:0])
    assert table3._quantities(parts[:1], "cnn", "1 hits") is None


def test_each_network_has_its_column():
    rows = detectors.ITEM.run(Request(seed=1063, scans=8, threads=1)).rows
    assert all((row.paper_mode is None) or "paper-cnn" in row.name for row in rows)
    assert next(row for row in rows if row.name == "all, paper-cnn: MSE").paper_mode > 0


def test_curves_are_those_of_the_cards():
    card = {
        "training": {"parts": 4},
        "metrics": [{"epoch": 1.0, "a": 3.0}, {"epoch": 2.0, "a": 2.0}],
    }
    assert fig5.curve(card, "a") == {0.25: 3.0, 0.5: 2.0}
    assert fig5.curve(card | {"start": {"passes": 2.5}}, "a") == {2.75: 3.0, 3.0: 2.0}
    rows = {row.name: row for row in fig5.ITEM.run(Request(seed=0, scans=1, threads=1)).rows}
    cards = {model: CircleNetwork(model).card for model in ("cnn", "paper-cnn")}
    small = min(row["validation_mse"] for row in cards["cnn"]["metrics"])
    paper = cards["paper-cnn"]["metrics"][-1]["validation_loss"]  # see docs/training.md
    assert rows["loss of the shipped weights, validation"].best_mode == pytest.approx(3 * small)
    assert rows["loss of the shipped weights, validation"].paper_mode == paper


@pytest.mark.nightly
def test_errors_of_groups_add_up_to_those_of_the_test():
    rows = {row.name: row for row in table3.ITEM.run(Request(seed=1064, scans=500, threads=1)).rows}
    by_hits = [row for name, row in rows.items() if name.endswith("hits: MSE") and "ml" not in name]
    for mode in ("paper_mode", "best_mode"):
        values = [getattr(row, mode) for row in by_hits]
        known = [value for value in values if value is not None]
        assert min(known) <= getattr(rows["test: MSE"], mode) <= max(known)
    assert rows["test: MSE"].best_mode < 3e-4 < rows["test: MSE"].paper
    assert rows["test: MAE"].best_mode < 0.006 < rows["test: MAE"].paper
