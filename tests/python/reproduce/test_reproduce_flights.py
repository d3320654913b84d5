"""What the simulated flights of `lidar-core reproduce` promise: ways, truth, closed loops."""

import numpy as np
import pytest

from lidar_core import TrackKind, evaluation, sim
from lidar_core.flying import Tracks
from lidar_core.reproduce.common import GATE, evaluation_config
from lidar_core.reproduce.flying import fig8
from lidar_core.reproduce.flying.simulated import street
from lidar_core.reproduce.flying.simulated.flights import tables, truth_columns
from lidar_core.reproduce.flying.simulated.pursuit import (
    ATTACK_TO,
    FOLLOW_DISTANCE,
    Interceptor,
    Quarry,
    follow,
)
from lidar_core.reproduce.flying.simulated.sightings import sightings


def test_a_walk_through_the_ways_keeps_speeds_accelerations_ranges_and_distances():
    ranges = []
    for number, way in enumerate(street.WAYS):
        scene = street.scene(1000, number, 100, is_noisy=False)
        places = []
        for target in scene.targets:
            times, matrices = target.motion.knots(10.0)
            place = matrices[:, :3, 3]
            velocity = np.diff(place, axis=0) / np.diff(times)[:, None]
            change = np.diff(velocity, axis=0) / 0.01
            assert np.linalg.norm(velocity, axis=1).max() <= way.speed * 1.001
            assert np.linalg.norm(change, axis=1).max() <= way.acceleration * 1.01 + 1e-3
            places.append(place)
        places = np.array(places)
        for one, other in np.array(np.triu_indices(4, 1)).T:
            apart = np.linalg.norm(places[one] - places[other], axis=1)
            assert apart.min() > GATE + 2 * street.RADII[1]
        ranges.append(np.linalg.norm(places[..., :2], axis=-1).ravel())
    ranges = np.concatenate(ranges)
    share, _ = np.histogram(ranges, np.linspace(5, 20, 6))
    assert ((ranges > 4.4) & (ranges < 20.6)).all()
    assert share.min() > 0.1 * len(ranges)


def test_flights_differ_and_repeat():
    first = street.scene(0, 0, 10, is_noisy=False)
    assert first == street.scene(0, 0, 10, is_noisy=False)
    assert first.targets != street.scene(1, 0, 10, is_noisy=False).targets
    noisy = street.scene(0, 0, 10, is_noisy=True)
    assert noisy.targets == first.targets
    assert first.lidar.snapshot
    assert (first.lidar.range_std, noisy.lidar.range_std) == (0.0, 0.03)


def part_of(speed):
    """Truth of a drone that passes a sensor, with one detection and one track per scan."""
    motion = sim.Shuttle(start=(6, -8, 0), end=(6, 8, 0), speed=speed, acceleration=1e3, lead=0.2)
    scene = sim.Scene(
        targets=(sim.Target(shape=sim.Sphere(radius=0.5), motion=motion),),
        lidar=sim.LidarModel.preset("os1-128", ideal=True),
        sensor=sim.Hover(position=(0, 0, 0)),
        scans=12,
    )
    simulator = sim.Simulator(scene, seed=0)
    made = list(simulator)
    part = truth_columns(simulator, made)
    number = np.arange(12)
    part |= {
        "best_detections_scan": number,
        "best_tracks_scan": number,
        "best_tracks_id": np.zeros(12, np.int64),
    }
    centres = [one.scan.points.reshape(-1, 3)[one.label == 0].mean(axis=0) for one in made]
    part["best_detections_position"] = np.array(centres, float)
    part["best_tracks_position"] = part["position"][:, 0] + (0.3, 0, 0)
    return part


