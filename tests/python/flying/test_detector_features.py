"""The detector, option by option: motion, LiDARs, lost rays, masks, teammates, jumps, seeds."""

import threading

import numpy as np
import pytest
from flying_scenes import drone, feed, lidar, scans_of, wall, yard
from scipy.spatial.transform import Rotation

from lidar_core import PointClass, VoxelMapConfig, sim
from lidar_core.errors import InputError
from lidar_core.flying import (
    ClassifyConfig,
    FlyingConfig,
    FlyingObjectDetector,
    SeedConfig,
    SensorConfig,
)
from lidar_core.sim import Body, Circle, Cylinder, Hover, Plane, Tree, Waypoints

FLYING, UNKNOWN = PointClass.FLYING, PointClass.UNKNOWN
IN_THE_SKY = yard(drone((6.0, 4.0, 3.5), (-4.0, 7.0, 4.5)), scans=20)


def pipeline(config=None, scans=(), **options):
    detector = FlyingObjectDetector(config, **options)
    return detector, [feed(detector, simulated) for simulated in scans]


# Targets that hover from the beginning are looked at too.
NOTHING_STANDS = FlyingConfig(seed=SeedConfig(standing_scans=0))


def with_sensor(**changes):
    return FlyingConfig(sensor=SensorConfig(**changes))


def misses(frame, simulated):
    """Distance of every detection to the nearest target."""
    offset = frame.detections.position[:, None] - simulated.truth.position
    return np.linalg.norm(offset, axis=2).min(axis=1)


# --- motion during the scan -----------------------------------------------------------------------

TURNING = yard(
    drone((-3.0, 7.0, 4.0)),
    sensor=Circle(center=(0.0, 0.0, 3.0), radius=2.0, speed=5.0),
)


def test_deskew_keeps_walls_thin_and_finds_the_drone():
    """At 5 m/s and 2.5 rad/s the sensor turns by 14 degrees in a scan."""
    scans = scans_of(TURNING)
    detector, frames = pipeline(NOTHING_STANDS, scans)
    assert thickness(detector) <= 0.75  # [m]: the wall is in 2 voxels, noise in a third
    for simulated, frame in zip(scans[12:], frames[12:], strict=True):
        assert len(frame.detections) == 1
        assert misses(frame, simulated)[0] < 0.35
        assert frame.tracks.id.tolist() == [0]
        assert np.linalg.norm(frame.tracks.position[0] - simulated.truth.position[0]) < 0.35


def test_without_deskew_walls_are_thick_and_all_is_wrong():
    scans = scans_of(TURNING)
    detector = FlyingObjectDetector(FlyingConfig(mismatch_share=None))
    still = {"point_time_ns": None, "pose_stamps_ns": None}
    frames = [feed(detector, one, world_from_lidar=one.poses[0], **still) for one in scans]
    assert thickness(detector) > 1.5
    errors = [
        misses(frame, simulated).max(initial=0)
        for simulated, frame in zip(scans[12:], frames[12:], strict=True)
    ]
    assert max(errors) > 0.6


def thickness(detector):
    """Extent across the wall whose face is x = 11.5 of what is occupied in its middle [m]."""
    x, y, z = detector.occupied_points().T
    part = (np.abs(y) < 4) & (z > 1.5) & (z < 5) & (x > 8)
    return np.ptp(x[part])


def test_a_stream_without_times_takes_the_pose_at_the_stamp():
    scans = scans_of(IN_THE_SKY)[:3]
    one, two = FlyingObjectDetector(), FlyingObjectDetector()
    for simulated in scans:
        ahead = simulated.poses.copy()
        ahead[1:, 0, 3] += 5.0
        feed(one, simulated, world_from_lidar=ahead, point_time_ns=None)
        still = {"point_time_ns": None, "pose_stamps_ns": None}
        feed(two, simulated, world_from_lidar=simulated.poses[0], **still)
    assert one._detector.map_bytes() == two._detector.map_bytes()


def test_rows_that_tell_nothing_may_have_any_time():
    scans = scans_of(IN_THE_SKY)[:3]
    one, two = FlyingObjectDetector(), FlyingObjectDetector()
    for simulated in scans:
        lost = np.arange(simulated.label.size) % 7 == 0
        points = simulated.scan.points.reshape(-1, 3).copy()
        points[lost] = np.nan
        given = {"points_lidar": points, "no_return": simulated.scan.no_return & ~lost}
        feed(one, simulated, **given)
        times = np.where(lost, 0, simulated.scan.point_time_ns + 0)
        feed(two, simulated, **given, point_time_ns=times)
    assert one._detector.map_bytes() == two._detector.map_bytes()


# --- several LiDARs -------------------------------------------------------------------------------


