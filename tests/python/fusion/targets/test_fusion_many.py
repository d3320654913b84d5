"""Many targets: oracle, life of tracks, bad input, the Autoferry recordings."""

import json

import numpy as np
import pytest
from autoferry_files import entry, scenario, standing
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from lidar_core.cli import app
from lidar_core.errors import ConfigError, FormatError, InputError, LimitError
from lidar_core.estimation import chi2_quantile
from lidar_core.fusion import (
    FusionConfig,
    Measurement,
    MultiTargetConfig,
    MultiTargetTracker,
    TargetTracks,
    empty_gospa,
    mean_gospa,
    read_autoferry,
    target_coverage,
)
from lidar_core.fusion.recordings.autoferry import DELAYS, SOURCES
from reference.fusion_clutter import reported_covariance
from reference.fusion_company import is_reported
from reference.fusion_many import JointTargets, ManyTargets

STEP_NS = 500_000_000
ORACLE = 1e-9
"""Inverses instead of factors, over tens of scans, relative to metres."""
KINDS = 1e-7
"""The noise of motions over short times is a series in Rust, and integrals in the oracle."""
GATE = 0.99
SMALL = MultiTargetConfig(
    association="nearest",
    target=FusionConfig(
        model="cv", method="kf", lidar_std=(0.5, 0.4), acceleration_noise=0.7, gate_probability=GATE
    ),
    confirm_hits=2,
    confirm_window=3,
    max_coast=1.6,
    max_position_std=8.0,
    birth_distance=1.5,
)
SCENARIOS = (2, 3, 4, 5, 13, 17)
COVERED = {"integrated": 0.65, "nearest": 0.85, "joint": 0.8}
"""Least share of the time for which a target has a track of its own; 0.85 is the goal."""
SHARED = {(17, 2): 0.25}
"""Targets, by scenario and number, that miss the goal: beside another one whose track is theirs."""


def lidar(stamp_ns, places):
    return [Measurement(stamp_ns, "lidar", place) for place in places]


def feed(tracker, scans, source="lidar"):
    return [
        tracker.process(k * STEP_NS, lidar(k * STEP_NS, scan), source=source).id.tolist()
        for k, scan in enumerate(scans)
    ]


@pytest.mark.parametrize("association", ["nearest", "joint"])
@given(seed=st.integers(6300, 6999))
def test_the_tracker_agrees_with_the_oracle(association, seed):
    rng = np.random.default_rng(seed)
    config = SMALL.model_copy(update={"association": association, "clutter": (0.02, 1e-3)})
    tracker = MultiTargetTracker(config)
    kind = ManyTargets if association == "nearest" else JointTargets
    oracle = kind(config, gate=chi2_quantile(GATE, degrees=2))
    place, speed = rng.uniform(-5, 5, (3, 2)), rng.normal(0, 1.5, (3, 2))
    stamp = 0
    for _ in range(14):
        stamp += int(rng.integers(1, 8)) * 100_000_000
        source = str(rng.choice(["left", "right"]))
        seen = (place + speed * stamp * 1e-9)[rng.random(3) < 0.75]
        seen = seen + rng.normal(0, 0.45, seen.shape)
        seen = np.vstack([seen, rng.uniform(-12, 12, (int(rng.random() < 0.3), 2))])
        got = tracker.process(stamp, lidar(stamp, seen), source=source)
        assert got.id.tolist() == oracle.process(stamp, seen, source)
        np.testing.assert_allclose(got.nis, oracle.nis, atol=ORACLE)
        tracks = tracker.tracks_at(stamp, confirmed=False)
        assert tracks.id.tolist() == [track["id"] for track in oracle.tracks]
        assert tracks.confirmed.tolist() == [is_reported(track) for track in oracle.tracks]
        assert tracks.hits.tolist() == [track["hits"] for track in oracle.tracks]
        for row, track in enumerate(oracle.tracks):
            np.testing.assert_allclose(tracks.states[row], track["mean"], atol=ORACLE)
            expected = reported_covariance(track)
            np.testing.assert_allclose(tracks.covariances[row], expected, atol=ORACLE)
            found = tracks.kind_probability[row]
            np.testing.assert_allclose(found, oracle.kinds(track), atol=KINDS)


