"""What moves on the ground: class MOVING, and the map without it."""

from copy import deepcopy
from functools import cache

import numpy as np
import pytest
from flying_scenes import YARD, drone, feed, lidar, scans_of, yard

from lidar_core import PointClass, TrackKind, VoxelMap, sim
from lidar_core.errors import ConfigError
from lidar_core.evaluation import score_static_map
from lidar_core.flying import FlyingConfig, FlyingObjectDetector
from lidar_core.runs.scans.flying_output import _points_in_world
from lidar_core.sim import Body, Cylinder, Target, Waypoints
from reference import static_map as reference

MOVING, BACKGROUND = PointClass.MOVING, PointClass.BACKGROUND
BODIES = (*YARD, Body(shape=Cylinder(radius=0.15, height=3.0), position=(5.0, -4.0, 1.5)))


def walker(start, end, *, wait=1.0, speed=3.0):
    """A person who stands, goes straight from place to place, and stands again."""
    arrives = wait + float(np.linalg.norm(np.subtract(end, start))) / speed
    ways = ((*start, 0.0), (*start, 0.0), (*end, 0.0))
    return Target(
        shape=sim.Person(height=1.75),
        motion=Waypoints(times=(0.0, wait, arrives), positions=ways),
        clutter=True,
    )


@cache
def flown(target, scans, *, scan_rate=10.0, maps=False):
    """Scans, frames, rows on the target, and the detector, which also maps what stands."""
    scene = yard(
        target, scans=scans, bodies=BODIES, lidar=lidar(64, half_deg=30.0, scan_rate=scan_rate)
    )
    made = scans_of(scene)
    detector = FlyingObjectDetector(FlyingConfig())
    if maps:
        detector.make_static_map()
    frames = [feed(detector, one) for one in made]
    rows = [one.label.reshape(-1) == len(BODIES) for one in made]
    return made, frames, rows, detector


PASSER = walker((6.0, -3.0), (6.0, 3.0))


def share_moving(frames, rows, since):
    """Share of the points of the target that move, and number of other points that do."""
    moving = [frame.point_class == MOVING for frame in frames]
    own = sum((m & r).sum() for m, r in list(zip(moving, rows, strict=True))[since:])
    all_own = sum(r.sum() for r in rows[since:])
    others = sum((m & ~r).sum() for m, r in zip(moving, rows, strict=True))
    return own / all_own, others


def test_points_of_a_walker_move_and_no_others():
    _, frames, rows, _ = flown(PASSER, 32)
    share, others = share_moving(frames, rows, 18)
    assert share >= 0.6  # feet are beside the ground
    assert others <= 40  # ground and pole where it passes
    assert not any((frame.point_class == MOVING).any() for frame in frames[:10])


def test_what_stands_does_not_move():
    made = scans_of(yard(drone((6.0, 4.0, 3.5), (5.0, 6.0, 4.0)), scans=25))
    detector = FlyingObjectDetector()
    frames = [feed(detector, one) for one in made]
    assert not any((frame.point_class == MOVING).any() for frame in frames)
    assert sum((frame.point_class == PointClass.FLYING).sum() for frame in frames) > 100


def behind_a_screen(*, radius, speed=2.0):
    """Kinds of the track, and classes of the points, of a ball that rises behind a screen.

    The space below it is hidden in every scan. It then flies on a circle of some radius, or, for
    none, straight on as a person walks.
    """
    times = np.arange(0, 5.0, 0.05)
    since = np.maximum(times - 1.8, 0.0)
    rise = 2.0 + 1.9 * np.minimum(times / 1.8, 1.0)
    if radius is None:
        along, aside = np.full(len(since), 0.5), since
    else:
        turn = speed / radius * since
        along, aside = radius * np.cos(turn), radius * np.sin(turn)
    places = np.c_[6.0 + along, aside, rise]
    target = Target(
        shape=sim.Sphere(radius=0.325),
        motion=Waypoints(times=tuple(times), positions=tuple(map(tuple, places))),
    )
    screen = Body(shape=sim.Box(size=(0.2, 10.0, 3.3)), position=(3.0, 0.0, 1.65))
    sensor = lidar(64, columns=720, half_deg=30.0)
    made = scans_of(yard(target, scans=40, bodies=(*YARD, screen), lidar=sensor))
    detector, kinds, classes = FlyingObjectDetector(FlyingConfig()), [], []
    for one in made:
        frame = feed(detector, one)
        kinds.append([TrackKind(kind) for kind in frame.tracks.kind])
        own = frame.point_class[one.label.reshape(-1) == len(YARD) + 1]
        classes.append({PointClass(value) for value in own})
    return kinds, classes


@pytest.mark.nightly
def test_what_manoeuvres_above_hidden_space_flies_and_what_goes_straight_on_does_not():
    for radius, speed in ((0.5, 2.0), (0.35, 1.5)):  # it never leaves what it hides
        kinds, classes = behind_a_screen(radius=radius, speed=speed)
        assert all(one == [TrackKind.FLYING] for one in kinds[28:])
        assert all(one == {PointClass.FLYING} for one in classes[28:])
    kinds, classes = behind_a_screen(radius=None)
    seen = [kind for one in kinds for kind in one]
    assert TrackKind.GROUND in seen
    assert TrackKind.FLYING not in seen
    assert PointClass.FLYING not in set().union(*classes[22:])


def test_a_walker_who_stands_for_long_is_background():
    slow = walker((6.0, -3.0), (6.0, 3.0), wait=6.0)
    _, frames, rows, _ = flown(slow, 42, scan_rate=2.0)
    is_moving = [
        (frame.point_class == MOVING)[own].mean() for frame, own in zip(frames, rows, strict=True)
    ]
    assert np.mean(is_moving[17:20]) > 0.5  # it has just stopped
    assert max(is_moving[-3:]) == 0