def half(simulated, mounting=None):
    """The part of a scan ahead of the sensor (x > 0), from a sensor mounted otherwise."""
    scan = simulated.scan
    ahead = scan.directions[:, 0] > 0
    mounting = np.eye(4) if mounting is None else mounting
    turn = mounting[:3, :3]
    return {
        "points_lidar": (scan.points.reshape(-1, 3)[ahead] - mounting[:3, 3]) @ turn,
        "directions": scan.directions[ahead] @ turn,
        "no_return": scan.no_return[ahead],
        "point_time_ns": scan.point_time_ns[ahead],
        "world_from_lidar": simulated.poses @ mounting,
    }


def two_scenes(scans=20, stop=20):
    """The same drone seen from one place by LiDARs that look ahead and back."""
    target = drone((4.0, 6.0, 3.5), (-4.0, 6.0, 4.5))
    back = Hover(position=(0.0, 0.0, 3.0), rotation=(0.0, 0.0, 1.0, 0.0))
    ahead = scans_of(yard(target, scans=scans))[:stop]
    return ahead, scans_of(yard(target, scans=scans, sensor=back), seed=1)[:stop]


def test_two_lidars_make_one_map_and_one_track():
    """A drone that leaves the view of one for that of the other keeps its number."""
    mounting = np.eye(4)
    mounting[:3, :3] = Rotation.from_euler("zyx", [0.5, 0.2, 0.1]).as_matrix()
    detector = FlyingObjectDetector()
    numbers, seen_by = set(), []
    for one, two in zip(*two_scenes(), strict=True):
        frames = [
            feed(detector, one, **half(one), sensor="front"),
            feed(detector, two, **half(two, mounting), sensor="back"),
        ]
        for frame in frames:
            numbers |= set(frame.tracks.id.tolist())
        seen_by.append([len(frame.detections) for frame in frames])
    assert detector.health().processed == 40
    assert numbers == {0}
    assert [1, 0] in seen_by
    assert [0, 1] in seen_by
    assert detector.state_at([[11.6, 0.0, 3.0], [-7.0, 2.7, 3.0]]).min() >= 2


def test_many_lidars_may_share_a_stamp_and_lag():
    """Four scans of one time; then one sensor delivers its scans one period late."""
    detector = FlyingObjectDetector()
    ahead, _ = two_scenes(stop=6)
    for simulated in ahead[:3]:
        for name in "abcd":
            feed(detector, simulated, sensor=name)
    for simulated, earlier in zip(ahead[4:], ahead[3:], strict=False):
        feed(detector, simulated, sensor="a")
        feed(detector, earlier, sensor="b")
    assert detector.health().processed == 12 + 4
    with pytest.raises(InputError, match='sensor "b"'):
        feed(detector, ahead[3], sensor="b")


def test_every_lidar_has_its_own_masks():
    config = FlyingConfig(sensors={"near": SensorConfig(min_range=9.0)})
    detector = FlyingObjectDetector(config)
    simulated = scans_of(IN_THE_SKY)[0]
    all_classes = feed(detector, simulated, sensor="far").point_class
    some = feed(detector, simulated, sensor="near").point_class
    distance = np.linalg.norm(simulated.scan.points.reshape(-1, 3), axis=1)
    assert (all_classes > 0).sum() == np.isfinite(distance).sum()
    assert (some > 0).sum() == (distance >= 9.0).sum()


# --- the robot itself -----------------------------------------------------------------------------


def spoiled(simulated, rows, distance=0.8):
    """The rows of a scan hit the robot."""
    points = simulated.scan.points.reshape(-1, 3).copy()
    points[rows] = simulated.scan.directions[rows] * distance
    no_return = simulated.scan.no_return.copy()
    no_return[rows] = False
    return {"points_lidar": points, "no_return": no_return}


def robot_rows(simulated):
    azimuth = np.arctan2(simulated.scan.directions[:, 1], simulated.scan.directions[:, 0])
    return (np.abs(azimuth - 1.5) < 0.35) & (simulated.scan.directions[:, 2] < 0.0)


SELF = {
    "box": {"self_box": ((-0.7, 0.3, -0.5), (0.7, 1.0, 0.3))},
    "range": {"min_range": 0.9},
    "sectors": {"blind_sectors": ((1.15, 1.85, -0.5, 0.0),)},
    "mask": {},
    "learnt": {"learn_mask_scans": 4},
}
NOT_LEARNT = {"learn_mask_scans": 0}


@pytest.mark.parametrize("kind", SELF)
def test_returns_from_the_robot_itself_are_not_used(kind):
    scans = scans_of(IN_THE_SKY)
    rows = robot_rows(scans[0])
    options = SELF[kind] if kind != "mask" else {"self_mask": tuple(rows.tolist())}
    detector = FlyingObjectDetector(with_sensor(**NOT_LEARNT | options))
    for simulated in scans:
        frame = feed(detector, simulated, **spoiled(simulated, rows))
        assert (frame.point_class[rows] == 0).all()
        assert len(frame.detections) <= 1
    near = np.array([[0.0, 0.8, 2.8]])
    assert detector.state_at(near) == [1]
    assert frame.tracks.id.tolist() == [0]


