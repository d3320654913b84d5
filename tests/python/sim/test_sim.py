"""Simulator: rays against the oracle, times, noise, scenes, motions, files."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from repository import ROOT
from scipy import stats
from scipy.spatial.transform import Rotation

from lidar_core import ConfigError, InputError, LimitError, sim
from lidar_core._core import SimScene, SimShape, SimTrajectory
from lidar_core.io import open_recording, posed_scans
from lidar_core.sim.motion.knots import poses
from reference import raycast

DISTANCE_TOLERANCE = 1e-8  # [m], of the oracle's quadratic formulas at 100 m
SCALE = 1e-6  # a ray counts if shapes larger and smaller by this share agree on it
POINT_TOLERANCE = 2e-5  # [m], float32 at 100 m

seeds = st.integers(0, 2**32 - 1)


def random_pose(rng, reach=20.0):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(rng=rng).as_matrix()
    pose[:3, 3] = rng.uniform(-reach, reach, 3)
    return pose


def bumpy(rng):
    return rng.uniform(-1, 1, (4, 5))


def make(kind, rng):
    """A shape of the core, and the oracle of the same shape scaled by a factor."""
    if kind == "sphere":
        radius = rng.uniform(0.1, 5)
        return SimShape.sphere(radius), lambda factor: raycast.sphere(factor * radius)
    if kind == "box":
        size = rng.uniform(0.1, 8, 3)
        return SimShape.cuboid(size), lambda factor: raycast.box(factor * size)
    if kind == "cylinder":
        radius, height = rng.uniform(0.1, 5, 2)
        return SimShape.cylinder(radius, height), lambda f: raycast.cylinder(f * radius, f * height)
    if kind == "plane":
        size = rng.uniform(1, 50, 2)
        return SimShape.plane(size), lambda factor: raycast.plane(factor * size)
    if kind == "mesh":
        vertices, faces = sim.hexacopter_mesh(rng.uniform(0.3, 3))
        return SimShape.mesh(vertices, faces), lambda f: raycast.mesh(f * vertices, faces)
    heights, cell = bumpy(rng), rng.uniform(0.5, 3)
    field = SimShape.height_field(heights, cell)
    return field, lambda factor: raycast.height_field(factor * heights, factor * cell)


KINDS = ("sphere", "box", "cylinder", "plane", "mesh", "height_field")


def random_rays(rng, count, pose):
    """From anywhere, most of them towards the shape; some from inside, some along axes."""
    origins = rng.uniform(-60, 60, (count, 3))
    origins[: count // 8] = pose[:3, 3] + rng.normal(scale=0.2, size=(count // 8, 3))
    directions = pose[:3, 3] + rng.normal(scale=2.0, size=(count, 3)) - origins
    directions[::9] = (
        rng.choice([-1.0, 1.0], (len(directions[::9]), 1))
        * np.eye(3)[rng.integers(3, size=len(directions[::9]))]
    )
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def assert_equals_oracle(found, oracle, pose, origins, directions):
    expected, small, large = (
        raycast.cast(oracle(factor), pose, origins, directions)
        for factor in (1.0, 1 - SCALE, 1 + SCALE)
    )
    with np.errstate(invalid="ignore"):
        firm = (np.abs(large - small) < 1e-2) | (np.isinf(small) & np.isinf(large))
    firm &= np.isfinite(expected) == np.isfinite(small)
    assert firm.mean() > 0.9
    np.testing.assert_allclose(found[firm], expected[firm], rtol=0, atol=DISTANCE_TOLERANCE)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=20)
@given(seed=seeds)
def test_every_shape_equals_the_oracle(kind, seed):
    rng = np.random.default_rng(seed)
    shape, oracle = make(kind, rng)
    pose = random_pose(rng)
    origins, directions = random_rays(rng, 80, pose)
    scene = SimScene([(shape, pose, 7)], [], threads=1)
    found, label = scene.cast(origins, directions, 1e6)
    assert_equals_oracle(found, oracle, pose, origins, directions)
    assert (label == np.where(np.isfinite(found), 7, -1)).all()


@settings(max_examples=10)
@given(seed=seeds)
def test_a_full_scene_gives_the_nearest_of_all(seed):
    rng = np.random.default_rng(seed)
    bodies, alone = [], []
    for label in range(40):
        shape, _ = make(KINDS[label % len(KINDS)], rng)
        pose = random_pose(rng)
        bodies.append((shape, pose, label))
        alone.append(SimScene([(shape, pose, label)], [], threads=1))
    origins, directions = random_rays(rng, 500, random_pose(rng))
    found, label = SimScene(bodies, [], threads=2).cast(origins, directions, 100.0)
    every = np.array([scene.cast(origins, directions, 100.0)[0] for scene in alone])
    assert (found == every.min(axis=0)).all()
    assert (label == np.where(np.isfinite(found), every.argmin(axis=0), -1)).all()


@given(seed=seeds)
@settings(max_examples=10)
def test_far_from_the_origin_nothing_changes(seed):
    rng = np.random.default_rng(seed)
    away = np.array([4.5e5, -5.5e6, 300.0])  # like UTM coordinates
    near, far = [], []
    for label, kind in enumerate(KINDS):
        shape, _ = make(kind, rng)
        pose = random_pose(rng)
        moved = pose.copy()
        moved[:3, 3] += away
        near.append((shape, pose, label))
        far.append((shape, moved, label))
    origins, directions = random_rays(rng, 300, near[0][1])
    here, _ = SimScene(near, [], threads=1).cast(origins, directions, 100.0)
    there, _ = SimScene(far, [], threads=1).cast(origins + away, directions, 100.0)
    same = np.isclose(here, there, rtol=0, atol=1e-6)  # coordinates are rounded to 1e-9 m there
    assert same.mean() > 0.99  # the rest grazes an edge


def test_a_mesh_sphere_converges_to_the_sphere():
    rng = np.random.default_rng(3)
    origins, directions = random_rays(rng, 2000, np.eye(4))
    toward = np.linalg.norm(np.cross(origins, directions), axis=1) < 1.8  # not grazing
    origins, directions = origins[toward], directions[toward]
    exact, _ = SimScene([(SimShape.sphere(2.0), np.eye(4), 0)], [], threads=1).cast(
        origins, directions, 200.0
    )
    errors = []
    for rings in (16, 32, 64):
        mesh = SimShape.mesh(*sim.sphere_mesh(2.0, rings=rings, sectors=2 * rings))
        found, _ = SimScene([(mesh, np.eye(4), 0)], [], threads=1).cast(origins, directions, 200.0)
        both = np.isfinite(found) & np.isfinite(exact)
        assert both.mean() > 0.4
        errors.append(np.abs(found - exact)[both].max())
    assert errors[2] < 0.01
    assert errors[0] / errors[1] > 3.5  # second order: 4
    assert errors[1] / errors[2] > 3.5


@given(seed=seeds)
@settings(max_examples=10)
def test_clearance_is_the_distance_to_the_nearest_surface(seed):
    rng = np.random.default_rng(seed)
    bodies = [(make(kind, rng)[0], random_pose(rng), 0) for kind in KINDS]
    scene = SimScene(bodies, [], threads=1)
    points = rng.uniform(-30, 30, (20, 3))
    found = scene.clearance(points, 100.0)
    directions = rng.normal(size=(5000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for point, clearance in zip(points, found, strict=True):
        if clearance > 0:  # no ray is shorter; some ray is about as short
            ranges, _ = scene.cast(np.tile(point, (5000, 1)), directions, 1e3)
            assert ranges.min() >= clearance - 1e-9
    assert (found <= 100.0).all()


def wall_scene(**changes):
    return sim.Scene(
        bodies=[sim.Body(shape=sim.Box(size=(1.0, 200.0, 200.0)), position=(30.5, 0.0, 0.0))],
        **{
            "scans": 1,
            "lidar": sim.LidarModel.preset("vlp-16", ideal=True, range_std=0.0),
            **changes,
        },
    )


def only(scene, *, seed=0):
    return next(sim.simulate(scene, seed=seed))


def world_points(made, trajectory):
    """Points in the world frame, each with the pose of its own time."""
    pose = trajectory.poses_at(made.scan.point_time_ns)
    points = made.scan.points.reshape(-1, 3).astype(np.float64)
    return np.einsum("nij,nj->ni", pose[:, :3, :3], points) + pose[:, :3, 3]


def test_every_ray_has_its_own_time_and_place():
    way = sim.Waypoints(times=(0.0, 1.0), positions=((0, 0, 0), (20, 0, 0)))
    simulator = sim.Simulator(wall_scene(sensor=way), seed=0)
    made = simulator.scan(0)
    time = made.scan.point_time_ns.reshape(16, 1800)
    assert (time == 100_000_000 * np.arange(1800) // 1800).all()
    hit = np.isfinite(made.scan.points[..., 0])
    expected = 30.0 - 20.0 * time * 1e-9  # x of the wall from where the sensor is
    found = made.scan.points[..., 0]
    np.testing.assert_allclose(found[hit], expected[hit], rtol=0, atol=POINT_TOLERANCE)
    assert (made.world_from_lidar == np.eye(4)).all()
    np.testing.assert_allclose(made.poses[-1, 0, 3], 2.0, atol=1e-12)


def test_points_of_a_turning_sensor_lie_on_the_wall():
    way = sim.Loop(center=(0, 0, 0), straight=8, radius=2, speed=3, yaw_rate=1.0, tilt_deg=10)
    simulator = sim.Simulator(wall_scene(sensor=way, scans=3), seed=0)
    for made in simulator:
        points = world_points(made, simulator.sensor)
        hit = made.label >= 0
        np.testing.assert_allclose(points[hit, 0], 30.0, rtol=0, atol=POINT_TOLERANCE)
        # poses at 100 Hz are enough to put them there: what a user does
        again = SimTrajectory(made.pose_stamps_ns, made.poses)
        np.testing.assert_allclose(world_points(made, again)[hit, 0], 30.0, rtol=0, atol=2e-3)


def test_points_of_a_moving_target_lie_on_it_at_their_own_time():
    flight = sim.Waypoints(times=(0.0, 1.0), positions=((8, -10, 0), (8, 10, 0)))
    target = sim.Target(shape=sim.Sphere(radius=1.0), motion=flight)
    lidar = sim.LidarModel.preset("os1-128", ideal=True, range_std=0.0)
    simulator = sim.Simulator(
        sim.Scene(targets=[target], lidar=lidar, scans=10, sensor=sim.Hover(position=(0, 0, 0))),
        seed=0,
    )
    for made in simulator:
        hit = made.label == 0
        assert hit.sum() == made.truth.hits[0] > 50
        center = simulator.targets[0].poses_at(made.scan.point_time_ns[hit])[:, :3, 3]
        reach = np.linalg.norm(made.scan.points.reshape(-1, 3)[hit] - center, axis=1)
        np.testing.assert_allclose(reach, 1.0, rtol=0, atol=POINT_TOLERANCE)
    np.testing.assert_allclose(made.truth.position, [[8, 8, 0]], atol=1e-9)
    np.testing.assert_allclose(made.truth.velocity, [[0, 20, 0]], atol=1e-9)


def arrays_of(made):
    truth = made.truth
    return [
        made.scan.points,
        made.scan.no_return,
        made.scan.directions,
        made.scan.point_time_ns,
        made.label,
        made.poses,
        truth.position,
        truth.hits,
        truth.rays,
    ]


def test_the_same_bits_for_any_number_of_threads():
    scene = sim.scenes.demo(1)
    lidar = sim.LidarModel.preset("os1-128", ideal=True, dropout=0.05)
    scene = scene.model_copy(update={"lidar": lidar})
    runs = [sim.Simulator(scene, seed=5, threads=threads) for threads in (1, 2, 5)]
    for number in (3, 0):  # in any order
        first, *others = [arrays_of(run.scan(number)) for run in runs]
        for other in others:
            for a, b in zip(first, other, strict=True):
                assert a.tobytes() == b.tobytes()


def test_other_seeds_and_scans_have_other_noise():
    scene = wall_scene(scans=2, lidar=sim.LidarModel.preset("vlp-16", ideal=True))
    a, b = sim.simulate(scene, seed=0)
    (c,) = sim.simulate(scene, seed=1, scans=1)
    hit = a.label >= 0
    for other in (b, c):
        assert (other.label == a.label).all()
        assert (other.scan.points[..., 0].ravel() != a.scan.points[..., 0].ravel())[
            hit
        ].mean() > 0.9


def test_noise_and_dropout_have_the_stated_distribution():
    std, dropout = 0.05, 0.2
    lidar = sim.LidarModel.preset(
        "os1-128", ideal=True, range_std=std, dropout=dropout, snapshot=True
    )
    clean, noisy = (
        only(wall_scene(lidar=model))
        for model in (
            sim.LidarModel.preset("os1-128", ideal=True, range_std=0.0, snapshot=True),
            lidar,
        )
    )
    hit = clean.label >= 0
    lost = hit & (noisy.label < 0)
    count = hit.sum()
    assert count > 10_000
    share = lost.sum() / count
    assert abs(share - dropout) < 4 * np.sqrt(dropout * (1 - dropout) / count)  # 4 standard errors
    kept = hit & ~lost
    ranges = [
        np.linalg.norm(made.scan.points.reshape(-1, 3)[kept], axis=1) for made in (clean, noisy)
    ]
    errors = (ranges[1] - ranges[0]) / std
    assert stats.kstest(errors, "norm").pvalue > 0.01
    assert abs(np.corrcoef(errors[:-1], errors[1:])[0, 1]) < 4 / np.sqrt(len(errors))
    assert not noisy.scan.no_return[lost].any()
    assert np.isnan(noisy.scan.points.reshape(-1, 3)[lost]).all()


def test_near_surfaces_give_no_information_and_far_ones_no_return():
    lidar = sim.LidarModel.preset(
        "vlp-16", ideal=True, range_min=31.0, range_max=40.0, range_std=0.0
    )
    made = only(wall_scene(lidar=lidar))
    ranges = np.linalg.norm(made.scan.points.reshape(-1, 3), axis=1)
    true = 30.0 / made.scan.directions[:, 0].astype(np.float64)
    far = (true >= 40.001) | (true < 0)
    near = (true > 0) & (true < 30.999)
    assert near.sum() > 100
    assert made.scan.no_return[far].all()
    assert not made.scan.no_return[near].any()
    assert np.isnan(ranges[near]).all()
    between = ~far & ~near & (true > 31.001) & (true < 39.999)
    np.testing.assert_allclose(ranges[between], true[between], atol=1e-4)


@pytest.mark.parametrize(("number", "first", "mean"), [(1, 74_127, 72_128), (2, 98_633, 98_924)])
def test_performance_scene_has_its_known_returns(number, first, mean):
    scene = sim.scenes.performance(scene=number)
    counts = [np.isfinite(made.scan.points[..., 0]).sum() for made in sim.simulate(scene, seed=0)]
    assert counts[0] == first
    assert round(np.mean(counts)) == mean


def test_the_table_of_the_benches_is_the_performance_scene():
    text = (ROOT / "rust/lidar_sim/src/scenes.rs").read_text()
    tables = [
        np.array([[float(number) for number in re.findall(r"-?\d+\.\d+", row)] for row in rows])
        for rows in (
            re.findall(r"\[([^\[\]]+)\]", re.search(rf"const {name}.*?= \[(.*?)\];", text, re.S)[1])
            for name in ("BOXES", "CYLINDERS")
        )
    ]
    bodies = sim.scenes.performance(scene=1).bodies[1:]
    boxes = [[*body.shape.size, *body.position[:2]] for body in bodies[:15]]
    poles = [[b.shape.radius, b.shape.height, *b.position[:2]] for b in bodies[15:]]
    assert (tables[0] == boxes).all()
    assert (tables[1] == poles).all()


@pytest.mark.parametrize("seed", range(10))
def test_demo_flights_keep_what_they_promise(seed):
    scene = sim.scenes.demo(seed)
    simulator = sim.Simulator(scene, seed=seed)
    stamps = np.arange(0, 6_000_000_000, 10_000_000)
    sensor = simulator.sensor.poses_at(stamps)
    speed = np.linalg.norm(np.diff(sensor[:, :3, 3], axis=0), axis=1) / 0.01
    np.testing.assert_allclose(speed, 3.0, rtol=1e-3)
    standing = SimScene(_bodies_of(scene), [], threads=1)
    assert standing.clearance(np.ascontiguousarray(sensor[:, :3, 3]), 10.0).min() > 1.5
    ways = [way.poses_at(stamps)[:, :3, 3].copy() for way in simulator.targets]
    for way in ways:
        assert standing.clearance(way, 10.0).min() > 1.5 + 0.325
        local = np.einsum("nji,nj->ni", sensor[:, :3, :3], way - sensor[:, :3, 3])
        distance = np.linalg.norm(local, axis=1)
        assert distance.min() > 4.8
        assert distance.max() < 20.2
        assert np.abs(np.rad2deg(np.arcsin(local[:, 2] / distance))).max() < 20
        velocity = np.diff(way, axis=0) / 0.01
        assert np.linalg.norm(velocity, axis=1).max() <= 4.0 + 1e-6
    knots = [way[::2] for way in ways]  # every 20 ms
    for way in knots:
        change = np.diff(way, 2, axis=0) / 0.02**2
        assert np.linalg.norm(change, axis=1).max() <= 3.0 + 1e-6
    assert np.linalg.norm(ways[0] - ways[1], axis=1).min() > 1.5 + 2 * 0.325


def _bodies_of(scene):
    bodies = []
    for body in scene.bodies:
        pose = poses(np.array([body.position]), np.array([body.rotation]))[0]
        for shape, place in body.shape.surfaces():
            at = pose.copy()
            at[:3, 3] += place
            bodies.append((shape, at, 0))
    return bodies


@pytest.mark.nightly
def test_demo_drones_are_seen_most_of_the_time():
    seen = []
    for seed in range(10):
        simulator = sim.Simulator(sim.scenes.demo(seed), seed=seed)
        seen += [simulator.scan(number).truth.hits >= 3 for number in range(0, 60, 6)]
    assert np.mean(seen) > 0.9


def test_other_seeds_are_other_worlds():
    a, b = sim.scenes.demo(0), sim.scenes.demo(1)
    assert a != b
    assert a == sim.scenes.demo(0)
    one, two = (sim.Simulator(a, seed=seed).targets[0].poses_at(np.array([0])) for seed in (0, 1))
    assert (one != two).any()


@pytest.mark.parametrize(
    ("name", "shape", "elevation"),
    [
        ("os0-128", (128, 1024), (-45, 45)),
        ("os1-128", (128, 1024), (-22.5, 22.5)),
        ("os2-128", (128, 1024), (-11.25, 11.25)),
        ("vlp-16", (16, 1800), (-15, 15)),
        ("hdl-32e", (32, 2170), (-30.67, 10.67)),
        ("livox-mid360", (20_000,), (-7, 52)),
    ],
)
def test_presets(name, shape, elevation):
    model = sim.LidarModel.preset(name, ideal=True)
    assert model.shape == shape
    scene = sim.Scene(lidar=model, scans=2)
    first, second = sim.simulate(scene, seed=0)
    assert first.scan.points.shape == (*shape, 3)
    assert first.scan.no_return.all()
    directions = first.scan.directions
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-6)
    found = np.rad2deg(np.arcsin(directions[:, 2].astype(np.float64)))
    np.testing.assert_allclose((found.min(), found.max()), elevation, atol=0.1)
    repeats = (first.scan.directions == second.scan.directions).all()
    assert repeats == (name != "livox-mid360")
    assert first.scan.point_time_ns.max() < 100_000_000 <= second.scan.point_time_ns.min()


def test_a_rosette_covers_its_field_of_view_with_time():
    scene = sim.Scene(lidar=sim.LidarModel.preset("livox-mid360", ideal=True), scans=5)
    cells = set()
    shares = []
    for made in sim.simulate(scene, seed=0):
        x, y, z = made.scan.directions.T.astype(np.float64)
        azimuth, elevation = np.rad2deg(np.arctan2(y, x)), np.rad2deg(np.arcsin(z))
        cells |= set(zip(azimuth.astype(int), elevation.astype(int), strict=True))
        shares.append(len(cells) / (360 * 59))
    assert shares[0] < 0.75
    assert shares[-1] > 0.95


def test_a_preset_can_be_changed_and_named_in_toml(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(
        'scans = 3\n[lidar]\npreset = "vlp-16"\nrange_std = 0.0\n'
        '[[bodies]]\nshape = {kind = "plane"}\n'
        '[[targets]]\nshape = {kind = "hexacopter"}\n'
        'motion = {kind = "take_off", position = [5, 0, 0.5], height = 3}\n'
    )
    scene = sim.Scene.read(path)
    assert scene.lidar.range_std == 0.0
    assert scene.lidar.shape == (16, 1800)
    assert len(list(sim.simulate(scene, seed=0))) == 3
    path.write_text(scene.to_toml())
    assert sim.Scene.read(path) == scene


@pytest.mark.parametrize("scene", [sim.scenes.demo(2), sim.scenes.performance(scene=2)])
def test_scenes_come_back_from_toml(scene, tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(scene.to_toml())
    assert sim.Scene.read(path) == scene


def test_scripted_motions():
    def places(motion, times):
        scene = sim.Scene(sensor=motion, scans=100)
        way = sim.Simulator(scene, seed=0).sensor
        return way.poses_at((np.array(times) * 1e9).astype(np.int64))

    circle = places(sim.Circle(center=(1, 2, 3), radius=2, speed=np.pi), [0, 1, 2])
    np.testing.assert_allclose(circle[:, :3, 3], [[3, 2, 3], [1, 4, 3], [-1, 2, 3]], atol=1e-9)
    np.testing.assert_allclose(circle[:, :3, 0], [[0, 1, 0], [-1, 0, 0], [0, -1, 0]], atol=1e-9)
    rise = places(sim.TakeOff(position=(1, 0, 0), height=3, start=1, speed=1.5), [0, 1, 2.5, 4, 9])
    np.testing.assert_allclose(rise[:, 2, 3], [0, 0, 1.5, 3, 3], atol=1e-9)
    stay = places(sim.Hover(position=(1, 2, 3), rotation=(0, 0, 1, 0)), [0, 5])
    np.testing.assert_allclose(stay[1], [[-1, 0, 0, 1], [0, -1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    loop = places(sim.Loop(center=(0, 0, 1), straight=4, radius=1, speed=1), [0, 4, 4 + np.pi, 20])
    np.testing.assert_allclose(
        loop[:3, :3, 3], [[-2, -1, 1], [2, -1, 1], [2, 1, 1]], atol=1e-4
    )  # knots every 10 ms


def test_a_drone_mesh_fits_its_sphere():
    vertices, faces = sim.hexacopter_mesh(0.325)
    assert np.linalg.norm(vertices, axis=1).max() == pytest.approx(0.325, abs=1e-12)
    assert faces.max() < len(vertices)
    size = np.ptp(vertices, axis=0)
    assert (size[:2] > 0.5).all()
    assert 0.1 < size[2] < 0.4
    seen = only(
        sim.Scene(
            targets=[sim.Target(shape=sim.Hexacopter(), motion=sim.Hover(position=(10, 0, 3)))]
        )
    )
    assert 5 < seen.truth.hits[0] < seen.truth.rays[0] + 1
    assert seen.truth.radius[0] == pytest.approx(0.325)


def test_hidden_targets_have_rays_but_no_hits():
    behind = sim.Target(shape=sim.Sphere(radius=1), motion=sim.Hover(position=(35, 0, 0)))
    above = sim.Target(shape=sim.Sphere(radius=1), motion=sim.Hover(position=(0, 0, 35)))
    before = sim.Target(shape=sim.Sphere(radius=1), motion=sim.Hover(position=(20, 0, 0)))
    level = sim.Hover(position=(0, 0, 0))
    truth = only(wall_scene(targets=[behind, above, before], sensor=level)).truth
    assert truth.id.tolist() == [1, 2, 3]
    assert truth.rays[0] > 0
    assert truth.rays[1] == 0
    assert truth.hits[2] == truth.rays[2] > 0
    assert truth.visible.tolist() == [False, False, True]


NO_ROOM = sim.RandomMotion(box_min=(-1, -1, -1), box_max=(1, 1, 1), clearance=5)


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: sim.LidarModel.preset("os9"), ConfigError, "expected one of os0-32, .*'os9'"),
        (lambda: sim.LidarModel.preset("vlp-16", range_max=0.1), ConfigError, "range_min < range"),
        (lambda: sim.Sphere(radius=0), ConfigError, "radius: .*greater than 0"),
        (lambda: sim.Hover(position=(0, 0, 0), rotation=(0, 0, 0, 2)), ConfigError, "unit quat"),
        (lambda: sim.Waypoints(times=(1, 1), positions=[(0, 0, 0)] * 2), ConfigError, "increasing"),
        (lambda: sim.Waypoints(times=(1,), positions=[(0, 0, 0)] * 2), ConfigError, "as many"),
        (lambda: sim.Scene(weather="rain"), ConfigError, "weather: no such parameter"),
        (lambda: sim.Scene(bodies=[{"shape": {"kind": "cone"}}]), ConfigError, "bodies.0.*shape"),
        (lambda: sim.scenes.performance(scene=3), ConfigError, "scene: expected 1 or 2, got 3"),
        (lambda: sim.simulate(sim.Scene(), seed=-1), ConfigError, "seed: expected 0 to"),
        (lambda: sim.simulate(sim.Scene(), seed=0, scans=0), ConfigError, "scans: expected >= 1"),
        (lambda: sim.simulate(sim.Scene(), seed=0, threads=0), ConfigError, "threads: expected"),
        (lambda: sim.Simulator(sim.Scene(), seed=0).scan(60), ConfigError, "number: expected 0 to"),
        (
            lambda: only(
                sim.Scene(
                    targets=[sim.Target(shape=sim.Sphere(radius=1), motion=NO_ROOM)],
                    sensor=sim.Hover(position=(0, 0, 0)),
                )
            ),
            ConfigError,
            "bounds: expected a box with room",
        ),
        (
            lambda: only(
                sim.Scene(
                    bodies=[sim.Body(shape=sim.Mesh(vertices=[(0, 0, 0)] * 3, faces=[(0, 1, -3)]))]
                )
            ),
            InputError,
            r"faces\[0\]: expected indices of vertices",
        ),
        (
            lambda: only(
                sim.Scene(bodies=[sim.Body(shape=sim.HeightField(heights=[[1, 2], [3]], cell=1))])
            ),
            ConfigError,
            "heights: expected at least 2 x 2",
        ),
        (
            lambda: only(
                sim.Scene(
                    lidar=sim.LidarModel(
                        pattern=sim.Spinning(elevations_deg=[0.0] * 100, columns=65_000)
                    )
                )
            ),
            LimitError,
            "the limit is 4000000",
        ),
    ],
)
def test_errors_name_what_and_why(call, error, text):
    with pytest.raises(error, match=text):
        call()


def models():
    return [
        sim.Body,
        sim.Box,
        sim.Circle,
        sim.Cylinder,
        sim.HeightField,
        sim.Hexacopter,
        sim.Hover,
        sim.LidarModel,
        sim.Loop,
        sim.Mesh,
        sim.Plane,
        sim.RandomMotion,
        sim.Rosette,
        sim.Scene,
        sim.Sphere,
        sim.Spinning,
        sim.TakeOff,
        sim.Target,
        sim.Tree,
        sim.Waypoints,
    ]


@pytest.mark.parametrize("model", models(), ids=lambda model: model.__name__)
def test_every_parameter_states_its_unit(model):
    for name, field in model.model_fields.items():
        if name != "kind":
            assert re.search(r"\[.+\]|\(no unit\)|for units\)", field.description), name


def test_the_elevations_of_a_rosette_ascend():
    assert sim.Rosette(elevation_deg=(-7, 52)).elevation_deg == (-7, 52)
    for wrong in [(52, -7), (1, 1)]:
        with pytest.raises(ConfigError, match="lowest < highest"):
            sim.Rosette(elevation_deg=wrong)


@pytest.mark.parametrize("suffix", [".npz", ".mcap"])
def test_a_recording_reads_back_as_it_was_simulated(suffix, tmp_path):
    scene = sim.scenes.demo(4).model_copy(
        update={
            "lidar": sim.LidarModel.preset("vlp-16", ideal=True),
            "start_ns": 1_700_000_000_000_000_000,
        }
    )
    done = sim.record(scene, tmp_path / f"flight{suffix}", seed=3, scans=4)
    made = list(sim.simulate(scene, seed=3, scans=4))
    with open_recording(done.recording) as recording:
        read = list(posed_scans(recording))
    assert len(read) == done.scans == 4
    for posed, expected in zip(read, made, strict=True):
        scan = posed.scan
        assert scan.stamp_ns == expected.scan.stamp_ns
        np.testing.assert_array_equal(
            scan.points.reshape(-1, 3), expected.scan.points.reshape(-1, 3)
        )
        assert (scan.no_return == expected.scan.no_return).all()
        assert (scan.point_time_ns == expected.scan.point_time_ns).all()
        start = posed.pose_stamps_ns.tolist().index(scan.stamp_ns)
        np.testing.assert_allclose(
            posed.world_from_lidar[start], expected.world_from_lidar, rtol=0, atol=1e-9
        )
    rows = np.genfromtxt(done.truth, delimiter=",", names=True)
    assert len(rows) == 8
    np.testing.assert_array_equal(rows["hits"].reshape(4, 2), [m.truth.hits for m in made])
    np.testing.assert_array_equal(rows["x"].reshape(4, 2), [m.truth.position[:, 0] for m in made])
    assert done.target_hits == rows["hits"].sum()
    assert done.points == sum((m.label >= 0).sum() for m in made)
    assert sim.Scene.read(done.scene) == scene.model_copy(update={"scans": 4})


def test_a_street_keeps_given_places_clear():
    places = np.array([[0.0, 0.0], [10.0, 5.0], [10.0, 7.0]])
    bodies = sim.scenes.street(3, keep_clear=places, clearance=2.5)
    assert len(bodies) == 1 + 15 + 15 + 10
    for body in bodies[1:]:
        shape = body.shape
        reach = {
            "box": lambda s: np.hypot(*s.size[:2]) / 2,
            "cylinder": lambda s: s.radius,
            "tree": lambda s: s.crown_radius,
        }[shape.kind](shape)
        assert (np.hypot(*(places - body.position[:2]).T) > reach + 2.5).all()
    assert bodies == sim.scenes.street(3, keep_clear=places, clearance=2.5)
    assert bodies != sim.scenes.street(4, keep_clear=places, clearance=2.5)


def test_a_street_without_room_says_so():
    grid = np.stack(np.meshgrid(np.arange(-45, 46, 5), np.arange(-45, 46, 5)), -1).reshape(-1, 2)
    with pytest.raises(InputError, match="no room"):
        sim.scenes.street(0, keep_clear=grid, clearance=5.0)
    with pytest.raises(InputError, match="keep_clear"):
        sim.scenes.street(0, keep_clear=[[1, 2, 3]], clearance=5.0)


shuttles = st.builds(
    lambda speed, acceleration, pause, length: sim.Shuttle(
        start=(0, 0, 1), end=(0, length, 1), speed=speed, acceleration=acceleration, pause=pause
    ),
    *[st.floats(0.2, 10)] * 2,
    st.floats(0, 3),
    st.floats(0.5, 30),
)


@given(shuttles)
def test_a_shuttle_keeps_its_speed_and_acceleration_and_reaches_both_ends(shuttle):
    length = shuttle.end[1]
    leg = shuttle.leg(length)
    times, matrices = shuttle.knots(2 * leg + 0.5)
    way = matrices[:, 1, 3]
    assert way.min() >= 0
    assert way.max() <= length
    speed = np.diff(way) / np.diff(times)
    assert np.abs(speed).max() <= shuttle.speed + 1e-6
    turn = np.diff(speed) / np.diff(times)[1:]
    assert np.abs(turn).max() <= shuttle.acceleration * 1.001 + 1e-6
    reach = shuttle.acceleration * 0.01**2
    assert np.interp(leg, times, way) == pytest.approx(length, abs=reach)
    assert np.interp(leg - shuttle.pause, times, way) == pytest.approx(length, abs=reach)
    assert np.interp(2 * leg, times, way) == pytest.approx(0, abs=reach)
    later = shuttle.model_copy(update={"lead": 1.0}).knots(1.0)[1][:, 1, 3]
    np.testing.assert_allclose(later[0], np.interp(1.0, *(times, way)), atol=reach)


def test_a_shuttle_needs_two_places():
    with pytest.raises(ConfigError, match="expected two places"):
        sim.Shuttle(start=(1, 2, 3), end=(1, 2, 3), speed=1, acceleration=1)


# Noise on poses


def pose_errors(noise, *, scans, seed=0):
    """Errors of the poses of successive scans, (scans, K, 6): translations and angles."""
    scene = sim.Scene(lidar=sim.LidarModel(pattern=sim.Spinning(elevations_deg=(0,), columns=1)))
    noisy = sim.NoisyPoses(noise, seed=seed)
    errors = []
    for made in sim.simulate(scene, seed=0, scans=scans):
        seen = noisy.observed(made)
        assert seen.truth is made.truth
        assert (seen.world_from_lidar == seen.poses[0]).all()
        step = np.linalg.inv(made.poses) @ seen.poses
        angles = Rotation.from_matrix(step[:, :3, :3]).as_euler("ZYX")[:, ::-1]
        errors.append(np.hstack([seen.poses[:, :3, 3] - made.poses[:, :3, 3], angles]))
    return np.array(errors)


def test_white_pose_noise_is_one_error_per_scan_of_the_stated_size():
    noise = sim.PoseNoise(position_std=0.1, angle_std_deg=0.5)
    errors = pose_errors(noise, scans=400)
    np.testing.assert_allclose(errors, np.repeat(errors[:, :1], errors.shape[1], axis=1), atol=1e-9)
    std = errors[:, 0].std(axis=0)
    np.testing.assert_allclose(std, np.sqrt(np.diag(noise.covariance)), rtol=0.15)
    assert np.abs(np.corrcoef(errors[:-1, 0].T, errors[1:, 0].T)[:6, 6:]).max() < 0.2


@pytest.mark.nightly
def test_coloured_pose_noise_goes_on_between_scans_and_forgets_itself():
    noise = sim.PoseNoise(position_std=0.1, angle_std_deg=0.0, time_constant=0.5)
    errors = pose_errors(noise, scans=2000)
    assert (errors[:-1, -1] == errors[1:, 0]).all()  # one time, one error
    start = errors[:, 0, :3]
    np.testing.assert_allclose(start.std(axis=0), 0.1, rtol=0.15)
    for lag in (1, 5):
        kept = (start[:-lag] * start[lag:]).mean() / (start**2).mean()
        assert kept == pytest.approx(np.exp(-0.1 * lag / 0.5), abs=0.08)
    assert np.abs(errors[..., 3:]).max() < 1e-9


def test_pose_noise_is_seeded():
    noise = sim.PoseNoise()
    assert (pose_errors(noise, scans=3) == pose_errors(noise, scans=3)).all()
    assert (pose_errors(noise, scans=3) != pose_errors(noise, scans=3, seed=1)).any()


# Steered sensors

places = st.tuples(*[st.floats(-30, 30)] * 3)


@given(
    st.lists(st.tuples(places, places, st.floats(0.05, 0.5)), min_size=1, max_size=6),
    st.floats(0.5, 10),
    st.floats(0.5, 10),
)
def test_a_steered_sensor_keeps_its_limits_and_never_jumps(goals, speed, acceleration):
    steering = sim.Steering(speed_max=speed, acceleration_max=acceleration)
    sensor = sim.SteeredSensor((1, 2, 3), stamp_ns=5_000, steering=steering)
    way, stamps = [np.array([1.0, 2.0, 3.0])], [5_000]
    for goal, drift, seconds in goals:
        flown = sensor.fly(goal, goal_velocity=drift, seconds=seconds)
        steps = stamps[-1] + np.arange(round(seconds * 100) + 1) * 10_000_000
        assert steps[-1] == sensor.stamp_ns
        places_flown = flown.poses_at(steps)[:, :3, 3]
        np.testing.assert_allclose(places_flown[0], way[-1], atol=1e-9)
        way += list(places_flown[1:])
        stamps += steps[1:].tolist()
    velocity = np.diff(way, axis=0) / 0.01
    assert np.linalg.norm(velocity, axis=1).max() <= speed * (1 + 1e-6)
    change = np.diff(velocity, axis=0) / 0.01
    if len(change):
        assert np.linalg.norm(change, axis=1).max() <= acceleration * (1 + 1e-4) + 1e-4


def test_a_steered_sensor_arrives_and_follows_a_moving_goal_without_lag():
    sensor = sim.SteeredSensor((0, 0, 0), stamp_ns=0)
    sensor.fly((5, 0, 2), seconds=10)
    np.testing.assert_allclose(sensor.position, (5, 0, 2), atol=0.01)
    np.testing.assert_allclose(sensor.velocity, 0, atol=0.01)
    sensor.fly((5, 0, 2), goal_velocity=(0, 3, 0), seconds=10)
    np.testing.assert_allclose(sensor.position, (5, 30, 2), atol=0.02)


def test_a_scan_can_be_taken_from_a_steered_sensor():
    scene = sim.Scene(
        bodies=(sim.Body(shape=sim.Plane()),),
        lidar=sim.LidarModel(pattern=sim.Spinning(elevations_deg=(-90,), columns=8), range_std=0),
        sensor=sim.Hover(position=(0, 0, 3)),
    )
    simulator = sim.Simulator(scene, seed=0)
    sensor = sim.SteeredSensor((0, 0, 3), stamp_ns=0)
    way = sensor.fly((0, 0, 9), seconds=0.1)
    made = simulator.scan(0, sensor=way)
    heights = way.poses_at(made.scan.point_time_ns)[:, 2, 3]
    np.testing.assert_allclose(-made.scan.points[0, :, 2], heights, atol=1e-5)
    assert heights[-1] > heights[0] == 3
    assert made.poses[-1, 2, 3] == sensor.position[2]
    assert simulator.scan(0).world_from_lidar[2, 3] == 3


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"goal": (0, 0)}, "goal"),
        ({"goal": (0, 0, np.nan)}, "goal"),
        ({"goal": (0, 0, 0), "goal_velocity": (1, 2)}, "goal_velocity"),
        ({"goal": (0, 0, 0), "seconds": 0.0}, "seconds"),
        ({"goal": (0, 0, 0), "seconds": np.nan}, "seconds"),
    ],
)
def test_a_goal_that_is_none_is_refused(arguments, named):
    sensor = sim.SteeredSensor((0, 0, 0), stamp_ns=0)
    with pytest.raises(InputError, match=named):
        sensor.fly(**{"seconds": 0.1, **arguments})
    assert sensor.stamp_ns == 0
