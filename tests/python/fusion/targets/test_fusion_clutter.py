"""Clutter that stands, learnt by place, and the spread of what is measured of a target."""

import numpy as np
import pytest

from lidar_core.estimation import chi2_quantile
from lidar_core.fusion import FusionConfig, Measurement, MultiTargetConfig, MultiTargetTracker
from reference.fusion_clutter import reported_covariance
from reference.fusion_company import is_reported
from reference.fusion_many import JointTargets

ORACLE = 1e-9
GATE = 0.99
SMALL = MultiTargetConfig(
    association="joint",
    target=FusionConfig(
        model="cv", method="kf", lidar_std=(0.5, 0.4), acceleration_noise=0.7, gate_probability=GATE
    ),
    clutter=(1e-3, 1e-3),
    confirm_hits=2,
    confirm_window=3,
    max_position_std=8.0,
    birth_distance=1.5,
    report_speed=0.3,
)
BOATS = MultiTargetConfig.boats()
SECOND = 1_000_000_000


def lidar(stamp, places, std=None):
    noise = None if std is None else np.eye(2) * std**2
    return [Measurement(stamp, "lidar", place, noise) for place in places]


def posts(rng):
    """Returns of two posts 3 m apart, now from one and now from the other."""
    return np.array([[4.0 + 3.0 * (rng.random() < 0.4), 2.0]]) + rng.normal(0, 0.1, (1, 2))


@pytest.mark.parametrize("seed", [9000, 9001, 9002])
def test_the_tracker_agrees_with_the_oracle(seed):
    rng = np.random.default_rng(seed)
    tracker = MultiTargetTracker(SMALL)
    oracle = JointTargets(SMALL, gate=chi2_quantile(GATE, degrees=2))
    stamp, scores = 0, []
    for _ in range(60):
        stamp += int(rng.integers(2, 7)) * 100_000_000
        source = str(rng.choice(["left", "right"]))
        boat = np.array([[-20.0 + 1.2e-9 * stamp, 3.0]]) + rng.normal(0, 0.3, (1, 2))
        seen = np.vstack([posts(rng), boat[: int(rng.random() < 0.85)]])
        got = tracker.process(stamp, lidar(stamp, seen), source=source)
        assert got.id.tolist() == oracle.process(stamp, seen, source)
        tracks = tracker.tracks_at(stamp, confirmed=False)
        assert tracks.id.tolist() == [track["id"] for track in oracle.tracks]
        assert tracks.confirmed.tolist() == [is_reported(track) for track in oracle.tracks]
        for row, track in enumerate(oracle.tracks):
            scores.append(track.get("credible", True))
            np.testing.assert_allclose(tracks.states[row], track["mean"], atol=ORACLE)
            covariance = reported_covariance(track)
            np.testing.assert_allclose(tracks.covariances[row], covariance, atol=ORACLE)
    assert 0 < np.count_nonzero(scores) < len(scores)  # of both kinds


def reported(config, scans, *, std=3.0, restart=None):
    """Reported tracks after each scan of places, two a second; with a saved state on the way."""
    tracker, told = MultiTargetTracker(config), []
    for k, places in enumerate(scans):
        stamp = k * SECOND // 2
        tracker.process(stamp, lidar(stamp, places, std), source="lidar")
        if k == restart:
            tracker = MultiTargetTracker.from_bytes(tracker.to_bytes())
        told.append(tracker.tracks_at(stamp))
    return told


def jetty(rng):
    """Of a jetty of 16 m one end or the other returns."""
    return np.array([-345.0 + 16.0 * (rng.random() < 0.5), -259.0]) + rng.normal(0, 1, 2)


def near(tracks, place, reach=10.0):
    away = np.linalg.norm(tracks.position - place, axis=1)
    return tracks.id[away < reach].tolist()