@pytest.mark.parametrize("kind", ["sectors", "mask"])
def test_masks_apply_to_all_rays_or_only_to_empty_ones(kind):
    """Where the robot's shadow is masked, a return from beyond counts if so wanted."""
    scans = scans_of(IN_THE_SKY)
    rows = robot_rows(scans[0])
    for empty_only in (False, True):
        options = SELF[kind] if kind != "mask" else {"self_mask": tuple(rows.tolist())}
        detector = FlyingObjectDetector(
            with_sensor(**NOT_LEARNT | options, mask_empty_only=empty_only)
        )
        for simulated in scans[:5]:
            feed(detector, simulated, **spoiled(simulated, rows))
        frame = feed(detector, scans[5])
        hits = rows & (scans[5].label >= 0)
        assert (frame.point_class[hits] > 0).all() == empty_only
        assert (frame.point_class[hits] == 0).all() == (not empty_only)
        assert frame.n_rays == np.count_nonzero(~rows | hits if empty_only else ~rows)


def test_where_the_robot_was_learnt_only_what_lies_beyond_it_counts():
    """Returns from farther away are seen past the robot; no return there is the robot again."""
    scans = scans_of(IN_THE_SKY)
    rows = robot_rows(scans[0])
    detector = FlyingObjectDetector(with_sensor(learn_mask_scans=4))
    plain = FlyingObjectDetector(with_sensor(**NOT_LEARNT))
    for simulated in scans[:5]:
        feed(detector, simulated, **spoiled(simulated, rows))
        feed(plain, simulated)
    frame, expected = feed(detector, scans[5]), feed(plain, scans[5])
    assert (frame.point_class[rows & (scans[5].label >= 0)] > 0).all()
    lost = np.count_nonzero(rows & scans[5].scan.no_return)
    assert lost > 20
    assert expected.n_rays - 3 * lost < frame.n_rays <= expected.n_rays - lost


def test_a_mask_of_the_wrong_length_is_refused():
    with pytest.raises(InputError, match="self_mask"):
        feed(FlyingObjectDetector(with_sensor(self_mask=(True, False))), scans_of(IN_THE_SKY)[0])


# --- several returns per ray ----------------------------------------------------------------------


def test_of_two_returns_only_the_farther_one_casts_its_ray():
    scans = scans_of(IN_THE_SKY)
    detector = FlyingObjectDetector(with_sensor(returns_per_ray=2))
    _, frames = pipeline(None, scans)
    for simulated, expected in zip(scans, frames, strict=True):
        scan = simulated.scan
        twice = {
            "points_lidar": np.concatenate([scan.points.reshape(-1, 3)] * 2),
            "no_return": np.tile(scan.no_return, 2),
            "directions": np.tile(scan.directions, (2, 1)),
            "point_time_ns": np.tile(scan.point_time_ns, 2),
        }
        frame = feed(detector, simulated, **twice)
        assert frame.n_rays == expected.n_rays
        assert frame.n_visits == expected.n_visits
        assert len(frame.detections) == len(expected.detections)
        assert frame.tracks.id.tolist() == expected.tracks.id.tolist()
    np.testing.assert_array_equal(frame.detections.n_points, 2 * expected.detections.n_points)


def test_what_lies_before_the_farther_return_stays():
    """A net in front of a wall: the ray to the wall does not clear the net."""
    detector = FlyingObjectDetector(with_sensor(returns_per_ray=2))
    side = np.linspace(-2, 2, 40)
    wall_points = np.stack([0 * side + 8.0, side, 0 * side], axis=1)
    net = wall_points / 2
    for k in range(3):
        frame = detector.process(np.concatenate([net, wall_points]), np.eye(4), k)
        assert frame.n_rays == 40
    assert detector.state_at(wall_points / 4).tolist() == [0] * 40
    assert detector.state_at(net).min() >= 1
    with pytest.raises(InputError, match="returns_per_ray"):
        detector.process(net[:7], np.eye(4), 9)


# --- teammates ------------------------------------------------------------------------------------


def test_teammates_are_labelled_and_neither_reported_nor_tracked():
    scene = yard(drone((6.0, 4.0, 3.5), (-4.0, 7.0, 4.5)), drone((5.0, -4.0, 3.6)), scans=22)
    detector = FlyingObjectDetector(NOTHING_STANDS)
    for simulated in scans_of(scene):
        mate, other = simulated.truth.position
        detector.set_teammates([77], [mate + 0.2], radius=0.8)
        frame = feed(detector, simulated)
    assert frame.teammate_id.tolist() == [77]
    assert np.linalg.norm(frame.teammates.position[0] - mate) < 0.4
    assert np.linalg.norm(frame.detections.position - other, axis=1).tolist() < [0.4]
    assert len(frame.tracks) == 1
    assert np.linalg.norm(frame.tracks.position[0] - other) < 0.4


