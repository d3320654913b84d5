"""Surfaces that lose, mirror or pass light, fog, own body, blind zone, scenes of real sensors."""

import numpy as np
import pytest

from lidar_core import ConfigError, sim
from reference import surfaces as oracle

FORWARD = sim.Spinning(elevations_deg=(0.0,), columns=20_000)
RANGE_MAX = 100.0
SCATTER = 4.5
"""Standard deviations of a share of many rays within which it has to lie."""
GHOST, OWN, AIR = -3, -4, -2


def lidar(**changes):
    return sim.LidarModel(
        pattern=FORWARD, range_std=0.0, snapshot=True, **{"range_max": RANGE_MAX, **changes}
    )


def ball(radius, **surface):
    """A sphere around the sensor: every ray meets it head-on."""
    return sim.Body(shape=sim.Sphere(radius=radius), surface=sim.Surface(**surface))


IDEAL = lidar()


def made_of(*bodies, **changes):
    changes = {"lidar": IDEAL, "sensor": sim.Hover(position=(0, 0, 0)), "scans": 2, **changes}
    world = sim.Scene(bodies=bodies, **changes)
    return next(sim.simulate(world, seed=7))


def assert_share(found, expected, rays=20_000):
    spread = np.sqrt(max(expected * (1 - expected), 1e-4) / rays)
    assert abs(found - expected) < SCATTER * spread + 1e-9


@pytest.mark.parametrize("reflectivity", [0.02, 0.1, 0.5])
@pytest.mark.parametrize("distance", [30.0, 60.0, 95.0])
def test_dropout_by_range_and_reflectivity_is_that_of_the_oracle(reflectivity, distance):
    made = made_of(ball(distance, reflectivity=reflectivity))
    share = (made.label == 0).mean()
    assert_share(share, oracle.seen(reflectivity, 1.0, distance, RANGE_MAX))
    assert made.scan.no_return.mean() == pytest.approx(1 - share)


def test_dropout_by_incidence_is_that_of_the_oracle():
    surface = sim.Surface(reflectivity=0.15)
    wall = sim.Body(shape=sim.Box(size=(400.0, 1.0, 4.0)), position=(0, 20.5, 0), surface=surface)
    made = made_of(wall)
    azimuth = np.arctan2(made.scan.directions[:, 1], made.scan.directions[:, 0])
    for low in np.deg2rad(np.arange(10, 90, 8)):
        bins = np.abs(azimuth - low) < np.deg2rad(2)
        expected = np.mean(
            [
                oracle.seen(0.15, np.sin(a), 20 / np.sin(a), RANGE_MAX)
                * (20 / np.sin(a) < RANGE_MAX)
                for a in azimuth[bins]
            ]
        )
        assert_share((made.label[bins] == 0).mean(), expected, bins.sum())


@pytest.mark.parametrize("clear", [0.0, 0.5, 0.95])
def test_glass_passes_mirrors_and_returns_as_the_oracle_says(clear):
    glass = {"reflectivity": 0.05, "mirror": 0.2, "clear": clear}
    made = made_of(ball(5.0, **glass), ball(9.0, reflectivity=0.4))
    pane, wall = oracle.glass_before_a_wall(glass, 0.4, 5.0, 9.0, RANGE_MAX)
    lengths = np.linalg.norm(made.scan.points[0], axis=1)
    assert_share((made.label == 0).mean(), pane)
    assert_share((made.label == 1).mean(), wall)
    np.testing.assert_allclose(lengths[made.label == 0], 5.0, rtol=1e-6)
    np.testing.assert_allclose(lengths[made.label == 1], 9.0, rtol=1e-6)
    # Mirrored rays cross the ball: they meet the pane again at 5 + 10 m.
    ghosts = lengths[made.label == GHOST]
    assert len(ghosts) > 100
    assert ghosts.min() > 14.9


