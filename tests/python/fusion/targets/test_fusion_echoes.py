"""Echoes of a radar that came back twice are no targets, and other boats are no echoes."""

import numpy as np
import pytest

from lidar_core.errors import InputError
from lidar_core.fusion import Measurement, MultiTargetConfig, MultiTargetTracker
from reference.fusion_echo import Echoes

SECOND = 1_000_000_000
BOATS = MultiTargetConfig.boats()
SHOWN, HIDDEN, TELLS_LATE = 0.95, 0.4, 0.8
"""Shares of the scans from the 14th on in which boats are reported at least, and echoes at most."""


def measured(stamp, places, radar, *, std=5.0):
    """Positions that a radar there has told."""
    cov = np.eye(2) * std**2
    return [Measurement(stamp, "lidar", place, cov, seen_from=radar) for place in places]


def polar(radar, bearing_deg, far):
    angle = np.radians(bearing_deg)
    return radar + far * np.array([np.cos(angle), np.sin(angle)])


def boat(t):
    """Passes at some 130 m, from 60 to 120 degrees, at 3 m/s."""
    return np.array([75.0 - 2.5 * t, 130.0 - 0.5 * t])


def echo_of(radar, place, *, detour, offset_deg=2.0):
    away = place - radar
    bearing = np.arctan2(away[1], away[0]) + np.radians(offset_deg)
    far = 2.0 * np.hypot(*away) + detour
    return radar + far * np.array([np.cos(bearing), np.sin(bearing)])


def run(
    seed,
    other,
    *,
    lidar=False,
    with_radar=True,
    scans=36,
    period=1.7,
    beside_it=None,
    config=BOATS,
    nearer=None,
):
    """Shares of the scans in which something is reported near the boat and the other."""
    rng = np.random.default_rng(seed)
    tracker, plain = MultiTargetTracker(config), MultiTargetTracker(config)
    oracle = Echoes(stands=config.report_speed == 0.0)
    near = []
    for k in range(scans):
        t = period * k
        stamp, radar = round(t * SECOND), np.array([0.1 * t, -0.05 * t])
        true = [(nearer or boat)(t), other(t, radar)]
        seen = [place + rng.normal(0, 4.0, 2) for place in true if rng.random() < 0.9]
        scan = measured(stamp, seen, radar if with_radar else None)
        tracker.process(stamp, scan, source="radar")
        plain.process(stamp, measured(stamp, seen, None), source="radar")
        if beside_it is not None:
            beside_it(tracker, stamp)
            beside_it(plain, stamp)
        if lidar and k % 4 == 3:
            again = [
                Measurement(stamp + 1, "lidar", true[1] + rng.normal(0, 1, 2), np.eye(2) * 9.0)
            ]
            for one in (tracker, plain):
                one.process(stamp + 1, again, source="lidar")
        if k == 20:
            tracker = MultiTargetTracker.from_bytes(tracker.to_bytes())
        told, all_told = tracker.tracks_at(stamp), plain.tracks_at(stamp)
        if with_radar and not lidar:  # the oracle: what the other tracker reports, without echoes
            rows = zip(
                all_told.id.tolist(), all_told.position, all_told.seen_ns.tolist(), strict=True
            )
            echoes = oracle.echoes(stamp, list(rows), radar)
            assert told.id.tolist() == [n for n in all_told.id.tolist() if n not in echoes], k
        away = np.linalg.norm(told.position[:, None] - np.array(true)[None], axis=-1)
        near.append((away < 25.0).any(axis=0) if len(told.id) else [False, False])
    return np.mean(near[14:], axis=0)


@pytest.mark.parametrize("seed", range(1000, 1012))
@pytest.mark.parametrize("detour", [0.0, 40.0, 120.0])
def test_an_echo_is_not_reported_and_its_boat_is(seed, detour):
    def echo(t, radar):
        return echo_of(radar, boat(t), detour=detour)

    of_boat, of_echo = run(seed, echo)
    assert of_boat >= SHOWN
    assert of_echo <= HIDDEN


def passing(t, _):
    """Another boat behind, the other way."""
    return np.array([-60.0 + 3.0 * t, 290.0])


def abreast(t, _):
    """Goes the same way as the boat, at the same speed, at 2.3 times its range."""
    return boat(t) + np.array([0.0, 170.0])


