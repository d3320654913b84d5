"""The demo scene, seeds 0 to 9: what the detector promises on it."""

import sys

import pytest
from repository import ROOT

sys.path.insert(0, str(ROOT / "examples"))

from score_seeds import score

LONGEST_GAP = 1.0  # [s]: every target is tracked within this time of being in sight
MEAN_ERROR = 0.25  # [m]: the visible side of a sphere of 0.325 m lies about 0.22 m off its centre
LOWEST_RECALL = 0.98


pytestmark = pytest.mark.xdist_group("demo scene")


@pytest.fixture(scope="module")
def scores():
    return {seed: score(seed) for seed in range(10)}


def test_targets_in_sight_are_tracked(scores):
    tracks = [tracks for tracks, _ in scores.values()]
    found, eligible = sum(t.n_found for t in tracks), sum(t.n_eligible for t in tracks)
    assert eligible > 900
    assert found >= LOWEST_RECALL * eligible
    assert sum(d.n_found for _, d in scores.values()) >= LOWEST_RECALL * eligible


@pytest.mark.parametrize("seed", range(10))
def test_every_target_is_tracked_soon_and_nothing_else(scores, seed):
    tracks, _ = scores[seed]
    assert tracks.n_eligible > 50
    assert tracks.mean_error <= MEAN_ERROR
    assert max(tracks.longest_gap.values()) <= LONGEST_GAP
    assert tracks.false_ids == ()