def test_a_mirror_shows_a_target_where_it_is_not():
    mirror = sim.Surface(reflectivity=0.0, mirror=1.0)
    pane = sim.Body(shape=sim.Box(size=(20.0, 1.0, 20.0)), position=(0, 8.5, 0), surface=mirror)
    target = sim.Target(shape=sim.Sphere(radius=1.0), motion=sim.Hover(position=(6, 2, 0)))
    made = made_of(pane, targets=(target,))
    ghosts = made.scan.points[0][made.label == GHOST]
    assert len(ghosts) > 100
    image = np.array([6.0, 14.0, 0.0])
    np.testing.assert_allclose(np.linalg.norm(ghosts - image, axis=1), 1.0, atol=1e-4)
    assert made.truth.hits[0] == (made.label == 1).sum()
    turned = oracle.reflected([0.6, 0.8, 0.0], [0, 1, 0])
    np.testing.assert_allclose(turned, [0.6, -0.8, 0.0])


@pytest.mark.parametrize("visibility", [30.0, 120.0])
def test_fog_fades_and_speckles_as_the_oracle_says(visibility):
    fog = sim.Fog(visibility=visibility, speckle=0.02)
    made = made_of(ball(20.0, reflectivity=0.3), air=(fog,), lidar=lidar(range_min=1.0))
    extinction = 3.912 / visibility
    air = oracle.speckle(0.02, 1.0, 6.0)
    assert_share((made.label == AIR).mean(), air)
    there = oracle.seen(0.3, 1.0, 20.0, RANGE_MAX, extinction)
    assert_share((made.label == 0).mean(), (1 - air) * there)
    lengths = np.linalg.norm(made.scan.points[0][made.label == AIR], axis=1)
    assert 1.0 <= lengths.min() < 1.2
    assert 5.8 < lengths.max() <= 6.0


def test_surfaces_that_state_nothing_return_every_ray_and_the_same_bits():
    plain = sim.Body(shape=sim.Sphere(radius=90.0))
    made = made_of(plain)
    assert (made.label == 0).all()
    with_other = made_of(plain, ball(95.0, reflectivity=0.1))
    np.testing.assert_array_equal(made.scan.points, with_other.scan.points)


def test_the_own_body_moves_and_turns_with_the_sensor_and_hides_what_is_behind():
    roof = sim.Body(shape=sim.Box(size=(2.0, 1.4, 0.1)), position=(0.3, 0, -0.4))
    way = sim.Loop(center=(0, 0, 3), straight=8, radius=2, speed=3, yaw_rate=1.0, tilt_deg=10)
    pattern = sim.Spinning(elevations_deg=(-20.0, -30.0), columns=720)
    world = sim.Scene(
        bodies=(sim.Body(shape=sim.Plane()),),
        own_body=(roof,),
        sensor=way,
        scans=20,
        lidar=sim.LidarModel(pattern=pattern, range_std=0.0, range_min=0.75),
    )
    scans = list(sim.simulate(world, seed=0))
    own = scans[0].label == OWN
    assert own.sum() > 200
    for made in scans:
        np.testing.assert_array_equal(made.label == OWN, own)
        points = made.scan.points.reshape(-1, 3)
        np.testing.assert_allclose(points[own, 2], -0.35, atol=1e-6)
        np.testing.assert_array_equal(points[own], scans[0].scan.points.reshape(-1, 3)[own])
        lengths = np.linalg.norm(points, axis=1)
        assert np.nanmin(lengths) >= 0.75  # the blind zone
    blind = np.isnan(scans[0].scan.points).any(axis=2).ravel() & ~scans[0].scan.no_return
    assert blind.sum() > 50  # nearer than it: no information


def test_any_number_of_threads_gives_the_same_bits():
    scene = sim.scenes.fog_street(3, scans=2)
    one, many = (next(sim.simulate(scene, seed=5, threads=threads)) for threads in (1, 3))
    assert one.scan.points.tobytes() == many.scan.points.tobytes()
    assert one.label.tobytes() == many.label.tobytes()
    other = next(sim.simulate(scene, seed=6))
    assert other.scan.points.tobytes() != one.scan.points.tobytes()


