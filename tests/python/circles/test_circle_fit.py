"""Circles from rays: oracle, accuracy, honesty, symmetries, bad input."""

import json
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from repository import ROOT

from lidar_core.circles import (
    CircleDetector,
    CirclesConfig,
    FitConfig,
    Scanner,
    SegmentConfig,
    Segments,
    fit_circles,
    fit_shapes,
    segment,
)
from lidar_core.errors import ConfigError, InputError
from reference import circle_fit as reference

SCANNER = Scanner()
BEARINGS = SCANNER.bearings()
STD = 0.01
METHODS = ["ml", "mode", "taubin", "pratt", "kasa"]
ROUNDING = 1e-9  # of a covariance, the same steps from another direction [m^2]
STEPS = 0.1  # the steps themselves depend on the direction: in standard deviations


def scans(seed, count, low=0.05, high=0.5, std=STD):
    """Circles (count, 3) and their scans, as of sec. IV-A, but off its lattice."""
    rng = np.random.default_rng(seed)
    circles, rows = [], []
    while len(rows) < count:
        circle = np.append(rng.uniform(-10, 10, 2), rng.uniform(low, high))
        if math.hypot(*circle[:2]) <= circle[2]:
            continue
        ranges = reference.ranges_of(circle, BEARINGS)
        ranges = ranges + std * rng.standard_normal(len(BEARINGS))
        ranges[(ranges < SCANNER.range_min) | (ranges > SCANNER.range_max)] = np.inf
        if np.isfinite(ranges).any():
            circles.append(circle)
            rows.append(ranges)
    return np.array(circles), np.array(rows, np.float32)


def one_scan(circle, std=0.0, seed=0):
    ranges = reference.ranges_of(circle, BEARINGS)
    return ranges + std * np.random.default_rng(seed).standard_normal(len(BEARINGS))


@pytest.fixture(scope="module")
def many():
    """Circles as of the paper, their scans, and what a method says about them."""
    circles, rows = scans(0, 8000)
    return circles, rows, cache(lambda method: CircleDetector(method).detect(rows, BEARINGS))


@pytest.mark.nightly
def test_the_oracle_agrees():
    _, rows = scans(1, 60)
    found = CircleDetector("ml").detect(rows, BEARINGS)
    config, step, compared = FitConfig(), SCANNER.angle_increment, 0
    for row, mean, covariance in zip(rows, found.parameters, found.covariance, strict=True):
        (hits,) = np.nonzero(np.isfinite(row))
        nearest = row[hits].min()
        if nearest + 1.1 > SCANNER.range_max or nearest < 0.3 or len(hits) > 40:
            continue
        wide = 2 * math.asin(config.max_radius / (nearest + config.max_radius))
        low, high = BEARINGS[hits[[0, -1]]]
        lows = (low - (step if hits[0] > 0 else wide), low)
        highs = (high, high + (step if hits[-1] < len(BEARINGS) - 1 else wide))
        expected, spread = reference.posterior(
            row[hits].astype(float),
            BEARINGS[hits],
            lows,
            highs,
            std=STD,
            radius=(config.min_radius, config.max_radius),
            usual=config.usual_radius,
        )
        std = np.sqrt(np.diag(spread))
        assert (abs(mean - expected) < 0.2 * std).all()  # two grids
        assert np.sqrt(np.diag(covariance)) == pytest.approx(std, rel=0.15)
        compared += 1
    assert compared > 20


def cut_circle(rng):
    """Ranges of a circle of which the range limit cuts off what lies beside a few rays."""
    far = SCANNER.range_max
    while True:
        angle, radius = rng.uniform(-2, 2), rng.uniform(0.05, 0.5)
        away = far + radius - rng.uniform(-0.015, 0.01)
        ranges = reference.ranges_of(
            (away * math.cos(angle), away * math.sin(angle), radius), BEARINGS
        )
        ranges += STD * rng.standard_normal(len(BEARINGS))
        ranges[ranges > far] = np.inf
        if 0 < np.isfinite(ranges).sum() < 8:
            return ranges.astype(np.float32).astype(float)


