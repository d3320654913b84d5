"""What is no target: rain, dust, swaying leaves, insects and birds."""

import numpy as np
import pytest

from lidar_core import ConfigError, sim

AIR = -2
SENSOR = sim.Hover(position=(0.0, 0.0, 3.0))
PATTERN = sim.Spinning(elevations_deg=tuple(np.linspace(20, -20, 40).tolist()), columns=360)
LIDAR = sim.LidarModel(pattern=PATTERN, range_min=0.5, range_std=0.0)


def scene(**changes):
    return sim.Scene(lidar=LIDAR, sensor=SENSOR, **changes)


def ranges(made):
    return np.linalg.norm(made.scan.points.reshape(-1, 3), axis=1)


def first(**changes):
    return next(sim.simulate(scene(**changes), seed=5))


def test_rain_takes_the_share_of_rays_that_its_drops_fill():
    rain = sim.Rain(density=20.0, drop_size=0.004)
    made = first(air=(rain,))
    is_drop = made.label == AIR
    found = ranges(made)[is_drop]
    beam, divergence, least_share = 0.0095, 0.0031, 0.01  # of an OS1, see lidar_sim::air
    furthest = (rain.drop_size / least_share**0.5 - beam) / divergence
    assert found.min() >= 0.5
    assert found.max() <= furthest
    steps = np.linspace(0.5, furthest, 20_001)
    width = beam + divergence * steps + rain.drop_size
    depth = np.trapezoid(rain.density * np.pi / 4 * width**2, steps)
    share = 1 - np.exp(-depth)
    spread = np.sqrt(share * (1 - share) / len(is_drop))
    assert abs(is_drop.mean() - share) < 4 * spread
    assert made.scan.no_return[~is_drop].all()


def test_rays_end_in_dust_only_and_after_its_free_path():
    cloud = sim.Dust(center=(10.0, 0.0, 3.0), radius=3.0, free_path=2.0)
    made = first(air=(cloud,))
    points = made.scan.points.reshape(-1, 3)[made.label == AIR]
    assert len(points) > 200
    assert np.linalg.norm(points - [10.0, 0.0, 0.0], axis=1).max() <= 3.0 + 1e-5
    middle = np.abs(made.scan.directions @ [1.0, 0.0, 0.0]) > 0.9995  # chords of nearly 6 m
    ahead = middle & (made.scan.directions[:, 0] > 0)
    assert (made.label[ahead] == AIR).mean() == pytest.approx(1 - np.exp(-6 / 2.0), abs=0.12)


def test_dust_drifts_and_grows():
    cloud = sim.Dust(
        center=(10.0, 0.0, 3.0), velocity=(0.0, 5.0, 0.0), radius=1.0, growth=1.0, free_path=0.5
    )
    simulator = sim.Simulator(scene(air=(cloud,), scans=11), seed=0)
    late = simulator.scan(10)
    points = late.scan.points.reshape(-1, 3)[late.label == AIR]
    seconds = (late.scan.point_time_ns[late.label == AIR] * 1e-9)[:, None]
    middle = np.array([10.0, 0.0, 0.0]) + seconds * [0.0, 5.0, 0.0]
    assert (np.linalg.norm(points - middle, axis=1) <= 1 + seconds[:, 0] + 1e-5).all()


def test_what_stands_in_front_hides_the_dust():
    wall = sim.Body(shape=sim.Box(size=(0.5, 60.0, 60.0)), position=(5.0, 0.0, 0.0))
    cloud = sim.Dust(center=(12.0, 0.0, 3.0), radius=3.0, free_path=0.01)
    assert (first(bodies=(wall,), air=(cloud,)).label != AIR).all()


@pytest.mark.parametrize("threads", [2, 5])
def test_clutter_is_the_same_for_any_number_of_threads(threads):
    air = tuple(sim.Dust(center=(x, 0.0, 3.0), radius=2.0) for x in range(3, 9))
    tree = sim.Body(shape=sim.Tree(sway=0.3), position=(6.0, 5.0, 0.0))
    world = scene(bodies=(tree,), air=(*air, sim.Rain()), scans=3)
    for one, other in zip(
        sim.simulate(world, seed=3), sim.simulate(world, seed=3, threads=threads), strict=True
    ):
        np.testing.assert_array_equal(one.scan.points, other.scan.points)
        np.testing.assert_array_equal(one.label, other.label)


