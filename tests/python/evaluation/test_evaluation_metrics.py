"""Set distances, consistency, groups, identities: by hand, by oracle, by other libraries."""

import json
import os
import re
from dataclasses import replace
from datetime import UTC, datetime
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import linear_sum_assignment
from scipy.stats import chi2

from lidar_core import ConfigError, InputError, MissingExtraError, NumericalError, evaluation
from lidar_core.estimation import chi2_quantile
from lidar_core.evaluation import Estimates, EvaluationConfig, Spread, Truth
from lidar_core.extras import install_command
from reference import evaluation as reference

PARITY = 1e-9
"""Against other implementations of the same sums [m] or [m^p]."""

SCAN_NS = 100_000_000
positions = st.integers(0, 4).flatmap(
    lambda rows: arrays(np.float64, (rows, 3), elements=st.integers(-20, 20).map(lambda n: n / 8))
)
orders = st.sampled_from([1.0, 2.0, 3.0])


@pytest.fixture(scope="session")
def stonesoup():
    """Classes of the library; in CI it has to be there."""
    if os.environ.get("CI") != "true":
        pytest.importorskip("stonesoup", reason="stonesoup, of the test group, is not installed")
    from stonesoup.metricgenerator.ospametric import GOSPAMetric, OSPAMetric
    from stonesoup.types.state import State

    def states(rows):
        return [State(row[:, None], timestamp=datetime(2026, 1, 1, tzinfo=UTC)) for row in rows]

    return OSPAMetric, GOSPAMetric, states


# OSPA and GOSPA


@given(positions, positions, orders)
def test_set_distances_are_the_best_of_all_pairings(found, true, order):
    ospa = evaluation.ospa(found, true, cutoff=2.0, order=order)
    assert ospa == pytest.approx(reference.ospa(found, true, 2.0, order), abs=PARITY)
    parts = evaluation.gospa(found, true, cutoff=2.0, order=order)
    total = parts.localisation + parts.missed + parts.false
    assert total == pytest.approx(reference.gospa(found, true, 2.0, order), abs=PARITY)
    assert parts.distance**order == pytest.approx(total, abs=PARITY)
    assert (parts.false - parts.missed) == pytest.approx(
        (len(found) - len(true)) * 2.0**order / 2, abs=PARITY
    )


@given(positions, positions, orders)
def test_set_distances_are_symmetric_and_bounded(found, true, order):
    there = evaluation.ospa(found, true, cutoff=2.0, order=order)
    assert there == pytest.approx(evaluation.ospa(true, found, cutoff=2.0, order=order), abs=PARITY)
    assert 0 <= there <= 2.0 + PARITY
    assert evaluation.ospa(found, found, cutoff=2.0, order=order) == 0
    back = evaluation.gospa(true, found, cutoff=2.0, order=order)
    parts = evaluation.gospa(found, true, cutoff=2.0, order=order)
    assert (back.missed, back.false) == (parts.false, parts.missed)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("seed", range(40))
def test_gospa_is_that_of_stonesoup(stonesoup, seed, order):
    _, metric, states = stonesoup
    rng = np.random.default_rng(seed)
    found, true = (rng.uniform(0, 2, (rng.integers(0, 6), 3)) for _ in range(2))
    if not len(found) and not len(true):
        return  # has no time there
    result, _ = metric(p=order, c=1.0).compute_gospa_metric(states(found), states(true))
    parts = evaluation.gospa(found, true, cutoff=1.0, order=order)
    for name, value in result.value.items():
        assert getattr(parts, name) == pytest.approx(float(value), abs=PARITY), name


@pytest.mark.parametrize("seed", range(40))
def test_ospa_of_order_one_is_that_of_stonesoup(stonesoup, seed):
    # Of higher orders, stonesoup minimises the sum of distances, not of their powers.
    metric, _, states = stonesoup
    rng = np.random.default_rng(seed)
    found, true = (rng.uniform(0, 2, (rng.integers(1, 6), 3)) for _ in range(2))
    generator = metric(p=1, c=1.0)
    expected = generator.compute_OSPA_distance(states(found), states(true)).value
    assert evaluation.ospa(found, true, cutoff=1.0, order=1) == pytest.approx(expected, abs=PARITY)
    other = metric(p=2, c=1.0).compute_OSPA_distance(states(found), states(true)).value
    assert evaluation.ospa(found, true, cutoff=1.0, order=2) <= other + PARITY


