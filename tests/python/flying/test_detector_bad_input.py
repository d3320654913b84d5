"""The detector and input that cannot be used: the exact error, and a state that stays as it was."""

import numpy as np
import pytest
from flying_scenes import drone, feed, scans_of, yard

from lidar_core import VoxelMapConfig
from lidar_core.errors import ConfigError, InputError, LimitError
from lidar_core.flying import (
    ClassifyConfig,
    ClusterConfig,
    FlyingConfig,
    FlyingObjectDetector,
    SensorConfig,
    SeparateConfig,
    TrackerConfig,
)
from lidar_core.messages import PosedScan, Scan
from lidar_core.sim import LidarModel, Spinning

SMALL = LidarModel(
    pattern=Spinning(elevations_deg=tuple(np.linspace(20, -20, 24).tolist()), columns=128),
    range_max=30.0,
)
SCENE = yard(drone((4.0, 2.0, 3.2), (2.0, 4.0, 3.6)), lidar=SMALL, scans=16)
CONFIG = FlyingConfig(
    cluster=ClusterConfig(max_distance=0.6),
    separate=SeparateConfig(min_confident=4),
    tracker=TrackerConfig(cluster_distance=0.6, report_existence=None),
)
BEFORE = 12  # scans before the bad one
ROWS = 24 * 128


def state(detector):
    """All of the state that can be seen."""
    tracks = detector.tracks_at(10**9)
    return (
        detector._detector.map_bytes(),
        *(getattr(tracks, name).tobytes() for name in ("id", "position", "covariance")),
        detector.map_memory_bytes,
    )


def flown(config=CONFIG, scans=BEFORE, **changes):
    detector = FlyingObjectDetector(config, **changes)
    for simulated in scans_of(SCENE)[:scans]:
        feed(detector, simulated)
    return detector


def goes_on_as(detector, other):
    """The next scans give the same bits."""
    for simulated in scans_of(SCENE)[BEFORE:]:
        one, two = feed(detector, simulated), feed(other, simulated)
        assert one.point_class.tobytes() == two.point_class.tobytes()
        assert one.detections.position.tobytes() == two.detections.position.tobytes()
        assert one.tracks.id.tolist() == two.tracks.id.tolist()
        assert state(detector) == state(other)
    assert len(two.tracks) == 1


def changed(matrix, index, value):
    """`matrix` with one entry changed."""
    matrix = np.array(matrix)
    matrix[index] = value
    return matrix


NOW = BEFORE * 100_000_000
STREAM = scans_of(SCENE)[BEFORE].poses
STAMPS = scans_of(SCENE)[BEFORE].pose_stamps_ns
TIMES = np.full(ROWS, NOW)
POINTS = np.ones((ROWS, 3), np.float32)
STILL = {"world_from_lidar": np.eye(4), "pose_stamps_ns": None, "point_time_ns": None}
HUGE = np.eye(6) * 1e308