def test_a_track_that_turns_out_to_be_a_teammate_ends():
    detector = FlyingObjectDetector(NOTHING_STANDS)
    scans = scans_of(yard(drone((6.0, 4.0, 3.5)), scans=30))
    for simulated in scans[:15]:
        frame = feed(detector, simulated)
    assert len(frame.tracks) == 1
    for simulated in scans[15:]:
        detector.set_teammates([5], simulated.truth.position)
        frame = feed(detector, simulated)
        assert len(frame.detections) == 0
    assert len(frame.tracks) == 0
    assert frame.teammate_id.tolist() == [5]
    detector.set_teammates([], np.empty((0, 3)))
    assert len(feed(detector, scans_of(yard(drone((6.0, 4.0, 3.5)), scans=31))[-1]).detections) == 1


# --- jumps of the pose ----------------------------------------------------------------------------

JUMP = np.eye(4)
JUMP[:3, :3] = Rotation.from_euler("z", 0.6).as_matrix()
JUMP[:3, 3] = [3.0, -2.0, 1.5]
LONG = yard(drone((6.0, 4.0, 3.5), (-5.0, 7.0, 4.5), seconds=3.0), scans=28)


def jumped():
    """A detector whose last three scans came with a pose that jumped, and the scans that follow."""
    detector = FlyingObjectDetector()
    scans = scans_of(LONG)
    for simulated in scans[:14]:
        feed(detector, simulated)
    before = detector._detector.map_bytes()
    for simulated in scans[14:17]:
        frame = feed(detector, simulated, world_from_lidar=JUMP @ simulated.poses)
        assert frame.status.map_pose_mismatch
        assert "map_pose_mismatch" in frame.status.reason
        assert not frame.status.gate_open
        assert len(frame.detections) == 0
        assert not (frame.point_class == FLYING).any()
        assert ((frame.point_class > 0) == (simulated.label >= 0)).all()
        assert frame.tracks.id.tolist() == [0]
    assert detector._detector.map_bytes() == before
    health = detector.health()
    assert (health.received, health.processed, health.held) == (17, 14, 3)
    return detector, scans[17:]


def test_a_jump_of_the_pose_holds_the_scan_and_reanchoring_goes_on():
    detector, scans = jumped()
    assert detector.reanchor()
    assert not detector.reanchor()
    for simulated in scans:
        frame = feed(detector, simulated, world_from_lidar=JUMP @ simulated.poses)
        assert frame.status.gate_open
        assert frame.tracks.id.tolist() == [0]
        centre = JUMP[:3, :3] @ simulated.truth.position[0] + JUMP[:3, 3]
    assert np.linalg.norm(frame.tracks.position[0] - centre) < 0.4
    face = JUMP[:3, :3] @ [11.6, 0.0, 3.0] + JUMP[:3, 3]
    assert detector.state_at([face]) == [3]


def test_after_a_jump_reset_starts_anew_without_reusing_numbers():
    detector, scans = jumped()
    detector.reset()
    assert len(detector.occupied_points()) == 0
    assert not detector.reanchor()
    numbers = set()
    for number, simulated in enumerate(scans):
        frame = feed(detector, simulated, world_from_lidar=JUMP @ simulated.poses)
        assert frame.status.gate_open == (number >= 10)
        numbers |= set(frame.tracks.id.tolist())
    assert numbers
    assert 0 not in numbers


def test_after_a_jump_back_everything_goes_on():
    detector, scans = jumped()
    frame = feed(detector, scans[0])
    assert frame.status.gate_open
    assert frame.tracks.id.tolist() == [0]


def test_reanchoring_takes_the_last_scan_of_the_same_lidar():
    detector = FlyingObjectDetector()
    mounting = np.eye(4)
    mounting[:3, :3] = Rotation.from_euler("z", 2.0).as_matrix()
    mounting[:3, 3] = [0.4, 0.2, 0.0]
    scans = scans_of(LONG)
    for simulated in scans[:13]:
        feed(detector, simulated, **half(simulated), sensor="a")
        feed(detector, simulated, **half(simulated, mounting), sensor="b")
    for part in (half(scans[13]), half(scans[13], mounting)):
        name = "b" if part["world_from_lidar"] is not scans[13].poses else "a"
        part["world_from_lidar"] = JUMP @ part["world_from_lidar"]
        assert feed(detector, scans[13], **part, sensor=name).status.map_pose_mismatch
    assert detector.reanchor()
    face = JUMP[:3, :3] @ [11.6, 0.0, 3.0] + JUMP[:3, 3]
    assert detector.state_at([face]) == [3]
    part = half(scans[14])
    part["world_from_lidar"] = JUMP @ part["world_from_lidar"]
    frame = feed(detector, scans[14], **part, sensor="a")
    assert frame.status.gate_open