def test_a_jetty_is_clutter_and_a_boat_that_passes_it_is_none():
    """Returns that jump along the jetty give its track a speed."""
    rng = np.random.default_rng(9100)
    boat = [np.array([-400.0 + 2.0 * (k / 2 - 40), -250.0]) for k in range(240)]
    scans = [
        [jetty(rng), *([place + rng.normal(0, 1, 2)] if k > 80 else [])]
        for k, place in enumerate(boat)
    ]
    told = reported(BOATS, scans, restart=70)
    of_jetty = [k for k, one in enumerate(told) if k < 80 and len(one.id)]
    assert not [k for k in of_jetty if k > 50]  # 25 s
    numbers = {number for k in range(95, 240) for number in near(told[k], boat[k])}
    assert len(numbers) == 1
    assert all(len(one.id) == 1 for one in told[95:])


@pytest.mark.nightly
@pytest.mark.parametrize("others", [0, 240])
def test_posts_are_clutter_however_much_else_the_scanner_sees(others):
    """Returns that jump between two posts give their track a speed; only their place tells."""
    rng = np.random.default_rng(9150)
    far = np.c_[np.full(others, 500.0), 3.0 * np.arange(others)]
    scans = [np.vstack([posts(rng), far]) for _ in range(160)]
    shares = []
    for speed in (SMALL.report_speed, 0.0):
        told = reported(SMALL.model_copy(update={"report_speed": speed}), scans, std=0.4)
        shares.append(np.mean([len(near(one, [5.5, 2.0], reach=5.0)) > 0 for one in told[80:]]))
    assert shares[0] < 0.1 < 0.5 < shares[1]


@pytest.mark.parametrize(("length", "speed"), [(36.0, 2.0), (18.0, 1.0)])
def test_a_ship_is_no_clutter_though_its_own_measurements_are_near(length, speed):
    """The opposite: its returns, anywhere on it, cover a place for 18 s."""
    middle = [np.array([0.5 * speed * k, 50.0]) for k in range(160)]
    shares = []
    for seed in range(9200, 9210):
        rng = np.random.default_rng(seed)
        ends = [np.array([x + length * rng.uniform(-0.5, 0.5), y]) for x, y in middle]
        told = reported(BOATS, [[rng.normal(place, [1e-9, 1.0])] for place in ends])
        found = [len(near(*pair, reach=18.0)) > 0 for pair in zip(told, middle, strict=True)]
        shares.append(np.mean(found))
    assert np.mean(shares) > 0.94
    assert np.min(shares) > 0.8


@pytest.mark.parametrize(("speed", "count"), [(0.0, 1), (1.0, 14)])
def test_what_stood_before_its_track_was_confirmed_is_hardly_reported(speed, count):
    """Scans every 2 s: a track is confirmed after 6 s. The opposite: a slow boat."""
    rng = np.random.default_rng(9250)
    tracker, told = MultiTargetTracker(BOATS), []
    for k in range(17):
        stamp = 2 * k * SECOND
        place = np.array([2.0 * speed * k, 50.0]) + rng.normal(0, 0.5, 2)
        tracker.process(stamp, lidar(stamp, [place]), source="lidar")
        told.append(len(tracker.tracks_at(stamp).id))
    assert sum(told) == count


def test_where_targets_may_stand_nothing_is_clutter_for_long_standing():
    rng = np.random.default_rng(9300)
    scans = [[rng.normal([20.0, 5.0], 1.0)] for _ in range(120)]
    config = BOATS.model_copy(update={"report_speed": 0.0})
    assert all(len(one.id) == 1 for one in reported(config, scans)[10:])


