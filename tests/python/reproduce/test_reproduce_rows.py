"""What the rows of `lidar-core reproduce` count, on tables made by hand."""

import numpy as np
import pytest

from lidar_core.flying import FlyingConfig
from lidar_core.reproduce import Request
from lidar_core.reproduce.flying import (
    consistency,
    detection_probability,
    pose_noise,
)
from lidar_core.reproduce.flying.encounters import occlusions

BURN_IN = FlyingConfig().seed.burn_in_scans
SCANS = BURN_IN + 20


def part_of(places, tracks, detections=None):
    """A part of targets (S, T, 3) and of rows (scan, id, place) that best mode reported."""
    places = np.asarray(places, float)
    count, targets = places.shape[:2]
    detections = tracks if detections is None else detections
    return {
        "stamp_ns": np.arange(count) * 100_000_000,
        "sensor": np.zeros((count, 3)),
        "id": np.arange(targets),
        "position": places,
        "position_hit": places,
        "hits": np.full((count, targets), 20),
        "best_burn_in_scans": np.array(BURN_IN),
        "best_detections_scan": np.array([row[0] for row in detections], np.int64),
        "best_detections_position": np.reshape([row[2] for row in detections], (-1, 3)),
        "best_tracks_scan": np.array([row[0] for row in tracks], np.int64),
        "best_tracks_id": np.array([row[1] for row in tracks], np.int64),
        "best_tracks_position": np.reshape([row[2] for row in tracks], (-1, 3)),
    }


def still(*places):
    return np.tile(np.array(places, float), (SCANS, 1, 1))


# Occlusions


def occluded(table):
    """A drone hidden in scans 10 to 19 of 30; `table` says which track it has in which scans."""
    here = (5.0, 0.0, 0.0)
    rows = [(scan, number, here) for number, scans in table.items() for scan in scans]
    part = part_of(np.tile(here, (30, 1, 1)), rows)
    part["hits"][10:20] = 0
    return part


@pytest.mark.parametrize(
    ("table", "is_kept"),
    [
        ({4: range(30)}, True),
        ({4: [*range(5, 12), *range(22, 30)]}, True),
        ({4: range(22, 30)}, False),  # none before
        ({4: [*range(5), *range(22, 30)]}, False),  # lost before it was hidden
        ({4: range(12)}, False),  # none at the end
        ({4: range(12), 5: range(22, 30)}, False),
        ({4: [*range(12), *range(26, 30)], 5: range(20, 26)}, False),
        ({}, False),
    ],
)
def test_an_id_is_kept_if_the_drone_had_it_before_and_at_the_end(table, is_kept):
    assert occlusions.is_kept(occluded(table), "best") is is_kept


def test_a_drone_that_never_was_hidden_kept_nothing():
    part = occluded({4: range(30)})
    part["hits"][:] = 20
    assert not occlusions.is_kept(part, "best")


# Pose noise


def test_a_track_that_ever_leaves_its_target_is_false():
    scans = range(BURN_IN, SCANS)
    away = [(scan, 3, (5 + 0.1 * (scan - BURN_IN), 0, 0)) for scan in scans]  # up to 1.9 m
    near = [(scan, 4, (0, 5.2, 0)) for scan in scans]
    part = part_of(still((5, 0, 0), (0, 5, 0)), away + near)
    false_detections, false_tracks, found, followed = pose_noise._counts([part], "best")
    assert (false_detections, false_tracks) == (4, 1)  # 1.6 to 1.9 m
    assert found == followed == pytest.approx(36 / 40)


def test_one_estimate_finds_one_target_only():
    scans = range(BURN_IN, SCANS)
    between = [(scan, 3, (5, 0.4, 0)) for scan in scans]
    counts = pose_noise._counts([part_of(still((5, 0, 0), (5, 1, 0)), between)], "best")
    assert counts == (0, 0, 0.5, 0.5)


# Detection probability


def test_the_standard_error_is_that_of_the_means_of_the_scans():
    rng = np.random.default_rng(1000)
    scans, targets = 400, detection_probability.TARGETS
    met = rng.random((scans, targets)) < 0.3
    error = detection_probability.standard_error({"met": met.reshape(-1)})
    assert error == pytest.approx(np.sqrt(0.3 * 0.7 / (scans * targets)), rel=0.15)
    assert detection_probability.standard_error({"met": met[0]}) is None


# Consistency


def test_steps_count_only_while_nearly_all_runs_have_a_track():
    values = np.full((20, 4), 9.0)
    values[0, 1] = values[:3, 2] = values[:, 3] = np.nan
    assert consistency.counts(values).tolist() == [True, True, False, False]


def test_modes_that_lose_their_tracks_have_no_share_of_steps():
    rows = {
        row.name: row for row in consistency.ITEM.run(Request(seed=1000, scans=12, threads=1)).rows
    }
    inside = rows["own model: steps inside the 95 % band"]
    steps = rows["own model: steps that count"]
    assert inside.paper_mode is None
    assert steps.paper_mode < 20
    assert inside.best_mode > 0.8
    assert steps.best_mode == consistency.STEPS
    assert rows["own model: tracks lost"].paper_mode == 1.0
