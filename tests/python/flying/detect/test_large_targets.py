"""Large targets: found from the first scan on and after they have hovered; what stands is not."""

from functools import cache

import numpy as np
import pytest
from flying_scenes import feed, lidar, scans_of, yard

from lidar_core import sim
from lidar_core.flying import FlyingObjectDetector
from lidar_core.reproduce.flying.situations.shapes import octocopter
from lidar_core.sim import Target, Waypoints

OCTOCOPTER = octocopter(1.5)
CRATE = sim.Box(size=(1.4, 1.4, 0.8))


@cache
def flown(shape, ways, times, sensor=(48, 30.0)):
    """Of every scan: distance of the nearest flying track, place [m]; flying tracks elsewhere."""
    motion = Waypoints(times=times, positions=ways)
    rows, half_deg = sensor
    sensor = lidar(rows, 240, half_deg=half_deg)
    scene = yard(Target(shape=shape, motion=motion), scans=36, lidar=sensor)
    detector, away, places, others = FlyingObjectDetector(), [], [], 0
    for one in scans_of(scene):
        tracks = feed(detector, one).tracks.flying
        place = one.truth.position.reshape(-1, 3)[0]
        distance = np.linalg.norm(tracks.position - place, axis=1)
        away.append(distance.min(initial=np.inf))
        others += int((distance > 1.0).sum())
        places.append(place)
    return np.array(away), np.array(places), others


def test_a_large_target_is_found_whether_it_flies_or_hovers_at_first():
    flies = ((6.0, -3.0, 4.0), (6.0, 5.0, 4.0))
    away, _, others = flown(OCTOCOPTER, flies, (0.0, 4.0))
    assert (away[16:] < 0.3).mean() >= 0.95
    assert others == 0
    # It has moved by its own size by then, and nothing of it was seen to fly before.
    away, places, others = flown(OCTOCOPTER, (flies[0], *flies), (0.0, 1.5, 3.5))
    moved = np.linalg.norm(places - places[0], axis=1)
    assert (away[moved >= 2.5] < 0.3).mean() >= 0.9
    assert np.isinf(away[:15]).all()  # in scan 15 it begins to move
    assert others == 0


def test_a_crate_that_is_dragged_along_the_lower_edge_of_the_view_does_not_fly():
    start, end = (6.0, -3.0, 0.41), (6.0, 5.0, 0.41)
    away, _, others = flown(CRATE, (start, start, end), (0.0, 1.5, 3.5), sensor=(40, 22.0))
    assert np.isinf(away).all()
    assert others == 0


@pytest.mark.parametrize("height", [4.0, 0.41])
def test_a_large_thing_that_hangs_or_is_dragged_along_the_ground_does_not_fly(height):
    start, end = (6.0, -3.0, height), (6.0, 5.0, height)
    end = start if height > 1.0 else end
    away, _, others = flown(CRATE, (start, start, end), (0.0, 1.5, 3.5))
    assert np.isinf(away).all()
    assert others == 0