@pytest.mark.parametrize("model", ["cv", "ctrv", "ctra"])
@pytest.mark.parametrize("method", ["ekf", "ukf", "imm"])
def test_a_single_target_in_clutter_is_followed_by_its_probabilities(model, method):
    rng = np.random.default_rng(7400)
    target = FusionConfig.load({"model": model, "method": method, "lidar_std": (0.2, 0.2)})
    config = MultiTargetConfig(target=target, association="joint", clutter=(0.01, 1e-3))
    tracker = MultiTargetTracker(config)
    for k in range(80):
        stamp, place = k * 100_000_000, np.array([2.0 + 0.3 * k, 1.0 + 0.1 * k])
        seen = [place + rng.normal(0, 0.2, 2)] if rng.random() < 0.9 or k < 5 else []
        seen += list(place + rng.uniform(-10, 10, (4, 2)))
        tracker.process(stamp, lidar(stamp, seen), source="lidar")
    tracks = tracker.tracks_at(stamp)
    away = np.linalg.norm(tracks.position - place, axis=1)
    assert away.min() < 0.5
    assert tracks.id[np.argmin(away)] == 0


@pytest.mark.ci_cases("joint")
@pytest.mark.parametrize("association", ["nearest", "joint"])
@given(seed=st.integers(7500, 7999))
def test_scans_in_any_order_give_what_the_oracle_gets_in_order(association, seed):
    """Up to the numbers, which are those of the order of arrival."""
    rng = np.random.default_rng(seed)
    config = SMALL.model_copy(
        update={
            "association": association,
            "clutter": (0.02, 1e-3),
            "target": SMALL.target.model_copy(update={"buffer_time": 2.0}),
        }
    )
    kind = ManyTargets if association == "nearest" else JointTargets
    oracle, tracker = kind(config, gate=chi2_quantile(GATE, degrees=2)), MultiTargetTracker(config)
    place, scans = rng.uniform(-5, 5, (3, 2)), []
    for k in range(16):
        seen = (place + 0.1 * k)[rng.random(3) < 0.75]
        seen = seen + rng.normal(0, 0.45, seen.shape)
        scans.append((k * STEP_NS // 2, seen, str(rng.choice(["left", "right"]))))
    for stamp, seen, source in scans:
        oracle.process(stamp, seen, source)
    late = np.argsort(np.arange(16) + rng.uniform(0, 7, 16))  # at most 1.75 s
    for stamp, seen, source in (scans[k] for k in late):
        tracker.process(stamp, lidar(stamp, seen), source=source)
    tracks = tracker.tracks_at(scans[-1][0], confirmed=False)
    assert len(set(tracks.id.tolist())) == len(oracle.tracks)
    for track in oracle.tracks:
        row = np.argmin(np.linalg.norm(tracks.position - track["mean"][:2], axis=1))
        np.testing.assert_allclose(tracks.states[row], track["mean"], atol=ORACLE)
        np.testing.assert_allclose(tracks.covariances[row], reported_covariance(track), atol=ORACLE)
        assert tracks.hits[row] == track["hits"]
        assert tracks.confirmed[row] == is_reported(track)


def test_a_late_scan_leaves_the_numbers_of_tracks():
    tracker = MultiTargetTracker(SMALL)
    feed(tracker, [[[0, 0]], [[0.1, 0]]])
    third = tracker.process(
        3 * STEP_NS // 2, lidar(3 * STEP_NS // 2, [[0.1, 0], [9, 9]]), source="lidar"
    )
    assert third.id.tolist() == [0, 1]
    assert np.isfinite(third.nis[0])
    assert np.isnan(third.nis[1])
    late = tracker.process(5 * STEP_NS // 4, lidar(5 * STEP_NS // 4, [[-9, 9]]), source="lidar")
    assert late.id.tolist() == [2]
    assert tracker.tracks_at(2 * STEP_NS, confirmed=False).id.tolist() == [0, 1, 2]
    again = tracker.process(
        3 * STEP_NS // 2, lidar(3 * STEP_NS // 2, [[0.1, 0], [9, 9]]), source="lidar"
    )
    assert again.id.tolist() == [0, 1]
    assert tracker.tracks_at(2 * STEP_NS, confirmed=False).hits.tolist() == [3, 1, 1]


def test_crossing_targets_keep_their_numbers():
    config = MultiTargetConfig(target=FusionConfig(model="cv"))
    time = np.arange(0, 10, 0.1)
    rng = np.random.default_rng(6200)
    tracker = MultiTargetTracker(config)
    for t in time:
        places = np.array([[-5 + t, -2 + 0.4 * t], [-5 + t, 2 - 0.4 * t]])
        stamp = round(t * 1e9)
        tracker.process(stamp, lidar(stamp, places + rng.normal(0, 0.1, (2, 2))), source="l")
    tracks = tracker.tracks_at(round(time[-1] * 1e9))
    assert tracks.id.tolist() == [0, 1]
    np.testing.assert_allclose(tracks.position, places, atol=0.5)
    np.testing.assert_allclose(tracks.velocity, [[1, 0.4], [1, -0.4]], atol=0.5)


def test_radar_and_lidar_make_one_track_of_any_model():
    rng = np.random.default_rng(6201)
    for model, method in (("ctrv", "ukf"), ("ca", "imm"), ("ct", "ekf")):
        tracker = MultiTargetTracker(
            MultiTargetConfig(target=FusionConfig(model=model, method=method))
        )
        for k in range(60):
            stamp, x = k * 50_000_000, 5 + 0.1 * k
            polar = np.array([np.hypot(x, 2), np.arctan2(2, x), 2 * x / np.hypot(x, 2)])
            if k % 2:
                scan = [Measurement(stamp, "radar", polar + rng.normal(0, [0.2, 0.02, 0.2]))]
            else:
                scan = lidar(stamp, [np.array([x, 2]) + rng.normal(0, 0.1, 2)])
            tracker.process(stamp, scan, source="radar" if k % 2 else "lidar")
        tracks = tracker.tracks_at(stamp)
        assert tracks.id.tolist() == [0]
        np.testing.assert_allclose(tracks.position[0], [x, 2], atol=0.4)
        np.testing.assert_allclose(tracks.velocity[0], [2, 0], atol=0.6)


def test_a_track_is_confirmed_carried_on_and_ends():
    tracker = MultiTargetTracker(SMALL)
    assert feed(tracker, [[[0, 0]]]) == [[0]]
    assert tracker.tracks_at(0).id.size == 0
    assert tracker.tracks_at(0, confirmed=False).id.tolist() == [0]
    tracker.process(STEP_NS, lidar(STEP_NS, [[0.1, 0]]), source="lidar")
    assert tracker.tracks_at(STEP_NS).id.tolist() == [0]
    for k in (2, 3, 4):
        tracker.process(k * STEP_NS, [], source="lidar")
        assert tracker.tracks_at(k * STEP_NS).id.tolist() == [0]
    tracker.process(5 * STEP_NS, [], source="lidar")
    assert tracker.tracks_at(5 * STEP_NS, confirmed=False).id.size == 0
    later = tracker.process(6 * STEP_NS, lidar(6 * STEP_NS, [[0, 0]]), source="lidar")
    assert later.id.tolist() == [1]


def test_clutter_makes_no_confirmed_track():
    tracker = MultiTargetTracker(SMALL)
    feed(tracker, [[[10.0 * k, 0]] for k in range(8)])
    assert tracker.tracks_at(8 * STEP_NS).id.size == 0


def test_scans_of_a_scanner_that_never_saw_a_track_do_not_count_against_it():
    for other, alive in (("radar", True), ("lidar", False)):
        tracker = MultiTargetTracker(SMALL)
        feed(tracker, [[[0, 0]]])
        for k in (1, 2):
            tracker.process(k * STEP_NS, [], source=other)
        tracks = tracker.tracks_at(2 * STEP_NS, confirmed=False)
        assert (tracks.id.size == 1) is alive


def test_parts_of_a_measured_target_start_nothing():
    tracker = MultiTargetTracker(SMALL)
    numbers = feed(tracker, [[[0, 0]], [[0, 0], [1.2, 0]], [[0, 0], [3, 0]]])
    assert numbers == [[0], [0, -1], [0, 1]]


def test_poses_put_tracks_into_the_world():
    tracker = MultiTargetTracker(SMALL)
    for k in range(6):
        stamp, x = k * STEP_NS, 0.4 * k
        scan = [Measurement(stamp, "pose", [x, 0.0, np.pi / 2]), *lidar(stamp, [[3.0, x]])]
        result = tracker.process(stamp, scan, source="lidar")
        assert result.id.tolist() == [-1, 0]
    np.testing.assert_allclose(tracker.tracks_at(stamp).position, [[0, 3]], atol=1e-6)


def test_measurements_that_cannot_be_used_have_no_track():
    tracker = MultiTargetTracker(SMALL)
    assert feed(tracker, [[[np.nan, 0], [1, 1]]]) == [[-1, 0]]


# Bad input


@pytest.mark.parametrize(
    ("stamp", "scan", "source", "error", "text"),
    [
        (0, [], "lidar", InputError, "the last one was of 1000000000 ns"),
        (2 * STEP_NS, lidar(STEP_NS, [[0, 0]]), "lidar", InputError, "the stamp of the scan"),
        (2 * STEP_NS, [3], "lidar", InputError, "Measurement"),
        (
            2 * STEP_NS,
            lidar(2 * STEP_NS, np.zeros((2001, 2))),
            "lidar",
            LimitError,
            "limit is 2000",
        ),
        (1.5, [], "lidar", InputError, "stamp"),
    ],
)
def test_a_bad_scan_is_refused_and_changes_nothing(stamp, scan, source, error, text):
    tracker, same = MultiTargetTracker(SMALL), MultiTargetTracker(SMALL)
    for each in (tracker, same):
        feed(each, [[[0, 0]], [[0.1, 0]], [[0.2, 0], [5, 5]]])
    with pytest.raises(error, match=text):
        tracker.process(stamp, scan, source=source)
    for each in (tracker, same):
        each.process(3 * STEP_NS, lidar(3 * STEP_NS, [[0.3, 0]]), source="lidar")
    one, other = (each.tracks_at(3 * STEP_NS, confirmed=False) for each in (tracker, same))
    np.testing.assert_array_equal(one.id, other.id)
    np.testing.assert_array_equal(one.states, other.states)


def test_too_many_scanners_are_refused():
    tracker = MultiTargetTracker(SMALL)
    for number in range(64):
        tracker.process(0, [], source=str(number))
    with pytest.raises(LimitError, match="at most 64 scanners, got one more: "):
        tracker.process(0, [], source="64")
    tracker.process(0, [], source="3")


def test_impossible_settings_are_refused():
    with pytest.raises(ConfigError, match="confirm_hits"):
        MultiTargetConfig(confirm_hits=4, confirm_window=3)
    with pytest.raises(ConfigError, match="MultiTargetConfig"):
        MultiTargetTracker(FusionConfig())


# Autoferry


def test_coverage_leaves_detection_gaps_out(tmp_path):
    places = [0.0, 1.0, 2.0, 10.0, 11.0]
    entries = [entry(1, time, [0.0, 0.0], own=(0, 0)) for time in places]
    truth = [standing(one, {1: 0.0}) for one in entries]
    scans = read_autoferry(scenario(tmp_path, entries, truth))
    tracker = MultiTargetTracker(
        MultiTargetConfig(association="nearest", confirm_hits=1, confirm_window=1)
    )
    tracks = []
    for scan in scans[:3]:
        tracker.process(scan.stamp_ns, scan.measurements, source=scan.source)
        tracks.append(tracker.tracks_at(scan.stamp_ns))
    empty = MultiTargetTracker().tracks_at(0)
    found = target_coverage(scans, [*tracks, empty, tracks[-1]], reach=1.0, gap=5.0)[1]
    assert found.n_scans == 5
    assert found.share == pytest.approx(4 / 5)
    assert (found.n_ids, found.n_switches) == (1, 0)
    assert found.rmse == pytest.approx(0, abs=1e-6)
    fewer = target_coverage(scans[:4], [*tracks, empty], reach=1.0, gap=5.0)[1]
    assert (fewer.n_scans, fewer.share) == (3, 1.0)
    distance = mean_gospa(scans, [*tracks, empty, tracks[-1]], cutoff=2.0)["distance"]
    assert distance == pytest.approx(np.sqrt(2) / 5, abs=1e-6)


def held(folder, scans, places_of):
    """Scans of two boats at x = 0 and 10 m, and tracks with these numbers and x of each scan."""
    entries = [entry(1, time, [[0.0, 0.0], [0.0, 10.0]], own=(0, 0)) for time in scans]
    truth = [standing(one, {1: 0.0, 2: 10.0}) for one in entries]
    read = read_autoferry(scenario(folder, entries, truth))
    tracks = []
    for scan, places in zip(read, places_of, strict=True):
        count = len(places)
        states = np.array([[x, 0.0, 0.0, 0.0] for _, x in places]).reshape(-1, 4)
        tracks.append(
            TargetTracks(
                scan.stamp_ns,
                np.array([number for number, _ in places], np.int64),
                states,
                np.zeros((count, 4, 4)),
                np.zeros((count, 2)),
                *np.zeros((3, count), np.int64),
                np.ones(count, bool),
                np.ones(count),
                np.zeros(count, np.uint8),
                np.full((count, 5), 0.2),
            )
        )
    return read, tracks


def test_a_track_between_two_boats_serves_one_of_them_only(tmp_path):
    scans, tracks = held(tmp_path, [0.0, 1.0, 2.0], [[(7, 4.0)]] * 3)
    found = target_coverage(scans, tracks, reach=15.0, gap=3.0)
    assert (found[1].share, found[1].rmse, found[1].n_ids) == (1.0, 4.0, 1)
    assert (found[2].share, found[2].n_ids) == (0.0, 0)
    assert np.isnan(found[2].rmse)


def test_two_tracks_serve_two_boats_also_where_one_is_nearer_to_both(tmp_path):
    # the track at 4 m is the nearest of both boats; boat 1 has the one at -9 m, so that both do
    scans, tracks = held(tmp_path, [0.0, 1.0], [[(7, 4.0), (8, -9.0)], [(7, 4.0)]])
    found = target_coverage(scans, tracks, reach=15.0, gap=3.0)
    assert (found[1].share, found[1].n_ids, found[1].n_switches) == (1.0, 2, 1)
    assert found[1].rmse == pytest.approx(np.sqrt((9**2 + 4**2) / 2))
    assert (found[2].share, found[2].rmse) == (0.5, 6.0)


def test_a_gap_is_three_seconds_without_a_detection_of_either_sensor(tmp_path):
    near, far = [[0.0, 14.0]], [[0.0, 16.0]]  # within 15 m, and beyond
    seen = [
        (1, 0.0, near),
        (2, 2.0, near),
        (1, 4.0, far),
        (2, 5.0, near),
        (1, 6.0, far),
        (1, 8.1, near),
        (2, 9.0, near),
    ]
    entries = [
        entry(
            sensor,
            time + DELAYS[SOURCES[sensor]],
            [list(place) for place in zip(*there, strict=True)],
            own=(0, 0),
        )
        for sensor, time, there in seen
    ]
    truth = [standing(one, {1: 0.0}) for one in entries]
    scans = read_autoferry(scenario(tmp_path, entries, truth))
    nothing = [MultiTargetTracker().tracks_at(0)] * len(scans)
    # 5.0 to 8.1 s is a gap: the scan at 6 s is out; 0 to 2 and 2 to 5 s, of both sensors, are none
    assert target_coverage(scans, nothing, reach=15.0, gap=3.0)[1].n_scans == 6
    assert target_coverage(scans, nothing, reach=15.0, gap=2.5)[1].n_scans == 4
    assert target_coverage(scans, nothing, reach=15.0, gap=3.2)[1].n_scans == 7


def test_gospa_of_an_empty_output_by_hand(tmp_path):
    scans, tracks = held(tmp_path, [0.0, 1.0], [[(7, 0.0), (8, 10.0)], [(7, 3.0)]])
    empty = empty_gospa(scans, cutoff=30.0)  # two missed: sqrt(2 * 30^2 / 2) = 30
    assert empty == {"distance": 30.0, "localisation": 0.0, "missed": 900.0, "false": 0.0}
    ours = mean_gospa(scans, tracks, cutoff=30.0)  # 0, and sqrt(3^2 + 450)
    assert ours["distance"] == pytest.approx(np.sqrt(459) / 2)


@pytest.mark.parametrize("association", ["integrated", "nearest", "joint"])
@pytest.mark.parametrize("number", SCENARIOS)
def test_boats_are_tracked(recordings, number, association):
    folder = recordings / "2d" / "autoferry" / f"scenario{number}"
    scans = read_autoferry(folder / f"scenario{number}_detections.json")
    config = MultiTargetConfig.boats().model_copy(update={"association": association})
    tracker, tracks = MultiTargetTracker(config), []
    for scan in scans:
        tracker.process(scan.stamp_ns, scan.measurements, source=scan.source)
        tracks.append(tracker.tracks_at(scan.stamp_ns))
    for target, item in target_coverage(scans, tracks, reach=15.0, gap=3.0).items():
        assert item.share >= SHARED.get((number, target), COVERED[association])
        assert item.share < 0.5 or (number, target) not in SHARED


@pytest.mark.ci_cases("integrated", "joint")
@pytest.mark.parametrize("association", ["integrated", "nearest", "joint"])
def test_fuse_tracks_many(recordings, tmp_path, association):
    path = recordings / "2d" / "autoferry" / "scenario13" / "scenario13_detections.json"
    folder = tmp_path / "run"
    arguments = [
        "fuse",
        str(path),
        "-o",
        str(folder),
        "--json",
        "-",
        "--model",
        "ct",
        "--association",
        association,
    ]
    out = CliRunner().invoke(app, arguments)
    assert out.exit_code == 0, out.output or out.exception
    result = json.loads(out.stdout)
    assert (result["model"], result["association"]) == ("ct", association)
    assert set(result["nis"]) == {"lidar", "radar"}
    assert all(0.5 < one["share_below_limit"] <= 1 for one in result["nis"].values())
    assert set(result["targets"]) == {"1", "2"}
    assert result["gospa"]["distance"] > 0
    # Two boats, but for the ends, where the place of one of them is not known.
    assert result["gospa_empty"]["distance"] == pytest.approx(30.0, abs=0.1)
    assert set(result["files"]) <= {file.name for file in folder.iterdir()}
    pytest.importorskip("pyarrow")
    scored = CliRunner().invoke(
        app,
        [
            "evaluate",
            str(folder),
            str(folder),
            "--gate",
            "15",
            "--max-distance",
            "500",
            "--json",
            "-",
        ],
    )
    scores = json.loads(scored.stdout)["track_scores"]
    assert scores["n_found"] > 0.5 * scores["n_eligible"]


def test_fuse_refuses_what_is_for_one_target(tmp_path):
    path = scenario(tmp_path, [entry()])
    for more in (["--lag", "1"], ["--mode", "paper"]):
        out = CliRunner().invoke(app, ["fuse", str(path), "-o", str(tmp_path / "run"), *more])
        assert isinstance(out.exception, ConfigError)
        assert "many targets" in str(out.exception)


def test_fuse_of_empty_scans_leaves_whole_files(tmp_path):
    path = scenario(tmp_path, [entry()])
    out = CliRunner().invoke(app, ["fuse", str(path), "-o", str(tmp_path / "run"), "--json", "-"])
    assert out.exit_code == 0, out.output or out.exception
    assert json.loads(out.stdout)["tracks"] == 0


@pytest.mark.parametrize("sources", ["ab", ["a", "a"], [1], [f"s{n}" for n in range(65)], {"a": 0}])
def test_a_state_with_other_scanners_is_refused(sources):
    tracker = MultiTargetTracker()
    core, _ = tracker._state()
    with pytest.raises(FormatError, match="sources: expected up to 64 different names"):
        MultiTargetTracker._from_state(tracker.config, core, {"sources": sources})


@pytest.mark.parametrize("association", ["nearest", "integrated"])
@pytest.mark.parametrize(("count", "spacing"), [(100, 20.0), (900, 20.0), (100, 0.1)])
def test_only_near_pairs_are_compared_and_each_track_is_predicted_once(count, spacing, association):
    """Targets that are far apart cost in proportion to their number; a crowd costs all pairs."""
    config = MultiTargetConfig(
        association=association, target=FusionConfig(model="cv", method="kf")
    )
    tracker = MultiTargetTracker(config)
    side = int(count**0.5)
    places = spacing * np.stack([np.arange(count) % side, np.arange(count) // side], axis=1)
    scans, looks = 5, 0
    for k in range(scans):
        looks += len(tracker.tracks_at(k * STEP_NS, confirmed=False).id)
        tracker.process(k * STEP_NS, lidar(k * STEP_NS, places), source="lidar")
    health = tracker.health()
    assert health.n_scans == scans
    assert health.n_predictions == looks
    if association == "nearest":
        assert looks == count * (scans - 1)
    if spacing > 1:
        assert looks <= 1.5 * count * (scans - 1)  # one more hypothesis for a scan, while divided
        assert looks <= health.n_pairs <= (1.5 if association == "nearest" else 3) * looks
    else:
        assert health.n_pairs > 10 * looks


# What is not reported: parts of long objects, and what stands


def reported(ways, config, *, seconds=20.0):
    """Numbers of the tracks reported at the end, of places (2,) over time [s], 2 scans a second."""
    tracker = MultiTargetTracker(config)
    for k in range(int(2 * seconds)):
        stamp = 500_000_000 * k
        seen = [Measurement(stamp, "lidar", way(0.5 * k), np.eye(2)) for way in ways]
        tracker.process(stamp, seen, source="lidar")
    return tracker.tracks_at(stamp), tracker.tracks_at(stamp, confirmed=False)


def sailing(x, y):
    return lambda t: [x + 2.0 * t, y]


@pytest.mark.parametrize("association", ["nearest", "integrated"])
@pytest.mark.parametrize(
    ("x", "y", "count"),
    [
        (24.0, 0.0, 1),  # the bow of the same ship
        (-24.0, 4.0, 1),  # its stern
        (0.0, 24.0, 2),  # a ship abreast
        (40.0, 0.0, 2),  # another one ahead
    ],
)
def test_ends_of_a_long_ship_are_one_track_and_ships_abreast_are_two(association, x, y, count):
    config = MultiTargetConfig.boats().model_copy(update={"association": association})
    told, held = reported([sailing(0.0, 0.0), sailing(x, y)], config)
    assert (len(told.id), len(held.id)) == (count, 2)


def test_what_goes_the_other_way_is_no_part():
    ways = [sailing(0.0, 0.0), lambda t: [66.0 - 2.0 * t, 3.0]]
    told, _ = reported(ways, MultiTargetConfig.boats())
    assert len(told.id) == 2


def test_a_track_that_stands_is_reported_once_it_moves():
    def starting(t):
        return [50.0 + max(0.0, 2.0 * (t - 20.0)), 0.0]

    config = MultiTargetConfig.boats()
    ways = [sailing(0.0, 30.0), starting]
    assert [len(one.id) for one in reported(ways, config)] == [1, 2]
    told, _ = reported(ways, config, seconds=26.0)
    assert len(told.id) == 2
    all_told, _ = reported(ways, config.model_copy(update={"report_speed": 0.0}))
    assert len(all_told.id) == 2


def test_ways_are_kept_with_the_state_of_a_tracker():
    config = MultiTargetConfig.boats()
    ways = [sailing(0.0, 0.0), sailing(24.0, 0.0), lambda t: [90.0, 40.0]]
    one, other = MultiTargetTracker(config), MultiTargetTracker(config)
    for k in range(60):
        stamp = 500_000_000 * k
        seen = [Measurement(stamp, "lidar", way(0.5 * k), np.eye(2)) for way in ways]
        if k == 23:
            other = MultiTargetTracker.from_bytes(other.to_bytes())
        for tracker in (one, other):
            tracker.process(stamp, seen, source="lidar")
        ids = [tracker.tracks_at(stamp).id.tolist() for tracker in (one, other)]
        assert ids[0] == ids[1]
    assert len(ids[0]) == 1


@pytest.mark.parametrize("association", ["nearest", "joint"])
@pytest.mark.parametrize(
    ("x", "y", "count"),
    [
        (0.0, 14.0, 2),  # a boat abreast
        (0.0, 10.5, 2),  # a near one
        (0.0, 8.0, 1),  # the side of the same ship
        (15.0, 0.0, 1),  # its bow
    ],
)
def test_a_boat_that_appears_abreast_gets_a_track_and_a_part_gets_none(association, x, y, count):
    config = MultiTargetConfig.boats().model_copy(update={"association": association})
    tracker = MultiTargetTracker(config)
    for k in range(40):
        stamp, own = 500_000_000 * k, np.array([1.0 * k, 0.0])
        places = [own, np.add(own, [x, y])] if k > 10 else [own]
        seen = [Measurement(stamp, "lidar", place, np.eye(2)) for place in places]
        tracker.process(stamp, seen, source="lidar")
    assert len(tracker.tracks_at(stamp, confirmed=False).id) == count
