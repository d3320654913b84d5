"""Uncertain poses: what they change in the map, against an oracle, and in what is detected."""

import numpy as np
import pytest
from flying_scenes import drone, feed, lidar, scans_of, yard

from lidar_core import ConfigError, VoxelMap
from lidar_core.flying import FlyingConfig, FlyingObjectDetector, PoseConfig, SeparateConfig
from lidar_core.sim import NoisyPoses, PoseNoise
from reference.analysis import rotation
from reference.weighting import UncertainMap

ROUNDING = 2e-3
"""Of float32 points and of shares in 1/1024, in values of G up to 1000 (no unit)."""
STD = np.array([0.1, 0.06, 0.08, 0.01, 0.012, 0.008])
NOISY = (3.0, -2.0, 1.5, 0.1, -0.2, 0.7)


def detector(**pose):
    config = FlyingConfig(pose=PoseConfig(**pose), separate=SeparateConfig(min_confident=0))
    return FlyingObjectDetector(config)


def wall(rng):
    """Points on a wall, in the frame of a sensor at `NOISY`: one cluster, large, background."""
    y, z = np.meshgrid(np.arange(-1.5, 1.5, 0.11), np.arange(-1.5, 1.5, 0.13))
    points = np.stack([np.full(y.shape, 7.3), y, z], axis=-1).reshape(-1, 3)
    return (points + rng.uniform(-0.02, 0.02, points.shape)).astype(np.float32)


def pose_of(noisy):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation(*noisy[3:]), noisy[:3]
    return matrix


def map_of(one, path):
    one.save_map(path)
    return VoxelMap.load(path)


def noisy_scans(scene, seed=3):
    """Scans of a scene with poses that jump by 0.1 m and 0.5 deg."""
    noise = NoisyPoses(PoseNoise(position_std=0.1, angle_std_deg=0.5), seed=seed)
    return [noise.observed(made) for made in scans_of(scene)], noise.noise.covariance


# The map


@pytest.mark.parametrize("weighting", ["ends", "spread"])
def test_the_map_is_that_of_the_oracle(weighting, tmp_path):
    points = wall(np.random.default_rng(0))
    made = detector(weighting=weighting)
    config = made.config
    made.process(points, pose_of(NOISY), 0, pose_covariance=np.diag(STD**2))
    got = map_of(made, tmp_path / "map")
    limits = config.voxel_map.model_copy(
        update={"max_range": config.voxel_map.max_range + config.range_margin}
    )
    oracle = UncertainMap(limits, config.pose, NOISY, np.diag(STD**2), config.range_std)
    local = (points.astype(float) @ rotation(*NOISY[3:]).T).astype(np.float32)
    oracle.integrate(local, np.ones(len(points), np.uint8), np.zeros(3))
    voxels = np.array(list(oracle.values))
    centers = (voxels + 0.5) * config.voxel_map.voxel_size
    values = got.values_at((centers + NOISY[:3]).astype(np.float32))
    expected = np.array(list(oracle.values.values()))
    off = np.abs(values - expected) > ROUNDING
    assert off.mean() < 0.01  # a ray through an edge may be rounded into the other voxel
    assert got.n_observed == pytest.approx(len(voxels), abs=3)


def test_without_weighting_or_without_a_covariance_the_map_is_the_same_bits():
    scans, covariance = noisy_scans(yard(drone((6.0, 0.0, 3.5)), scans=6))

    def run(pose_covariance=None, **pose):
        one = detector(**pose)
        for made in scans:
            feed(one, made, pose_covariance=pose_covariance)
        return one._detector.map_bytes()

    plain = run(weighting="off")
    assert run(covariance, weighting="off") == plain
    assert run(weighting="ends") == plain
    assert run(weighting="spread") == plain
    assert run(covariance, weighting="ends") != plain
    constant = {"position_std": (0.1,) * 3, "angle_std": (np.radians(0.5),) * 3}
    for weighting in ("ends", "spread"):
        assert run(weighting=weighting, **constant) == run(covariance, weighting=weighting)


