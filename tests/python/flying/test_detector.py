"""The whole detector: against its executable specification, threads, order, place in the world."""

import numpy as np
import pytest
from flying_scenes import VLP_16, drone, feed, scans_of, yard
from scipy.spatial.transform import Rotation

from lidar_core import PointClass
from lidar_core.flying import FlyingConfig, FlyingObjectDetector
from reference import raycast
from reference.detector import Detector as Specification

BACKGROUND, FLYING, UNKNOWN = PointClass.BACKGROUND, PointClass.FLYING, PointClass.UNKNOWN
MOVING = PointClass.MOVING
STEP_NS = 100_000_000
BALL = 0.5  # [m]
# Points are float32: a rotation that differs in the last bit of float64 moves them by this much.
FLOAT_TOLERANCE = 1e-6


# --- executable specification ---------------------------------------------------------------------


def fan(rows=11, columns=26):
    elevation, azimuth = np.meshgrid(
        np.deg2rad(np.linspace(45, -45, rows)), np.linspace(-np.pi, np.pi, columns, endpoint=False)
    )
    run = np.cos(elevation)
    rays = np.stack([run * np.cos(azimuth), run * np.sin(azimuth), np.sin(elevation)], axis=-1)
    return rays.reshape(-1, 3)


def random_world(seed, *, scans=10, stream=False):
    """Scans of a floor, a wall, and balls that drift and vanish, from a sensor that flies."""
    rng = np.random.default_rng(seed)
    body = fan()
    times = np.linspace(0, 0.09, len(body)) * 1e9
    velocity, turn = rng.uniform(-0.4, 0.4, 3), rng.uniform(-0.5, 0.5)
    start = np.array([30.0, -20.0, 4.0]) + rng.uniform(-1, 1, 3)
    heading = rng.uniform(-3, 3)
    balls = start + rng.uniform(1.5, 2.0, (2, 1)) * unit(rng.normal(size=(2, 3)) * [1, 1, 0.2])
    speeds = rng.uniform(-0.6, 0.6, (2, 3))
    wall_x = start[0] + rng.uniform(3.0, 4.0)

    def poses_at(seconds):
        at = np.tile(np.eye(4), (len(seconds), 1, 1))
        angles = np.full((len(seconds), 3), [heading, 0.1 * turn, 0.05])
        angles[:, 0] += turn * seconds
        at[:, :3, :3] = Rotation.from_euler("ZYX", angles).as_matrix()
        at[:, :3, 3] = start + velocity * seconds[:, None]
        return at

    for k in range(scans):
        stamp = 1_000 + k * STEP_NS
        seconds = k * 0.1 + (times * 1e-9 if stream else np.zeros(len(body)))
        poses = poses_at(seconds)
        rays = np.einsum("nij,nj->ni", poses[:, :3, :3], body)
        places = poses[:, :3, 3]
        hits = [
            cast_plane(places, rays, [0, 0, 1], start[2] - 2.2),
            cast_plane(places, rays, [1, 0, 0], wall_x),
        ]
        gone = rng.random(2) < 0.15
        for ball, speed in zip(balls[~gone], speeds[~gone], strict=True):
            at = np.eye(4)
            at[:3, 3] = ball + speed * k * 0.1
            hits.append(raycast.cast(raycast.sphere(BALL), at, places, rays))
        distance = np.min(hits, axis=0)
        no_return = distance > 7.0
        distance = distance + rng.normal(size=len(body)) * 0.02
        points = (body * np.where(no_return, np.nan, distance)[:, None]).astype(np.float32)
        points[rng.random(len(body)) < 0.01] = np.nan
        yield {
            "points": points,
            "poses": poses_at(k * 0.1 + np.array([0.0, 0.1])) if stream else poses[0],
            "stamp": stamp,
            "no_return": no_return,
            "directions": body.astype(np.float32),
            "times": (stamp + times).astype(np.int64) if stream else None,
            "pose_stamps": np.array([stamp, stamp + STEP_NS]) if stream else None,
        }


def unit(rows):
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def cast_plane(origins, rays, normal, offset):
    with np.errstate(divide="ignore"):
        distance = (offset - origins @ np.array(normal)) / (rays @ np.array(normal))
    return np.where(distance > 0, distance, np.inf)


