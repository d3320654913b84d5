"""What escorts the sensor is a target, what carries it is the robot; the robot in saved maps."""

import zlib
from dataclasses import replace

import numpy as np
import pytest
from flying_scenes import feed, scans_of, yard

from lidar_core import sim
from lidar_core.errors import FormatError, LimitError
from lidar_core.flying import FlyingObjectDetector
from lidar_core.flying.voxel_map import VoxelMap
from lidar_core.viz import playback_picture
from lidar_core.viz.drawing.frame import Window
from lidar_core.viz.pictures import flying_picture
from lidar_core.viz.playback import Moment, Objects
from lidar_core.viz.views import FlyingView

BACKGROUND, FLYING, UNKNOWN, OWN = 1, 2, 3, 5
KNOTS_PER_S = 20
ROOF = sim.Body(shape=sim.Box(size=(1.2, 1.2, 0.1)), position=(-0.3, 0.0, -0.5))
MAST = sim.Body(shape=sim.Box(size=(0.3, 0.3, 1.2)), position=(-1.6, 0.0, 0.0))
BURN_IN, SETTLED = 1.5, 3.0
"""Seconds before which nothing is reported, and from which on a target has to be tracked."""


def yaw_rate(seconds, rng):
    """Straight for a third of the time, a turn of 90 degrees, then bends to both sides [rad/s]."""
    times = np.arange(0.0, seconds + 1.0, 1 / KNOTS_PER_S)
    rate = np.zeros(len(times))
    third, side = seconds / 3, rng.choice([-1.0, 1.0])
    turning = (times >= third) & (times < third + 6.0)
    rate[turning] = side * np.pi / 12
    bends = times >= 2 * third
    rate[bends] = -side * 0.25 * np.sin(2 * np.pi * (times[bends] - 2 * third) / 12.0)
    return times, rate


def drive(seconds, rng, *, straight=False):
    """Way of a sensor at 2 m/s: times, places, headings."""
    times, rate = yaw_rate(seconds, rng)
    heading = np.cumsum(0 * rate if straight else rate) / KNOTS_PER_S
    steps = 2.0 / KNOTS_PER_S * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    places = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)[:-1]])
    return times, np.column_stack([places, np.full(len(times), 2.0)]), heading


def motion(times, places, heading):
    half = heading / 2
    quaternions = np.column_stack([0 * half, 0 * half, np.sin(half), np.cos(half)])
    return sim.Waypoints(
        times=tuple(times.tolist()),
        positions=tuple(map(tuple, places.tolist())),
        rotations=tuple(map(tuple, quaternions.tolist())),
    )


def beside(places, heading, offset):
    """Places at `offset` in the frame of the sensor; one row, or one per place."""
    offset = np.broadcast_to(offset, places.shape)
    c, s = np.cos(heading), np.sin(heading)
    turned = [c * offset[:, 0] - s * offset[:, 1], s * offset[:, 0] + c * offset[:, 1]]
    return places + np.column_stack([*turned, offset[:, 2]])


def houses_along(places, rng):
    """Houses and poles, 9 m and more from the way, with gaps of sky."""
    found = [sim.Body(shape=sim.Plane(size=(400.0, 400.0)))]
    while len(found) < 40:
        at = places[rng.integers(len(places)), :2] + rng.uniform(-25, 25, 2)
        wide, high = rng.uniform(3, 8, 2), rng.uniform(3, 9)
        if np.linalg.norm(places[:, :2] - at, axis=1).min() > 9 + np.linalg.norm(wide) / 2:
            shape = sim.Box(size=(*wide.tolist(), high))
            found.append(sim.Body(shape=shape, position=(*at.tolist(), high / 2)))
    return tuple(found)