@pytest.mark.parametrize("box", [10.0, 100.0])
def test_gospa_of_a_thousand_objects_is_that_of_scipy(box):
    rng = np.random.default_rng(4711)
    found, true = rng.uniform(0, box, (1000, 3)), rng.uniform(0, box, (900, 3))
    apart = np.linalg.norm(found[:, None] - true[None], axis=-1)
    cost = np.minimum(apart, 3.0) ** 2
    total = cost[linear_sum_assignment(cost)].sum() + 100 * 9 / 2
    assert evaluation.gospa(found, true, cutoff=3.0, order=2).distance ** 2 == pytest.approx(total)


@pytest.mark.parametrize("name", ["ospa", "gospa"])
def test_set_distances_refuse_what_they_cannot_use(name):
    distance = getattr(evaluation, name)
    with pytest.raises(ConfigError, match="cutoff"):
        distance([[0, 0, 0]], [[0, 0, 0]], cutoff=0, order=2)
    with pytest.raises(ConfigError, match="order"):
        distance([[0, 0, 0]], [[0, 0, 0]], cutoff=1, order=0.5)
    with pytest.raises(InputError, match="targets"):
        distance([[0, 0, 0]], [[0, 0]], cutoff=1, order=2)


# Consistency


@pytest.mark.parametrize("degrees", [1, 3, 6, 9, 1500])
@pytest.mark.parametrize("probability", [0.001, 0.025, 0.5, 0.975, 0.999])
def test_chi_square_quantiles_are_those_of_scipy(probability, degrees):
    expected = chi2.ppf(probability, degrees)
    assert chi2_quantile(probability, degrees=degrees) == pytest.approx(expected, rel=1e-9)


def test_a_quantile_out_of_range_is_refused():
    for probability in (0.0, 1.0, np.nan):
        with pytest.raises(ConfigError, match="probability"):
            chi2_quantile(probability, degrees=3)
    for degrees in (0, -1, 2**32):
        with pytest.raises(ConfigError, match="degrees"):
            chi2_quantile(0.5, degrees=degrees)


def covariances(rng, count, size):
    root = rng.normal(size=(count, size, size))
    return root @ root.transpose(0, 2, 1) + 0.1 * np.eye(size)


@pytest.mark.parametrize("size", [1, 3, 6])
def test_nees_by_the_formula(size):
    rng = np.random.default_rng(size)
    error, covariance = rng.normal(size=(50, size)), covariances(rng, 50, size)
    expected = reference.nees(error, covariance)
    np.testing.assert_allclose(evaluation.nees(error, covariance), expected, rtol=1e-8)
    shaped = evaluation.nees(error.reshape(5, 10, size), covariance.reshape(5, 10, size, size))
    np.testing.assert_allclose(shaped, expected.reshape(5, 10), rtol=1e-8)
    error[7] = np.nan
    assert np.flatnonzero(np.isnan(evaluation.nees(error, covariance))).tolist() == [7]


def test_nees_refuses_what_is_no_covariance():
    with pytest.raises(InputError, match=r"expected shape \(3, 3\), got \(2, 2\)"):
        evaluation.nees([0.0, 0, 0], np.eye(2))
    with pytest.raises(NumericalError, match="positive definite"):
        evaluation.nees([0.0, 0, 0], np.zeros((3, 3)))
    with pytest.raises(InputError, match="symmetric"):
        evaluation.nees([0.0, 0.0], [[1e-9, 5e-10], [0.0, 1e-9]])


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
def test_only_honest_covariances_are_consistent(scale):
    rng = np.random.default_rng(0)
    covariance = covariances(rng, 40, 3)
    error = np.linalg.cholesky(covariance) @ rng.normal(size=(200, 40, 3, 1))
    values = evaluation.nees(error[..., 0], np.broadcast_to(scale * covariance, (200, 40, 3, 3)))
    found = evaluation.consistency(values, degrees=3)
    assert (found.n_runs, found.count, found.degrees) == (200, 8000, 3)
    assert found.mean == pytest.approx(3 / scale, rel=0.05)
    assert (found.share_of_steps_inside >= 0.85) == (scale == 1)
    assert (abs(found.share_inside - 0.95) < 0.01) == (scale == 1)