@pytest.mark.nightly
def test_the_oracle_agrees_on_circles_cut_by_the_range_limit():
    """Rays may return nothing where the surface lies beyond the limit, also between two hits."""
    rng, config, off, ratio, gaps = np.random.default_rng(712), FitConfig(), [], [], 0
    for _ in range(12):
        ranges = cut_circle(rng)
        (hits,) = np.nonzero(np.isfinite(ranges))
        wide = 2 * math.asin(config.max_radius / (ranges[hits].min() + config.max_radius))
        low, high = BEARINGS[hits[[0, -1]]]
        near = (abs(BEARINGS - (low + high) / 2) < wide + (high - low) / 2) & np.isinf(ranges)
        expected, spread = reference.posterior(
            ranges[hits],
            BEARINGS[hits],
            (low - wide, low),
            (high, high + wide),
            std=STD,
            radius=(config.min_radius, config.max_radius),
            usual=config.usual_radius,
            missed=BEARINGS[near],
            limits=(SCANNER.range_min, SCANNER.range_max),
        )
        found = CircleDetector("ml").detect([ranges], BEARINGS)
        std = np.sqrt(np.diag(spread))
        off.append(abs(np.asarray(found)[0] - expected) / std.max())
        ratio.append(np.sqrt(np.diag(found.covariance[0])) / std)
        gaps += len(hits) <= np.ptp(hits)
    assert np.mean(off) < 0.1  # two grids, and Laplace's method
    assert np.max(off) < 0.5
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.1)
    assert (np.array(ratio) > 0.5).all()  # where the likelihood has steps, nodes are few
    assert (np.array(ratio) < 1.5).all()
    assert 2 <= gaps < 12


def test_accuracy_on_the_papers_distribution(many):
    circles, _, by_method = many
    found = by_method("ml")
    error = (np.asarray(found) - circles)[found.n_hits >= 4]
    assert np.mean(error**2) <= 9e-5
    assert np.mean(abs(error)) <= 0.0042


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("hits", [(1, 2), (3, 3), (4, 4), (5, 9), (10, 39), (40, 1081)])
def test_the_covariance_is_honest_for_every_number_of_hits(many, method, hits):
    circles, _, by_method = many
    found = by_method(method)
    least, most = hits
    chosen = (found.n_hits >= least) & (found.n_hits <= most)
    chosen &= np.linalg.norm(circles[:, :2], axis=1) - circles[:, 2] > SCANNER.range_min
    error = (np.asarray(found) - circles)[chosen]
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance[chosen]), error)
    assert 2.4 < np.mean(nees) < 3.6
    assert nees.max() < 60.0
    assert not found.is_fallback.any()


@pytest.mark.parametrize("method", METHODS)
def test_circles_larger_than_allowed_are_no_exact_ones(method):
    rng = np.random.default_rng(710)
    for radius in (1.02, 1.2, 2.0):
        circle = (6.0, 0.5, radius)
        ranges = reference.ranges_of(circle, BEARINGS) + STD * rng.standard_normal(len(BEARINGS))
        found = CircleDetector(method).detect([np.float32(ranges)], BEARINGS)
        error = np.asarray(found)[0] - circle
        assert error @ np.linalg.solve(found.covariance[0], error) < 30.0
        assert math.sqrt(found.covariance[0, 2, 2]) > 0.3 * (radius - 1.0)


def test_the_far_limit_moves_no_circles():
    """Over all places between the rays, not at one of them."""
    rng = np.random.default_rng(711)
    circles = [(9.9 * math.cos(a), 9.9 * math.sin(a), 0.3) for a in rng.uniform(-1, 1, 600)]
    rows = np.array([reference.ranges_of(circle, BEARINGS) for circle in circles])
    rows += STD * rng.standard_normal(rows.shape)
    rows[rows > SCANNER.range_max] = np.inf
    found = CircleDetector("ml").detect(np.float32(rows), BEARINGS)
    away = np.linalg.norm(np.asarray(found)[:, :2], axis=1) - 9.9
    assert abs(np.mean(away)) < 0.001
    assert abs(np.mean(np.asarray(found)[:, 2] - 0.3)) < 0.001


def test_misses_and_averages_help(many):
    circles, _, by_method = many
    seen = by_method("ml").n_hits >= 4
    error = {
        method: np.mean((np.asarray(by_method(method)) - circles)[seen] ** 2)
        for method in ["ml", "mode", "taubin"]
    }
    assert error["ml"] < 0.6 * error["mode"] < 0.6 * error["taubin"]


@pytest.mark.parametrize("method", METHODS)
def test_circles_without_noise(method):
    circle = (3.0, -1.0, 0.3)
    config = FitConfig(range_std=1e-4)
    found = CircleDetector(method, config=config).detect([one_scan(circle)], BEARINGS)
    np.testing.assert_allclose(np.asarray(found)[0], circle, atol=1e-4)
    assert found.n_hits[0] == np.isfinite(one_scan(circle)).sum()
    assert np.linalg.eigvalsh(found.covariance[0]).min() > 0


@pytest.mark.parametrize("method", ["taubin", "pratt"])
def test_algebraic_fits_agree_with_an_independent_package(method):
    path = ROOT / "tests" / "golden" / "circle_fits.json"
    for case in json.loads(path.read_text(encoding="utf-8")):
        found = CircleDetector(method).detect([case["ranges"]], case["bearings"])
        np.testing.assert_allclose(np.asarray(found)[0], case[method], atol=1e-9)