def small(config):
    """`config` for coarse voxels and few rays."""
    return config.model_copy(
        update={
            "voxel_map": config.voxel_map.model_copy(
                update={
                    "voxel_size": 0.5,
                    "max_range": 5.0,
                    "ray_gain": 2.0,
                    "threshold_confident": -100.0,
                }
            ),
            "cluster": config.cluster.model_copy(update={"max_distance": 0.7}),
            "classify": config.classify.model_copy(update={"search_distance": 2.0}),
            "separate": config.separate.model_copy(update={"max_gap": 1.0, "min_confident": 2}),
            "seed": config.seed.model_copy(
                update={
                    "burn_in_scans": 3,
                    "burn_in_period": None,
                    "burn_in_extent": 1.3,
                    "standing_scans": 0,
                }
            ),
            # The specification knows nothing of the robot itself: test_sky.py does.
            "sensor": config.sensor.model_copy(update={"learn_mask_scans": 0, "find_body": False}),
        }
    )


CONFIGS = {"best": FlyingConfig(), "paper": FlyingConfig.paper()}


@pytest.mark.ci_cases("best-True-1", "paper-False-1")
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("stream", [False, True])
@pytest.mark.parametrize("mode", CONFIGS)
def test_the_detector_does_what_the_specification_says(mode, stream, seed):
    config = small(CONFIGS[mode])
    met = {"detections": 0, "tracks": 0, "expected": 0, "classes": set()}
    detector, specification = FlyingObjectDetector(config), Specification(config)
    for scan in random_world(seed + 10 * stream, stream=stream):
        frame = detector.process(
            scan["points"],
            scan["poses"],
            scan["stamp"],
            no_return=scan["no_return"],
            directions=scan["directions"],
            point_time_ns=scan["times"],
            pose_stamps_ns=scan["pose_stamps"],
        )
        expected = specification.process(**scan)
        same(frame, expected)
        met["detections"] += len(frame.detections)
        met["tracks"] += len(frame.tracks)
        met["expected"] += len(specification.expected)
        met["classes"] |= set(frame.point_class.tolist())
    assert met["detections"] > 5
    assert met["tracks"] > 4
    if (mode, stream, seed) == ("best", False, 1):  # only tracks tell them from structure
        assert met["expected"] > 0
    assert met["classes"] - {MOVING} == {0, BACKGROUND, FLYING, UNKNOWN}


def past_an_edge(seed):
    """Scans of a floor, a wall and a ball, from a sensor that looks past a nearer ball."""
    rng, body = np.random.default_rng(seed), fan(18, 60)
    start, turned = np.array([5.0, 8.0, 4.0]), np.eye(4)
    turned[:3, :3] = Rotation.from_euler("z", rng.uniform(-3, 3)).as_matrix()
    drift = rng.uniform(-0.5, 0.5, 3)
    for k in range(12):
        pose = turned.copy()
        pose[:3, 3] = start + np.array([0.0, 0.15 * k, 0.0])
        rays, places = body @ pose[:3, :3].T, np.broadcast_to(pose[:3, 3], body.shape)
        hits = [
            cast_plane(places, rays, [0, 0, 1], start[2] - 2.2),
            cast_plane(places, rays, [1, 0, 0], start[0] + 4.0),
        ]
        near, far = np.array([0.8, 1.0, 0.1]), np.array([2.2, 1.4, 0.2]) + drift * 0.1 * k
        for place, radius in ((near, 0.25), (far, 0.4)):
            at = np.eye(4)
            at[:3, 3] = start + place
            hits.append(raycast.cast(raycast.sphere(radius), at, places, rays))
        distance = np.min(hits, axis=0)
        no_return = distance > 7.0
        distance = distance + rng.normal(size=len(body)) * 0.01
        yield {
            "points": (body * np.where(no_return, np.nan, distance)[:, None]).astype(np.float32),
            "poses": pose,
            "stamp": 1_000 + k * STEP_NS,
            "no_return": no_return,
            "directions": body.astype(np.float32),
        }


