"""What is read from maps of simulated 2D scans: hand-made runs with known answers."""

import numpy as np
import pytest

from lidar_core.reproduce.circles import fig8, lab, runs, single
from lidar_core.reproduce.circles.runs import MapRun

PERIOD_NS = 50_000_000
HIDDEN = 99  # number of an element that the map holds to be out of sight


def run_of(centers, elements, *, hits=20, rays=20, radius=0.3):
    """A run of objects at `centers` (S, T, 2) and `elements`: (scan, id, x, y, r) each."""
    centers = np.array(centers, float)
    shape = centers.shape[:2]
    rows = np.array(sorted(elements), float).reshape(-1, 5)
    return MapRun.of(
        {
            "stamp_ns": np.arange(shape[0]) * PERIOD_NS,
            "kind": np.array(["cylinder"] * shape[1]),
            "radius": np.full(shape[1], radius),
            "center": centers,
            "hits": np.broadcast_to(hits, shape).astype(np.int64),
            "rays": np.broadcast_to(rays, shape).astype(np.int64),
            "element_scan": rows[:, 0].astype(np.int64),
            "element_id": rows[:, 1].astype(np.int64),
            "element_center": rows[:, 2:4],
            "element_radius": rows[:, 4],
            "element_visible": rows[:, 1] != HIDDEN,
        }
    )


def in_both(*runs):
    return {"paper": runs, "best": runs}


def still(scans, *places):
    return np.tile(np.array(places, float), (scans, 1, 1))


def test_errors_belong_to_the_paired_element():
    run = run_of(still(3, (4, 0)), [(1, 7, 4.01, -0.02, 0.31), (2, 7, 4.0, 0.0, 0.3)])
    np.testing.assert_allclose(run.errors(0)[1:], [[0.01, -0.02, 0.01], [0, 0, 0]], atol=1e-12)
    assert np.isnan(run.errors(0)[0]).all()
    assert run.ids(0).tolist() == [-1, 7, 7]


def test_pairs_are_one_to_one_and_within_the_gate():
    run = run_of(still(1, (4, 0), (4, 0.6)), [(0, 1, 4, 0.1, 0.3), (0, 2, 4, 0.7, 0.3)])
    assert [run.ids(0)[0], run.ids(1)[0]] == [1, 2]
    far = run_of(still(1, (4, 0)), [(0, 1, 4 + runs.GATE + 0.01, 0, 0.3)])
    assert far.ids(0)[0] == -1


def test_ghosts_are_timed_at_a_stretch():
    at_rest = [(scan, 1, 4, 0, 0.3) for scan in range(40)]
    ghost = [(scan, 5, 1, 2, 0.3) for scan in [*range(3, 9), *range(20, 36)]]
    run = run_of(still(40, (4, 0)), at_rest + ghost)
    np.testing.assert_allclose(np.sort(run.ghosts()), [0.3, 0.8])
    assert runs.lasting(run.ghosts()) == 1
    none = run_of(still(40, (4, 0)), at_rest)
    assert len(none.ghosts()) == 0
    twin = run_of(still(40, (4, 0)), at_rest + [(scan, 2, 4.2, 0, 0.3) for scan in range(40)])
    assert runs.lasting(twin.ghosts()) == 1


def test_ghosts_out_of_sight_count_apart():
    ghost = [(scan, HIDDEN, 1, 2, 0.3) for scan in range(16)]
    run = run_of(still(20, (4, 0)), ghost)
    assert len(run.ghosts()) == 0
    np.testing.assert_allclose(run.ghosts(hidden=True), [0.8])


def test_ten_scans_are_no_longer_than_half_a_second():
    ghost = [(scan, 5, 1, 2, 0.3) for scan in range(10)]
    assert runs.lasting(run_of(still(20, (4, 0)), ghost).ghosts()) == 0


def test_delays_and_presence_count_visible_time_only():
    hits = np.full((60, 1), 20)
    hits[30:45] = 0
    elements = [(scan, 1, 4, 0, 0.3) for scan in [*range(4, 30), *range(50, 58)]]
    run = run_of(still(60, (4, 0)), elements, hits=hits)
    assert list(run.spells(0)) == [(0, 30), (45, 60)]
    np.testing.assert_allclose(run.delays(), [0.2, 0.25])
    assert run.presence() == (20 + 3, 20 + 5)
    never = run_of(still(60, (4, 0)), [])
    assert never.delays().tolist() == [np.inf]
    assert never.presence() == (0, 50)