BAD = {
    "pose NaN": ({"world_from_lidar": changed(STREAM, (1, 0, 3), np.nan)}, "rotation"),
    "pose infinite": ({"world_from_lidar": changed(STREAM, (1, 2, 3), -np.inf)}, "rotation"),
    "pose with scale": ({"world_from_lidar": 2.0 * STREAM}, "rotation"),
    "pose with shear": ({"world_from_lidar": changed(STREAM, (0, 0, 1), 0.3)}, "rotation"),
    "pose mirrored": ({"world_from_lidar": changed(STREAM, (0, 0, 0), -1.0)}, "rotation"),
    "pose all zero": ({"world_from_lidar": 0 * STREAM}, "rotation"),
    "pose with a last row": ({"world_from_lidar": changed(STREAM, (0, 3, 0), 1.0)}, "rotation"),
    "pose of 3 x 4": ({"world_from_lidar": np.eye(4)[:3]}, "world_from_lidar"),
    "no pose": ({"world_from_lidar": np.empty((0, 4, 4))}, "world_from_lidar"),
    "pose none": ({"world_from_lidar": None}, "world_from_lidar"),
    "pose complex": ({"world_from_lidar": np.eye(4) * 1j}, "world_from_lidar"),
    "pose beyond the lattice": (
        STILL | {"world_from_lidar": changed(np.eye(4), (0, 3), 1e30)},
        "point",
    ),
    "stream without stamps": ({"pose_stamps_ns": None}, "pose_stamps_ns"),
    "stream with one stamp": ({"pose_stamps_ns": STAMPS[:1]}, "pose_stamps_ns"),
    "stream backwards": ({"pose_stamps_ns": STAMPS[::-1]}, "increasing"),
    "stream standing still": ({"pose_stamps_ns": STAMPS * 0}, "increasing"),
    "stream with real stamps": ({"pose_stamps_ns": STAMPS * 1.0}, "integers"),
    "stream of another hour": ({"pose_stamps_ns": STAMPS + 3600 * 10**9}, "within 20 ms"),
    "points (N, 4)": ({"points_lidar": np.ones((ROWS, 4))}, r"expected shape \(N, 3\)"),
    "points (N,)": ({"points_lidar": np.ones(ROWS)}, r"expected shape \(N, 3\)"),
    "points text": ({"points_lidar": [["a", "b", "c"]]}, "points_lidar"),
    "points ragged": ({"points_lidar": [[1.0, 2.0], [1.0]]}, "points_lidar"),
    "points complex": ({"points_lidar": POINTS * 1j}, "points_lidar"),
    "points none": ({"points_lidar": None}, "points_lidar"),
    "points of objects": ({"points_lidar": POINTS.astype(object)}, "points_lidar"),
    "one point too few": ({"points_lidar": POINTS[1:]}, "no_return"),
    "a point at 1e30 m": (
        {"points_lidar": changed(POINTS, (5, 1), 1e30), "no_return": None},
        "point",
    ),
    "no_return too long": ({"no_return": np.zeros(ROWS + 1, bool)}, "no_return"),
    "no_return of numbers": ({"no_return": np.zeros(ROWS)}, "no_return: expected dtype bool"),
    "directions too few": ({"directions": POINTS[:7]}, "directions"),
    "directions (N, 2)": ({"directions": POINTS[:, :2]}, "directions"),
    "times too few": ({"point_time_ns": TIMES[:-1]}, "point_time_ns"),
    "times real": ({"point_time_ns": TIMES + 0.5}, "point_time_ns"),
    "times after the stream": ({"point_time_ns": TIMES + 10**9}, "point_time_ns"),
    "times before the stream": ({"point_time_ns": TIMES - 10**9}, "point_time_ns"),
    "times of another clock": (STILL | {"point_time_ns": TIMES - 10**18}, "point_time_ns"),
    "times too large": ({"point_time_ns": np.full(ROWS, 2**63, np.uint64)}, "point_time_ns"),
    "covariance (3, 3)": ({"pose_covariance": np.eye(3)}, "pose_covariance"),
    "covariance NaN": ({"pose_covariance": np.full((6, 6), np.nan)}, "pose_covariance"),
    "covariance lopsided": (
        {"pose_covariance": changed(np.eye(6), (0, 5), 0.5)},
        "pose_covariance",
    ),
    "covariance negative": ({"pose_covariance": -np.eye(6)}, "pose_covariance"),
    "covariance beyond all bounds": ({"pose_covariance": HUGE}, "pose_covariance"),
    "time equal": ({"stamp_ns": NOW - 100_000_000}, "expected a stamp after"),
    "time backwards": ({"stamp_ns": 0}, "expected a stamp after"),
    "time real": ({"stamp_ns": 1.5}, "stamp_ns: expected an integer"),
    "time text": ({"stamp_ns": "now"}, "stamp_ns: expected an integer"),
    "time too large": ({"stamp_ns": 2**63}, "stamp_ns: expected an int64"),
    "sensor a number": ({"sensor": 5}, "sensor"),
}


@pytest.fixture(scope="module")
def detector_in_flight():
    """A detector that bad scans leave as it is."""
    return flown()


@pytest.mark.parametrize("fault", BAD)
def test_a_bad_scan_raises_and_changes_nothing(fault, detector_in_flight):
    arguments, text = BAD[fault]
    before, count = state(detector_in_flight), detector_in_flight.health()
    with pytest.raises(InputError, match=text):
        feed(detector_in_flight, scans_of(SCENE)[BEFORE], **arguments)
    assert state(detector_in_flight) == before
    after = detector_in_flight.health()
    assert (after.received, after.rejected) == (count.received + 1, count.rejected + 1)
    assert (after.processed, after.held) == (BEFORE, 0)