@pytest.mark.ci_cases("0")
@pytest.mark.parametrize("seed", range(4))
def test_what_is_seen_past_an_edge_is_what_the_specification_says(seed):
    config, uncovered = small(FlyingConfig()), []
    detector, specification = FlyingObjectDetector(config), Specification(config)
    for scan in past_an_edge(seed):
        given = (scan["points"], scan["poses"], scan["stamp"])
        named = {"no_return": scan["no_return"], "directions": scan["directions"]}
        same(detector.process(*given, **named), specification.process(**scan))
        uncovered += specification.uncovered
    assert sum(uncovered) > 2
    assert len(uncovered) - sum(uncovered) > 2


def few_points(counts, *, speed, others=()):
    """Scans of a floor, a wall and a target of so many returns; others give one return each."""
    body, pose = fan(16, 40), np.eye(4)
    for k, count in enumerate((0, 0, 0, 0, *counts)):
        target = np.array([1.3 - speed * 0.1 * (k - 4), 2.1, 0.8])
        hits = [
            cast_plane(np.zeros_like(body), body, [0, 0, 1], -2.2),
            cast_plane(np.zeros_like(body), body, [1, 0, 0], 3.5),
        ]
        distance = np.min(hits, axis=0)
        for place, rows in ((target, count), *((target + other, 1) for other in others)):
            along = body @ place
            distance[np.argsort(-along)[:rows]] = np.linalg.norm(place)
        no_return = distance > 7.0
        yield {
            "points": (body * np.where(no_return, np.nan, distance)[:, None]).astype(np.float32),
            "poses": pose,
            "stamp": 1_000 + k * STEP_NS,
            "no_return": no_return,
            "directions": body.astype(np.float32),
        }


@pytest.mark.ci_cases("it moves", "it stands")
@pytest.mark.parametrize(
    ("counts", "speed", "others", "tracks"),
    [
        ([3, 1, 2, 1, 2, 1, 1, 2], 2.0, (), 1),
        ([3, 0, 0, 0, 0, 0, 0, 0], 2.0, (), 0),
        ([3, 1, 2, 1, 2, 1, 1, 2], 0.0, (), 0),
        ([3, 0, 0, 0, 0, 1, 1, 1], 2.0, (), 0),
        ([3, 1, 2, 1, 2, 1, 1, 2], 2.0, ([0.0, 1.0, 0.9],), 0),
    ],
    ids=["it moves", "seen once", "it stands", "found again elsewhere", "not alone"],
)
def test_a_point_or_two_in_free_space_confirm_what_moves(counts, speed, others, tracks):
    config = small(FlyingConfig())
    detector, specification = FlyingObjectDetector(config), Specification(config)
    for scan in few_points(counts, speed=speed, others=others):
        given = (scan["points"], scan["poses"], scan["stamp"])
        frame = detector.process(*given, no_return=scan["no_return"], directions=scan["directions"])
        same(frame, specification.process(**scan))
    assert len(frame.tracks) == tracks


@pytest.mark.ci_cases("1")
@pytest.mark.parametrize("min_confident", [1, 2])
def test_removal_from_the_first_scan_does_what_the_specification_says(min_confident):
    config = small(FlyingConfig.paper())
    at_once = config.separate.model_copy(
        update={"min_confident": min_confident, "waits_for_background": False}
    )
    config = config.model_copy(update={"separate": at_once})
    waiting = FlyingObjectDetector(small(FlyingConfig.paper()))
    detector, specification = FlyingObjectDetector(config), Specification(config)
    for scan in random_world(3, stream=False):
        given = (scan["points"], scan["poses"], scan["stamp"])
        named = {"no_return": scan["no_return"], "directions": scan["directions"]}
        same(detector.process(*given, **named), specification.process(**scan))
        waiting.process(*given, **named)
    if min_confident > 1:
        assert len(detector.occupied_points()) < len(waiting.occupied_points())