def test_every_scan_and_seed_has_its_own_drops():
    simulator = sim.Simulator(scene(air=(sim.Rain(density=50.0),), scans=2), seed=0)
    drops = [simulator.scan(number).label == AIR for number in (0, 1)]
    assert 0 < (drops[0] & drops[1]).sum() < 0.5 * drops[0].sum()
    other = sim.Simulator(scene(air=(sim.Rain(density=50.0),), scans=2), seed=1)
    assert (other.scan(0).label == AIR).tolist() != drops[0].tolist()


def test_leaves_sway_around_their_places_and_the_trunk_stands():
    tree = sim.Tree(sway=0.3, sway_rate=1.0, leaves=1, crown_radius=1.5, trunk_radius=0.2)
    ((_, _), (_, place)) = tree.surfaces()
    trunk, leaf = tree.sways()
    assert trunk is None
    assert leaf is not None
    reach, rate, phase = leaf
    body = sim.Body(shape=tree, position=(4.0, 0.0, 0.0))
    dense = LIDAR.model_copy(
        update={
            "pattern": sim.Spinning(
                elevations_deg=tuple(np.linspace(20, -5, 100).tolist()), columns=2000
            ),
            "snapshot": True,
        }
    )
    world = sim.Scene(lidar=dense, sensor=SENSOR, bodies=(body,), scans=8)
    for made in sim.simulate(world, seed=0):
        swing = np.sin(2 * np.pi * rate * made.scan.stamp_ns * 1e-9 + phase)
        middle = np.array([4.0, 0.0, 0.0]) + place + swing * np.array(reach)
        points = made.scan.points.reshape(-1, 3) + np.array([0.0, 0.0, 3.0])
        away = np.linalg.norm(points - middle, axis=1)
        assert np.nanmin(np.abs(away - tree.leaf_radius)) < 1e-5
        is_leaf = np.abs(away - tree.leaf_radius) < 1e-4
        axis = np.hypot(points[:, 0] - 4.0, points[:, 1])
        is_trunk = np.abs(axis - tree.trunk_radius) < 1e-4
        is_top = np.abs(points[:, 2] - tree.trunk_height) < 1e-4
        assert (is_leaf | is_trunk | is_top | np.isnan(away)).all()


def test_without_wind_nothing_sways():
    still = sim.Body(shape=sim.Tree(), position=(5.0, 0.0, 0.0))
    one, *_, last = sim.simulate(scene(bodies=(still,), scans=4), seed=0)
    np.testing.assert_array_equal(one.scan.points, last.scan.points)


def test_clutter_gives_returns_but_is_no_truth():
    def ball(y, clutter):
        motion = sim.Circle(center=(5.0, y, 3.0), radius=0.5, speed=1.0)
        return sim.Target(shape=sim.Sphere(radius=0.3), motion=motion, clutter=clutter)

    made = first(targets=(ball(-3.0, True), ball(0.0, False), ball(3.0, True)))
    assert made.truth.id.tolist() == [1]
    assert np.unique(made.label).tolist() == [-1, 0, 1, 2]
    assert made.truth.hits.tolist() == [(made.label == 1).sum()]
    assert made.truth.rays.shape == made.truth.radius.shape == (1,)
    np.testing.assert_allclose(made.truth.position, [[5.5, 0.0, 3.0]], atol=1e-9)


def test_scenes_with_clutter_come_back_from_toml(tmp_path):
    from lidar_core.parameters import commented_toml

    world = scene(
        bodies=(sim.Body(shape=sim.Tree(sway=0.2), position=(5.0, 0.0, 0.0)),),
        air=(sim.Rain(), sim.Dust(center=(1.0, 2.0, 3.0), radius=0.5)),
    )
    path = tmp_path / "scene.toml"
    path.write_text(commented_toml(world))
    assert sim.Scene.read(path) == world


@pytest.mark.parametrize("changes", [{"radius": 0.0}, {"free_path": -1.0}, {"growth": -0.1}])
def test_impossible_dust_is_refused(changes):
    with pytest.raises(ConfigError):
        sim.Dust(**{"center": (0.0, 0.0, 0.0), "radius": 1.0, **changes})