def test_bad_scans_are_counted_where_that_is_wanted_and_leave_no_trace():
    config = CONFIG.model_copy(update={"on_bad_scan": "count"})
    detector = flown(config)
    for arguments, text in BAD.values():
        frame = feed(detector, scans_of(SCENE)[BEFORE], **arguments)
        assert text.replace("\\", "") in frame.rejected
        assert not frame.status.gate_open
        assert frame.status.reason == f"scan rejected: {frame.rejected}"
        assert len(frame.detections) == len(frame.point_class) == 0
        assert frame.tracks.id.tolist() == [0]
    assert detector.health().rejected == len(BAD)
    goes_on_as(detector, flown())


@pytest.mark.parametrize("fault", ["pose NaN", "one point too few", "times after the stream"])
def test_a_bad_first_scan_leaves_no_trace(fault):
    arguments, text = BAD[fault]
    detector, twin = FlyingObjectDetector(CONFIG), FlyingObjectDetector(CONFIG)
    before = state(detector)
    away = scans_of(SCENE)[0].poses + changed(np.zeros((4, 4)), (0, 3), 1000.0)
    with pytest.raises(InputError, match=text):
        feed(detector, scans_of(SCENE)[0], **{"world_from_lidar": away} | arguments)
    assert state(detector) == before
    for simulated in scans_of(SCENE)[:BEFORE]:
        feed(detector, simulated), feed(twin, simulated)
    goes_on_as(detector, twin)


def test_faults_between_all_scans_leave_no_trace():
    config = CONFIG.model_copy(update={"on_bad_scan": "count"})
    detector, twin = FlyingObjectDetector(config, threads=2), flown()
    rng = np.random.default_rng(0)
    scans = scans_of(SCENE)[:BEFORE]
    for simulated in scans:
        for fault in rng.choice([name for name in BAD if "time" not in name], 5):
            feed(detector, simulated, **BAD[fault][0])
        feed(detector, simulated)
        assert feed(detector, simulated).rejected.startswith("stamp_ns: expected a stamp after")
    health = detector.health()
    assert (health.received, health.processed, health.held) == (7 * BEFORE, BEFORE, 0)
    assert health.received == health.processed + health.held + health.rejected
    goes_on_as(detector, twin)


def test_too_many_points_is_a_limit():
    detector, twin = flown(), flown()
    points = np.full((4_000_001, 3), np.nan, np.float32)
    with pytest.raises(LimitError, match="4000001 points"):
        detector.process(points, np.eye(4), NOW)
    assert detector.health().rejected == 1
    goes_on_as(detector, twin)


def test_a_map_beyond_its_budget_is_a_limit():
    """Scans of which the map cannot hold the voxels are refused; the others go on."""
    free = flown()
    config = CONFIG.model_copy(
        update={"voxel_map": VoxelMapConfig(max_voxels=free.map_memory_bytes)}
    )
    detector = FlyingObjectDetector(config)
    for simulated in scans_of(SCENE)[:BEFORE]:
        feed(detector, simulated)
    budget = detector._detector.map_size()[0]
    config = CONFIG.model_copy(update={"voxel_map": VoxelMapConfig(max_voxels=budget)})
    detector, twin = flown(config), flown(config)
    away = np.eye(4)
    away[0, 3] = 300.0
    before = state(detector)
    with pytest.raises(LimitError, match=r"voxel_map\.max_voxels"):
        feed(detector, scans_of(SCENE)[BEFORE], **STILL | {"world_from_lidar": away})
    assert state(detector) == before
    with pytest.raises(LimitError, match=r"voxel_map\.max_voxels"):
        detector.set_occupied([[500.0, 0.0, 0.0]])
    assert state(detector) == before
    goes_on_as(detector, twin)


def test_a_budget_that_is_full_when_the_ground_is_seeded():
    """The voxel under the take-off place does not fit any more: nothing of the scan stays."""
    seed = CONFIG.seed.model_copy(update={"take_off_height": 90.0})
    free = flown(scans=1)
    budget = VoxelMapConfig(max_voxels=free._detector.map_size()[0])
    config = CONFIG.model_copy(update={"seed": seed, "voxel_map": budget})
    detector = FlyingObjectDetector(config)
    before = state(detector)
    with pytest.raises(LimitError):
        feed(detector, scans_of(SCENE)[0])
    assert state(detector) == before


# --- scans with little in them --------------------------------------------------------------------


