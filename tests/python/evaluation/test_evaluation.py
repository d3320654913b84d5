"""Assignment and scores: against scipy, against all assignments tried, by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import linear_sum_assignment

from lidar_core import ConfigError, InputError, evaluation
from lidar_core.evaluation import Estimates, EvaluationConfig, Truth
from reference import evaluation as reference

COST_ERROR = 1e-9
"""Sums of at most a hundred costs below 100, in another order."""

tables = st.tuples(st.integers(0, 5), st.integers(0, 5)).flatmap(
    lambda shape: arrays(np.float64, shape, elements=st.integers(0, 20).map(lambda n: n / 10))
)


@given(tables)
def test_the_assignment_is_the_best_of_all(cost):
    rows, columns = evaluation.assign(cost, gate=1.0)
    assert len(set(rows.tolist())) == len(rows)
    assert len(set(columns.tolist())) == len(columns)
    assert (np.diff(rows) > 0).all()
    assert (cost[rows, columns] <= 1.0).all()
    size, total = reference.best_pairs(cost, 1.0)
    assert len(rows) == size
    assert cost[rows, columns].sum() == pytest.approx(total, abs=COST_ERROR)


@pytest.mark.parametrize("shape", [(1, 1), (40, 40), (60, 25), (25, 60)])
@pytest.mark.parametrize("seed", range(5))
def test_large_tables_agree_with_scipy(shape, seed):
    cost = np.random.default_rng(seed).uniform(0, 100, shape)
    rows, columns = evaluation.assign(cost, gate=100.0)
    expected = cost[linear_sum_assignment(cost)].sum()
    assert len(rows) == min(shape)
    assert cost[rows, columns].sum() == pytest.approx(expected, abs=COST_ERROR)


def test_more_pairs_come_before_closer_pairs():
    # Row 0 would rather have column 0, but then row 1 has none.
    rows, columns = evaluation.assign([[0.1, 0.9], [0.2, 5.0]], gate=1.0)
    assert rows.tolist() == [0, 1]
    assert columns.tolist() == [1, 0]


def test_infinite_and_unknown_costs_never_pair():
    rows, _ = evaluation.assign([[np.inf, np.nan]], gate=1.0)
    assert len(rows) == 0


@pytest.mark.parametrize("cost", [[1.0], [[-1.0]], [[1j]]])
def test_what_is_no_table_of_costs_is_refused(cost):
    with pytest.raises(InputError, match="cost"):
        evaluation.assign(cost, gate=1.0)


@pytest.mark.parametrize("gate", [0.0, -1.0, np.inf, np.nan])
def test_a_gate_out_of_range_is_refused(gate):
    with pytest.raises(InputError, match="gate"):
        evaluation.assign([[1.0]], gate=gate)


def test_match_without_targets_has_infinite_distances():
    matches = evaluation.match([[0, 0, 0]], np.empty((0, 3)), gate=1.0)
    assert len(matches.estimate) == 0
    assert matches.nearest.tolist() == [np.inf]


def test_eligible_targets_are_near_and_hit():
    config = EvaluationConfig(max_distance=10.0, min_hits=3)
    places = [[10, 0, 0], [10.1, 0, 0], [1, 0, 0]]
    found = evaluation.eligible(places, [3, 9, 2], [0, 0, 0], config=config)
    assert found.tolist() == [True, False, False]
    with pytest.raises(InputError, match="sensor_position"):
        evaluation.eligible(places, [3, 9, 2], [0, 0], config=config)


def random_scans(seed):
    """Scans with up to three targets and four tracks; all distances differ."""
    rng = np.random.default_rng(seed)
    scans = []
    for number in range(rng.integers(1, 7)):
        names = rng.permutation(3)[: rng.integers(0, 4)].tolist()
        tracks = rng.permutation(6)[: rng.integers(0, 5)].tolist()
        places, found = rng.uniform(0, 1.5, (len(names), 3)), rng.uniform(0, 1.5, (len(tracks), 3))
        eligible = rng.integers(0, 2, len(names)).astype(bool).tolist()
        scans.append((number * 100_000_000, names, places, eligible, tracks, found))
    return scans


def as_tables(scans):
    truth = Truth(
        stamp_ns=np.array([s for s, names, *_ in scans for _ in names], np.int64),
        id=np.array([n for _, names, *_ in scans for n in names], np.int64),
        position=np.concatenate([places for _, _, places, *_ in scans]),
        is_eligible=np.array([e for _, _, _, eligible, *_ in scans for e in eligible], bool),
    )
    tracks = Estimates(
        stamp_ns=np.array([s for s, _, _, _, ids, _ in scans for _ in ids], np.int64),
        position=np.concatenate([found for *_, found in scans]),
        id=np.array([n for *_, ids, _ in scans for n in ids], np.int64),
    )
    return tracks, truth


@pytest.mark.parametrize("seed", range(100))
def test_scores_agree_with_the_slow_version_in_any_order(seed):
    scans = random_scans(seed)
    tracks, truth = as_tables(scans)
    rng = np.random.default_rng(seed)
    order, other = rng.permutation(len(truth.id)), rng.permutation(len(tracks.stamp_ns))
    shuffled_truth = Truth(
        truth.stamp_ns[order], truth.id[order], truth.position[order], truth.is_eligible[order]
    )
    shuffled = Estimates(tracks.stamp_ns[other], tracks.position[other], tracks.id[other])
    found = evaluation.score_tracks(shuffled, shuffled_truth)
    expected = reference.scores(scans, 1.0)
    for name, value in expected.items():
        if isinstance(value, float):
            assert getattr(found, name) == pytest.approx(value, abs=COST_ERROR), name
        else:
            assert getattr(found, name) == value, name
    assert found.n_duplicate == found.n_estimates - found.n_matched - found.n_false
    assert found.n_duplicate >= 0
    detections = evaluation.score_detections(shuffled, shuffled_truth).to_dict()
    assert detections.pop("metrics") == {}
    assert detections.items() <= found.to_dict().items()
    segment = found.metrics["longest_segment"]
    assert segment == pytest.approx(reference.longest_segment(scans, 1.0), abs=COST_ERROR)


def one_target(eligible, tracked):
    """Scores of a target at rest that is eligible and tracked in these scans, 0.1 s apart."""
    stamps = np.arange(len(eligible), dtype=np.int64) * 100_000_000
    truth = Truth(
        stamps, np.full(len(stamps), 7), np.zeros((len(stamps), 3)), np.array(eligible, bool)
    )
    ids = np.array([number for number in tracked if number is not None], np.int64)
    when = stamps[[number is not None for number in tracked]]
    return evaluation.score_tracks(Estimates(when, np.full((len(ids), 3), 0.1), ids), truth)


def test_delays_and_gaps_by_hand():
    found = one_target([0, 1, 1, 1, 1, 1, 1, 1], [None, None, None, 4, 4, None, None, 5])
    assert found.recall == pytest.approx(3 / 7)
    assert found.first_delay == {7: pytest.approx(0.2)}
    assert found.longest_gap == {7: pytest.approx(0.2)}
    assert found.metrics["longest_segment"] == pytest.approx(2 / 7)
    assert found.n_switches == 1
    assert found.track_ids == (4, 5)
    assert found.false_ids == ()
    assert found.stamp_ns.tolist() == [n * 100_000_000 for n in range(1, 8)]
    assert found.recall_at.tolist() == [0, 0, 1, 1, 0, 0, 1]


def test_a_gap_ends_where_the_target_need_not_be_found():
    found = one_target([1, 1, 0, 1, 1], [None] * 5)
    assert found.longest_gap == {7: pytest.approx(0.1)}
    assert found.first_delay == {7: None}


def test_a_target_that_need_not_be_found_makes_its_track_neither_false_nor_a_merit():
    found = one_target([0, 0], [1, 1])
    assert (found.recall, found.n_found, found.n_false, found.precision) == (None, 0, 0, 1.0)
    assert found.mean_error is None
    assert found.first_delay == {}


def test_two_tracks_of_one_target_are_a_duplicate_not_false():
    truth = Truth(np.zeros(1, np.int64), np.zeros(1, np.int64), np.zeros((1, 3)), np.ones(1, bool))
    tracks = Estimates(
        np.zeros(3, np.int64), np.array([[0.3, 0, 0], [0.1, 0, 0], [1.01, 0, 0]]), np.arange(3)
    )
    found = evaluation.score_tracks(tracks, truth)
    assert (found.n_matched, found.n_duplicate, found.n_false) == (1, 1, 1)
    assert found.false_ids == (2,)
    assert found.mean_error == pytest.approx(0.1)
    assert found.precision == pytest.approx(1 / 3)


def test_nothing_scores_nothing():
    truth = evaluation.joined([])
    empty = Estimates(np.empty(0, np.int64), np.empty((0, 3)), np.empty(0, np.int64))
    found = evaluation.score_tracks(empty, truth)
    assert (found.n_scans, found.recall, found.precision, found.rmse) == (0, None, None, None)


def test_a_track_where_no_target_is_known_is_false():
    truth = evaluation.joined([])
    tracks = Estimates(np.array([5]), np.zeros((1, 3)), np.array([3]))
    found = evaluation.score_tracks(tracks, truth)
    assert (found.n_scans, found.n_false, found.false_ids) == (1, 1, (3,))


def test_columns_must_agree_and_tracks_have_numbers():
    truth = Truth(np.zeros(2, np.int64), np.zeros(1, np.int64), np.zeros((2, 3)), np.ones(2, bool))
    tracks = Estimates(np.empty(0, np.int64), np.empty((0, 3)), np.empty(0, np.int64))
    with pytest.raises(InputError, match=r"truth\.id: expected shape \(2,\), got \(1,\)"):
        evaluation.score_tracks(tracks, truth)
    with pytest.raises(InputError, match=r"tracks\.id"):
        evaluation.score_tracks(Estimates(tracks.stamp_ns, tracks.position), truth)
    with pytest.raises(ConfigError, match="gate"):
        EvaluationConfig(gate=0)
