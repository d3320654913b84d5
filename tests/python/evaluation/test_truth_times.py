"""Truth at other times than the scans: interpolated to them, or used as it is."""

import json

import numpy as np
import pytest
from commands import invoke, json_of

from lidar_core import FormatError
from lidar_core.evaluation import (
    Estimates,
    EvaluationConfig,
    Prediction,
    evaluate,
    read_prediction,
    read_truth,
)
from lidar_core.evaluation.matching.interpolation import supposed_scans

MS = 1_000_000
SCANS = np.arange(40) * 100 * MS
NEAR = 0.02
"""A chord of 0.1 s is at most 3 mm off the circle below; a shift of 40 ms moves by 80 mm [m]."""


def place_at(stamps, target=0):
    """Positions of a target on a circle, 2 m/s."""
    angle = 0.5 * np.asarray(stamps) * 1e-9 + target
    return np.stack([4 * np.cos(angle), 4 * np.sin(angle), np.full(len(angle), 2.0)], axis=1)


def write(path, stamps, targets=(0,), name="target_id", **more):
    """A table of targets that are where `place_at` says."""
    lines = [",".join(["t_ns", name, "x", "y", "z", *more])]
    for target in targets:
        for stamp, place in zip(stamps, place_at(stamps, target).tolist(), strict=True):
            lines.append(",".join(map(str, [stamp, target, *place, *more.values()])))
    path.write_text("\n".join(lines) + "\n")
    return path


def perfect(stamps=SCANS, scans=SCANS):
    """A run that tracks the target without error at `stamps`, with scans at `scans`."""
    numbers = np.zeros(len(stamps), np.int64)
    return Prediction(Estimates(stamps, place_at(stamps), numbers), scan_ns=scans)


def scores_of(path, run, **values):
    truth = read_truth(path, config=EvaluationConfig(**values), run=run)
    return truth, evaluate(truth, tracks=run.tracks, config=EvaluationConfig(**values)).tracks


@pytest.mark.parametrize("step", [10 * MS, 8_333_333, 50 * MS])
def test_a_denser_truth_is_scored_at_the_scans(tmp_path, step):
    path = write(tmp_path / "dense.csv", np.arange(0, SCANS[-1] + step, step))
    truth, scores = scores_of(path, perfect())
    assert truth.stamp_ns.tolist() == SCANS.tolist()
    assert (scores.n_found, scores.n_eligible, scores.n_false) == (40, 40, 0)
    assert scores.max_error < NEAR


def test_rows_at_the_scans_of_a_denser_truth_keep_their_bits(tmp_path):
    path = write(tmp_path / "dense.csv", np.arange(0, SCANS[-1] + 1, 10 * MS))
    truth, scores = scores_of(path, perfect())
    assert not truth.is_interpolated.any()
    np.testing.assert_array_equal(truth.position, place_at(SCANS))
    assert scores.max_error == 0


def test_a_truth_between_the_scans_is_interpolated(tmp_path):
    path = write(tmp_path / "between.csv", SCANS + 40 * MS, targets=(0, 1))
    truth, scores = scores_of(path, perfect())
    assert truth.is_interpolated.all()
    # The first scan is before the first row: nothing is known there.
    assert truth.stamp_ns.tolist() == [*SCANS[1:], *SCANS[1:]]
    assert scores.max_error < NEAR
    assert (scores.n_found, scores.n_eligible) == (39, 78)


def test_large_stamps_lose_nothing(tmp_path):
    start = 1_700_000_000 * 10**9 + 1
    path = write(tmp_path / "epoch.csv", start + SCANS[:3] + 40 * MS)
    tracks = Estimates(start + SCANS[:3], place_at(SCANS[:3]), np.zeros(3, np.int64))
    truth = read_truth(path, run=Prediction(tracks, scan_ns=start + SCANS[:3]))
    rows = place_at(start + SCANS[:3] + 40 * MS)
    np.testing.assert_allclose(truth.position[0], 0.4 * rows[0] + 0.6 * rows[1], atol=1e-9)