def test_a_target_that_fills_the_view_is_no_jump():
    """High up most returns may come from one target close by."""
    scene = yard(
        drone((12.0, 0.0, 40.0), (2.5, 0.0, 40.1)),
        scans=20,
        sensor=Hover(position=(0.0, 0.0, 40.0)),
        lidar=lidar(64, 720),
    )
    seed = SeedConfig(burn_in_scans=0)
    detector = FlyingObjectDetector(FlyingConfig(seed=seed))
    x, y = np.meshgrid(np.arange(-2, 2, 0.25), np.arange(-2, 2, 0.25))
    detector.set_occupied(np.stack([x.ravel(), y.ravel(), np.full(x.size, 30.0)], axis=1))
    for simulated in scans_of(scene):
        frame = feed(detector, simulated, **sector(simulated))
    assert frame.detections.n_points[0] > 200
    assert frame.detections.n_points[0] > 0.5 * np.count_nonzero(frame.point_class)
    assert detector.health().held == 0


# --- seeds and gates ------------------------------------------------------------------------------


def test_nothing_is_reported_during_the_burn_in():
    config = FlyingConfig(seed=SeedConfig(burn_in_scans=15))
    detector = FlyingObjectDetector(config)
    for number, simulated in enumerate(scans_of(IN_THE_SKY)):
        frame = feed(detector, simulated)
        assert frame.status.gate_open == (number >= 15)
        if number < 15:
            assert frame.status.reason == f"burn-in: scan {number + 1} of 15"
            assert len(frame.detections) == len(frame.tracks) == 0
            assert len(detector.tracks_at(simulated.scan.stamp_ns)) == 0
            assert not (frame.point_class == FLYING).any()
    assert len(frame.tracks) == 1


NO_BURN_IN = {"burn_in_scans": 0}


def reasons(config, prepare=lambda detector: None, scans=None):
    detector = FlyingObjectDetector(config)
    prepare(detector)
    frames = [feed(detector, one) for one in scans_of(IN_THE_SKY) if scans is None][:scans]
    for frame in frames:
        if not frame.status.gate_open:
            assert len(frame.detections) == len(frame.tracks) == 0
    return frames


def small_extent_background(**seed):
    """Nothing is background by its size."""
    classify = ClassifyConfig(background_extent=None)
    return FlyingConfig(classify=classify, seed=SeedConfig(**NO_BURN_IN | seed))


def test_without_any_seed_the_gate_stays_closed_and_says_so():
    frames = reasons(small_extent_background())
    assert all("no background" in frame.status.reason for frame in frames)
    assert not any(frame.status.gate_open for frame in frames)


def test_the_ground_is_a_seed():
    frames = reasons(small_extent_background(ground_height=0.5))
    assert "no background" in frames[0].status.reason
    assert frames[-1].status.gate_open
    assert len(frames[-1].tracks) == 1


def test_the_place_of_take_off_is_a_seed():
    """From one voxel below the sensor the background grows with the ground that is seen."""
    low = yard(
        drone((6.0, 4.0, 2.0), (-4.0, 5.0, 2.5)),
        sensor=Waypoints(times=(0.0, 1.5), positions=((0.0, 0.0, 0.5), (0.0, 0.0, 1.5))),
        scans=24,
        lidar=lidar(64, 360, half_deg=45.0),
    )
    detector = FlyingObjectDetector(small_extent_background(take_off_height=0.5))
    frames = [feed(detector, scans_of(low)[0])]
    assert detector.state_at([[0.1, 0.1, 0.1]]) == [2]
    assert len(detector.occupied_points()) == 1
    frames += [feed(detector, simulated) for simulated in scans_of(low)[1:]]
    assert "no background" in frames[0].status.reason
    assert frames[-1].status.gate_open
    assert len(frames[-1].tracks) == 1


def test_an_a_priori_map_is_a_seed():
    """The gate opens with the first scan on it."""
    y, z = np.meshgrid(np.arange(-9.9, 9.9, 0.25), np.arange(0.1, 6.0, 0.25))
    face = np.stack([np.full(y.size, 11.6), y.ravel(), z.ravel()], axis=1)
    frames = reasons(
        small_extent_background(), prepare=lambda detector: detector.set_occupied(face)
    )
    assert frames[1].status.gate_open
    assert len(frames[-1].tracks) == 1


def test_a_saved_map_is_a_seed(tmp_path):
    earlier, _ = pipeline(None, scans_of(IN_THE_SKY)[:12])
    earlier.save_map(tmp_path / "yard.lcvm")
    detector = FlyingObjectDetector(small_extent_background())
    detector.load_map(tmp_path / "yard.lcvm")
    assert detector._detector.map_bytes() == earlier._detector.map_bytes()
    frames = [feed(detector, simulated) for simulated in scans_of(IN_THE_SKY)[12:]]
    assert all(frame.status.gate_open for frame in frames[1:])
    assert len(frames[-1].tracks) == 1
    assert np.array_equal(earlier.occupied_points()[0] % 0.25, [0.125] * 3)


def test_loading_a_map_drops_tracks_but_no_numbers(tmp_path):
    detector, frames = pipeline(None, scans_of(IN_THE_SKY)[:14])
    assert frames[-1].tracks.id.tolist() == [0]
    detector.save_map(tmp_path / "yard.lcvm")
    detector.load_map(tmp_path / "yard.lcvm")
    assert len(detector.tracks_at(0)) == 0
    for simulated in scans_of(IN_THE_SKY)[14:]:
        frame = feed(detector, simulated)
    assert frame.tracks.id.tolist() == [1]