@pytest.mark.parametrize(
    "points",
    [
        np.empty((0, 3)),
        np.empty((0, 7, 3)),
        np.full((50, 3), np.nan),
        np.full((50, 3), np.inf),
        np.zeros((50, 3)),
        np.array([[5.0, 0.0, 0.0]]),
        np.full((500, 3), 4.0),
        [[5, 0, 0], [6, 0, 1]],
        np.ones((4, 6, 3))[::2, ::3],
        np.array([[-np.inf, 0.0, 0.0]]),
    ],
    ids=["none", "no rows", "NaN", "inf", "zero", "one", "equal", "ints", "strided", "-inf"],
)
def test_scans_with_little_in_them_are_scans(points):
    for detector in (FlyingObjectDetector(CONFIG), flown()):
        count = np.asarray(points).reshape(-1, 3).shape[0]
        tracks = len(detector.tracks_at(NOW))
        frame = detector.process(points, np.eye(4), NOW)
        assert frame.point_class.shape == (count,)
        assert len(frame.detections) <= (count == 500)  # so many in the sky may be a target
        rows = np.asarray(points, np.float32).reshape(-1, 3)
        used = np.isfinite(rows).all(axis=1) & (np.abs(rows).max(axis=1, initial=0) > 0.3)
        assert ((frame.point_class > 0) == used).all()
        assert len(detector.tracks_at(NOW)) == tracks
        assert detector.health().rejected == 0


def test_a_scan_without_points_clears_nothing():
    """Nor does one of NaN: no information is not open sky."""
    beams = SensorConfig(beams="learnt")
    ground = CONFIG.seed.model_copy(update={"ground_height": 5.0})
    seeded = CONFIG.model_copy(update={"seed": ground})
    for config in (seeded, seeded.model_copy(update={"sensor": beams})):
        detector = FlyingObjectDetector(config)
        for simulated in scans_of(SCENE)[:BEFORE]:
            pose, scan = simulated.poses[0], simulated.scan
            points = scan.points.reshape(-1, 3)
            detector.process(points[~scan.no_return], pose, scan.stamp_ns)
        occupied = detector.occupied_points()
        assert len(occupied) > 20
        for k in range(20):
            points = np.full((30 * (k % 2), 3), np.nan)
            frame = detector.process(points, pose, NOW + k)
            assert frame.status.sky_share == 0.0
            assert frame.n_rays == 0
        np.testing.assert_array_equal(detector.occupied_points(), occupied)


# --- other calls ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("config", "text"),
    [
        ({"voxel_map": VoxelMapConfig(voxel_size=0.02)}, "search_distance"),
        (
            {
                "voxel_map": VoxelMapConfig(voxel_size=0.1),
                "separate": SeparateConfig(max_gap=7.0),
            },
            "max_gap",
        ),
        (
            {
                "voxel_map": VoxelMapConfig(voxel_size=0.05),
                "classify": ClassifyConfig(close_distance=10.0),
            },
            "close_distance",
        ),
    ],
)
def test_values_that_cannot_work_together_are_refused_at_once(config, text):
    with pytest.raises(ConfigError, match=text):
        FlyingObjectDetector(FlyingConfig(**config))


@pytest.mark.parametrize("threads", [0, -1])
def test_threads_are_counted_from_one(threads):
    with pytest.raises(ConfigError, match="threads"):
        FlyingObjectDetector(threads=threads)


def test_no_config_is_not_a_config():
    with pytest.raises(ConfigError):
        FlyingObjectDetector({"range_std": 0.1})


def test_a_detection_without_spread_and_noise_is_still_a_detection():
    """One point, no range noise: a covariance of zero is no reason to fail half way."""
    paper = FlyingConfig.paper()
    config = CONFIG.model_copy(
        update={"classify": paper.classify, "tracker": paper.tracker, "range_std": 0.0}
    )
    detector = FlyingObjectDetector(config)
    frames = [feed(detector, simulated) for simulated in scans_of(SCENE)]
    assert detector.health().processed == len(frames)
    assert 1 in np.concatenate([frame.detections.n_points for frame in frames])


@pytest.mark.parametrize("scale", [1e150, 1e100, 1e12, 1e-300, 0.0])
def test_pose_covariances_of_any_size(scale):
    """Taken or refused, but not both: what was refused has changed nothing."""
    detector, twin = flown(), flown()
    before = state(detector)
    covariance = np.ones((6, 6)) * scale
    try:
        frame = feed(detector, scans_of(SCENE)[BEFORE], pose_covariance=covariance)
    except InputError:
        assert state(detector) == before
        goes_on_as(detector, twin)
    else:
        assert np.isfinite(frame.detections.covariance).all()
        assert detector.health().processed == BEFORE + 1