STREETS = [sim.scenes.moving_car, sim.scenes.fog_street, sim.scenes.dark_street]


@pytest.mark.parametrize("scene", STREETS)
def test_streets_show_the_own_body_and_lose_returns_that_are_no_sky(scene):
    world = scene(1, scans=40, drone=True)
    simulator = sim.Simulator(world, seed=1)
    rays = sim.Simulator(
        world.model_copy(update={"lidar": world.lidar.model_copy(update={"ideal": True})}), seed=1
    ).scan(20)
    ideal = sim.Simulator(world.idealised(), seed=1).scan(20)
    made = simulator.scan(20)
    assert world.lidar.delivery == "dropped"
    assert made.scan.no_return is None
    own = np.linalg.norm(made.scan.points[made.label == OWN], axis=1)
    assert len(own) > 500
    assert 0.5 < own.min() < own.max() < 2.8
    sky = ideal.scan.no_return
    assert 0.1 < sky.mean() < 0.9
    lost = rays.scan.no_return & ~sky
    assert lost.mean() > 0.01
    assert not (sky & (rays.label >= 0)).any()  # what a ray met without fog, it meets or loses
    hits = [int(simulator.scan(number).truth.hits[0]) for number in range(0, 40, 4)]
    assert np.mean(np.array(hits) >= 3) >= 0.7


def test_fog_loses_more_than_clear_air_and_dark_fronts_more_than_concrete():
    points = {
        scene: len(sim.Simulator(scene(2, scans=20), seed=1).scan(10).scan.points)
        for scene in STREETS
    }
    clear, fog, dark = (points[scene] for scene in STREETS)
    assert fog < 0.95 * clear
    assert dark < 0.95 * clear


@pytest.mark.ci_cases("livox-mid360-hexacopter", "vlp-16-quadcopter")
@pytest.mark.parametrize("flier", ["sphere", "hexacopter", "quadcopter"])
@pytest.mark.parametrize("sensor", ["livox-mid360", "livox-avia", "vlp-16", "hdl-32e", "xt32"])
def test_encounters_are_within_12_m_with_returns(sensor, flier):
    world = sim.scenes.encounter(sensor, flier, 1, scans=40)
    assert not world.lidar.ideal
    hits = []
    for made in list(sim.simulate(world, seed=1))[::4]:
        assert made.scan.no_return is None
        assert np.linalg.norm(made.truth.position[0] - [0, 0, 1.8]) < 12.0
        hits.append(int(made.truth.hits[0]))
    assert np.mean(np.array(hits) >= 3) >= 0.5


@pytest.mark.parametrize("sparse", [True, False])
def test_trees_sway_and_nothing_flies(sparse):
    world = sim.scenes.windy_trees(1, scans=8, sparse=sparse)
    assert not world.targets
    first, *_, last = sim.simulate(world, seed=1)
    leaves = [(one.label > 0).sum() for one in (first, last)]
    assert min(leaves) > 100
    dense = sim.scenes.windy_trees(1, scans=8, sparse=not sparse)
    other = (next(sim.simulate(dense, seed=1)).label > 0).sum()
    assert (other > leaves[0]) == sparse


def test_wrong_values_are_refused():
    for values in ({"reflectivity": -1}, {"mirror": 1.5}, {"clear": -0.1}):
        with pytest.raises(ConfigError):
            sim.Surface(**values)
    with pytest.raises(ConfigError, match="flier: expected one of sphere"):
        sim.scenes.encounter("vlp-16", "bird")
    with pytest.raises(ConfigError, match="sensor: expected a 3D LiDAR"):
        sim.scenes.encounter("utm-30lx")


def test_a_scene_file_states_surfaces_fog_and_the_own_body(tmp_path):
    for scene in (sim.scenes.fog_street(0, scans=3), sim.scenes.dark_street(0, scans=3)):
        path = tmp_path / "scene.toml"
        path.write_text(scene.to_toml())
        assert sim.Scene.read(path) == scene