def test_bands_are_those_of_the_chi_square_distribution():
    rng = np.random.default_rng(1)
    values = rng.chisquare(6, (10, 30))
    found = evaluation.consistency(values, degrees=6)
    assert found.band == pytest.approx(chi2.ppf([0.025, 0.975], 6))
    assert found.step_band == pytest.approx(chi2.ppf([0.025, 0.975], 60) / 10)
    low, high = found.step_band
    inside = (values.mean(axis=0) >= low) & (values.mean(axis=0) <= high)
    assert found.share_of_steps_inside == pytest.approx(inside.mean())
    narrow = evaluation.consistency(values, degrees=6, config=EvaluationConfig(band=0.5))
    assert narrow.band == pytest.approx(chi2.ppf([0.25, 0.75], 6))
    assert narrow.share_inside < found.share_inside


def test_missing_values_narrow_the_sample_not_the_result():
    values = np.array([[1.0, np.nan, np.nan], [5.0, 30.0, np.nan]])
    found = evaluation.consistency(values, degrees=3)
    assert (found.count, found.mean) == (3, 12.0)
    assert found.share_of_steps_inside == 0.5  # (1 + 5) / 2 of two runs is in, 30 of one is out
    assert evaluation.consistency([np.nan], degrees=3) is None
    for bad in ([-1.0], [np.inf], np.zeros((2, 2, 2))):
        with pytest.raises(InputError, match="values"):
            evaluation.consistency(bad, degrees=3)


def test_one_run_is_judged_value_by_value():
    values = np.random.default_rng(2).chisquare(3, 100)
    found = evaluation.consistency(values, degrees=3)
    assert found.share_of_steps_inside == found.share_inside
    assert found.step_band == found.band


# Groups and spreads


@given(
    arrays(np.float64, 30, elements=st.integers(-2, 14).map(float)),
    arrays(np.float64, 30, elements=st.integers(-9, 9).map(float)),
)
def test_groups_by_hand(keys, values):
    edges = [0.0, 3.0, 4.0, 10.0]
    found = evaluation.binned(keys, values, edges=edges)
    for number, (near, far) in enumerate(pairwise(edges)):
        inside = (keys > near) & (keys <= far) | (keys == 0) & (number == 0)
        assert found.count[number] == inside.sum()
        spread = Spread.of(values[inside])
        for name in ("mean", "std", "rmse"):
            value = getattr(found, name)[number]
            if spread is None:
                assert np.isnan(value)
            else:
                assert value == pytest.approx(getattr(spread, name), abs=1e-12)


def test_groups_leave_out_unknown_keys_and_refuse_unordered_edges():
    assert evaluation.binned([np.nan, 1.0], [5.0, 7.0], edges=[0, 2]).mean.tolist() == [7.0]
    for edges in ([1.0], [2.0, 1.0], [1.0, 1.0], [0.0, np.nan]):
        with pytest.raises(InputError, match="edges"):
            evaluation.binned([1.0], [1.0], edges=edges)
    with pytest.raises(ConfigError, match="distance_edges"):
        EvaluationConfig(distance_edges=(0.0, 5.0, 5.0))


def test_a_spread_is_that_of_numpy():
    sample = np.random.default_rng(3).normal(size=(20, 5))
    found = Spread.of(sample)
    assert (found.count, found.mean, found.std) == (100, sample.mean(), sample.std())
    assert found.rmse == pytest.approx(np.sqrt((sample**2).mean()))
    assert [found.p50, found.p99] == np.percentile(sample, [50, 99]).tolist()
    assert (found.smallest, found.largest) == (sample.min(), sample.max())
    assert Spread.of([]) is None
    with pytest.raises(InputError, match="finite"):
        Spread.of([np.nan])


# Scores of tables


