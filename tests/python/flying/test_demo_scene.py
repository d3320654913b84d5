"""The demo scene: what the detector promises on it; later seeds in `make nightly`."""

import sys
from functools import cache

import pytest
from repository import ROOT

sys.path.insert(0, str(ROOT / "examples"))

from score_seeds import score

LONGEST_GAP = 1.0  # [s]: every target is tracked within this time of being in sight
MEAN_ERROR = 0.25  # [m]: the visible side of a sphere of 0.325 m lies about 0.22 m off its centre
LOWEST_RECALL = 0.98


SEEDS = range(1)
LATER = [pytest.param(seed, marks=pytest.mark.nightly) for seed in range(1, 10)]
scored = cache(score)


@pytest.mark.parametrize(
    "seeds", [SEEDS, pytest.param(range(10), marks=pytest.mark.nightly)], ids=str
)
def test_targets_in_sight_are_tracked(seeds):
    tracks, detections = zip(*map(scored, seeds), strict=True)
    found, eligible = sum(t.n_found for t in tracks), sum(t.n_eligible for t in tracks)
    assert eligible > 90 * len(seeds)
    assert found >= LOWEST_RECALL * eligible
    assert sum(d.n_found for d in detections) >= LOWEST_RECALL * eligible


@pytest.mark.parametrize("seed", [*SEEDS, *LATER])
def test_every_target_is_tracked_soon_and_nothing_else(seed):
    tracks, _ = scored(seed)
    assert tracks.n_eligible > 50
    assert tracks.mean_error <= MEAN_ERROR
    assert max(tracks.longest_gap.values()) <= LONGEST_GAP
    assert tracks.false_ids == ()
