"""2D scanners in the simulator: rays against the oracle, beams, limbs, ways, truth."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidar_core import ConfigError, sim
from reference import planar

RANGE_TOLERANCE = 3e-4  # [m]: poses between knots are on straight lines, ranges float32
LEVEL_TOLERANCE = 2e-6  # [m]: the same without motion
UTM = {"preset": "utm-30lx", "scan_rate": 20.0, "range_max": 10.0}
LEVEL = sim.Hover(position=(0, 0, 1))


def scanner(**changes):
    return sim.LidarModel.load({**UTM, "range_std": 0.0, **changes})


def cylinder(x, y, radius, motion=None):
    motion = motion or sim.Hover(position=(x, y, 1))
    return sim.Target(shape=sim.Cylinder(radius=radius), motion=motion)


def scene(*targets, lidar=None, sensor=LEVEL, **changes):
    return sim.Scene(targets=targets, lidar=lidar or scanner(), sensor=sensor, **changes)


def sweep(*targets, number=0, seed=0, **changes):
    return sim.Simulator(scene(*targets, **changes), seed=seed).sweep(number)


def bearings(scan):
    return scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))


# Rays


@settings(max_examples=20, deadline=None)
@given(number=st.integers(0, 90), x=st.floats(1.5, 7), y=st.floats(-4, 4), r=st.floats(0.1, 0.6))
def test_tilted_rays_meet_cylinders_where_the_oracle_says(number, x, y, r):
    made = sweep(
        cylinder(x, y, r), number=number, scans=100, sensor=sim.Swinging(position=(0, 0, 1))
    )
    scan = made.scan
    times = (scan.stamp_ns + np.arange(len(scan.ranges)) * scan.time_increment_ns) * 1e-9
    expected = np.array(
        [
            planar.range_to_cylinder(planar.swinging_pose(t, 1.0), bearing, (x, y), r)
            for t, bearing in zip(times, bearings(scan), strict=True)
        ]
    )
    expected[expected >= 10] = np.inf
    both = np.isfinite(expected) & np.isfinite(scan.ranges)
    assert (np.isfinite(expected) != np.isfinite(scan.ranges)).sum() <= 2  # grazing rays
    error = np.abs(scan.ranges[both] - expected[both])
    assert error.max(initial=0) < 0.02  # at grazing rays
    assert not both.any() or np.median(error) < RANGE_TOLERANCE


@settings(max_examples=20, deadline=None)
@given(x=st.floats(2, 7), turn=st.floats(0, 3), a=st.floats(0.1, 0.5), b=st.floats(0.1, 0.5))
def test_level_rays_meet_ellipses_where_the_oracle_says(x, turn, a, b):
    motion = sim.Hover(position=(x, 0.3, 1), rotation=(0, 0, np.sin(turn / 2), np.cos(turn / 2)))
    target = sim.Target(shape=sim.EllipticCylinder(half_axes=(a, b)), motion=motion)
    scan = sweep(target).scan
    expected = np.array(
        [
            planar.ellipse_range((0, 0), bearing, (x, 0.3), turn, (a, b))
            for bearing in bearings(scan)
        ]
    )
    both = np.isfinite(expected) & np.isfinite(scan.ranges)
    assert both.any()
    assert (np.isfinite(expected) != np.isfinite(scan.ranges)).sum() <= 1  # a tangent
    np.testing.assert_allclose(scan.ranges[both], expected[both], atol=1e-4)


def test_rays_have_their_own_time():
    moving = sim.Waypoints(times=(0, 1), positions=((4, -2, 1), (4, 2, 1)))
    made = sweep(cylinder(4, 0, 0.3, moving), number=10)
    scan = made.scan
    assert scan.time_increment_ns == round(0.01875e9 / 1080)
    hit = np.flatnonzero(np.isfinite(scan.ranges))
    angle = bearings(scan)[hit]
    points = scan.ranges[hit, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    seconds = (scan.stamp_ns + hit * scan.time_increment_ns) * 1e-9
    centers = np.stack([np.full(len(hit), 4.0), -2 + 4 * seconds], axis=-1)
    np.testing.assert_allclose(np.linalg.norm(points - centers, axis=1), 0.3, atol=LEVEL_TOLERANCE)
    still = sweep(cylinder(4, 0, 0.3, moving), number=10, lidar=scanner(snapshot=True))
    assert still.scan.time_increment_ns == 0


def test_limits_are_misses_beyond_and_no_information_before():
    near, far = cylinder(0.1, 0, 0.05), cylinder(0, 9.9, 0.5)
    lidar = sim.LidarModel.load(UTM)
    for number in range(3):
        made = sweep(near, far, number=number, lidar=lidar)
        ranges = made.scan.ranges
        assert np.isnan(ranges).sum() > 100
        found = ranges[np.isfinite(ranges)]
        assert ((found >= np.float32(0.1)) & (found < 10)).all()
        np.testing.assert_array_equal(made.label == -1, ~np.isfinite(ranges))
        assert made.truth.hits[0] == 0
        assert made.truth.hits[1] > 10


def test_noise_has_the_stated_deviation():
    lidar = sim.LidarModel.load({**UTM, "range_std": 0.02})
    wall = sim.Body(shape=sim.Box(size=(0.1, 30, 3)), position=(4, 0, 1))
    noisy = [sweep(bodies=(wall,), lidar=lidar, number=n).scan.ranges for n in range(10)]
    exact = sweep(bodies=(wall,), lidar=scanner()).scan.ranges
    both = [np.isfinite(exact) & np.isfinite(ranges) for ranges in noisy]
    pairs = zip(noisy, both, strict=True)
    error = np.concatenate([ranges[where] - exact[where] for ranges, where in pairs])
    assert len(error) > 4000
    assert np.std(error) == pytest.approx(0.02, rel=0.05)  # 4 standard errors


def test_the_same_bits_for_any_number_of_threads_and_any_order():
    world = sim.scenes.demo(seed=1).model_copy(update={"lidar": sim.LidarModel.load(UTM)})
    one = sim.Simulator(world, seed=3)
    three = sim.Simulator(world, seed=3, threads=3)
    for number in (5, 0):
        a, b = one.sweep(number), three.sweep(number)
        assert a.scan.ranges.tobytes() == b.scan.ranges.tobytes()
        np.testing.assert_array_equal(a.label, b.label)
    (first,) = sim.sweeps(world, seed=3, scans=1)
    assert first.scan.ranges.tobytes() == a.scan.ranges.tobytes()
    assert sim.Simulator(world, seed=4).sweep(0).scan.ranges.tobytes() != a.scan.ranges.tobytes()


# Beams


def edges(made):
    """Bearings of the first and last ray on the object with the greatest label."""
    angle = bearings(made.scan)[made.label == made.label.max()]
    return angle.min(), angle.max()


@pytest.mark.parametrize("half_width", [0.004, 0.01])
def test_a_wide_beam_sees_objects_wider_by_its_width(half_width):
    lidar = scanner(beam={"half_width": half_width, "lines": 33})
    line, wide = sweep(cylinder(5, 0, 0.3)), sweep(cylinder(5, 0, 0.3), lidar=lidar)
    (a, b), (c, d) = edges(line), edges(wide)
    step = line.scan.angle_increment
    assert a - c == pytest.approx(half_width, abs=step)
    assert d - b == pytest.approx(half_width, abs=step)
    middle = np.argmin(np.abs(bearings(line.scan)))
    assert wide.scan.ranges[middle] == pytest.approx(4.7, abs=1e-4)


@pytest.mark.parametrize(
    ("returns", "behind", "mixed"),
    [
        ("first", 0.2, False),
        ("mean", 0.2, True),
        ("mean", 2, True),
        ("mixed", 0.2, True),
        ("mixed", 2, False),
    ],
)
def test_pixels_mix_at_edges_as_the_option_says(returns, behind, mixed):
    beam = {"half_width": 0.006, "returns": returns, "pulse_length": 0.5}
    wall = sim.Body(shape=sim.Box(size=(0.1, 30, 3)), position=(4 + behind + 0.05, 0, 1))
    front = sim.Target(shape=sim.Box(size=(0.02, 1, 3)), motion=sim.Hover(position=(4, 0, 1)))
    made = sweep(front, bodies=(wall,), lidar=scanner(beam=beam))
    x = made.scan.ranges * np.cos(bearings(made.scan))
    at_edge = (np.abs(bearings(made.scan)) < 0.2) & (x > 4.04) & (x < 4 + 0.9 * behind)
    assert at_edge.any() == mixed


def test_a_beam_of_one_surface_only_is_a_line():
    wall = sim.Body(shape=sim.Plane(), position=(4, 0, 1), rotation=(0, 0.5**0.5, 0, 0.5**0.5))
    line = sweep(bodies=(wall,)).scan.ranges
    wide = sweep(
        bodies=(wall,), lidar=scanner(beam={"half_width": 0.002, "returns": "mean"})
    ).scan.ranges
    straight = np.abs(bearings(sweep().scan)) < 0.5
    np.testing.assert_allclose(wide[straight], line[straight], atol=1e-3)


# Truth


def test_the_truth_tells_what_hides_what():
    made = sweep(cylinder(3, 0, 0.3), cylinder(6, 0, 0.3), cylinder(4, 3, 0.15))
    truth = made.truth
    assert truth.kind == ("cylinder",) * 3
    np.testing.assert_array_equal(truth.radius, [0.3, 0.3, 0.15])
    np.testing.assert_allclose(truth.center, [[3, 0], [6, 0], [4, 3]])
    np.testing.assert_allclose(truth.velocity, 0)
    np.testing.assert_array_equal(truth.visible_share, [1, 0, 1])
    expected = 2 * np.arcsin(0.3 / np.array([3.0, 6.0])) / np.deg2rad(0.25)
    np.testing.assert_allclose(truth.rays[:2], expected, atol=1)
    np.testing.assert_array_equal(truth.hits, [(made.label == name).sum() for name in truth.id])


def test_a_person_is_one_object_whose_arms_swing():
    person = sim.Target(shape=sim.Person(), motion=sim.Hover(position=(3, 0, 0)))
    simulator = sim.Simulator(scene(person, scans=40), seed=0)
    shares, fronts = [], []
    for number in range(22):  # one swing
        made = simulator.sweep(number)
        assert made.truth.kind == ("person",)
        assert np.isnan(made.truth.radius[0])
        assert made.truth.hits[0] == made.truth.rays[0] > 30
        angle = bearings(made.scan)
        y, x = made.scan.ranges * np.sin(angle), made.scan.ranges * np.cos(angle)
        left = (y > 0.19) & (y < 0.3)
        fronts.append(x[left].min())
        shares.append(np.nanmax(np.abs(y[np.isfinite(y)])))
    assert np.ptp(fronts) > 0.25  # 0.44 m below the shoulder, 25 deg to either side
    assert max(shares) == pytest.approx(0.18 + 0.01 + 2 * 0.045, abs=0.02)


def test_limbs_do_not_move_the_truth():
    walk = sim.Waypoints(times=(0, 4), positions=((3, -2, 0), (3, 2, 0)))
    person = sim.Target(shape=sim.Person(), motion=walk)
    made = sweep(person, number=20, scans=40)
    np.testing.assert_allclose(made.truth.center, [[3, -1]], atol=1e-9)
    np.testing.assert_allclose(made.truth.velocity, [[0, 1]], atol=1e-9)


def test_a_barrel_is_round_and_stands_on_the_ground():
    ground = sim.Body(shape=sim.Plane())
    barrel = sim.Target(shape=sim.Barrel(), motion=sim.Hover(position=(3, 0, 0)))
    over, through = (sim.Hover(position=(0, 0, z)) for z in (0.9, 0.5))
    assert sweep(barrel, bodies=(ground,), sensor=over).truth.hits[0] == 0
    made = sweep(barrel, bodies=(ground,), sensor=through)
    assert made.truth.radius[0] == 0.286
    assert made.scan.ranges.min() == pytest.approx(3 - 0.286, abs=1e-4)


def test_clouds_of_people_count_them_once():
    person = sim.Target(shape=sim.Person(), motion=sim.Hover(position=(5, 0, 0)))
    world = sim.Scene(targets=(person,), lidar=sim.LidarModel.preset("vlp-16", ideal=True))
    made = next(sim.simulate(world, seed=0, scans=1))
    assert made.truth.hits[0] == made.truth.rays[0] > 10
    assert 0.8 < made.truth.radius[0] < 1.8


# Ways


def places(motion, seconds=20.0):
    times, frames = motion.knots(seconds)
    return times, frames[:, :3, 3]


def test_a_figure_eight_has_its_size_and_greatest_speed():
    times, way = places(sim.FigureEight(center=(4, 0, 1), speed=1.0), 40)
    np.testing.assert_allclose(np.abs(way - [4, 0, 1]).max(axis=0), [1.25, 2.5, 0], atol=1e-3)
    speed = np.linalg.norm(np.diff(way, axis=0), axis=1) / np.diff(times)
    assert speed.max() == pytest.approx(1.0, abs=1e-3)
    assert speed[0] == pytest.approx(1.0, abs=1e-3)


def test_stop_and_go_rests_and_turns_back():
    times, way = places(sim.StopAndGo(start=(4, -3, 1), velocity=(0, 1, 0)), 30)
    at = {
        second: way[times.searchsorted(second - 1e-9)][1] for second in (0, 1, 3, 4, 6, 10, 16, 22)
    }
    expected = {0: -3, 1: -2.5, 3: -0.5, 4: 0, 6: 0, 10: 3, 16: 0, 22: -3}
    assert at == pytest.approx(expected, abs=1e-9)
    speed = np.diff(way[:, 1]) / np.diff(times)
    assert np.abs(speed).max() == pytest.approx(1.0)
    assert np.abs(np.diff(speed)).max() <= 0.01 + 1e-9  # 1 m/s2 at steps of 0.01 s


def test_wandering_stays_inside_and_has_its_speed():
    found = []
    for seed in range(4):
        motion = sim.Wandering(start=(4, 0, 1), speed=1.0, seed=seed)
        times, way = places(motion, 120)
        assert (way[:, :2] >= [1.5, -4]).all()
        assert (way[:, :2] <= [7, 4]).all()
        velocity = np.diff(way[:, :2], axis=0) / np.diff(times)[:, None]
        found.append(np.mean(np.sum(velocity[4000:] ** 2, axis=1)))
    assert np.sqrt(np.mean(found)) == pytest.approx(1.0, rel=0.2)
    again = places(sim.Wandering(start=(4, 0, 1), speed=1.0, seed=3), 120)[1]
    np.testing.assert_array_equal(again, way)


def test_a_swinging_sensor_is_the_one_of_the_oracle():
    times, frames = sim.Swinging(position=(0, 0, 1)).knots(10)
    for index in range(0, len(times), 83):
        np.testing.assert_allclose(
            frames[index], planar.swinging_pose(times[index], 1.0), atol=1e-12
        )


# Refusals


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: scanner(pattern={"kind": "planar", "sweep_time": 0.1}), "within 1 / scan_rate"),
        (lambda: scanner(beam={"half_width": 0}), "half_width"),
        (lambda: sim.FigureEight(center=(0, 0, 0), half_size=(0, 0), speed=1), "not zero"),
        (lambda: sim.Wandering(start=(0, 0, 1), speed=1), "expected a start between"),
        (lambda: sim.Simulator(sim.Scene(), seed=0).sweep(0), "expected a planar one"),
        (lambda: sweep(number=60), "expected 0 to 59"),
        (
            lambda: sweep(lidar=scanner(pattern={"kind": "planar", "angle_increment": 0.01})),
            "at most one turn",
        ),
    ],
)
def test_what_is_no_planar_scene_is_refused(call, text):
    with pytest.raises(ConfigError, match=text):
        call()


@pytest.mark.parametrize("name", ["utm-30lx", "urg-04lx", "lms111"])
def test_presets_turn_about_the_x_axis(name):
    lidar = sim.LidarModel.preset(name, ideal=True)
    made = sweep(cylinder(3, 0, 0.3), lidar=lidar)
    angle = bearings(made.scan)
    assert angle[0] == pytest.approx(-angle[-1])
    assert made.scan.ranges[len(angle) // 2] == pytest.approx(2.7, abs=0.06)
    assert lidar.shape == made.scan.ranges.shape


def test_a_planar_scene_comes_back_from_toml(tmp_path):
    person = sim.Target(shape=sim.Person(), motion=sim.Wandering(start=(4, 0, 0), speed=1.0))
    world = scene(
        person, cylinder(3, 1, 0.3), lidar=scanner(beam={"half_width": 0.002, "returns": "mixed"})
    )
    path = tmp_path / "scene.toml"
    path.write_text(world.to_toml())
    assert sim.Scene.read(path) == world


def test_a_pattern_begins_at_its_azimuth_and_turns_from_scan_to_scan():
    pattern = sim.Spinning(
        elevations_deg=(0,), columns=360, azimuth_start=0.3, azimuth_per_scan=0.02
    )
    room = sim.Body(shape=sim.Box(size=(9.0, 9.0, 9.0)))
    scene = sim.Scene(lidar=sim.LidarModel(pattern=pattern, range_std=0), bodies=(room,))
    for number, made in enumerate(sim.simulate(scene, seed=0, scans=3)):
        first = made.scan.points.reshape(-1, 3)[0]
        assert np.arctan2(first[1], first[0]) == pytest.approx(0.3 + 0.02 * number, abs=1e-6)