def same(frame, expected):
    assert frame.status.gate_open == (expected.gate == "open")
    np.testing.assert_array_equal(frame.point_class, expected.point_class)
    for name in ("position", "covariance", "radius", "extent", "n_points", "confidence"):
        found, wanted = getattr(frame.detections, name), getattr(expected, name)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=FLOAT_TOLERANCE)
    tracks = frame.tracks
    assert tracks.id.tolist() == [track[0] for track in expected.tracks]
    for row, (_, x, P, n_detections, kinds) in enumerate(expected.tracks):
        state = np.r_[tracks.position[row], tracks.velocity[row], tracks.acceleration[row]]
        scale = np.maximum(1.0, np.abs(x))
        assert np.abs(state - x).max() <= 10 * FLOAT_TOLERANCE * scale.max()
        np.testing.assert_allclose(tracks.covariance[row], P, rtol=1e-6, atol=1e-6)
        assert tracks.n_detections[row] == n_detections
        if np.isfinite(tracks.existence[row]):
            np.testing.assert_allclose(tracks.kind_probability[row], kinds, atol=1e-5)


# --- one target in a yard -------------------------------------------------------------------------

PATH = ((6.0, 4.0, 3.5), (-4.0, 7.0, 4.5))
YARD_WITH_DRONE = yard(drone(*PATH), scans=20)


def run(scans, config=None, *, threads=1, shift=(0.0, 0.0, 0.0), change=lambda scan: {}):
    """Frames of a flight and the detector after it."""
    detector = FlyingObjectDetector(config, threads=threads)
    frames = []
    for simulated in scans:
        poses = simulated.poses.copy()
        poses[:, :3, 3] += shift
        frames.append(feed(detector, simulated, world_from_lidar=poses, **change(simulated)))
    return frames, detector


def digest(frame):
    """Everything a frame says, in bits."""
    found, tracks = frame.detections, frame.tracks
    arrays = [getattr(found, name) for name in found.__slots__]
    arrays += [getattr(tracks, name) for name in tracks.__slots__ if name != "stamp_ns"]
    return [frame.point_class.tobytes(), *(array.tobytes() for array in arrays), str(frame.status)]


def test_a_drone_in_a_yard_is_found_and_nothing_else():
    scans = scans_of(YARD_WITH_DRONE)
    frames, detector = run(scans)
    assert detector.health().processed == len(scans)
    for simulated, frame in zip(scans[12:], frames[12:], strict=True):
        own = simulated.label == simulated.truth.id[0]
        assert (frame.status.gate_open, frame.status.reason) == (True, "open")
        assert (frame.point_class[own] == FLYING).all()
        assert not (frame.point_class[~own] == FLYING).any()
        assert len(frame.detections) == 1
        assert frame.detections.n_points.tolist() == simulated.truth.hits.tolist()
        assert 0.5 < frame.detections.confidence[0] <= 1.0
        assert frame.tracks.id.tolist() == [0]
        centre = simulated.truth.position[0]
        assert np.linalg.norm(frame.detections.position[0] - centre) < 0.35
        assert np.linalg.norm(frame.tracks.position[0] - centre) < 0.35


def test_paper_mode_finds_the_drone_too():
    """Without gates on size and number, fragments of the far ground fly as well."""
    scans = scans_of(YARD_WITH_DRONE)
    frames, _ = run(scans, FlyingConfig.paper())
    for simulated, frame in zip(scans[12:], frames[12:], strict=True):
        own = simulated.label == simulated.truth.id[0]
        assert (frame.point_class[own] == FLYING).mean() > 0.9
        misses = np.linalg.norm(frame.tracks.position - simulated.truth.position[0], axis=1)
        assert misses.min() < 0.5


def test_removal_from_the_first_scan_leaves_a_sparse_sensor_nothing_and_says_so():
    """It pulls the background down before it has become one: why paper mode waits with it."""
    paper = FlyingConfig.paper()
    at_once = paper.separate.model_copy(update={"waits_for_background": False})
    config = paper.model_copy(update={"separate": at_once})
    frames, detector = run(scans_of(YARD_WITH_DRONE), config)
    assert not any(frame.status.gate_open for frame in frames)
    assert "no background" in frames[-1].status.reason
    assert "separate.waits_for_background" in frames[-1].status.reason
    assert len(detector.occupied_points()) == 0


def test_paper_mode_drops_no_return_by_its_range():
    """But a point at the sensor itself is how drivers mark a ray without return."""
    scan = scans_of(YARD_WITH_DRONE)[0]
    points = scan.scan.points.reshape(-1, 3).copy()
    points[:2] = [[0.2, 0.0, 0.0], [0.0, 0.0, 0.0]]
    given = {"points_lidar": points, "no_return": None}
    paper, best = (
        feed(FlyingObjectDetector(config), scan, **given).point_class
        for config in (FlyingConfig.paper(), FlyingConfig())
    )
    assert paper[:2].tolist() == [UNKNOWN, 0]
    assert best[:2].tolist() == [0, 0]