@pytest.mark.parametrize("shift", [0, 50_000])
def test_a_truth_at_the_scans_stays_as_it_is(tmp_path, shift):
    stamps = np.delete(SCANS, [7, 20]) + shift  # within the tolerance; two rows are missing
    path = write(tmp_path / "exact.csv", stamps)
    truth, alone = read_truth(path, run=perfect()), read_truth(path)
    assert truth.is_interpolated is None
    for name in ("stamp_ns", "id", "position", "is_eligible"):
        np.testing.assert_array_equal(getattr(truth, name), getattr(alone, name))


def test_a_run_that_lost_scans_missed_them(tmp_path):
    path = write(tmp_path / "exact.csv", SCANS)
    scans = np.delete(SCANS, [5, 6, 30])
    _, scores = scores_of(path, perfect(scans, scans))
    assert (scores.n_found, scores.n_eligible) == (37, 40)


@pytest.mark.parametrize("lost", [slice(3, 20), slice(1, 40, 3)])
def test_a_run_that_lost_many_scans_missed_them(tmp_path, lost):
    """As live drops them, or as a run of many targets has states only where there are tracks."""
    path = write(tmp_path / "exact.csv", SCANS)
    scans = np.delete(SCANS, lost)
    for known in (scans, None):
        truth, scores = scores_of(path, perfect(scans, known))
        assert truth.is_interpolated is None
        assert (scores.n_found, scores.n_eligible) == (len(scans), 40)


def test_a_part_of_a_recording_is_scored_over_its_scans(tmp_path):
    path = write(tmp_path / "exact.csv", SCANS, targets=(0, 1))
    truth, scores = scores_of(path, perfect(SCANS[10:25], SCANS[10:25]), burn_in_scans=3)
    assert (truth.n_before, truth.n_after) == (20, 30)
    # Target 1 is found in none of the scans, and the burn-in is that of the part.
    assert (scores.n_found, scores.n_eligible) == (12, 24)


def test_a_part_of_a_denser_truth_is_counted_in_its_rows(tmp_path):
    path = write(tmp_path / "dense.csv", np.arange(0, SCANS[-1] + 1, 10 * MS))
    truth, scores = scores_of(path, perfect(SCANS[10:25], SCANS[10:25]))
    assert (truth.n_before, truth.n_after) == (100, 150)
    assert (scores.n_found, scores.n_eligible) == (15, 15)


def test_a_target_that_is_lost_early_is_missed_up_to_the_last_scan(tmp_path):
    path = write(tmp_path / "exact.csv", SCANS)
    truth, scores = scores_of(path, perfect(SCANS[10:15], SCANS[10:25]))
    assert (truth.n_before, truth.n_after) == (10, 15)
    assert (scores.n_found, scores.n_eligible) == (5, 15)


def test_the_truth_of_another_recording_is_not_left_out(tmp_path):
    truth = read_truth(write(tmp_path / "other.csv", SCANS + 10**12), run=perfect())
    assert (len(truth.id), truth.n_before, truth.n_after) == (len(SCANS), 0, 0)


def test_a_table_at_uneven_times_keeps_its_truth(tmp_path):
    rng = np.random.default_rng(7)
    stamps = SCANS + rng.integers(-2 * MS, 2 * MS, len(SCANS))
    path = write(tmp_path / "exact.csv", stamps)
    truth, scores = scores_of(path, perfect(stamps[10:34], None))
    assert truth.is_interpolated is None
    assert (scores.n_found, scores.n_eligible) == (24, 40)


def test_a_sparser_truth_is_scored_at_its_own_times(tmp_path):
    path = write(tmp_path / "sparse.csv", SCANS[::10])
    truth, scores = scores_of(path, perfect())
    assert truth.is_interpolated is None
    assert (scores.n_found, scores.n_eligible) == (4, 4)


def test_a_sparser_truth_between_the_scans_is_refused_without_a_wide_tolerance(tmp_path):
    truth = write(tmp_path / "sparse.csv", SCANS[::10] + 40 * MS)
    table = write(tmp_path / "tracks.csv", SCANS, name="track_id")
    text = str(invoke("evaluate", table, truth).exception)
    assert "at least as often as the scans" in text
    assert "time_tolerance" not in text


