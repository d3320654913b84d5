"""Scanners whose measurements are later than their stamps say."""

import numpy as np
import pytest

from lidar_core.fusion import Measurement, MultiTargetConfig, MultiTargetTracker
from reference.fusion_delay import followed

STD = {"lidar": 0.3, "radar": 1.0}
TARGET = {
    "model": "cv",
    "acceleration_noise": 0.5,
    "start_rows": 1,
    "initial_position": 2.0,
    "initial_speed": 6.0,
    "gate_probability": 0.99999,
}
CONFIG = MultiTargetConfig.load(
    {"association": "nearest", "target": TARGET, "confirm_hits": 3, "confirm_window": 5}
)


def scans(seed, late, count=240, speed=4.0):
    """(time [s], source, place) of one target on a wide curve, and its true places."""
    rng = np.random.default_rng(seed)
    made, truth = [], []

    def at(t):
        return np.array([40 * np.sin(speed * t / 40), 40 * np.cos(speed * t / 40) - 90])

    for k in range(count):
        source, t = ("radar" if k % 3 == 1 else "lidar"), 0.25 * k
        place = at(t - late[source]) + STD[source] * rng.normal(size=2)
        made.append((t, source, place))
        truth.append(at(t))
    return made, np.array(truth)


def tracked(made, config=CONFIG):
    """Reported places (NaN before), number of tracks, and the delays at the end."""
    tracker, places, ids = MultiTargetTracker(config), [], set()
    for t, source, place in made:
        stamp, R = round(t * 1e9), np.eye(2) * STD[source] ** 2
        tracker.process(stamp, [Measurement(stamp, "lidar", place, R)], source=source)
        state = tracker.tracks_at(stamp)
        places.append(state.position[0] if len(state.id) else np.full(2, np.nan))
        ids |= set(state.id.tolist())
    return np.array(places), len(ids), tracker


@pytest.mark.parametrize("config", [CONFIG, MultiTargetConfig()])
@pytest.mark.parametrize("seed", range(3))
def test_a_late_radar_is_found_and_no_longer_drags_the_track_behind(seed, config):
    made, truth = scans(seed, {"lidar": 0.0, "radar": 1.5})
    places, count, tracker = tracked(made, config)
    delays = tracker.health().delays_s
    assert count == 1
    assert delays["lidar"] == 0.0
    assert delays["radar"] == pytest.approx(1.5, abs=0.2)
    found = np.sqrt(np.square(places - truth)[120:].sum(axis=1).mean())
    in_time, _ = scans(seed, {"lidar": 0.0, "radar": 0.0})
    least, _, _ = tracked(in_time, config)
    possible = np.sqrt(np.square(least - truth)[120:].sum(axis=1).mean())
    assert found < 1.3 * possible


@pytest.mark.parametrize("seed", range(3))
def test_scanners_in_time_have_no_delay(seed):
    made, _ = scans(seed, {"lidar": 0.0, "radar": 0.0})
    delays = tracked(made)[2].health().delays_s
    assert max(delays.values()) < 0.15


def test_what_stands_and_what_one_scanner_sees_say_nothing():
    made, _ = scans(0, {"lidar": 0.0, "radar": 1.5}, speed=0.0)
    assert max(tracked(made)[2].health().delays_s.values()) < 0.5
    alone, _ = scans(0, {"lidar": 1.5, "radar": 1.5})
    alone = [one for one in alone if one[1] == "lidar"]
    assert tracked(alone)[2].health().delays_s == {"lidar": 0.0}


@pytest.mark.parametrize("seed", range(3))
def test_states_and_delays_are_those_of_the_oracle(seed):
    made, _ = scans(seed, {"lidar": 0.0, "radar": 0.8}, count=60)
    tracker, states = MultiTargetTracker(CONFIG), []
    for t, source, place in made:
        stamp, R = round(t * 1e9), np.eye(2) * STD[source] ** 2
        tracker.process(stamp, [Measurement(stamp, "lidar", place, R)], source=source)
        states.append(tracker.tracks_at(stamp, confirmed=False).states[0])
    expected, delays = followed(
        made, STD, density=0.5, position=2.0, speed=6.0, hits=CONFIG.confirm_hits
    )
    np.testing.assert_allclose(states, expected, rtol=1e-6, atol=1e-6)
    assert tracker.health().delays_s == pytest.approx(delays, abs=1e-6)


def test_delays_survive_saving_and_late_scans():
    made, _ = scans(4, {"lidar": 0.0, "radar": 1.5}, count=60)
    tracker = tracked(made)[2]
    again = MultiTargetTracker.from_bytes(tracker.to_bytes())
    assert again.health().delays_s == tracker.health().delays_s
    swapped = [*made[:40], made[41], made[40], *made[42:]]
    assert tracked(swapped)[2].health().delays_s == tracker.health().delays_s
