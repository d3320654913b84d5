"""Open sky and the own body, found in the returns: what drivers drop, mark or replace."""

import numpy as np
import pytest
from flying_scenes import VLP_16, drone, feed, scans_of, yard

from lidar_core import PointClass, sim
from lidar_core.errors import ConfigError
from lidar_core.flying import FlyingConfig, FlyingObjectDetector, SensorConfig
from lidar_core.sim import Circle, Simulator

UNKNOWN = PointClass.UNKNOWN
SCENE = yard(drone((4.5, 2.5, 3.2), (1.0, 5.0, 3.6)), lidar=VLP_16, scans=18)
IN_THE_SKY = [[0.0, 15.0, 3.8]]


def with_sensor(**changes):
    return FlyingConfig(sensor=SensorConfig(**changes))


def dropped(simulated):
    """What a driver delivers that leaves out rays without return."""
    known = np.isfinite(simulated.scan.points).all(axis=2).reshape(-1)
    return {
        "points_lidar": simulated.scan.points.reshape(-1, 3)[known],
        "point_time_ns": simulated.scan.point_time_ns[known],
        "no_return": None,
        "directions": None,
    }


def replaced(simulated, row):
    """The same with a row of its own for every ray without return, and no directions."""
    points = simulated.scan.points.reshape(-1, 3).copy()
    points[~np.isfinite(points).all(axis=1)] = row
    return {"points_lidar": points, "no_return": None, "directions": None}


def marked(simulated):
    """Rays without return are marked, as readers of zero rows do, and have no directions."""
    points = simulated.scan.points.reshape(-1, 3)
    return {"points_lidar": points, "directions": None}


def misses(frame, simulated):
    offset = frame.tracks.position[:, None] - simulated.truth.position
    return np.linalg.norm(offset, axis=2)


def tracked(config, deliver):
    """Share of the scans after the first twelve with one track, on the target; the last frame."""
    detector, found = FlyingObjectDetector(config), []
    for number, simulated in enumerate(scans_of(SCENE)):
        frame = feed(detector, simulated, **deliver(simulated))
        if number > 12:
            found.append(len(frame.tracks) == 1 and misses(frame, simulated).max() < 0.5)
    return np.mean(found), frame, detector


@pytest.mark.ci_cases("*-auto")
@pytest.mark.parametrize("beams", ["auto", "learnt", "vlp-16"])
@pytest.mark.parametrize(
    "deliver",
    [
        dropped,
        marked,
        lambda one: replaced(one, 0.0),
        lambda one: replaced(one, 0.01),
        lambda one: replaced(one, 0.1),
    ],
    ids=["dropped rows", "marks without directions", "zeros", "tiny vectors", "placeholders"],
)
def test_what_flies_before_the_sky_is_tracked_however_the_driver_says_no_return(beams, deliver):
    share, frame, detector = tracked(with_sensor(beams=beams), deliver)
    assert share == 1.0
    assert frame.status.sky == "pattern"
    assert 0.05 < frame.status.sky_share < 0.6
    assert frame.status.n_sky_rays > 100
    assert detector.state_at(IN_THE_SKY) == [0]


def test_a_sensor_with_two_scans_a_second_is_ready_after_one_second():
    scene = SCENE.model_copy(update={"scans": 36})
    simulator, detector = Simulator(scene, seed=0), FlyingObjectDetector()
    for step in range(0, 36, 5):
        simulated = simulator.scan(step)
        frame = feed(detector, simulated, **dropped(simulated))
        assert frame.status.gate_open == (step >= 15)
        assert (frame.status.sky == "unknown") == (step == 0)
        if step >= 25:  # the third detection confirms a track
            assert len(frame.tracks) == 1
            assert misses(frame, simulated).max() < 0.5


@pytest.mark.parametrize("beams", ["given", None])
def test_where_rays_are_to_be_given_and_are_not_the_sky_stays_unknown(beams):
    detector = FlyingObjectDetector(with_sensor(beams=beams))
    for simulated in scans_of(SCENE):
        frame = feed(detector, simulated, **dropped(simulated))
        assert (frame.status.sky, frame.status.n_sky_rays) == ("unknown", 0)
        assert detector.health().sky == "unknown"
        assert len(frame.detections) == len(frame.tracks) == 0
    assert frame.status.gate_open
    assert detector.state_at(IN_THE_SKY) == [1]
    rows = np.isfinite(simulated.scan.points).all(axis=2).reshape(-1)
    own = simulated.label[rows] == simulated.truth.id[0]
    assert set(frame.point_class[own].tolist()) == {UNKNOWN}


def test_a_mask_with_directions_is_never_second_guessed():
    frames = {}
    for beams in ("auto", "given", "vlp-16"):
        detector = FlyingObjectDetector(with_sensor(beams=beams))
        for simulated in scans_of(SCENE):
            frames[beams] = feed(detector, simulated)
        assert frames[beams].status.sky == "given"
        assert frames[beams].status.n_sky_rays == 0
    for one in frames.values():
        np.testing.assert_array_equal(one.point_class, frames["given"].point_class)
        np.testing.assert_array_equal(one.tracks.covariance, frames["given"].tracks.covariance)


def test_free_space_that_only_the_sky_supports_is_less_certain():
    given, found = (tracked(with_sensor(), deliver)[1] for deliver in (lambda _: {}, dropped))
    assert 0 < found.detections.confidence[0] < given.detections.confidence[0]


def test_walls_stay_where_the_sky_is_found():
    """Rays into the sky must not pass through what returns."""
    given, found = (tracked(with_sensor(), deliver)[2] for deliver in (lambda _: {}, dropped))
    walls = given.occupied_points()
    assert (found.state_at(walls) >= 2).mean() > 0.98