def test_kasa_is_linear_least_squares():
    ranges = one_scan((3.0, -1.0, 0.3), STD)
    hit = np.isfinite(ranges)
    points = ranges[hit] * np.array([np.cos(BEARINGS[hit]), np.sin(BEARINGS[hit])])
    found = CircleDetector("kasa").detect([ranges], BEARINGS)
    np.testing.assert_allclose(np.asarray(found)[0], reference.kasa(*points), atol=1e-6)


@given(seed=st.integers(2000, 10**6), turn=st.floats(-3, 3), method=st.sampled_from(METHODS))
def test_turned_and_mirrored_scans_turn_and_mirror_circles(seed, turn, method):
    _, rows = scans(seed, 1)
    detector = CircleDetector(method)
    circle = detector.detect(rows, BEARINGS)
    turned = detector.detect(rows, BEARINGS + turn)
    clockwise = detector.detect(rows[:, ::-1], BEARINGS[::-1])
    mirrored = detector.detect(rows, -BEARINGS)
    (x, y, r), (c, s) = np.asarray(circle)[0], (math.cos(turn), math.sin(turn))
    near = STEPS * np.sqrt(np.diag(circle.covariance[0])).min()
    assert np.asarray(turned)[0] == pytest.approx([c * x - s * y, s * x + c * y, r], abs=near)
    assert np.asarray(clockwise)[0] == pytest.approx([x, y, r], abs=near)
    assert np.asarray(mirrored)[0] == pytest.approx([x, -y, r], abs=near)
    assert clockwise.covariance == pytest.approx(circle.covariance, rel=1e-3, abs=ROUNDING)


@pytest.mark.parametrize("method", METHODS)
def test_a_circle_per_segment_as_of_scans_of_one(method):
    circles = [(4.0, 1.0, 0.3), (2.5, -1.0, 0.1), (6.0, 4.0, 0.5)]
    rows = [one_scan(circle, STD, seed) for seed, circle in enumerate(circles)]
    scan = np.min(rows, axis=0)
    found = fit_circles(scan, BEARINGS, segment(scan, BEARINGS), method=method, range_std=STD)
    alone = CircleDetector(method).detect(rows, BEARINGS)
    order = np.argsort(np.asarray(alone)[:, 1] / np.asarray(alone)[:, 0])
    np.testing.assert_allclose(np.asarray(found), np.asarray(alone)[order], atol=1e-6)
    np.testing.assert_allclose(found.covariance, alone.covariance[order], rtol=1e-3, atol=1e-9)


def test_segments_of_another_scan_are_refused():
    scan = one_scan((4.0, 1.0, 0.3))
    found = segment(scan, BEARINGS)
    with pytest.raises(InputError, match=r"segments\[0\]: expected rays that ended on something"):
        fit_circles(scan[:100], BEARINGS[:100], found)
    starts = -found.starts - 5
    broken = Segments(labels=found.labels, sides=found.sides, rays=found.rays, starts=starts)
    with pytest.raises(InputError, match="segments"):
        fit_circles(scan, BEARINGS, broken)
    with pytest.raises(ConfigError, match="range_std"):
        fit_circles(scan, BEARINGS, found, range_std=-1.0)