def flights(seed, *, n_scans=30, noise=0.1):
    """Two targets over some scans, tracks that miss some of them, and what belongs to them."""
    rng = np.random.default_rng(seed)
    stamps = np.repeat(np.arange(n_scans) * SCAN_NS, 2)
    ids = np.tile([3, 8], n_scans)
    velocity = rng.normal(size=(2, 3))
    position = np.tile([[6.0, 0, 3], [0.0, 12, 4]], (n_scans, 1))
    position = position + np.tile(velocity, (n_scans, 1)) * stamps[:, None] * 1e-9
    truth = Truth(
        stamp_ns=stamps,
        id=ids,
        position=position,
        is_eligible=rng.random(2 * n_scans) < 0.8,
        velocity=np.tile(velocity, (n_scans, 1)),
        sensor=rng.normal(size=(2 * n_scans, 3)),
    )
    kept = rng.random(2 * n_scans) < 0.7
    covariance = np.tile(noise**2 * np.eye(6), (kept.sum(), 1, 1))
    tracks = Estimates(
        stamp_ns=stamps[kept],
        position=position[kept] + rng.normal(size=(kept.sum(), 3)) * noise,
        id=ids[kept] + 10,
        velocity=truth.velocity[kept] + rng.normal(size=(kept.sum(), 3)) * noise,
        covariance=covariance,
    )
    return tracks, truth, kept


@pytest.mark.parametrize("seed", range(10))
def test_errors_and_losses_of_two_flights(seed):
    tracks, truth, kept = flights(seed)
    scores = evaluation.score_tracks(tracks, truth)
    row = np.full(len(kept), -1)
    row[kept] = np.arange(kept.sum())
    found = np.flatnonzero(kept & truth.is_eligible)
    away = tracks.position[row[found]] - truth.position[found]
    parts = [
        reference.line_of_sight(e, truth.position[k], truth.sensor[k])
        for e, k in zip(away, found, strict=True)
    ]
    speed = np.linalg.norm(tracks.velocity[row[found]] - truth.velocity[found], axis=1)
    for name, values in (
        ("radial_error", [along for along, _ in parts]),
        ("across_error", [across for _, across in parts]),
        ("velocity_error", speed),
        ("position_error", np.linalg.norm(away, axis=1)),
    ):
        spread = getattr(scores, name)
        assert spread.mean == pytest.approx(np.mean(values), abs=1e-12), name
        assert spread.std == pytest.approx(np.std(values), abs=1e-12), name
        assert spread.count == len(found)
    assert scores.n_fragmentations == sum(
        reference.fragmentations(truth.is_eligible[truth.id == n], kept[truth.id == n])
        for n in (3, 8)
    )
    assert scores.duration == pytest.approx(3.0)
    assert scores.position_nees.count == scores.state_nees.count == len(found)
    assert scores.position_nees.mean == pytest.approx(np.mean(np.sum(away**2, axis=1)) / 0.1**2)
    assert scores.state_nees.degrees == 6


@pytest.mark.parametrize("seed", range(5))
def test_scores_over_distance_add_up(seed):
    tracks, truth, kept = flights(seed)
    scores = evaluation.score_tracks(tracks, truth)
    groups = scores.over_distance
    for name in ("n_eligible", "n_found", "n_estimates", "n_matched"):
        assert sum(getattr(group, name) for group in groups) == getattr(scores, name)
    away = np.linalg.norm(truth.position - truth.sensor, axis=1)
    for group in groups:
        here = truth.is_eligible & (away > group.near) & (away <= group.far)
        assert group.n_eligible == here.sum()
        assert group.n_found == (here & kept).sum()
    names = scores.to_dict()["over_distance"]
    last = groups[-1]
    assert names[f"recall@{last.far:g}m"] == last.recall
    assert f"precision@{last.far:g}m" in names
    without = Truth(truth.stamp_ns, truth.id, truth.position, truth.is_eligible)
    bare = evaluation.score_tracks(tracks, without)
    assert bare.over_distance == ()
    assert (bare.radial_error, bare.velocity_error, bare.state_nees) == (None, None, None)


def test_what_belongs_to_a_target_that_need_not_be_found_counts_neither_way():
    stamps = np.zeros(2, np.int64)
    truth = Truth(
        stamps, np.arange(2), np.array([[0.0, 0, 0], [9.0, 0, 0]]), np.array([1, 0], bool)
    )
    places = np.array([[0.1, 0, 0], [9.1, 0, 0], [9.3, 0, 0], [5.0, 0, 0]])
    tracks = Estimates(np.zeros(4, np.int64), places, np.arange(4))
    found, true = evaluation.counted(tracks, truth)
    assert found.id.tolist() == [0, 3]
    assert true.id.tolist() == [0]
    scores = evaluation.score_tracks(tracks, truth)
    assert scores.sets.n_scans == 1
    assert scores.sets.false == 0.5
    assert scores.sets.missed == 0.0
    assert scores.sets.localisation == pytest.approx(0.01)
    assert scores.sets.ospa == pytest.approx(np.sqrt((0.01 + 1) / 2))