def escort(seconds, *, seed, preset, distance, straight=False, own=(ROOF,), sway=0.0, joins=0.0):
    """Scans of a drone that keeps its place abeam, as the driver of the sensor delivers them.

    It sways about its place [m], and comes there from 20 m away within 3 s after `joins` [s].
    """
    rng = np.random.default_rng([20240607, seed])
    times, places, heading = drive(seconds, rng, straight=straight)
    abeam = np.array([rng.uniform(-0.5, 0.5), rng.choice([-1.0, 1.0]) * distance, 0.3])
    offset = np.tile(abeam, (len(times), 1))
    phases = rng.uniform(0, 2 * np.pi, 3)
    offset += sway * np.sin(times[:, None] * (1.1, 0.7, 0.9) + phases)
    if joins:
        away = np.clip((joins + 3.0 - times) / 3.0, 0.0, 1.0)
        offset[:, 1] += np.sign(abeam[1]) * (20.0 - distance) * away
    path = beside(places, heading, offset)
    flight = sim.Waypoints(times=tuple(times.tolist()), positions=tuple(map(tuple, path.tolist())))
    lidar = sim.LidarModel.preset(preset)
    return sim.Scene(
        bodies=houses_along(places, rng),
        targets=(sim.Target(shape=sim.Hexacopter(radius=0.45), motion=flight),),
        own_body=own,
        lidar=lidar,
        sensor=motion(times, places, heading),
        scans=round(seconds * lidar.scan_rate),
    )


def frames(scene, *, seed=0, detector=None):
    """Every simulated scan with what the detector says of it."""
    detector = detector or FlyingObjectDetector()
    for made in sim.simulate(scene, seed=seed):
        scan = made.scan
        frame = detector.process(
            scan.points,
            made.poses,
            scan.stamp_ns,
            no_return=scan.no_return,
            directions=scan.directions,
            point_time_ns=scan.point_time_ns,
            pose_stamps_ns=made.pose_stamps_ns,
        )
        yield made, frame, detector


def followed(scene, *, since=SETTLED, seed=0):
    """Recall of tracks where the target has 3 returns or more, its ids, and other tracks' ids."""
    seen, found, ids, others = 0, 0, set(), set()
    first_ns = None
    for made, frame, _ in frames(scene, seed=seed):
        first_ns = made.scan.stamp_ns if first_ns is None else first_ns
        away = np.linalg.norm(frame.tracks.position - made.truth.position[0], axis=1)
        ids |= set(frame.tracks.id[away < 1.0].tolist())
        others |= set(frame.tracks.id[away >= 1.0].tolist())
        if (made.scan.stamp_ns - first_ns) * 1e-9 >= since and made.truth.hits[0] >= 3:
            seen, found = seen + 1, found + bool((away < 1.0).any())
    return found / max(seen, 1), seen, ids, others - ids


# --- what escorts the sensor ------------------------------------------------------------------


@pytest.mark.nightly
def test_a_drone_that_escorts_five_metres_abeam_stays_a_target():
    scene = escort(9.0, seed=1, preset="vlp-16", distance=5.0)
    recall, seen, ids, others = followed(scene)
    assert seen > 50
    assert recall >= 0.95
    assert len(ids) == 1
    assert not others


@pytest.mark.nightly
@pytest.mark.parametrize("straight", [False, True])
@pytest.mark.parametrize("preset", ["vlp-16", "hdl-32e", "livox-mid360"])
@pytest.mark.parametrize("seed", [2, 3])
def test_escorts_of_a_minute(seed, preset, straight):
    scene = escort(60.0, seed=seed, preset=preset, distance=5.0, straight=straight)
    recall, seen, ids, others = followed(scene)
    assert seen > 400
    assert recall >= 0.95
    assert len(ids) == 1
    assert not others


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [2, 3])
def test_on_straight_ways_the_robot_is_never_reported(seed):
    scene = escort(40.0, seed=seed, preset="vlp-16", distance=5.0, straight=True)
    scene = scene.model_copy(update={"targets": (), "own_body": (ROOF, MAST)})
    for made, frame, _ in frames(scene):
        assert len(frame.tracks) == 0
        assert len(frame.detections) == 0
        is_own = np.linalg.norm(made.scan.points.reshape(-1, 3), axis=1) < 2.5
        assert not (frame.point_class[is_own] == FLYING).any()
    assert frame.status.own_body > 0.01
    assert not frame.status.own_body_is_decided


def test_droplets_do_not_hide_the_robot_and_are_none():
    """In fog, every voxel beside the robot has returns now and then."""
    fog = sim.scenes.fog_street(1, scans=20)
    shares = [frame.status.own_body for _, frame, _ in frames(fog)]
    assert min(shares[6:]) > 0.07  # 0.14 of the rays
    for _, frame, _ in frames(fog.model_copy(update={"own_body": ()})):
        assert frame.status.own_body == 0


