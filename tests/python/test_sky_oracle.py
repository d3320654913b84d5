"""The sky that is found in returns, against a slow oracle: ray by ray."""

import numpy as np
import pytest

from lidar_core import sim
from lidar_core.flying import FlyingConfig, FlyingObjectDetector
from reference import sky as oracle

SCANS = 24
"""Longer than the two seconds after which a direction is trusted."""


def compared(scans, poses, *, least_rays):
    """Feed a detector and the oracle; the shares of the sky in all scans.

    Every ray has to be the same: its direction, and its length to the rounding of a float32.
    """
    detector = FlyingObjectDetector(FlyingConfig())
    core, given = detector._detector, detector.config
    expected = oracle.SkyOracle(given.map.voxel_size, given.map.max_range)
    shares, rays = [], 0
    for number, (points, pose) in enumerate(zip(scans, poses, strict=True)):
        stamp_ns = 1_000_000_000 + number * 100_000_000
        seen = expected.process(points, pose[:3, :3], pose[:3, 3], stamp_ns, detector.state_at)
        frame = detector.process(points, pose, stamp_ns)
        directions, reach = core.sky_rays()
        assert frame.status.gate_open or number < 20
        assert len(directions) == len(seen.directions) == frame.status.n_sky_rays
        np.testing.assert_allclose(directions, seen.directions, rtol=0, atol=3e-7)
        np.testing.assert_allclose(reach, seen.reach, rtol=2e-6, atol=0)
        assert frame.status.sky_share == pytest.approx(seen.share, rel=1e-5, abs=1e-9)
        shares.append(seen.share)
        rays += len(reach)
    assert rays >= least_rays
    return np.array(shares)


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


@pytest.mark.parametrize(("seed", "half_width"), [(0, None), (1, None), (2, 0.7)])
def test_random_worlds_have_the_sky_that_the_oracle_finds(seed, half_width):
    rng = np.random.default_rng(seed)
    way = np.cumsum(rng.normal(0, 0.03 * (seed % 2), (SCANS, 2)), axis=0)
    poses = np.broadcast_to(np.eye(4), (SCANS, 4, 4)).copy()
    poses[:, :2, 3] = way
    scans = list(random_scans(rng, half_width=half_width))
    shares = compared(scans, poses, least_rays=5000)
    assert 0.02 < shares[-1] < 0.9


@pytest.mark.parametrize("name", ["vlp-16", "livox-mid360", "livox-avia"])
def test_simulated_sensors_have_the_sky_that_the_oracle_finds(name):
    scene = sim.scenes.dark_street(3, scans=SCANS, sensor=name, speed=2.0)
    made = [sim.Simulator(scene, seed=3).scan(number) for number in range(SCANS)]
    scans = [one.scan.points.reshape(-1, 3) for one in made]
    poses = [one.world_from_lidar for one in made]
    shares = compared(scans, poses, least_rays=2000)
    assert shares[-1] > 0.01


def test_a_cover_takes_the_sky_away_and_gives_it_back():
    scans = list(random_scans(np.random.default_rng(5)))
    for number in (12, 13):
        scans[number] = scans[number][:900]
    poses = np.broadcast_to(np.eye(4), (SCANS, 4, 4))
    shares = compared(scans, poses, least_rays=5000)
    assert (shares[12:14] == 0).all()
    assert shares[11] > 0.02
    assert shares[14] > 0.02