def test_false_tracks_per_minute():
    stamps = np.arange(60) * SCAN_NS
    truth = Truth(stamps, np.zeros(60, np.int64), np.zeros((60, 3)), np.ones(60, bool))
    tracks = Estimates(stamps[:2], np.full((2, 3), 5.0), np.array([1, 2]))
    scores = evaluation.score_tracks(tracks, truth)
    assert scores.duration == pytest.approx(6.0)
    assert scores.false_tracks_per_minute == pytest.approx(20.0)
    assert scores.sets.gospa == pytest.approx((58 * np.sqrt(0.5) + 2) / 60)


def test_pairs_can_be_grouped_by_anything():
    tracks, truth, _ = flights(0)
    pairing = evaluation.pair(tracks, truth)
    rows = pairing.found
    away = tracks.position[pairing.estimate_of[rows]] - truth.position[rows]
    speed = np.linalg.norm(truth.velocity[rows], axis=1)
    groups = evaluation.binned(speed, np.linalg.norm(away, axis=1), edges=[0, 1, 10])
    assert groups.count.sum() == len(rows)
    assert (np.diff(truth.stamp_ns[rows]) >= 0).all()
    assert (pairing.target_of[pairing.estimate_of[rows]] == rows).all()


def test_an_object_twice_at_one_time_is_refused():
    truth = Truth(np.zeros(2, np.int64), np.full(2, 4), np.zeros((2, 3)), np.ones(2, bool))
    none = Estimates(np.empty(0, np.int64), np.empty((0, 3)), np.empty(0, np.int64))
    with pytest.raises(InputError, match=r"truth\.id: .* got 4 twice at 0 ns"):
        evaluation.score_tracks(none, truth)
    with pytest.raises(InputError, match=r"^id: .* got 4 twice"):
        evaluation.score_tracks(
            Estimates(truth.stamp_ns, truth.position, truth.id), evaluation.joined([])
        )


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_refused(bad):
    stamps, place = np.zeros(1, np.int64), np.zeros((1, 3))
    wrong = np.array([[0.0, bad, 0.0]])
    truth = Truth(stamps, stamps, place, np.ones(1, bool))
    for name, tracks, targets in (
        ("position", Estimates(stamps, wrong, stamps), truth),
        ("velocity", Estimates(stamps, place, stamps, wrong), truth),
        ("covariance", Estimates(stamps, place, stamps, None, np.full((1, 3, 3), bad)), truth),
        ("truth.position", Estimates(stamps, place, stamps), replace(truth, position=wrong)),
        ("truth.velocity", Estimates(stamps, place, stamps), replace(truth, velocity=wrong)),
    ):
        with pytest.raises(InputError, match=rf"^{name}: expected finite values"):
            evaluation.pair(tracks, targets)
    for distance in (evaluation.ospa, evaluation.gospa):
        with pytest.raises(InputError, match=r"^estimates: expected finite"):
            distance(wrong, place, cutoff=1.0, order=2)
        with pytest.raises(InputError, match=r"^targets: expected finite"):
            distance(place, wrong, cutoff=1.0, order=2)
    with pytest.raises(InputError, match=r"^position: expected finite"):
        evaluation.eligible(wrong, [9], [0, 0, 0])
    with pytest.raises(InputError, match=r"^sensor_position: expected finite"):
        evaluation.eligible(place, [9], wrong[0])
    with pytest.raises(InputError, match="finite symmetric"):
        evaluation.nees([0.0, 0.0], [[1.0, 0.0], [0.0, bad]])