def test_hardly_visible_objects_are_not_missed():
    for hits, rays in ((4, 4), (9, 40)):
        run = run_of(still(60, (4, 0)), [], hits=hits, rays=rays)
        assert len(run.delays()) == 0
        assert run.presence() == (0, 0)


def test_changes_of_identity_are_counted_over_gaps():
    elements = [(0, 1, 4, 0, 0.3), (1, 1, 4, 0, 0.3), (4, 2, 4, 0, 0.3), (5, 1, 4, 0, 0.3)]
    assert run_of(still(6, (4, 0)), elements).switches() == 2


def test_largest_errors_count_two_seconds_after_the_first_report():
    elements = [(scan, 1, 4 + (0.1 if scan < 45 else 0.01), 0, 0.3) for scan in range(5, 60)]
    run = run_of(still(60, (4, 0)), elements)
    np.testing.assert_allclose(single.settled(run)[:, 0], [0.01] * 15)
    rows = {row.name: row for row in single.rows("a", in_both(run), (1.0,) * 6)}
    assert rows["a: x, largest error"].best_mode == pytest.approx(0.01)
    assert rows["a: x, MSE"].best_mode == pytest.approx((40 * 0.1**2 + 15 * 0.01**2) / 55)
    assert rows["a: y, MSE"].best_mode == 0
    assert rows["a: radius, MSE"].paper == 1.0
    worst = {row.name: row.best_mode for row in single.worst_rows(in_both(run, run))}
    assert worst["worst of 2 runs: x, largest error"] == pytest.approx(0.01)
    assert worst["present while visible"] == 1
    assert worst["reported within 0.5 s"] == 1


def test_runs_without_a_report_give_no_numbers():
    run = run_of(still(60, (4, 0)), [])
    assert all(row.best_mode is None for row in single.rows("a", in_both(run)))
    worst = {row.name: row.best_mode for row in single.worst_rows(in_both(run))}
    assert worst["reported within 0.5 s"] == 0
    assert worst["present while visible"] == 0
    assert worst["worst of 1 runs: x, MSE"] is None
    measures = {name: value for name, _, value in fig8.world_measures("a", run)}
    assert measures["a: x, RMS"] is None
    assert measures["a: ghosts"] == 0


def test_an_identity_is_kept_if_it_is_the_same_before_and_after():
    scans = 200
    same = [(scan, 3, 4, 0, 0.3) for scan in [*range(100), *range(140, 200)]]
    other = [(scan, 3 if scan < 120 else 4, 4, 0, 0.3) for scan in range(200)]
    assert fig8.is_kept(run_of(still(scans, (4, 0)), same))
    assert not fig8.is_kept(run_of(still(scans, (4, 0)), other))
    assert not fig8.is_kept(run_of(still(scans, (4, 0)), []))


def test_neighbours_need_an_element_each():
    places = still(20, (5, -0.4), (5, 0.4))
    both = [(scan, n, 5, y, 0.25) for scan in range(20) for n, y in ((1, -0.4), (2, 0.4))]
    one = [(scan, 1, 5, 0, 0.6) for scan in range(20)]
    assert fig8.are_apart(run_of(places, both)).tolist() == [True] * 10
    assert not fig8.are_apart(run_of(places, one)).any()


def test_hidden_posts_count_while_they_are_hidden_in_part():
    hits = np.tile([[10, 30]], (20, 1))
    hits[15:, 0] = 18
    elements = [(scan, 1, 5.03, -0.4, 0.3) for scan in range(13)]
    run = run_of(still(20, (5, -0.4), (3, 0.4)), elements, hits=hits)
    errors = fig8.hidden_errors(run)
    assert errors.shape == (5, 3)
    np.testing.assert_allclose(errors[:3, 0], 0.03)
    assert np.isnan(errors[3:, 0]).all()


def test_parts_of_a_person_are_counted():
    elements = [(scan, 1, 1, 0, 0.2) for scan in range(20)]
    elements += [(scan, 2, 1, 0.3, 0.05) for scan in range(15, 20)]
    run = run_of(still(20, (1, 0), (0, 1)), elements)
    assert lab.elements_near(run, 0).tolist() == [1] * 5 + [2] * 5