def test_paper_mode_has_no_moving_points():
    made, *_ = flown(PASSER, 32)
    detector = FlyingObjectDetector(FlyingConfig.paper())
    frames = [feed(detector, one) for one in made[:20]]
    assert not any((frame.point_class == MOVING).any() for frame in frames)


@pytest.mark.nightly
def test_a_copy_goes_on_to_the_same_points():
    made, *_ = flown(PASSER, 32)
    detector = FlyingObjectDetector(FlyingConfig())
    for one in made[:18]:
        feed(detector, one)
    detector.make_static_map()
    feed(detector, made[18])
    other = deepcopy(detector)
    for one in made[19:22]:
        frame = feed(detector, one)
        assert np.array_equal(feed(other, one).point_class, frame.point_class)
        assert (frame.point_class == MOVING).any()
    assert len(other.static_points())
    assert np.array_equal(other.static_points(), detector.static_points())


def labelled(made, rows):
    """All points in the world, and whether each is of the target."""
    clouds = [
        _points_in_world(one.scan, one.poses.reshape(-1, 4, 4), one.pose_stamps_ns) for one in made
    ]
    points, moved = np.concatenate(clouds), np.concatenate(rows)
    is_point = np.isfinite(points).all(axis=1)
    return points[is_point], moved[is_point]


def test_the_static_map_holds_what_stands_and_nothing_else(tmp_path):
    """Of the walker what is beside the ground stays, and the place where it is at the end."""
    passer = walker((6.0, -3.0), (6.0, 3.0), wait=0.3, speed=6.0)
    made, _, rows, detector = flown(passer, 16, maps=True)
    points, moved = labelled(made, rows)
    passed = moved & (points[:, 2] > 0.5) & (np.abs(points[:, 1]) < 2.0)
    pole = np.linalg.norm(points[:, :2] - (5.0, -4.0), axis=1) < 0.25
    kept = detector.static_points()
    assert score_static_map(kept, points, moved).static_accuracy >= 99
    assert score_static_map(kept, points[pole], moved[pole]).static_accuracy >= 95
    assert passed.sum() > 50
    assert score_static_map(kept, points[passed], moved[passed]).dynamic_accuracy >= 90
    detector.save_static_map(tmp_path / "static.lcvm")
    voxels = VoxelMap.load(tmp_path / "static.lcvm").occupied_points()
    of_voxels = score_static_map(voxels, points, moved, resolution=0.1)
    assert of_voxels.static_accuracy >= 99
    on_way = score_static_map(voxels, points[passed], moved[passed], resolution=0.1)
    assert on_way.dynamic_accuracy >= 85


def test_without_being_asked_for_there_is_no_static_map(tmp_path):
    detector = FlyingObjectDetector()
    assert len(detector.static_points()) == 0
    with pytest.raises(ConfigError, match="make_static_map before the first scan"):
        detector.save_static_map(tmp_path / "static.lcvm")
    assert not (tmp_path / "static.lcvm").exists()


def passing_box(scans):
    """A box that passes before a wall and a floor: points, rays without return, pose."""
    azimuth, elevation = np.deg2rad(np.arange(-40, 40, 0.8)), np.deg2rad(np.arange(-25, 15, 0.7))
    azimuth, elevation = (grid.ravel() for grid in np.meshgrid(azimuth, elevation))
    ways = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    ).T
    rng = np.random.default_rng(1000)
    for k in range(scans):
        place, y = np.array([0.1 * k, 0.0, 0.0]), -3.0 + k
        with np.errstate(divide="ignore"):
            length = np.where(ways[:, 2] < 0, -1.8 / ways[:, 2], np.inf)
            length = np.minimum(length, (12.0 - place[0]) / ways[:, 0])
            at_box = (7.0 - place[0]) / ways[:, 0]
        y_box, z_box = at_box * ways[:, 1], at_box * ways[:, 2]
        length[(np.abs(y_box - y) < 0.4) & (z_box < 0.3) & (at_box < length)] = np.nan
        is_box = np.isnan(length)
        length = np.where(is_box, at_box, length) + rng.normal(0, 0.01, len(ways))
        misses = (ways[:, 2] > 0.2) & ~is_box
        length[misses] = np.nan
        pose = np.eye(4)
        pose[:3, 3] = place
        yield (
            (ways * length[:, None]).astype(np.float32),
            ways.astype(np.float32),
            misses,
            pose,
            is_box,
        )


def test_static_points_are_those_of_the_specification():
    own = {"learn_mask_scans": 0, "find_body": False}
    best = FlyingConfig()
    config = best.model_copy(update={"sensor": best.sensor.model_copy(update=own)})
    detector, given, moved = FlyingObjectDetector(config), [], []
    detector.make_static_map()
    for k, (points, ways, misses, pose, is_box) in enumerate(passing_box(8)):
        named = {"no_return": misses, "directions": ways}
        detector.process(points, pose, 1_000 + k * 100_000_000, **named)
        placed = (points[~misses].astype(float) + pose[:3, 3]).astype(np.float32).astype(float)
        given.append(
            (placed, np.broadcast_to(pose[:3, 3], placed.shape), ways[misses].astype(float))
        )
        moved.append(is_box[~misses])
    found, wanted = detector.static_points(), reference.static_points(given)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9)
    scores = score_static_map(found, np.concatenate([g[0] for g in given]), np.concatenate(moved))
    assert scores.static_accuracy >= 99
    assert scores.dynamic_accuracy >= 90
    assert scores.n_dynamic > 500