def late_pass(*, with_velocity=True, with_times=True):
    """Two targets 1 m apart that fly 10 m/s, each measured late, up to 90 ms into a scan."""
    delays = np.array([90_000_000, 30_000_000, 60_000_000, 80_000_000])
    stamps = np.repeat(np.array([0, 100_000_000]), 2)
    velocity = np.tile([10.0, 0.0, 0.0], (4, 1))
    start = np.array([[0.0, 5, 0], [1, 5, 0], [1, 5, 0], [2, 5, 0]])
    truth = Truth(
        stamps,
        np.array([0, 1, 0, 1]),
        start,
        np.ones(4, bool),
        velocity if with_velocity else None,
        np.zeros((4, 3)),
    )
    found = start + delays[:, None] * 1e-9 * velocity
    times = stamps + delays if with_times else None
    covariance = np.tile(1e-4 * np.eye(3), (4, 1, 1))
    return Estimates(stamps, found, None, None, covariance, times), truth


def test_detections_are_held_against_the_targets_when_they_were_measured():
    found, truth = late_pass()
    scores = evaluation.score_detections(found, truth, config=EvaluationConfig(gate=0.5))
    assert (scores.n_found, scores.n_false) == (4, 0)
    assert scores.max_error == pytest.approx(0, abs=1e-12)
    assert scores.position_nees.mean == pytest.approx(0, abs=1e-12)
    assert scores.sets.gospa == pytest.approx(0, abs=1e-12)
    assert evaluation.pair(found, truth).target_of.tolist() == [0, 1, 2, 3]
    # Times a little beside those of the truth are taken for them, both of them.
    shifted = replace(found, stamp_ns=found.stamp_ns + 50_000, time_ns=found.time_ns + 50_000)
    again = evaluation.evaluate(truth, detections=shifted).detections
    assert again.max_error == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("missing", ["with_velocity", "with_times"])
def test_without_times_or_velocities_targets_stay_where_the_scan_began(missing):
    found, truth = late_pass(**{missing: False})
    scores = evaluation.score_detections(found, truth, config=EvaluationConfig(gate=0.5))
    assert (scores.n_found, scores.n_false) == (2, 1)
    assert scores.max_error > 0.2


def test_times_of_measurement_belong_to_rows():
    found, truth = late_pass()
    with pytest.raises(InputError, match=r"^time_ns: expected shape \(4,\), got \(3,\)"):
        evaluation.evaluate(truth, detections=replace(found, time_ns=found.time_ns[:3]))
    with pytest.raises(InputError, match=r"^time_ns: expected integers"):
        evaluation.pair(replace(found, time_ns=found.time_ns * 1e-9), truth)


def test_times_near_those_of_the_truth_are_taken_for_them():
    tracks, truth, _ = flights(1)
    shifted = Estimates(tracks.stamp_ns + 90_000, tracks.position, tracks.id)
    found = evaluation.evaluate(truth, tracks=shifted).tracks
    assert found.n_found == evaluation.score_tracks(tracks, truth).n_found > 0
    strict = EvaluationConfig(time_tolerance=1e-5)
    assert evaluation.evaluate(truth, tracks=shifted, config=strict).tracks.n_found == 0
    assert evaluation.aligned(shifted, evaluation.joined([])) is shifted


# Identities


def swapped(n_scans, *, at):
    """Two targets, perfect tracks that change places after `at` scans."""
    stamps = np.repeat(np.arange(n_scans) * SCAN_NS, 2)
    ids = np.tile([0, 1], n_scans)
    position = np.stack([ids * 5.0, stamps * 1e-9, 0 * stamps], axis=1)
    truth = Truth(stamps, ids, position, np.ones(len(ids), bool))
    numbers = np.where(stamps < at * SCAN_NS, ids, 1 - ids)
    return Estimates(stamps, position, numbers), truth


def test_perfect_tracks_have_perfect_identities():
    tracks, truth = swapped(10, at=10)
    found = evaluation.score_identities(tracks, truth)
    for name in ("hota", "deta", "assa", "loca", "mota", "idf1", "id_recall", "id_precision"):
        assert getattr(found, name) == pytest.approx(1), name
    assert (found.n_switches, found.mostly_tracked, found.mostly_lost) == (0, 2, 0)