# --- approaches -----------------------------------------------------------------------------------


def sector(simulated, half_angle=0.5):
    """Only the rays ahead."""
    scan = simulated.scan
    ahead = np.abs(np.arctan2(scan.directions[:, 1], scan.directions[:, 0])) < half_angle
    return {
        "points_lidar": scan.points.reshape(-1, 3)[ahead],
        "directions": scan.directions[ahead],
        "no_return": scan.no_return[ahead],
        "point_time_ns": scan.point_time_ns[ahead],
    }


DENSE = lidar(96, 900, range_max=23.0)
HEAD_ON = yard(
    drone((24.0, 0.125, 5.125)),  # in the middle of a voxel: no ray grazes what it hides
    bodies=(Body(shape=Plane(size=(120.0, 120.0))), wall((0.0, 9.0, 4.0), (14.0, 0.5, 8.0))),
    sensor=Waypoints(
        times=(0.0, 1.0, 7.4), positions=tuple((x, 0.125, 5.125) for x in (0.0, 0.0, 18.0))
    ),
    scans=74,
    lidar=DENSE,
)


def approach(config):
    """Distances to the target at which it was found; during the burn-in it is out of range."""
    detector = FlyingObjectDetector(config)
    found = []
    for simulated in scans_of(HEAD_ON):
        frame = feed(detector, simulated, **sector(simulated, 1.3))
        distance = np.linalg.norm(simulated.truth.position[0] - simulated.poses[0, :3, 3])
        if (misses(frame, simulated) < 0.6).any():
            found.append(distance)
    assert frame.status.gate_open
    return np.array(found)


@pytest.mark.nightly
def test_a_hovering_target_approached_head_on_is_found_in_best_mode_only():
    found = approach(FlyingConfig())
    assert found.max() > 15.0
    assert (found > 7.0).sum() > 20
    as_published = FlyingConfig(classify=ClassifyConfig(shadow="paper"))
    assert (approach(as_published) > 7.0).sum() == 0


@pytest.mark.ci_cases("1")
@pytest.mark.parametrize("seed", range(4))
def test_what_is_first_seen_on_an_approach_is_no_flyer(seed):
    """Walls, poles and trees beyond the range of the map while the background is made."""
    rng = np.random.default_rng(seed)
    bodies = [Body(shape=Plane(size=(120.0, 120.0))), wall((-2.0, 8.0, 4.0), (8.0, 0.5, 8.0))]
    for number, x in enumerate(rng.uniform(26, 44, 7)):
        y = rng.uniform(-10, 10)
        if number < 2:
            bodies.append(wall((x, y, 3.0), (0.3, rng.uniform(1, 5), 6.0)))
        elif number < 4:
            pole = Cylinder(radius=rng.uniform(0.05, 0.3), height=rng.uniform(4, 9))
            bodies.append(Body(shape=pole, position=(x, y, pole.height / 2)))
        else:
            crown = rng.uniform(1, 2)
            tree = Tree(
                trunk_radius=0.15,
                trunk_height=rng.uniform(3, 5),
                crown_radius=crown,
                leaves=round(60 * crown**3),
                seed=number,
            )
            bodies.append(Body(shape=tree, position=(x, y, 0.0)))
    way = Waypoints(times=(0.0, 1.0, 7.0), positions=((0, 0, 3.5), (0, 0, 3.5), (24.0, 0, 3.5)))
    scene = yard(bodies=tuple(bodies), sensor=way, scans=70, lidar=lidar(64, 600))
    detector = FlyingObjectDetector()
    reported = 0
    for simulated in scans_of(scene, seed):
        frame = feed(detector, simulated, **sector(simulated, 1.3))
        reported += len(frame.detections)
        assert len(frame.tracks) == 0
    assert frame.status.gate_open
    assert reported == 0


# --- limits of the map ----------------------------------------------------------------------------


def test_nothing_is_mapped_and_nothing_flies_outside_the_operating_volume():
    bounds = ((-8.0, -12.0, -1.0), (13.0, 5.0, 7.0))
    for classify in (ClassifyConfig(), ClassifyConfig.paper()):
        config = FlyingConfig(
            classify=classify, voxel_map=VoxelMapConfig(max_range=22.0, bounds=bounds)
        )
        detector = FlyingObjectDetector(config)
        for simulated in scans_of(IN_THE_SKY):
            frame = feed(detector, simulated)
            found, reach = frame.detections.position, frame.detections.radius[:, None]
            assert ((found >= bounds[0] - reach) & (found <= bounds[1] + reach)).all()
        occupied = detector.occupied_points()
        assert len(occupied) > 500
        inside = (occupied > bounds[0]) & (occupied < np.add(bounds[1], 0.25))  # whole voxels
        assert inside.all()
        assert detector.state_at([[0.0, 15.0, 3.8]]) == [1]


