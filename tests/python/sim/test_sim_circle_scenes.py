"""Scenes for 2D scanners keep what they promise."""

import numpy as np
import pytest

from lidar_core import ConfigError, sim

scenes = sim.circle_scenes


def truths(scene, every=1):
    simulator = sim.Simulator(scene, seed=0)
    return [simulator.sweep(number).truth for number in range(0, scene.scans, every)]


@pytest.mark.parametrize("trajectory", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("sensor", ["hovering", "swinging"])
def test_a_single_post_is_seen_within_range(trajectory, sensor):
    seen = truths(scenes.single(0.3, trajectory, sensor=sensor, seed=1), every=7)
    share = np.mean([truth.hits[0] >= 4 for truth in seen])
    assert share > 0.98
    assert all(truth.visible_share[0] in (0, 1) for truth in seen)


def test_there_is_no_sixth_trajectory():
    with pytest.raises(ConfigError, match="expected 1 to 5, got 6"):
        scenes.single(0.3, 6)
    with pytest.raises(ConfigError, match="expected hovering or swinging"):
        scenes.single(0.3, 1, sensor="resting")


@pytest.mark.ci_cases("False-0", "False-1", "True-0", "True-1")
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("walls", [False, True])
def test_several_posts_hide_one_another_and_never_touch(seed, walls):
    seen = truths(scenes.several(seed, walls=walls, scans=1200), every=10)
    hidden = 0
    for truth in seen:
        way = truth.center[:, None] - truth.center[None]
        free = np.linalg.norm(way, axis=-1) - truth.radius[:, None] - truth.radius[None]
        assert free[~np.eye(len(free), dtype=bool)].min() > 0.1
        assert np.linalg.norm(truth.center, axis=1).min() > 1.0  # the sensor's place
        hidden += ((truth.rays > 0) & (truth.visible_share < 0.5)).sum()
    assert hidden > 20


@pytest.mark.parametrize("seed", range(4))
def test_the_lab_stays_in_its_volume(seed):
    low, high = scenes.LAB_VOLUME
    seen = truths(scenes.lab(seed, scans=400), every=4)
    for truth in seen:
        assert (truth.center > low[:2]).all()
        assert (truth.center < high[:2]).all()
        assert np.linalg.norm(truth.center[0] - truth.center[1]) > 0.29 + 0.3
    assert min(truth.visible_share[0] for truth in seen) < 0.5
    assert all(truth.hits[1] > 20 for truth in seen)


def test_a_quarter_to_three_quarters_are_hidden():
    shares, sizes = [], []
    for seed in range(40):
        truth = truths(scenes.hidden(seed, scans=1))[0]
        shares += (1 - truth.visible_share[::2]).tolist()
        sizes += truth.rays.tolist()
        free = np.linalg.norm(truth.center[::2] - truth.center[1::2], axis=1)
        assert (free - truth.radius[::2] - truth.radius[1::2] > 0.25).all()
        np.testing.assert_array_equal(truth.visible_share[1::2], 1)
    rough = 1.5 / min(sizes[::2])
    assert np.quantile(shares, 0.1) > 0.25 - rough
    assert np.quantile(shares, 0.9) < 0.75 + rough
    assert min(sizes) > 6


def test_neighbours_are_as_far_apart_as_told():
    for seed in range(20):
        truth = truths(scenes.neighbours(seed, scans=1))[0]
        free = np.linalg.norm(truth.center[0] - truth.center[1]) - truth.radius.sum()
        assert free == pytest.approx(0.3, abs=1e-9)
        assert np.linalg.norm(truth.center.mean(axis=0)) == pytest.approx(5, abs=0.2)
        np.testing.assert_array_equal(truth.visible_share, 1)


@pytest.mark.nightly
@pytest.mark.parametrize("sensor", ["hovering", "swinging"])
def test_occlusions_last_about_two_seconds(sensor):
    for seed in range(8):
        seen = truths(scenes.occlusion(seed, sensor=sensor))
        gone = np.array([truth.hits[0] == 0 for truth in seen])
        assert not gone[:60].any()
        assert not gone[-60:].any()
        if sensor == "hovering":
            assert gone.sum() == pytest.approx(40, abs=4)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_cluttered_room_hides_much_and_leaves_the_robot_its_way(seed):
    scene = scenes.cluttered(seed, scans=200)
    simulator = sim.Simulator(scene, seed=0)
    hidden = 0
    for number in range(0, 200, 10):
        made = simulator.sweep(number)
        place = made.poses[0][:2, 3]
        # Boxes reach up to 0.6 m from their middles, which keep 0.9 m from the way.
        assert np.linalg.norm(made.truth.center[:, :2] - place, axis=1).min() > 0.85
        hidden += int(np.count_nonzero(made.truth.visible_share < 0.5))
    assert len(scene.targets) == 28
    assert hidden > 100