@pytest.mark.parametrize(
    ("ids", "positions", "radius", "error"),
    [
        ([1, 2], [[0, 0, 0]], 1.0, InputError),
        ([1.5], [[0, 0, 0]], 1.0, InputError),
        ([1], [[0, 0]], 1.0, InputError),
        ([1], [[np.nan, 0, 0]], 1.0, InputError),
        ([1], [[0, 0, 0]], np.nan, InputError),
        ([1], [[0, 0, 0]], -1.0, InputError),
        ([1], [[0, 0, 0]], "wide", InputError),
    ],
)
def test_teammates_are_checked(ids, positions, radius, error):
    with pytest.raises(error):
        flown().set_teammates(ids, positions, radius=radius)


def test_known_voxels_are_checked():
    detector = flown()
    before = state(detector)
    for points in ([[np.nan, 0, 0]], [[0, 0]], [[1e30, 0, 0]], "here"):
        for call in (detector.set_occupied, detector.set_free):
            with pytest.raises(InputError):
                call(points)
    with pytest.raises(InputError):
        detector.state_at([[0, 0]])
    detector.set_occupied(np.empty((0, 3)))
    assert state(detector) == before


def test_a_priori_points_that_cannot_be_used_do_not_place_the_map():
    detector, twin = FlyingObjectDetector(CONFIG), FlyingObjectDetector(CONFIG)
    with pytest.raises(InputError):
        detector.set_occupied([[1e6, 0.0, 0.0], [1e30, 0.0, 0.0]])
    for simulated in scans_of(SCENE)[:BEFORE]:
        feed(detector, simulated), feed(twin, simulated)
    goes_on_as(detector, twin)


@pytest.mark.parametrize("stamp", [1.5, None, "now", 2**63])
def test_stamps_of_predictions_are_checked(stamp):
    with pytest.raises(InputError, match="stamp_ns"):
        flown(scans=1).tracks_at(stamp)


def counting():
    return FlyingObjectDetector(FlyingConfig(on_bad_scan="count"))


def test_a_rejected_posed_scan_keeps_its_time():
    bad = Scan(7, np.zeros((2, 3), np.float32), "lidar", no_return=np.ones(3, bool))
    frame = counting().process(PosedScan(bad, np.eye(4)))
    assert frame.rejected.startswith("no_return: expected shape (2,)")
    assert frame.stamp_ns == 7


def test_a_scan_without_a_pose_is_told_what_it_lacks():
    scan = Scan(7, np.zeros((2, 3), np.float32), "lidar")
    told = (
        r"points_lidar: expected a posed scan or an array, got a Scan without a pose: PosedScan\("
    )
    with pytest.raises(InputError, match=told):
        FlyingObjectDetector(FlyingConfig(on_bad_scan="raise")).process(scan)
    frame = counting().process(scan)
    assert (frame.stamp_ns, "PosedScan(" in frame.rejected) == (7, True)


def test_names_of_sensors_are_free_after_a_reset():
    detector = FlyingObjectDetector(FlyingConfig(on_bad_scan="raise"))

    def give(name, stamp_ns):
        return detector.process(np.ones((1, 3), np.float32), np.eye(4), stamp_ns, sensor=name)

    for number in range(64):
        give(f"old {number}", number)
    with pytest.raises(LimitError, match='sensor "new", the detector\'s 65th'):
        give("new", 64)
    detector.reset()
    for number in range(64):
        give(f"new {number}", number)
    with pytest.raises(LimitError, match="65th"):
        give("old 1", 64)


def test_health_counts_clouds_in_millimetres_and_clouds_without_a_point():
    rng = np.random.default_rng(1)
    cloud = rng.uniform(2, 20, (5000, 3)).astype(np.float32)
    nearly_empty = np.full((5000, 3), np.nan, np.float32)
    nearly_empty[7] = (3.0, 4.0, 5.0)
    clouds = {
        "metres": (cloud, 0, 0),
        "millimetres": (1000 * cloud, 1, 0),
        "no rows": (cloud[:0], 0, 1),
        "no points": (np.full((5000, 3), np.nan, np.float32), 0, 1),
        "one point": (nearly_empty, 0, 0),
    }
    for name, (points, far, empty) in clouds.items():
        detector = FlyingObjectDetector()
        detector.process(points, np.eye(4), 0)
        health = detector.health()
        assert (health.far_scans, health.empty_scans) == (far, empty), name
        assert FlyingObjectDetector.from_bytes(detector.to_bytes()).health() == health