def test_the_place_of_a_long_target_is_uncertain_along_its_length():
    """Returns come from bow and stern in turn, for 10 s each; the antenna is amidships."""
    rng = np.random.default_rng(9400)
    middle = [np.array([2.0 * k / 2, 0.0]) for k in range(200)]
    ends = [9.0 if k // 20 % 2 else -9.0 for k in range(200)]
    scans = [
        [rng.normal([place[0] + end, place[1]], 1.0)]
        for place, end in zip(middle, ends, strict=True)
    ]
    points = BOATS.model_copy(update={"birth_distance": 0.0})
    inside = {"ship": [], "point": []}
    for name, config in (("ship", BOATS), ("point", points)):
        for one, place in zip(reported(config, scans)[60:], middle[60:], strict=True):
            error, spread = one.position[0] - place, one.covariances[0, :2, :2]
            inside[name].append(error @ np.linalg.solve(spread, error) < 5.99)
    assert np.mean(inside["ship"]) > 0.9 > 0.5 > np.mean(inside["point"])
    last = reported(BOATS, scans)[-1].covariances[0]
    assert last[0, 0] > 2.5 * last[1, 1]


def test_the_middle_of_a_ship_is_half_a_width_from_the_side_that_returns():
    rng = np.random.default_rng(9450)
    middle = [np.array([2.0 * k / 2, 0.0]) for k in range(200)]
    places = [rng.normal([x + rng.uniform(-12, 12), y - 3.0], 0.5) for x, y in middle]
    inside = []
    told = reported(BOATS, [[place] for place in places], std=1.0)
    for one, place in zip(told[60:], middle[60:], strict=True):
        error, spread = one.position[0] - place, one.covariances[0, :2, :2]
        inside.append(error @ np.linalg.solve(spread, error) < 5.99)
    assert 0.9 < np.mean(inside) <= 1.0


@pytest.mark.parametrize(("away", "is_of_it"), [((8.0, 0.0), True), ((0.0, 8.0), False)])
def test_what_lies_abeam_of_a_boat_is_not_its_body(away, is_of_it):
    """What lies ahead is: objects are long rather than wide."""
    rng = np.random.default_rng(9460)
    middle = [np.array([2.0 * k / 2, 0.0]) for k in range(120)]
    scans = [[rng.normal(place, 0.3), rng.normal(place + away, 0.3)] for place in middle]
    alone = reported(BOATS, [one[:1] for one in scans], std=1.0)[-1]
    last = reported(BOATS, scans, std=1.0)[-1]
    assert len(last.id) == len(alone.id) == 1
    more = np.trace((last.covariances - alone.covariances)[0, :2, :2])
    assert (more > 8.0) if is_of_it else (more < 0.5)


def test_a_small_target_stays_as_certain_as_it_is():
    rng = np.random.default_rng(9500)
    scans = [[np.array([2.0 * k / 2, 0.0]) + rng.normal(0, 0.3, 2)] for k in range(100)]
    points = BOATS.model_copy(update={"birth_distance": 0.0})
    last, point = (reported(config, scans)[-1].covariances[0] for config in (BOATS, points))
    assert np.all(np.diag(last - point)[:2] < 0.15)
    np.testing.assert_array_equal(last[2:], point[2:])


def test_clutter_everywhere_is_learnt_and_hides_no_boat():
    """Five false returns per scan where the configuration expects one in 100,000 m^2."""
    boat = [np.array([-150.0 + 1.5 * k, 40.0]) for k in range(200)]
    n_false = []
    for seed in range(9200, 9208):
        rng = np.random.default_rng(seed)
        scans = [
            [place + rng.normal(0, 1, 2), *rng.uniform(-150, 150, (rng.poisson(5), 2))]
            for place in boat
        ]
        told = reported(BOATS, scans, restart=70)[20:]
        of_boat = [near(one, place) for one, place in zip(told, boat[20:], strict=True)]
        assert np.mean([bool(ids) for ids in of_boat]) > 0.97
        assert len({ids[0] for ids in of_boat if ids}) == 1
        n_false += [len(one.id) - len(ids[:1]) for one, ids in zip(told, of_boat, strict=True)]
    assert np.mean(n_false) < 0.4  # 0.8 with the density of the configuration
