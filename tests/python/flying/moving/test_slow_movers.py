"""People on foot and other slow things are MOVING; what stands is not, from a sensor that moves."""

import numpy as np
import pytest
from flying_scenes import feed, lidar, scans_of, yard
from test_ground_movers import BODIES, MOVING, flown, share_moving, walker

from lidar_core import VoxelMap, sim
from lidar_core.flying import FlyingConfig, FlyingObjectDetector
from lidar_core.runs.scans.flying_output import _points_in_world
from reference.movers import Movers, counted, values_of

SIZE = FlyingConfig().voxel_map.voxel_size


def check_against_specification(made, tmp_path):
    """Compare every point of every scan with the numpy reference. Returns movers per scan."""
    detector, wanted, found = FlyingObjectDetector(), Movers(FlyingConfig()), []
    for number, (one, times) in enumerate(made):
        if number:  # a detector without scans has no map
            detector.save_map(tmp_path / "map.lcvm")
            value = values_of(VoxelMap.load(tmp_path / "map.lcvm"), SIZE)
        else:
            value = values_of(VoxelMap(FlyingConfig().voxel_map), SIZE)
        frame = feed(detector, one, **times)
        poses = one.poses.reshape(-1, 4, 4)
        points = _points_in_world(one.scan, poses, one.pose_stamps_ns).astype(np.float32)
        is_mover = wanted.find(points, frame.stamp_ns * 1e-9, value)
        both, *others = counted(is_mover, frame.point_class == MOVING)
        assert others == [0, 0], f"scan {number}"
        found.append(both)
    return np.array(found)


@pytest.mark.ci_cases("1.3")
@pytest.mark.parametrize("speed", [1.3, 3.0, 0.6], ids=str)
def test_moving_points_are_those_of_the_specification(speed, tmp_path):
    target = walker((6.0, -3.0), (6.0, 1.0), speed=speed, wait=1.2)
    small = lidar(32, columns=360, half_deg=30.0)
    made = scans_of(yard(target, scans=round(20 + 8 / speed), bodies=BODIES, lidar=small))
    found = check_against_specification(((one, {}) for one in made), tmp_path)
    assert found.sum() > 100


POST = sim.Body(shape=sim.Cylinder(radius=0.15, height=2.2), position=(6.0, 1.0, 1.1))


@pytest.mark.ci_cases("0.3")
@pytest.mark.parametrize("period", [0.1, 0.3, 1.0], ids=str)
def test_what_is_seen_now_and_then_stands(period, tmp_path):
    """A post that every eighth scan shows: gaps of 0.8 to 8 s."""
    small = lidar(32, columns=360, half_deg=30.0)
    with_post = scans_of(yard(scans=44, bodies=(*BODIES, POST), lidar=small))
    without = scans_of(yard(scans=44, bodies=BODIES, lidar=small))
    is_shown = np.arange(44) % 8 == 7
    is_shown[:20] = False

    def scans():
        for number, shown in enumerate(is_shown):
            one = with_post[number] if shown else without[number]
            times = {"stamp_ns": round(number * period * 1e9), "point_time_ns": None}
            pose = one.poses.reshape(-1, 4, 4)[0]
            yield one, {**times, "world_from_lidar": pose, "pose_stamps_ns": None}

    found = check_against_specification(scans(), tmp_path)
    looks = np.flatnonzero(is_shown)
    assert found[looks[0]] > 10  # something new, which may move
    assert not found[looks[2:]].any()


@pytest.mark.ci_cases("1.3-10")
@pytest.mark.parametrize(
    ("speed", "scan_rate"),
    [(1.3, 10.0), (0.8, 10.0), (2.0, 10.0), (1.3, 5.0)],
    ids=["1.3-10", "0.8-10", "2.0-10", "1.3-5"],
)
def test_a_person_on_foot_moves_and_does_not_before(speed, scan_rate):
    wait, scans = 2.0, round((2.0 + 3.0) * scan_rate)
    target = walker((6.0, -3.0), (6.0, 3.0), speed=speed, wait=wait)
    _, frames, rows, _ = flown(target, scans, scan_rate=scan_rate)
    start = round((wait + 0.6 / speed) * scan_rate)  # it has gone by two voxels
    share, others = share_moving(frames, rows, start)
    assert share >= 0.75
    assert others <= 40  # ground and pole where it passes
    before = frames[: round(wait * scan_rate)]
    assert not any((frame.point_class == MOVING).any() for frame in before)