def test_detections_are_held_against_where_the_rays_met_the_drone():
    part = part_of(speed=10.0)
    config = evaluation.EvaluationConfig(burn_in_scans=2)
    seen = sightings([part], "best", "detections", target=0, config=config)
    assert seen.scan.tolist() == list(range(2, 12))
    late = np.linalg.norm(part["position_hit"] - part["position"], axis=-1)
    assert late.max() > 0.2  # the start of the scan is no time to compare with
    assert (np.abs(seen.along + 0.33) < 0.12).all()  # its near side, 2/3 of the radius
    assert seen.error.max() < 0.45
    np.testing.assert_allclose(seen.speed, 10.0, rtol=1e-6)


def test_tracks_are_held_against_the_start_of_the_scan():
    part = part_of(speed=5.0)
    config = evaluation.EvaluationConfig()
    seen = sightings([part], "best", "tracks", target=0, config=config)
    np.testing.assert_allclose(seen.error, 0.3, atol=1e-9)
    estimates, truth = tables(part, "best", "tracks", config=config)
    assert (truth.position == part["position"][:, 0]).all()
    assert estimates.id is not None
    part["best_tracks_position"] = part["best_tracks_position"] + (5.0, 0, 0)
    missed = sightings([part], "best", "tracks", target=0, config=config)
    assert not missed.is_found.any()


# Closed loops


def tracks(ids, places):
    places = np.reshape(np.array(places, float), (-1, 3))
    count = len(ids)
    return Tracks(
        id=np.array(ids, np.int64),
        position=places,
        velocity=0.1 * places,
        acceleration=0 * places,
        covariance=np.zeros((count, 9, 9)),
        extent=0 * places,
        n_detections=np.ones(count, np.int64),
        age=np.ones(count),
        existence=np.ones(count),
        kind=np.full(count, TrackKind.FLYING, np.uint8),
        kind_probability=np.full((count, 5), 0.2),
        stamp_ns=0,
    )


def test_one_track_is_followed_as_long_as_it_lives():
    quarry, here = Quarry(), np.zeros(3)
    assert quarry.choose(tracks([], []), here) is None
    assert quarry.choose(tracks([3, 4], [[9, 0, 0], [5, 0, 0]]), here)[0].tolist() == [5, 0, 0]
    assert quarry.choose(tracks([3, 4], [[1, 0, 0], [6, 0, 0]]), here)[0].tolist() == [6, 0, 0]
    place, velocity = quarry.choose(tracks([3, 7], [[1, 0, 0], [7, 0, 0]]), here)
    assert place.tolist() == [7, 0, 0]  # the nearest to where the other one ended
    np.testing.assert_allclose(velocity, [0.7, 0, 0])


def test_the_follower_keeps_its_distance_and_stays_without_a_target():
    here = np.array([1.0, 2.0, 3.0])
    assert (follow(here, None) == here).all()
    target = np.array([20.0, 2.0, 5.0])
    goal = follow(here, target)
    assert np.linalg.norm((goal - target)[:2]) == pytest.approx(FOLLOW_DISTANCE)
    assert goal[2] == target[2]
    assert goal[0] < target[0]
    assert np.isfinite(follow(target, target)).all()


def test_the_interceptor_attacks_turns_away_and_attacks_again():
    guide, target = Interceptor(), np.zeros(3)
    assert (guide(np.array([9.0, 0, 0]), target) == target).all()
    drawn_back = guide(np.array([ATTACK_TO - 0.1, 0, 0]), target)
    assert np.linalg.norm(drawn_back) > 10
    assert np.linalg.norm(guide(np.array([6.0, 0, 0]), target)) > 10
    assert (guide(np.array([11.5, 0, 0]), target) == target).all()
    here = np.array([5.0, 0, 0])
    assert (guide(here, None) == here).all()


@pytest.mark.nightly
def test_the_follower_of_a_short_flight_finds_its_target():
    part = fig8.flight(kind="following", mode="best", seed=1000, number=0, scans=45)
    sensor = part["sensor"]
    assert (sensor[:12] == fig8.START).all()
    assert np.linalg.norm(sensor[-1] - sensor[0]) > 2
    seen = sightings([part], "best", "tracks", target=0, config=evaluation_config())
    assert seen.is_found[-10:].all()
    assert seen.error[-10:].max() < 1.0