@pytest.mark.parametrize("beams", ["hdl-32e", "hdl-64e", "xt32", "livox-avia"])
def test_a_sensor_that_cannot_have_given_the_scans_is_refused_with_those_that_fit(beams):
    detector = FlyingObjectDetector(with_sensor(beams=beams))
    scans = scans_of(SCENE)
    before = detector.map_memory_bytes, detector.n_observed
    for simulated in scans[:5]:
        with pytest.raises(ConfigError, match=rf"sensor\.beams.*{beams}.*fit:.*vlp-16"):
            feed(detector, simulated, **dropped(simulated))
    assert (detector.map_memory_bytes, detector.n_observed) == before
    assert detector.health().rejected == 5


def test_directions_that_the_robot_hides_are_no_sky():
    """The sector lies about +y, where the sky is known without it."""
    _, frame, detector = tracked(with_sensor(blind_sectors=((0.9, 2.2, -1.5, 1.5),)), dropped)
    assert frame.status.sky == "pattern"
    assert detector.state_at(IN_THE_SKY) == [1]


def test_rows_given_with_beams_given_are_not_looked_for():
    config = with_sensor(beams="given", beam_elevations=(-0.1, 0.1))
    detector = FlyingObjectDetector(config)
    for simulated in scans_of(SCENE)[:5]:
        frame = feed(detector, simulated, **dropped(simulated))
        assert frame.status.n_sky_rays == 0


def test_results_do_not_depend_on_the_number_of_threads():
    found = []
    for threads in (1, 2, 3):
        detector = FlyingObjectDetector(threads=threads)
        for simulated in scans_of(SCENE):
            frame = feed(detector, simulated, **dropped(simulated))
        found.append((frame, detector))
    for frame, detector in found[1:]:
        np.testing.assert_array_equal(frame.tracks.covariance, found[0][0].tracks.covariance)
        assert frame.status.sky_share == found[0][0].status.sky_share
        np.testing.assert_array_equal(detector.occupied_points(), found[0][1].occupied_points())


# --- the robot itself -----------------------------------------------------------------------------

DRIVE = yard(scans=40, sensor=Circle(center=(0.0, 0.0, 3.0), radius=6.0, speed=5.0))
ESCORT = [0.0, 5.0, 0.4]


def with_body(simulated, parts):
    """Returns of things that stay in place in the sensor's frame, added to a scan."""
    scan = simulated.scan
    points = np.concatenate([scan.points.reshape(-1, 3), *parts]).astype(np.float32)
    more = len(points) - scan.points.shape[0] * scan.points.shape[1]
    rays = np.concatenate([scan.directions, np.zeros((more, 3), np.float32)])
    return {
        "points_lidar": points,
        "no_return": np.concatenate([scan.no_return, np.zeros(more, bool)]),
        "directions": rays,
        "point_time_ns": np.concatenate([scan.point_time_ns, np.full(more, scan.stamp_ns)]),
    }


def roof(rng):
    """A plate of 0.8 m by 1 m, 1.4 m behind the sensor and below it."""
    plate = rng.uniform((-2.2, -0.5, -0.5), (-1.4, 0.5, -0.48), (300, 3))
    return plate + rng.normal(0, 0.01, plate.shape)


def ball(center, rng, radius=0.325):
    """Returns on the near side of a ball."""
    toward = -np.asarray(center) / np.linalg.norm(center)
    normals = rng.normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return np.asarray(center) + radius * normals[normals @ toward > 0.3]


def test_the_own_body_is_neither_target_nor_background():
    detector, rng = FlyingObjectDetector(), np.random.default_rng(1000)
    for number, simulated in enumerate(scans_of(DRIVE)):
        plate = roof(rng)
        frame = feed(detector, simulated, **with_body(simulated, [plate]))
        assert len(frame.tracks) == 0
        if number > 12:
            assert set(frame.point_class[-len(plate) :].tolist()) == {UNKNOWN}
            assert 0 < frame.status.own_body < 0.1
            assert detector.health().own_body == frame.status.own_body
    assert frame.status.own_body_is_decided


def test_what_escorts_the_robot_at_a_distance_is_a_target():
    detector, rng, hits = FlyingObjectDetector(), np.random.default_rng(1000), []
    for number, simulated in enumerate(scans_of(DRIVE)):
        target = ball(ESCORT, rng)
        frame = feed(detector, simulated, **with_body(simulated, [roof(rng), target]))
        pose = simulated.poses[0]
        place = pose[:3, :3] @ ESCORT + pose[:3, 3]
        if number > 12:
            distance = np.linalg.norm(frame.tracks.position - place, axis=1)
            hits.append(distance.min(initial=9.0) < 1.0)
    assert np.mean(hits) > 0.95


def test_without_the_search_the_own_body_is_tracked():
    """The test above can fail: without `find_body` the roof is a target."""
    detector = FlyingObjectDetector(with_sensor(find_body=False))
    rng, seen = np.random.default_rng(1000), 0
    for simulated in scans_of(DRIVE):
        frame = feed(detector, simulated, **with_body(simulated, [roof(rng)]))
        seen += len(frame.tracks)
    assert seen > 0
    assert frame.status.own_body == 0.0


def test_a_wet_road_and_what_it_mirrors_do_not_fly():
    street = sim.scenes.dark_street(
        1, sensor="livox-avia", fronts=(sim.surfaces.CONCRETE,), road=sim.surfaces.WET
    )
    simulator, detector = sim.Simulator(street, seed=1), FlyingObjectDetector()
    below = 0
    for number in range(24):
        made = simulator.scan(number)
        frame = feed(detector, made, no_return=None, directions=None)
        below += (made.label == -3).sum()  # seen in the mirror
        assert len(frame.detections) == len(frame.tracks) == 0
    assert below > 1000
