"""The sky that is found in returns, against a slow oracle: ray by ray."""

import numpy as np
import pytest

from lidar_core import sim
from lidar_core.flying import FlyingConfig, FlyingObjectDetector, SensorConfig
from reference import sky as oracle

SCANS = 24
"""Longer than the two seconds after which a direction is trusted."""
LOOKS = (3, 23)
"""Scans whose rays are compared: before and after directions are trusted."""


NO_ROBOT = FlyingConfig(sensor=SensorConfig(learn_mask_scans=0))
"""Directions in which the robot may be are no part of the oracle."""


def compared(
    scans, poses, *, least_rays=0, in_fog=False, has_rows=False, config=NO_ROBOT, hidden=0.0
):
    """Feed a detector and the oracle; the shares of the sky in all scans.

    Rays are compared in the scans of `LOOKS`: all of them have to be the same, their directions
    and, to the rounding of a float32, their lengths; but for the share `hidden` of them.
    """
    detector = FlyingObjectDetector(config)
    core, given = detector._detector, detector.config
    expected = oracle.SkyOracle(
        given.voxel_map.voxel_size, given.voxel_map.max_range + given.range_margin, has_rows
    )
    shares, rays = [], 0
    for number, (points, pose) in enumerate(zip(scans, poses, strict=True)):
        stamp_ns = 1_000_000_000 + number * 100_000_000
        state_at = detector.state_at if number in LOOKS else None
        air = detector.state_at if in_fog else None
        seen = expected.process(points, pose[:3, :3], pose[:3, 3], stamp_ns, state_at, air=air)
        frame = detector.process(points, pose, stamp_ns)
        assert frame.status.sky_share == pytest.approx(seen.share, rel=1e-5)
        shares.append(seen.share)
        if state_at is not None:
            directions, reach = core.sky_rays()
            assert len(directions) == frame.status.n_sky_rays
            rows = nearest(directions, seen.directions)
            assert len(np.unique(rows)) >= (1 - hidden) * len(seen.directions)
            np.testing.assert_allclose(directions, seen.directions[rows], rtol=0, atol=3e-7)
            np.testing.assert_allclose(reach, seen.reach[rows], rtol=2e-6, atol=0)
            rays += len(reach)
    assert rays >= least_rays
    return np.array(shares)


def nearest(directions, others):
    """Row of the nearest other direction for each: both come cell by cell."""
    rows, at = [], 0
    for one in directions:
        while at + 1 < len(others) and np.abs(others[at] - one).max() > 3e-7:
            at += 1
        rows.append(at)
    return np.array(rows)


def random_scans(rng, *, half_width=None):
    """Walls, ground and posts drawn at random, seen along random rays that change every scan."""
    place = rng.uniform(-12, 12, (6, 2))
    size = rng.uniform(0.3, 5.0, 6)
    for _ in range(SCANS):
        azimuth = rng.uniform(-np.pi, np.pi, 6000)
        if half_width is not None:
            azimuth *= half_width / np.pi
        height = rng.uniform(-0.4, 0.45, len(azimuth))
        way = np.column_stack(
            [np.cos(azimuth) * np.sqrt(1 - height**2), np.sin(azimuth) * np.sqrt(1 - height**2)]
        )
        length = np.where(height < -0.05, -2.0 / height, np.inf)
        for (x, y), width in zip(place, size, strict=True):
            along = way[:, 0] * x + way[:, 1] * y
            aside = np.abs(way[:, 0] * y - way[:, 1] * x) / np.linalg.norm(way, axis=1)
            met = (along > 0) & (aside < width)
            length = np.where(met, np.minimum(length, np.hypot(x, y)), length)
        found = np.isfinite(length) & (length < 30) & (length > 1.5)
        points = np.column_stack([way, height])[found] * length[found, None]
        yield (points + rng.normal(0, 0.01, points.shape)).astype(np.float32)


@pytest.mark.nightly
def test_a_turning_sensor_that_drifts_has_the_sky_that_the_oracle_finds():
    rng = np.random.default_rng(1)
    poses = np.broadcast_to(np.eye(4), (SCANS, 4, 4)).copy()
    poses[:, :2, 3] = np.cumsum(rng.normal(0, 0.02, (SCANS, 2)), axis=0)
    shares = compared(list(random_scans(rng)), poses, least_rays=4000)
    assert 0.02 < shares[-1] < 0.9


def test_a_fixed_field_of_view_that_is_covered_for_two_scans_has_that_sky_too():
    scans = list(random_scans(np.random.default_rng(2), half_width=0.7))
    for number in (15, 16):
        scans[number] = scans[number][:900]
    shares = compared(scans, np.broadcast_to(np.eye(4), (SCANS, 4, 4)), least_rays=500)
    assert (shares[15:17] == 0).all()
    assert shares[14] > 0.02
    assert shares[17] > 0.02


@pytest.mark.nightly
def test_a_simulated_sensor_on_a_wet_street_has_the_sky_that_the_oracle_finds():
    simulator = sim.Simulator(sim.scenes.dark_street(3, sensor="vlp-16", speed=2.0), seed=3)
    made = [simulator.scan(number) for number in range(SCANS)]
    scans = [one.scan.points.reshape(-1, 3) for one in made]
    for number in (12, 13, 23):  # packets of the network are lost: 45 degrees, then 70
        azimuth = np.arctan2(scans[number][:, 1], scans[number][:, 0])
        scans[number] = scans[number][(azimuth < 0.3) | (azimuth > (1.1 if number < 20 else 1.5))]
    poses = [one.world_from_lidar for one in made]
    shares = compared(scans, poses, least_rays=2000, has_rows=True)
    assert shares[-1] > 0.01
    assert (shares[[12, 13, 23]] < shares[[11, 11, 22]] + 0.01).all()


def fog_scans():
    fog = sim.scenes.fog_street(4, sensor="vlp-16", speed=0.0, visibility=80.0)
    simulator = sim.Simulator(fog, seed=4)
    made = [simulator.scan(number) for number in range(SCANS)]
    return [one.scan.points.reshape(-1, 3) for one in made], [one.world_from_lidar for one in made]


@pytest.mark.nightly
def test_in_fog_the_sky_behind_droplets_is_the_one_that_the_oracle_finds():
    shares = compared(*fog_scans(), in_fog=True, has_rows=True, least_rays=15_000)
    assert shares[-1] > 0.1


@pytest.mark.nightly
def test_droplets_near_the_sensor_are_no_robot_that_hides_rays():
    """By default the robot is looked for: only the roof of the car hides rays."""
    compared(
        *fog_scans(),
        in_fog=True,
        has_rows=True,
        least_rays=15_000,
        config=FlyingConfig(),
        hidden=0.01,
    )