@pytest.mark.parametrize("step", [10 * MS, 100 * MS])
def test_gaps_and_ends_are_not_bridged(tmp_path, step):
    stamps = np.arange(440 * MS, 3000 * MS, step)
    stamps = stamps[(stamps < 1450 * MS) | (stamps > 2050 * MS)]
    path = write(tmp_path / "gap.csv", stamps)
    truth, scores = scores_of(path, perfect())
    seen = truth.stamp_ns // MS
    assert not ((seen > 1450) & (seen < 2050)).any()
    assert seen.min() == 500
    assert seen.max() <= 3000
    assert scores.max_error < NEAR


def test_one_missing_row_is_no_gap(tmp_path):
    path = write(tmp_path / "between.csv", np.delete(SCANS + 40 * MS, 9))
    assert read_truth(path, run=perfect()).stamp_ns.tolist() == SCANS[1:].tolist()


def test_scans_without_a_track_are_missed(tmp_path):
    """A run folder knows its scans; those of a table are supposed at their usual interval."""
    path = write(tmp_path / "dense.csv", np.arange(0, SCANS[-1] + 1, 10 * MS))
    tracked = np.delete(SCANS, [*range(8), 20, 21, 22, 30])
    for scans in (SCANS, None):
        truth, scores = scores_of(path, perfect(tracked, scans))
        assert truth.stamp_ns.tolist() == SCANS.tolist()
        assert (scores.n_found, scores.n_eligible) == (28, 40)


def test_a_day_without_tracks_has_scans():
    day = 86_400_000 * MS
    tracked = np.array([0, 100 * MS, 200 * MS, day - 100 * MS, day])
    scans = supposed_scans(tracked, np.arange(0, day + 1, 100 * MS))
    assert len(scans) == 864_001
    assert (np.diff(scans) == 100 * MS).all()


def test_the_burn_in_counts_scans(tmp_path):
    path = write(tmp_path / "dense.csv", np.arange(500 * MS, SCANS[-1] + 1, 10 * MS))
    truth, _ = scores_of(path, perfect(), burn_in_scans=10)
    assert truth.stamp_ns[truth.is_eligible].tolist() == SCANS[10:].tolist()


def test_a_truth_with_hits_is_one_of_scans(tmp_path):
    path = write(tmp_path / "hits.csv", np.arange(0, SCANS[-1] + 1, 10 * MS), hits=5)
    assert read_truth(path, run=perfect()).is_interpolated is None


def test_the_command_tells_what_it_interpolated(tmp_path):
    table = write(tmp_path / "tracks.csv", SCANS, name="track_id")
    between = write(tmp_path / "between.csv", SCANS + 40 * MS)
    out = " ".join(invoke("evaluate", table, between).output.split())
    assert "39 of 39 true positions at the scans are interpolated" in out
    assert json_of("evaluate", table, between)["truth_interpolated"] == 39
    exact = write(tmp_path / "exact.csv", SCANS)
    assert "interpolated" not in invoke("evaluate", table, exact).output
    assert json_of("evaluate", table, exact)["truth_interpolated"] == 0


def without_heights(path):
    """The same table without its column z, which is the last."""
    lines = path.read_text().splitlines()
    path.write_text("\n".join(line.rsplit(",", 1)[0] for line in lines) + "\n")
    return path


def test_a_run_in_the_plane_needs_no_heights(tmp_path):
    path = without_heights(write(tmp_path / "plane.csv", SCANS))
    flat = perfect()
    flat.tracks.position[:, 2] = 0
    _, scores = scores_of(path, flat)
    assert (scores.n_found, scores.max_error) == (40, 0)
    with pytest.raises(FormatError, match=r"plane\.csv: no column z: add z"):
        read_truth(path, run=perfect())


def test_run_and_truth_that_were_exchanged_are_told(tmp_path):
    targets = write(tmp_path / "targets.csv", SCANS)
    with pytest.raises(FormatError, match=r"targets\.csv: target_id instead of track_id.*exchange"):
        read_prediction(targets)
    run = tmp_path / "run"
    run.mkdir()
    (run / "run.toml").write_text("")
    (run / "summary.json").write_text(json.dumps({}))
    with pytest.raises(FormatError, match="the run itself is the first argument"):
        read_truth(run, run=perfect())