def shares_of(scene, *, seed):
    """Shares of MOVING among the points of people within 20 m, and of people among MOVING."""
    detector, n_static = FlyingObjectDetector(), len(scene.bodies)
    moving_people = people = moving = 0
    for one in sim.simulate(scene, seed=seed):
        frame = feed(detector, one)
        is_moving, label = frame.point_class == MOVING, one.label.reshape(-1)
        reach = np.linalg.norm(one.scan.points.reshape(-1, 3), axis=1)
        is_person = (label >= n_static) & (reach < 20.0)
        moving += int(is_moving.sum())
        if frame.status.gate_open:
            people += int(is_person.sum())
            moving_people += int((is_moving & is_person).sum())
    return moving_people / people, moving_people / moving


def with_people(scene, seed, *, speed=1.3, count=5):
    """The scene with people who walk to and fro."""
    rng = np.random.default_rng(seed)
    targets = []
    for _ in range(count):
        one, way = rng.uniform([-8, -8], [12, 8]), rng.uniform(0, 2 * np.pi)
        other = one + rng.uniform(2, 6) * np.array([np.cos(way), np.sin(way)])
        span = float(np.linalg.norm(other - one)) / speed
        times = tuple(span * number for number in range(20))
        places = tuple((*(one, other)[number % 2], 0.0) for number in range(20))
        motion = sim.Waypoints(times=times, positions=places)
        targets.append(sim.Target(shape=sim.Person(height=1.75), motion=motion, clutter=True))
    return scene.model_copy(update={"targets": tuple(targets)})


@pytest.mark.ci_cases("0-vlp-16")
@pytest.mark.parametrize("sensor", ["vlp-16", "os1-64"])
@pytest.mark.parametrize("seed", [0, 1])
def test_only_people_move_before_a_sensor_that_flies(seed, sensor):
    model = sim.LidarModel.preset(sensor)
    pattern = model.pattern.model_copy(update={"columns": 512})
    model = model.model_copy(update={"pattern": pattern}) if sensor == "os1-64" else model
    scene = sim.scenes.demo(seed, scans=60).model_copy(update={"lidar": model})
    found, right = shares_of(with_people(scene, seed), seed=seed)
    assert right >= 0.97
    assert found >= (0.35 if sensor == "os1-64" else 0.2)  # many are beside walls


@pytest.mark.parametrize("velocity", [(0.0, 0.0, 0.1), (0.05, 0.0, 0.0)], ids=["up", "ahead"])
def test_surfaces_do_not_move_where_poses_drift(velocity):
    person = sim.Body(shape=sim.Box(size=(0.6, 0.4, 1.7)), position=(5.0, 2.0, 0.85))
    small = lidar(32, columns=360, half_deg=30.0)
    detector = FlyingObjectDetector()
    for number, one in enumerate(scans_of(yard(scans=100, bodies=(*BODIES, person), lidar=small))):
        poses = np.array(one.poses)
        poses[..., :3, 3] += 0.1 * number * np.array(velocity)
        frame = feed(detector, one, world_from_lidar=poses)
        assert not (frame.point_class == MOVING).any(), f"scan {number}"


@pytest.mark.nightly
def test_hardly_any_point_moves_where_all_stands():
    """Trees in wind do move, but leaves come back to where they were."""
    for scene, most in (
        (sim.scenes.windy_trees(0, scans=100, sensor="vlp-16"), 0.002),
        (sim.scenes.moving_car(0, scans=100), 0.004),
        (sim.scenes.dark_street(0, scans=60), 0.005),
    ):
        detector, moving, returns = FlyingObjectDetector(), 0, 0
        for one in sim.simulate(scene, seed=0):
            moving += int((feed(detector, one).point_class == MOVING).sum())
            returns += int(np.isfinite(one.scan.points.reshape(-1, 3)).all(axis=1).sum())
        assert moving <= most * returns