def in_line(t, radar):
    """Goes along in the line of sight, 150 m behind, and falls back."""
    away = boat(t) - radar
    return radar + away * (1.0 + (150.0 + 1.5 * t) / np.hypot(*away))


def beside(t, radar):
    """At twice the range, and 30 degrees beside."""
    return echo_of(radar, boat(t), detour=0.0, offset_deg=30.0)


@pytest.mark.parametrize("seed", range(1000, 1012))
@pytest.mark.parametrize("other", [passing, abreast, in_line, beside])
def test_other_boats_are_reported(seed, other):
    """The opposite error: what is behind another boat now and then, or near its line of sight."""
    of_boat, of_other = run(seed, other)
    assert of_boat >= SHOWN
    assert of_other >= (TELLS_LATE if other is in_line else SHOWN)


@pytest.mark.parametrize("seed", range(1000, 1006))
@pytest.mark.parametrize("far", [300.0, 360.0])
def test_what_rests_in_line_is_reported_where_what_stands_counts(seed, far):
    """Two things at rest, one behind the other, tell nothing of an echo."""
    standing = BOATS.model_copy(update={"report_speed": 0.0})
    anchored = np.array([20.0, 150.0])
    ahead = run(
        seed,
        lambda t, radar: anchored * far / 150.0,
        config=standing,
        nearer=lambda t: anchored,
    )
    assert (ahead >= TELLS_LATE).all()


def test_what_another_scanner_measures_is_no_echo_and_without_a_place_there_are_none():
    def echo(t, radar):
        return echo_of(radar, boat(t), detour=40.0)

    assert run(1000, echo, lidar=True)[1] >= SHOWN
    assert run(1000, echo, with_radar=False)[1] >= SHOWN


def test_only_a_measurement_by_another_scanner_makes_an_echo_a_target():
    """Not a scan of the same time that measures nothing or something else, nor a lost place."""

    def echo(t, radar):
        return echo_of(radar, boat(t), detour=40.0)

    def empty(tracker, stamp):
        tracker.process(stamp, [], source="lidar")

    def elsewhere(tracker, stamp):
        far = Measurement(stamp, "lidar", [-400.0, -300.0], np.eye(2))
        tracker.process(stamp, [far], source="lidar")

    def two_places(tracker, stamp):
        scan = measured(stamp, [[-400.0, -300.0]], [0.0, 0.0])
        tracker.process(stamp, scan + measured(stamp, [[-400.0, 300.0]], None), source="other")

    for beside_it in (empty, elsewhere, two_places):
        assert run(1001, echo, beside_it=beside_it)[1] <= HIDDEN


def test_the_place_of_a_radar_is_checked_and_kept():
    m = Measurement(0, "lidar", [1.0, 2.0], seen_from=[3.0, 4.0])
    assert m.with_values([5.0, 6.0]).seen_from.tolist() == [3.0, 4.0]
    assert repr(m) == "Measurement(0, 'lidar', [1.0, 2.0], seen_from=[3.0, 4.0])"
    assert Measurement(0, "lidar", [1.0, 2.0]).seen_from is None
    for sensor, values, place in (
        ("lidar", [1.0, 2.0], [3.0]),
        ("lidar", [1.0, 2.0], [np.nan, 0.0]),
        ("radar", [1.0, 0.0, 0.0], [3.0, 4.0]),
    ):
        with pytest.raises(InputError, match="seen_from"):
            Measurement(0, sensor, values, seen_from=place)


def near_boat(t):
    """Passes at 35 m."""
    return np.array([25.0 - 0.8 * t, 35.0])


@pytest.mark.parametrize("seed", range(1000, 1006))
def test_a_near_boat_takes_a_large_angle(seed):
    """Another part of it reflects: the bearing of its echo drifts by 16 degrees, or 10 m."""

    def echo(t, radar):
        return echo_of(radar, near_boat(t), detour=120.0, offset_deg=16.0 * np.sin(0.05 * t))

    _, of_echo = run(seed, echo, nearer=near_boat)
    assert of_echo <= HIDDEN


@pytest.mark.parametrize("seed", range(1000, 1006))
def test_a_boat_that_crosses_behind_a_near_one_is_reported(seed):
    """The opposite error."""
    _, of_other = run(seed, lambda t, _: np.array([-60.0 + 3.0 * t, 190.0]), nearer=near_boat)
    assert of_other >= SHOWN