def test_what_is_far_behind_is_forgotten():
    way = Waypoints(times=(0.0, 5.0), positions=((-5.0, 0.0, 3.0), (5.0, 0.0, 3.0)))
    scene = yard(sensor=way, scans=20)
    config = FlyingConfig(forget_distance=9.0)
    detector, frames = pipeline(config, scans_of(scene))
    keeps, _ = pipeline(None, scans_of(scene))
    sensor = scans_of(scene)[-1].poses[0, :3, 3]
    reach = np.abs(detector.occupied_points() - sensor).max(axis=1)
    assert reach.max() <= 9.0 + 2 * 8 * 0.25 + 1e-6  # whole blocks of 8 voxels
    assert detector.map_memory_bytes < 0.7 * keeps.map_memory_bytes
    near = keeps.occupied_points()
    near = near[(np.abs(near - sensor) < 9.0).all(axis=1)]
    assert (detector.state_at(near) >= 2).mean() > 0.9
    assert frames[-1].status.gate_open


def test_memory_stays_where_the_sensor_stays():
    scans = scans_of(yard(scans=24, lidar=lidar(24, 180)))
    detector, _ = pipeline(None, scans[:12])
    before = detector.map_memory_bytes
    for simulated in scans[12:]:
        feed(detector, simulated)
    assert detector.map_memory_bytes < 1.05 * before


def test_pockets_around_a_target_are_filled_on_request():
    """Voxels that rays miss around a far target become free; those with points do not."""
    scene = yard(drone((5.0, 6.0, 4.0)), scans=16, lidar=lidar(48, 360))
    states = []
    for fill in (False, True):
        config = NOTHING_STANDS.model_copy(update={"classify": ClassifyConfig(fill_pockets=fill)})
        detector, frames = pipeline(config, scans_of(scene))
        assert len(frames[-1].detections) == 1
        assert frames[-1].detections.n_points[0] >= 3
        around = np.stack(np.meshgrid(*[np.arange(-0.75, 0.8, 0.25)] * 3), -1).reshape(-1, 3)
        states.append(detector.state_at(around + np.array([5.0, 6.0, 4.0])))
        points = scans_of(scene)[-1].scan.points.reshape(-1, 3)
        own = points[scans_of(scene)[-1].label == 4] + np.array([0.0, 0.0, 3.0])
        assert (detector.state_at(own) >= 1).all()
    assert (states[1] <= states[0]).all()
    assert (states[1] < states[0]).any()


def test_what_stands_before_a_slow_sensor_becomes_background():
    """Two scans a second: the burn-in has three scans, in which what moves meets a place twice."""
    standing, moving = (6.0, 4.0, 3.5), drone((-3.0, 7.0, 4.0), (-4.5, 7.0, 4.0), seconds=4.0)
    scene = yard(drone(standing), moving, scans=9, lidar=lidar(scan_rate=2.0))
    _, frames = pipeline(None, scans_of(scene))
    assert [frame.status.gate_open for frame in frames] == 3 * [False] + 6 * [True]
    assert len(frames[-1].tracks) == 1
    assert misses(frames[-1], scans_of(scene)[-1]).tolist() < [0.35]
    assert np.linalg.norm(frames[-1].tracks.position[0] - standing) > 5.0


# --- predictions, covariances, threads ------------------------------------------------------------


def test_tracks_can_be_asked_for_at_any_time():
    detector, frames = pipeline(None, scans_of(IN_THE_SKY))
    tracks, last = frames[-1].tracks, frames[-1].tracks.stamp_ns
    before = detector._detector.map_bytes(), detector.health()
    velocity = np.array([-5.0, 1.5, 0.5])  # of the way, 2 s long
    for later in (0, 50_000_000, 300_000_000):
        ahead = detector.tracks_at(last + later)
        assert ahead.stamp_ns == last + later
        assert ahead.id.tolist() == tracks.id.tolist()
        moved = tracks.position + velocity * later * 1e-9
        np.testing.assert_allclose(ahead.position, moved, atol=0.05 + 1.0 * later * 1e-9)
        assert np.linalg.eigvalsh(ahead.covariance[0]).min() > 0
    assert np.trace(ahead.covariance[0]) > np.trace(tracks.covariance[0])
    assert (detector._detector.map_bytes(), detector.health()) == before
    again = detector.tracks_at(last)
    assert again.position.tobytes() == tracks.position.tobytes()
    for far in (-(2**63), 2**63 - 1):
        assert np.isfinite(detector.tracks_at(far).position).all()


def jacobian(pose, point):
    """Derivative of a measured point by the pose, numerically: eq. 38 for the angles."""
    gamma, beta, alpha = Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX")
    local = pose[:3, :3].T @ (point - pose[:3, 3])

    def place(q):
        turn = Rotation.from_euler("ZYX", [q[5], q[4], q[3]]).as_matrix()
        return turn @ local + q[:3]

    at = np.r_[pose[:3, 3], alpha, beta, gamma]
    steps = 1e-6 * np.eye(6)
    return np.stack([(place(at + h) - place(at - h)) / 2e-6 for h in steps], axis=1)


