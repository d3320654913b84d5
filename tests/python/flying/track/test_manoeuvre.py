"""Targets that turn harder than the motion model expects, and those that do not."""

import numpy as np
import pytest
from flying_scenes import feed, lidar, scans_of, yard

from lidar_core.flying import FlyingConfig, FlyingObjectDetector
from lidar_core.sim import Circle, Sphere, Target, Waypoints

FINE = lidar(rows=128, columns=1024)
PLACE = (6.0, 4.0, 3.0)
FREE = 20  # scans until a new target is surely a track


def flown(motion, process_noise):
    """Places of the target, and the flying tracks, of every scan."""
    config = FlyingConfig(tracker={"process_noise": process_noise})
    detector = FlyingObjectDetector(config)
    scene = yard(Target(shape=Sphere(radius=0.15), motion=motion), scans=60, lidar=FINE)
    scans = list(scans_of(scene))
    return [scan.truth.position[0] for scan in scans], [
        feed(detector, scan).tracks.flying for scan in scans
    ]


def errors_of(places, tracks):
    """Distance of the only flying track from the target; infinite where there is none."""
    return np.array(
        [
            np.linalg.norm(track.position[0] - place) if len(track) == 1 else np.inf
            for place, track in zip(places[FREE:], tracks[FREE:], strict=True)
        ]
    )


LATER = [pytest.param(*one, marks=pytest.mark.nightly) for one in [(0.7, 3.0), (0.8, 3.5)]]


@pytest.mark.nightly
@pytest.mark.parametrize(("radius", "speed"), [(0.6, 3.0), *LATER])
def test_a_target_on_a_tight_circle_is_followed(radius, speed):
    """At 13 to 15 m/s^2, where the process noise that is told stands for some 4."""
    motion = Circle(center=PLACE, radius=radius, speed=speed)
    places, tracks = flown(motion, "adaptive")
    errors = errors_of(places, tracks)
    assert len({number for track in tracks for number in track.id.tolist()}) == 1
    calm = errors_of(*flown(motion, "continuous"))
    assert np.isfinite([errors, calm]).all()
    assert np.median(errors) < 0.8 * np.median(calm)


@pytest.mark.nightly
def test_a_target_that_flies_straight_on_is_told_as_surely_as_before():
    motion = Waypoints(times=(0.0, 6.0), positions=((6.0, -4.0, 3.0), (6.0, 5.0, 3.0)))
    of = {noise: flown(motion, noise) for noise in ("adaptive", "continuous")}
    spreads = {
        noise: np.mean([np.trace(track.covariance[0, :3, :3]) for track in tracks[FREE:]])
        for noise, (_, tracks) in of.items()
    }
    assert spreads["adaptive"] <= 1.1 * spreads["continuous"]
    assert errors_of(*of["adaptive"]).max() <= 0.2