# --- saved maps, limits, shares: cheap scans ---------------------------------------------------

DRIVE = yard(scans=30, sensor=sim.Circle(center=(0.0, 0.0, 3.0), radius=6.0, speed=6.0))
PLATE = np.random.default_rng(1).uniform((-2.2, -0.5, -0.5), (-1.4, 0.5, -0.48), (300, 3))
OTHER_PLATE = PLATE * [-1, 1, 1] + [0.4, 0, 0]


def carried(detector, plate, *, scans=DRIVE.scans, first=0, sensor="lidar"):
    """Frames of a drive on which `plate` goes along with the sensor; its rows are the last."""
    for made in scans_of(DRIVE)[first : first + scans]:
        yield feed(detector, made, sensor=sensor, **with_points(made, plate))


def with_points(made, more):
    scan, count = made.scan, len(more)
    return {
        "points_lidar": np.concatenate([scan.points.reshape(-1, 3), np.float32(more)]),
        "no_return": np.concatenate([scan.no_return, np.zeros(count, bool)]),
        "directions": np.concatenate([scan.directions, np.zeros((count, 3), np.float32)]),
        "point_time_ns": np.concatenate([scan.point_time_ns, np.full(count, scan.stamp_ns)]),
    }


@pytest.fixture(scope="module")
def driven():
    """A detector after a drive with turns, and its last frame."""
    detector = FlyingObjectDetector()
    *_, frame = carried(detector, PLATE)
    return detector, frame


@pytest.fixture(scope="module")
def saved(driven, tmp_path_factory):
    path = tmp_path_factory.mktemp("map") / "map.lcvm"
    driven[0].save_map(path)
    return path


def test_points_on_the_robot_are_told_and_counted_as_a_share_of_the_rays(driven):
    _, frame = driven
    rays = len(frame.point_class)
    own = np.arange(rays - len(PLATE), rays)
    np.testing.assert_array_equal(frame.own_rows, own)
    assert frame.status.own_body == len(PLATE) / rays
    assert set(frame.point_class[own].tolist()) == {UNKNOWN}
    assert set(frame.shown_class[own].tolist()) == {OWN}
    rest = np.setdiff1d(np.arange(rays), own)
    np.testing.assert_array_equal(frame.shown_class[rest], frame.point_class[rest])


def test_a_share_counts_the_rays_that_the_driver_drops():
    """With rows of returns only, the share of the rows is larger; that of the rays is not."""
    detector = FlyingObjectDetector()
    for made in scans_of(DRIVE):
        values = with_points(made, PLATE)
        kept = ~values["no_return"]
        frame = feed(
            detector,
            made,
            points_lidar=values["points_lidar"][kept],
            point_time_ns=values["point_time_ns"][kept],
            no_return=None,
            directions=None,
        )
    of_rows, of_rays = len(PLATE) / kept.sum(), len(PLATE) / len(kept)
    assert of_rows > 1.2 * of_rays
    assert frame.status.own_body < 0.7 * of_rows
    assert frame.status.own_body == pytest.approx(of_rays, rel=0.25)


def test_a_saved_map_knows_the_robot_from_the_first_scan_on(saved, tmp_path):
    detector = FlyingObjectDetector()
    detector.load_map(saved)
    for frame in carried(detector, PLATE, scans=8):
        assert len(frame.own_rows) == len(PLATE)
        assert frame.status.own_body_is_decided
        assert len(frame.tracks) == 0
    other = FlyingObjectDetector()
    other.load_map(saved)
    for frame in carried(other, PLATE, scans=2, sensor="another"):
        assert len(frame.own_rows) == 0
    other.save_map(tmp_path / "again")  # the sensor that was not met stays in the file
    third = FlyingObjectDetector()
    third.load_map(tmp_path / "again")
    assert len(next(carried(third, PLATE)).own_rows) == len(PLATE)


def test_a_map_of_a_sensor_that_sits_elsewhere_forgets_its_robot(saved):
    detector = FlyingObjectDetector()
    detector.load_map(saved)
    for number, frame in enumerate(carried(detector, OTHER_PLATE, scans=6)):
        assert frame.status.own_body_is_decided == (number < 4)
    *_, frame = carried(detector, OTHER_PLATE, first=6)
    assert len(frame.own_rows) == len(OTHER_PLATE)