@pytest.mark.parametrize("threads", [2, 4])
def test_any_number_of_threads_gives_the_same_bits(threads):
    scans = scans_of(YARD_WITH_DRONE)[:14]
    frames, one = run(scans)
    others, many = run(scans, threads=threads)
    assert one._detector.map_bytes() == many._detector.map_bytes()
    assert list(map(digest, frames)) == list(map(digest, others))


@pytest.mark.parametrize("stream", [False, True])
def test_the_order_of_the_points_does_not_matter(stream):
    scans = scans_of(YARD_WITH_DRONE)[:14]
    rng = np.random.default_rng(0)
    orders = [rng.permutation(simulated.label.size) for simulated in scans]
    still = {} if stream else {"point_time_ns": None, "pose_stamps_ns": None}
    one, two = FlyingObjectDetector(), FlyingObjectDetector()
    for simulated, order in zip(scans, orders, strict=True):
        scan = simulated.scan
        pose = simulated.poses if stream else simulated.poses[0]
        frame = feed(one, simulated, world_from_lidar=pose, **still)
        shuffled = {
            "points_lidar": scan.points.reshape(-1, 3)[order],
            "no_return": scan.no_return[order],
            "directions": scan.directions[order],
            "point_time_ns": scan.point_time_ns[order],
        }
        other = feed(two, simulated, world_from_lidar=pose, **shuffled | still)
        np.testing.assert_array_equal(frame.point_class[order], other.point_class)
        assert one._detector.map_bytes() == two._detector.map_bytes()
        assert frame.tracks.id.tolist() == other.tracks.id.tolist()
        np.testing.assert_allclose(frame.tracks.position, other.tracks.position, atol=1e-9)
    assert len(frame.tracks) == 1


def test_far_from_the_origin_everything_is_the_same():
    shift = np.array([5e5, 5.4e6, 300.0])
    scans = scans_of(YARD_WITH_DRONE)[:16]
    here, _ = run(scans)
    there, detector = run(scans, shift=shift)
    for near, far in zip(here, there, strict=True):
        np.testing.assert_array_equal(near.point_class, far.point_class)
        assert near.tracks.id.tolist() == far.tracks.id.tolist()
        for name in ("detections", "tracks"):
            a, b = getattr(near, name), getattr(far, name)
            np.testing.assert_allclose(a.position + shift, b.position, atol=1e-3)
            np.testing.assert_allclose(a.covariance, b.covariance, atol=1e-6)
    assert len(far.tracks) == 1
    assert detector.state_at(np.array([[11.6, 0.0, 3.0]]) + shift).tolist() == [3]
    occupied = detector.occupied_points()
    assert np.abs(occupied - shift).max() < 110


def test_the_world_may_be_turned():
    """The same flight in a frame with another heading and tilt finds the same drone there."""
    scans = scans_of(YARD_WITH_DRONE)[:16]
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("zyx", [2.0, 0.3, -0.2]).as_matrix()
    turn[:3, 3] = [100.0, -50.0, 7.0]
    here, _ = run(scans)
    detector = FlyingObjectDetector()
    there = [feed(detector, one, world_from_lidar=turn @ one.poses) for one in scans]
    moved = here[-1].tracks.position @ turn[:3, :3].T + turn[:3, 3]
    np.testing.assert_allclose(there[-1].tracks.position, moved, atol=0.1)
    velocity = here[-1].tracks.velocity @ turn[:3, :3].T
    np.testing.assert_allclose(there[-1].tracks.velocity, velocity, atol=0.5)
    assert len(there[-1].detections) == len(here[-1].detections) == 1


def test_a_sparse_sensor_can_build_up_a_background():
    """Removal of separate voxels pulls down what 16 rows build up, unless it waits."""
    scene = yard(drone((4.0, 3.0, 3.3), (3.0, 6.0, 3.6)), lidar=VLP_16, scans=16)
    frames, _ = run(scans_of(scene))
    assert frames[10].status.gate_open
    assert len(frames[-1].tracks) == 1