@pytest.mark.parametrize("reanchored", [False, True])
def test_the_covariance_of_the_pose_adds_to_that_of_detections(reanchored):
    """By J C J' of the centroid (eqs 38-42), in the world's axes."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6)) * ([0.2] * 3 + [0.02] * 3)
    covariance = root.T @ root
    tilt = np.eye(4)
    tilt[:3, :3] = Rotation.from_euler("ZYX", [0.7, -0.3, 0.2]).as_matrix()
    scans = scans_of(LONG)
    one, two = FlyingObjectDetector(), FlyingObjectDetector()
    still = {"point_time_ns": None, "pose_stamps_ns": None}
    world = np.eye(4)
    for number, simulated in enumerate(scans[:20]):
        held = reanchored and number == 14
        world = JUMP if held else world
        pose = world @ simulated.poses[0] @ tilt
        turned = {
            "points_lidar": simulated.scan.points.reshape(-1, 3) @ tilt[:3, :3],
            "directions": simulated.scan.directions @ tilt[:3, :3],
        }
        if held:
            for detector in (one, two):
                frame = feed(detector, simulated, world_from_lidar=pose, **turned, **still)
                assert frame.status.map_pose_mismatch
                assert detector.reanchor()
            continue
        plain = feed(one, simulated, world_from_lidar=pose, **turned, **still)
        wide = feed(
            two, simulated, world_from_lidar=pose, **turned, **still, pose_covariance=covariance
        )
        np.testing.assert_array_equal(plain.point_class, wide.point_class)
        np.testing.assert_array_equal(plain.detections.position, wide.detections.position)
    assert len(plain.detections) == 1
    J = jacobian(pose, plain.detections.position[0])
    added = wide.detections.covariance[0] - plain.detections.covariance[0]
    np.testing.assert_allclose(added, J @ covariance @ J.T, rtol=1e-5, atol=1e-9)


def test_eight_threads_may_use_one_detector():
    scans = scans_of(yard(drone((4.0, 3.0, 3.3)), scans=12, lidar=lidar(24, 180)))
    # A thread that waits for its turn falls behind the others by all of their scans at most.
    config = FlyingConfig(on_bad_scan="count", tracker={"buffer_size": 4 * len(scans)})
    detector = FlyingObjectDetector(config, threads=2)
    alone = {name: FlyingObjectDetector() for name in "abcd"}
    problems, stop = [], threading.Event()

    def produce(name):
        for simulated in scans:
            if feed(detector, simulated, sensor=name).rejected:
                problems.append(name)
            feed(detector, simulated, sensor=name)  # a second time: counted
            feed(alone[name], simulated)

    def watch():
        while not stop.is_set():
            tracks = detector.tracks_at(scans[-1].scan.stamp_ns)
            states = detector.state_at([[11.6, 0.0, 3.0], [3.0, 0.0, 3.0]])
            if len(tracks) > 1 or states.max() > 3 or not np.isfinite(tracks.position).all():
                problems.append(states)

    writers = [threading.Thread(target=produce, args=[name]) for name in "abcd"]
    readers = [threading.Thread(target=watch) for _ in range(4)]
    for thread in readers + writers:
        thread.start()
    for thread in writers:
        thread.join()
    stop.set()
    for thread in readers:
        thread.join()
    assert not problems
    health = detector.health()
    assert health.received == 8 * len(scans)
    assert health.processed + health.held + health.rejected == health.received
    assert health.rejected == 4 * len(scans)
    assert len({twin._detector.map_bytes() for twin in alone.values()}) == 1


# Large targets


@pytest.mark.nightly
def test_a_large_sphere_that_comes_straight_at_the_sensor_is_found_all_the_way():
    motion = sim.Shuttle(
        start=(20, 0.4, 3), end=(4, 0, 3), speed=4, acceleration=4, lead=1.0
    )  # its own trail lies in its shadow
    scene = sim.Scene(
        bodies=(
            sim.Body(shape=sim.Plane(size=(80, 80))),
            sim.Body(shape=sim.Box(size=(2, 40, 12)), position=(30, 0, 6)),
        ),
        targets=(sim.Target(shape=sim.Sphere(radius=0.6), motion=motion),),
        lidar=sim.LidarModel.preset("os1-128", ideal=True, snapshot=True, range_std=0.0),
        sensor=sim.Hover(position=(0, 0, 3)),
        scans=35,
    )
    detector = FlyingObjectDetector()
    missed = []
    for number, made in enumerate(sim.simulate(scene, seed=0)):
        scan = made.scan
        found = detector.process(
            scan.points, made.world_from_lidar, scan.stamp_ns, no_return=scan.no_return
        ).detections.position
        near = np.linalg.norm(found - made.truth.position, axis=1) < 1
        if number >= detector.config.seed.burn_in_scans and near.sum() != 1:
            missed.append(number)
    assert missed == []