def test_maps_without_a_robot_are_as_before_and_maps_with_one_are_plain_maps_too(saved, tmp_path):
    detector = FlyingObjectDetector()
    for made in scans_of(DRIVE)[:3]:
        feed(detector, made)
    detector.save_map(tmp_path / "plain")
    content = (tmp_path / "plain").read_bytes()
    assert content[4:8] == (1).to_bytes(4, "little")
    assert content == bytes(detector._detector.map_bytes())
    assert saved.read_bytes()[4:8] == (2).to_bytes(4, "little")
    assert len(VoxelMap.load(saved).occupied_points()) > 100


def test_hostile_maps_leave_the_detector_as_it_was(saved, tmp_path):
    content = saved.read_bytes()
    detector = FlyingObjectDetector()
    list(carried(detector, PLATE, scans=3))
    before = bytes(detector._detector.map_bytes())
    for at in range(len(content) - 5, len(content) - 120, -28):  # high bytes of places of voxels
        hostile = bytearray(content[:-4])
        hostile[at] ^= 0x80
        (tmp_path / "map").write_bytes(hostile + zlib.crc32(hostile).to_bytes(4, "little"))
        with pytest.raises(FormatError, match=r"map.*byte|byte"):
            detector.load_map(tmp_path / "map")
        assert bytes(detector._detector.map_bytes()) == before


def test_names_of_sensors_are_limited():
    """Each costs memory for good: a name per scan would fill it."""
    detector = FlyingObjectDetector()
    points = np.array([[5.0, 0.0, 0.0]], np.float32)
    for number in range(64):
        detector.process(points, np.eye(4), number, sensor=f"lidar {number}")
    before = bytes(detector._detector.map_bytes())
    with pytest.raises(LimitError, match=r"sensor \"lidar 64\".*limit is 64.*one name"):
        detector.process(points, np.eye(4), 64, sensor="lidar 64")
    assert bytes(detector._detector.map_bytes()) == before
    detector.process(points, np.eye(4), 65, sensor="lidar 0")
    assert detector.health().processed == 65


def test_a_part_that_comes_into_sight_late_becomes_the_robot():
    """A leg that was folded: tracked at most for a while."""
    detector, leg = FlyingObjectDetector(), PLATE * [0.3, 0.3, 1] + [1.2, 0.0, 0.3]
    for number, made in enumerate(scans_of(DRIVE)):
        plates = [PLATE, leg] if number >= 8 else [PLATE]
        frame = feed(detector, made, **with_points(made, np.concatenate(plates)))
    assert len(frame.own_rows) == len(PLATE) + len(leg)
    assert len(frame.tracks) == 0


def test_the_own_body_has_a_colour_and_a_legend_entry():
    figure_module = pytest.importorskip("matplotlib.figure")
    view = FlyingView(
        title="",
        cloud=np.zeros((4, 3)),
        cloud_class=np.array([BACKGROUND, UNKNOWN, OWN, OWN], np.uint8),
        flying=np.zeros((1, 3)),
        occupied=np.zeros((1, 3)),
        voxel_size=0.25,
        sensor=np.empty((0, 3)),
        stamp_ns=np.empty(0, np.int64),
        tracks=[],
        n_detections=np.empty(0, np.int64),
    )
    for classes, is_named in ((view.cloud_class, True), (view.cloud_class[:2], False)):
        figure = figure_module.Figure()
        shown = replace(view, cloud=view.cloud[: len(classes)], cloud_class=classes)
        flying_picture._compose(figure, shown)
        texts = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
        assert ("own body, last scan" in texts) == is_named
    nothing = Objects(
        id=np.empty(0, np.int64),
        position=np.empty((0, 3)),
        covariance=np.empty((0, 3, 3)),
        size=np.empty((0, 3)),
        velocity=np.empty((0, 3)),
    )
    moment = Moment(0, np.zeros((4, 3), np.float32), view.cloud_class, nothing)
    panel = figure_module.Figure().add_subplot()
    window = Window(np.array([-1.0, -1.0]), np.array([1.0, 1.0]))
    playback_picture._draw_points(panel, moment, (0, 1), window, (-1.0, 1.0), "scan")
    texts = panel.get_legend_handles_labels()[1]
    assert texts == ["background", "unknown", "own body"]
