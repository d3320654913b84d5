"""Targets in recorded scans: rays end where they must, everything else stays as it was."""

from dataclasses import replace

import numpy as np
import pytest

from lidar_core import InputError
from lidar_core.messages import Scan
from lidar_core.sim import InsertedFlight, insert_target, with_target

RADIUS = 0.5
CENTRE = np.array([6.0, 0.0, 0.0])
SURFACE_ERROR = 1e-5
"""Float32 coordinates at 10 m [m]."""


def fan(rows=40, columns=360, half_deg=25.0):
    elevation, azimuth = np.meshgrid(
        np.deg2rad(np.linspace(half_deg, -half_deg, rows)),
        np.linspace(-np.pi, np.pi, columns, endpoint=False),
        indexing="ij",
    )
    flat = np.cos(elevation)
    directions = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], -1)
    return directions.reshape(-1, 3).astype(np.float32)


@pytest.fixture
def scan():
    """A round wall 15 m away; open sky above 10 degrees; a row without information."""
    directions = fan()
    points = (15.0 * directions).astype(np.float32)
    no_return = directions[:, 2] > np.sin(np.deg2rad(10))
    points[no_return] = np.nan
    points[20 * 360 : 21 * 360] = np.nan
    return Scan(
        stamp_ns=1_000_000_000,
        points=points.reshape(40, 360, 3),
        no_return=no_return,
        directions=directions,
        point_time_ns=1_000_000_000 + np.tile(np.arange(360) * 277_777, 40).astype(np.int64),
    )


def insert(scan, centre, **changes):
    settings = {"radius": RADIUS, "range_max": 50.0, "range_std": 0.0} | changes
    return insert_target(scan, centre, rng=np.random.default_rng(0), **settings)


def test_hit_rays_end_on_the_sphere_and_no_other_changes(scan):
    seen, is_hit = insert(scan, CENTRE)
    assert is_hit.sum() > 20
    points, before = seen.points.reshape(-1, 3), scan.points.reshape(-1, 3)
    away = np.linalg.norm(points[is_hit] - CENTRE, axis=1)
    assert np.abs(away - RADIUS).max() < SURFACE_ERROR
    assert np.linalg.norm(points[is_hit], axis=1).max() < 6.0  # on the side that faces the sensor
    np.testing.assert_array_equal(points[~is_hit], before[~is_hit])
    np.testing.assert_array_equal(seen.no_return, scan.no_return)
    along = np.sum(points[is_hit] * scan.directions[is_hit], axis=1)
    np.testing.assert_allclose(along, np.linalg.norm(points[is_hit], axis=1), rtol=1e-6)


def test_every_ray_that_meets_the_sphere_first_is_hit(scan):
    _, is_hit = insert(scan, CENTRE)
    along = scan.directions @ CENTRE
    aside = np.sqrt(np.maximum(CENTRE @ CENTRE - along**2, 0))
    has_ray = np.isfinite(scan.points.reshape(-1, 3)).all(axis=1) | scan.no_return
    clear = np.abs(aside - RADIUS) > SURFACE_ERROR
    expected = (aside < RADIUS) & (along > 0) & has_ray
    np.testing.assert_array_equal(is_hit[clear], expected[clear])


def test_rays_without_return_end_on_it_and_rays_without_information_do_not(scan):
    high = 8.0 * np.array([np.cos(0.3), 0, np.sin(0.3)])
    seen, is_hit = insert(scan, high)
    assert scan.no_return[is_hit].all()
    assert not seen.no_return[is_hit].any()
    _, level = insert(scan, CENTRE)
    assert not level.reshape(40, 360)[20].any()


def test_what_stands_before_it_hides_it(scan):
    _, is_hit = insert(scan, CENTRE * 3)
    assert not is_hit.any()
    _, far = insert(scan, 60 * np.array([np.cos(0.3), 0, np.sin(0.3)]))
    assert not far.any()


def test_a_target_that_moves_is_where_it_is_at_the_time_of_each_ray(scan):
    centres = np.tile(CENTRE, (len(scan.directions), 1))
    centres[:, 1] = np.linspace(-1, 1, len(centres))
    seen, is_hit = insert(scan, centres)
    away = np.linalg.norm(seen.points.reshape(-1, 3)[is_hit] - centres[is_hit], axis=1)
    assert np.abs(away - RADIUS).max() < SURFACE_ERROR


def test_wrong_shapes_are_refused(scan):
    with pytest.raises(InputError, match="position"):
        insert(scan, np.zeros((2, 3)))
    with pytest.raises(InputError, match="scans"):
        next(with_target([], seed=0))


def test_a_flight_keeps_its_promises_and_its_bits(scan):
    flight = InsertedFlight(scans=40, distance=(4.0, 12.0), circle=(2.0, 3.0))
    made = list(with_target([scan], flight, seed=3))
    truth = [item.truth for item in made]
    ways = np.array([item.position[0] for item in truth])
    speeds = np.array([np.linalg.norm(item.velocity) for item in truth])
    assert [item.scan.stamp_ns for item in made] == [n * 100_000_000 for n in range(40)]
    assert 0.99 < speeds.min() < speeds.max() < 4.01
    assert (np.linalg.norm(ways, axis=1) < 12.0).all()
    steps = np.linalg.norm(np.diff(ways, axis=0), axis=1)
    assert steps.max() < 0.41
    assert all(item.hits[0] >= 3 for item in truth)
    assert all(np.count_nonzero(item.label == 1) == item.truth.hits[0] for item in made)
    again = list(with_target([scan], flight, seed=3))
    for left, right in zip(made, again, strict=True):
        np.testing.assert_array_equal(left.scan.points, right.scan.points)
    other = next(with_target([scan], flight, seed=4))
    assert not np.array_equal(other.truth.position, truth[0].position)


def test_noise_moves_points_along_their_rays(scan):
    flight = InsertedFlight(scans=2, range_std=0.05, distance=(4.0, 12.0), circle=(2.0, 3.0))
    made = next(with_target([scan], flight, seed=0))
    is_wall = made.label == 0
    lengths = np.linalg.norm(made.scan.points.reshape(-1, 3)[is_wall], axis=1)
    assert 0.045 < lengths.std() < 0.055
    assert abs(lengths.mean() - 15.0) < 0.005


def test_without_free_space_there_is_no_flight(scan):
    with pytest.raises(InputError, match="no free space for a flight"):
        next(with_target([scan], InsertedFlight(clearance=12.0), seed=0))
    bare = replace(scan, no_return=None, directions=None)
    assert next(with_target([bare], InsertedFlight(circle=(1.0, 2.0)), seed=0)).truth.hits[0] > 0