def test_what_is_hidden_is_less_certain():
    circle = (4.0, 0.5, 0.3)
    ranges = one_scan(circle, STD)
    (hits,) = np.nonzero(np.isfinite(ranges))
    hidden = ranges.copy()
    hidden[hits[0] - 40 : hits[len(hits) // 2]] = np.nan
    found = CircleDetector().detect([ranges, hidden], BEARINGS)
    std = np.sqrt(np.einsum("nii->ni", found.covariance))
    assert (std[1] > 2 * std[0]).all()
    assert (abs(np.asarray(found) - circle) < 4 * std).all()


def test_wide_beams_do_not_widen_circles():
    width, circle = 0.006, (4.0, 0.5, 0.3)
    wide = one_scan(circle)
    distance = math.hypot(*circle[:2])
    beside = abs(BEARINGS - math.atan2(circle[1], circle[0]))
    grazed = np.isinf(wide) & (beside < math.asin(circle[2] / distance) + width)
    wide[grazed] = math.sqrt(distance**2 - circle[2] ** 2)
    plain = CircleDetector().detect([wide], BEARINGS)
    config = FitConfig(beam_half_width=width)
    known = CircleDetector(config=config).detect([wide], BEARINGS)
    assert abs(known.parameters[0, 2] - 0.3) < 0.5 * abs(plain.parameters[0, 2] - 0.3)


def test_the_seam_of_a_full_circle_is_no_edge():
    bearings = np.radians(np.arange(-180, 180, 0.5))
    ranges = reference.ranges_of((-3.0, 0.02, 0.3), bearings)
    assert np.isfinite(ranges[[0, -1]]).all()
    found = CircleDetector().detect([ranges], bearings)
    np.testing.assert_allclose(np.asarray(found)[0], (-3.0, 0.02, 0.3), atol=0.01)
    assert np.sqrt(found.covariance[0, 2, 2]) < 0.01


@given(
    seed=st.integers(2000, 10**6),
    method=st.sampled_from(METHODS),
    share=st.sampled_from([0.02, 0.3, 1.0]),
)
def test_whatever_is_seen_a_circle_within_bounds_is_reported(seed, method, share):
    rng = np.random.default_rng(seed)
    bearings = np.sort(rng.uniform(-3, 3, rng.integers(1, 300)))
    ranges = rng.choice([rng.uniform(0.01, 12), np.inf, np.nan], bearings.shape)
    scattered = rng.random(bearings.shape) < share
    ranges[scattered] = rng.uniform(0.5, 9, scattered.sum())
    found = CircleDetector(method).detect([ranges], bearings)
    if not np.isfinite(ranges).any():
        assert np.isnan(np.asarray(found)).all()
        assert found.n_hits[0] == 0
        return
    config = FitConfig()
    assert np.isfinite(np.asarray(found)).all()
    assert config.min_radius - 1e-6 <= found.parameters[0, 2] <= config.max_radius + 1e-6
    assert np.linalg.eigvalsh(found.covariance[0]).min() > -1e-12
    assert np.diag(found.covariance[0]).min() > 0


@pytest.mark.parametrize(
    ("ranges", "bearings", "text"),
    [
        (np.ones((2, 3)), np.zeros(2), r"ranges_batch: expected shape \(N, 2\), got \(2, 3\)"),
        (np.ones(3), np.zeros(3), r"ranges_batch: expected shape \(N, 3\), got \(3,\)"),
        (np.ones((1, 2)), [0, np.nan], "bearings: expected finite values, got nan in row 1"),
        (
            [[1.0, 0.0]],
            [0, 0.1],
            r"ranges_batch: expected ranges > 0, got 0.0 in row 0, ray 1",
        ),
    ],
)
def test_bad_arrays_are_refused(ranges, bearings, text):
    with pytest.raises(InputError, match=text):
        CircleDetector().detect(ranges, bearings)


def test_segments_that_are_none_are_refused():
    scan = one_scan((4.0, 1.0, 0.3))
    found = segment(scan, BEARINGS)
    for fit in (fit_circles, fit_shapes):
        with pytest.raises(InputError, match="segments: expected Segments, got NoneType"):
            fit(scan, BEARINGS, None)
        with pytest.raises(InputError, match=r"segments\.rays: expected"):
            fit(scan, BEARINGS, replace(found, rays=None))


@pytest.mark.parametrize("name", [None, 5, "moon", ""])
def test_names_of_detectors_have_one_rule(name):
    text = r"expected one of ml, .*, cnn, paper-cnn, or an \.onnx file.*, got "
    with pytest.raises(ConfigError, match=rf"detector: {text}"):
        CircleDetector(name)
    with pytest.raises(ConfigError, match=text) as refused:
        CirclesConfig(detector=name)
    assert len(str(refused.value).splitlines()) == 1


def test_detectors_that_are_not_there_are_refused():
    with pytest.raises(ConfigError, match=r"detector: expected one of ml, .*, got 'moon'"):
        CircleDetector("moon")
    with pytest.raises(ConfigError, match="min_radius < max_radius"):
        FitConfig(min_radius=2.0)


def test_what_no_circle_explains_is_a_fallback():
    wall = 3.0 / np.cos(BEARINGS[400:681])
    post = one_scan((4.0, 1.0, 0.3), STD)[400:681]
    for method in METHODS:
        found = CircleDetector(method).detect([wall, post], BEARINGS[400:681])
        assert found.is_fallback.tolist() == [True, False]
        assert np.sqrt(found.covariance[0, 2, 2]) > 0.5  # a wall tells no radius


def test_walls_have_covariances_that_can_be_factorised():
    """The hits of a wall press the circle against the largest radius."""
    rng = np.random.default_rng(20261121)
    bearings = math.radians(0.25) * np.arange(-20, 20)
    for _ in range(200):
        tilt, distance, half = rng.uniform(-0.6, 0.6), rng.uniform(5, 8), rng.integers(8, 15)
        ranges = distance * math.cos(tilt) / np.cos(bearings - tilt) + rng.normal(0, STD, 40)
        ranges[: 20 - half] = ranges[20 + half :] = 3.0
        found = fit_circles(ranges, bearings, segment(ranges, bearings, config=SegmentConfig()))
        assert np.linalg.eigvalsh(found.covariance).min() > 0.9e-8


def test_no_scans_no_circles():
    found = CircleDetector().detect(np.zeros((0, 5)), np.arange(5))
    assert len(found) == 0
    assert np.asarray(found, dtype=np.float32).shape == (0, 3)