def test_the_number_of_threads_does_not_matter():
    scans, covariance = noisy_scans(yard(drone((6.0, 0.0, 3.5)), scans=5))
    results = []
    for threads in (1, 3):
        one = FlyingObjectDetector(
            FlyingConfig(pose=PoseConfig(weighting="spread")), threads=threads
        )
        for made in scans:
            feed(one, made, pose_covariance=covariance)
        results.append(one._detector.map_bytes())
    assert results[0] == results[1]


# What is detected


def test_detections_know_of_the_constant_uncertainty():
    scene = yard(drone((9.0, -3.0, 3.5), (9.0, 3.0, 3.5), seconds=1.4), scans=14)
    constant = PoseConfig(position_std=(0.3, 0.3, 0.3), weighting="off")
    certain, uncertain = FlyingObjectDetector(), FlyingObjectDetector(FlyingConfig(pose=constant))
    for made in scans_of(scene):
        first, second = feed(certain, made), feed(uncertain, made)
    more = second.detections.covariance - first.detections.covariance
    np.testing.assert_allclose(more, np.broadcast_to(0.09 * np.eye(3), more.shape), atol=1e-9)
    assert len(more) == 1


def test_the_paper_takes_poses_for_certain():
    assert FlyingConfig.paper().pose == PoseConfig(weighting="off")
    assert FlyingConfig().pose.weighting != "off"


@pytest.mark.nightly
def test_false_detections_fall_and_recall_stays():
    places = [(9.0, y, 3.5 + 0.05 * y) for y in (-3.0, 3.0, -3.0, 3.0)]
    scene = yard(drone(*places, seconds=6.0), lidar=lidar(range_std=0.03), scans=60)
    scans, covariance = noisy_scans(scene)
    false, found = {}, {}
    for weighting in ("off", "ends"):
        one = FlyingObjectDetector(FlyingConfig(pose=PoseConfig(weighting=weighting)))
        false[weighting] = found[weighting] = 0
        for made in scans:
            positions = feed(one, made, pose_covariance=covariance).detections.position
            away = np.linalg.norm(positions - made.truth.position[0], axis=1)
            false[weighting] += int((away > 1.5).sum())
            found[weighting] += bool((away < 1.5).any())
    assert false["off"] >= 10
    assert false["ends"] < 0.8 * false["off"]
    assert found["ends"] >= found["off"] - 1
    assert found["ends"] > 40


@pytest.mark.parametrize(
    "values",
    [{"position_std": (-0.1, 0, 0)}, {"weighting": "hit"}, {"end_sigmas": -1.0}],
)
def test_what_is_no_uncertainty_is_refused(values):
    with pytest.raises(ConfigError, match=next(iter(values))):
        PoseConfig(**values)


def test_tracks_that_know_of_uncertain_poses_are_steadier_and_honest():
    scene = yard(drone((6.0, 2.0, 4.0), (2.0, 7.0, 4.5), seconds=4.0), scans=40)
    observed, covariance = noisy_scans(scene)
    errors, squares = {}, {}
    for known in (None, covariance):
        made = FlyingObjectDetector(FlyingConfig())
        found, nees = [], []
        for simulated, seen in zip(scans_of(scene), observed, strict=True):
            tracks = feed(made, seen, pose_covariance=known).tracks
            if len(tracks) == 1 and made.health().processed > 15:
                e = tracks.position[0] - simulated.truth.position[0]
                found.append(np.linalg.norm(e))
                nees.append(e @ np.linalg.solve(tracks.covariance[0, :3, :3], e))
        assert len(found) > 10
        errors[known is None], squares[known is None] = np.mean(found), np.mean(nees)
    assert errors[False] < 0.9 * errors[True]
    assert squares[False] < 9 < squares[True]  # 3 if exact