def test_exchanged_identities_by_hand():
    tracks, truth = swapped(10, at=5)
    found = evaluation.score_identities(tracks, truth)
    assert found.deta == pytest.approx(1)
    assert found.assa == pytest.approx(1 / 3)  # 5 of 5 + 5 + 5 in every pair
    assert found.hota == pytest.approx(np.sqrt(1 / 3))
    assert found.mota == pytest.approx(1 - 2 / 20)
    assert found.idf1 == pytest.approx(0.5)
    assert found.n_switches == 2 == evaluation.score_tracks(tracks, truth).n_switches


def test_half_the_gate_away_is_half_the_similarity():
    tracks, truth = swapped(10, at=10)
    moved = Estimates(tracks.stamp_ns, tracks.position + np.array([0, 0, 0.5]), tracks.id)
    found = evaluation.score_identities(moved, truth)
    assert found.mota == pytest.approx(1)
    # At thresholds up to 0.5 all is found, at the nine above nothing: location 1 by definition.
    assert found.hota == pytest.approx(10 / 19)
    far = Estimates(tracks.stamp_ns, tracks.position + np.array([0, 0, 1.01]), tracks.id)
    lost = evaluation.score_identities(far, truth)
    assert (lost.mota, lost.idf1, lost.hota) == (pytest.approx(-1), 0, 0)


@pytest.mark.parametrize("seed", range(10))
def test_switches_and_losses_are_those_of_clear(seed):
    tracks, truth, _ = flights(seed)
    everything = Truth(truth.stamp_ns, truth.id, truth.position, np.ones(len(truth.id), bool))
    # CLEAR forgets to end a track in scans without any estimate: a third, steady target.
    stamps = np.unique(truth.stamp_ns)
    still = np.tile([[40.0, 0, 0]], (len(stamps), 1))
    ours = Estimates(
        np.concatenate([tracks.stamp_ns, stamps]),
        np.concatenate([tracks.position, still]),
        np.concatenate([tracks.id, np.full(len(stamps), 99)]),
    )
    true = Truth(
        np.concatenate([truth.stamp_ns, stamps]),
        np.concatenate([everything.id, np.full(len(stamps), 50)]),
        np.concatenate([truth.position, still]),
        np.ones(len(truth.id) + len(stamps), bool),
    )
    mine, theirs = evaluation.score_tracks(ours, true), evaluation.score_identities(ours, true)
    assert mine.n_switches == theirs.n_switches
    assert mine.n_fragmentations == theirs.n_fragmentations
    missed, false = mine.n_eligible - mine.n_found, mine.n_estimates - mine.n_matched
    assert theirs.mota == pytest.approx(1 - (missed + false + mine.n_switches) / mine.n_eligible)


def test_identities_without_targets_or_without_the_library(monkeypatch):
    from lidar_core import extras

    tracks, truth = swapped(3, at=3)
    nobody = evaluation.joined([])
    assert evaluation.score_identities(tracks, nobody) is None
    none = Estimates(np.empty(0, np.int64), np.empty((0, 3)), np.empty(0, np.int64))
    assert evaluation.score_identities(none, truth).mota == 0
    with pytest.raises(InputError, match=r"tracks\.id"):
        evaluation.score_identities(Estimates(tracks.stamp_ns, tracks.position), truth)

    def refuse(name):
        raise ImportError(name)

    monkeypatch.setattr(extras, "import_module", refuse)
    with pytest.raises(MissingExtraError, match=re.escape(install_command("eval"))):
        evaluation.evaluate(truth, tracks=tracks, with_identities=True)
    assert evaluation.evaluate(truth, tracks=tracks).identities is None


# Reports


def test_a_report_is_plain_values():
    tracks, truth, _ = flights(2)
    latency = evaluation.Latency.of([1.0, 3.0], {"track": [0.5, 0.7]})
    report = evaluation.evaluate(
        truth,
        tracks=tracks,
        detections=Estimates(tracks.stamp_ns, tracks.position),
        latency=latency,
        with_identities=True,
    )
    values = json.loads(json.dumps(report.to_dict()))
    assert values["latency_ms"]["total"]["mean"] == 2.0
    assert values["latency_ms"]["stages"]["track"]["largest"] == 0.7
    assert values["identity_scores"]["hota"] == report.identities.hota
    assert values["track_scores"]["position_error"]["mean"] == report.tracks.mean_error
    assert values["detection_scores"]["position_nees"] is None
    assert evaluation.Latency.of([], {}) is None
    assert evaluation.Latency.of_frames([]) is None
