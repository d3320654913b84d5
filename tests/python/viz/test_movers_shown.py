"""What moves on the ground is seen: background never thins it out, and every frame holds it."""

import base64
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from test_view import needs_rerun
from test_viz import drawn, moving_from, tracks_at, view  # noqa: F401

from lidar_core.flying import FlyingObjectDetector
from lidar_core.messages import PointClass, PosedScan, Scan, ShownClass
from lidar_core.runs.scans import flying_output
from lidar_core.viz import Objects, playback_picture, rerun_log
from lidar_core.viz.drawing.frame import Window, box_of_movers, window_around
from lidar_core.viz.drawing.thinning import evenly, spread, thinned
from lidar_core.viz.pictures import flying_picture
from lidar_core.viz.playback import Moment
from lidar_core.viz.report import scene

BACKGROUND, UNKNOWN = ShownClass.BACKGROUND, ShownClass.UNKNOWN
MARKED = (ShownClass.FLYING, ShownClass.MOVING, ShownClass.OWN_BODY)
BLUE = playback_picture.POINT_COLOURS[ShownClass.MOVING]
PLAN = Window(np.full(2, -30.0), np.full(2, 30.0))
TRUCK = 10_000
STRAY = np.array([[900.0, -700.0, 80.0]])
RNG = np.random.default_rng(0)


def person_at(*place, count=60):
    return np.asarray(place) + RNG.uniform(-1, 1, (count, 3)) * [0.25, 0.25, 0.9]


def moment_of(*clouds, objects=0, at=(0.0, 0.0, 5.0)):
    """A scan of clouds (class, points), and so many objects at a place."""
    kinds = [np.full(len(points), kind, np.uint8) for kind, points in clouds]
    found = Objects(
        id=np.arange(objects),
        position=np.tile(at, (objects, 1)),
        velocity=np.zeros((objects, 3)),
        covariance=np.tile(np.eye(3) * 0.01, (objects, 1, 1)),
        size=np.ones((objects, 3)),
    )
    points = np.concatenate([points for _, points in clouds]).astype(np.float32)
    return Moment(0, points, np.concatenate(kinds), found, sensor=np.zeros(3))


def street(count=120_000):
    return RNG.uniform((-30, -30, -2), (30, 30, 2), (count, 3))


def truck_and_person():
    """The side of a truck, and 40 points of a person 2 m beside it."""
    side = RNG.uniform((0, 8, 0), (10, 8, 3), (TRUCK, 3))
    return np.concatenate([side, person_at(12, 8, 1, count=40)])


def run_of(*moments):
    """A run of the detector that consists of these moments."""
    trails = {row: moments[0].objects.position[[row]] for row in moments[0].objects.id.tolist()}
    return SimpleNamespace(
        capability="flying",
        folder=Path("run"),
        points_name="scan",
        voxel_map=None,
        occupied=lambda: (np.empty((0, 3)), 0.25),
        times=lambda: list(range(len(moments))),
        moments=lambda chosen=None: iter(moments),
        steps=lambda: ((0, moment.objects) for moment in moments),
        trails=lambda moment, most: trails,
    )


# Thinning


@pytest.mark.parametrize("most", [0, 1, 7, 100, 999, 1000, 5000])
def test_a_limit_holds_and_few_points_are_all_kept(most):
    points = RNG.normal(size=(1000, 3)) * 5
    for rows in (evenly(1000, most), spread(points, most)):
        assert len(rows) == min(most, 1000)
        assert (np.diff(rows) > 0).all()


@pytest.mark.parametrize("kind", MARKED)
def test_background_and_unknown_points_never_thin_out_what_matters(kind):
    classes = RNG.choice([ShownClass.INVALID, BACKGROUND, UNKNOWN], 10_000).astype(np.uint8)
    classes[::100] = kind
    points = RNG.normal(size=(10_000, 3)).astype(np.float32)
    rows = thinned(points, classes, 300)
    assert len(rows) == 300
    assert (classes[rows] == kind).sum() == 100
    rest = classes[rows][classes[rows] != kind]
    assert {*rest.tolist()} == {ShownClass.INVALID, BACKGROUND, UNKNOWN}
    assert len(thinned(points, classes, 50)) == 50
    assert (classes[thinned(points, classes, 50)] == kind).all()
    assert len(thinned(points, classes, 20_000)) == 10_000


def test_what_matters_is_thinned_evenly_if_it_is_too_much_alone():
    """Of a person of 40 points beside a truck of 10,000, every hundredth point would be none."""
    points = truck_and_person()
    classes = np.full(len(points), ShownClass.MOVING, np.uint8)
    rows = thinned(points, classes, 1000)
    assert len(rows) == 1000
    assert (rows >= TRUCK).sum() >= 10
    rows = spread(points, 100)
    assert len(rows) == 100
    assert (rows >= TRUCK).sum() >= 2
    assert np.ptp(points[rows[rows < TRUCK]], axis=0) == pytest.approx([10, 0, 3], abs=1.5)


def test_a_run_keeps_points_of_a_person_beside_a_truck():
    run, points = flying_output.FlyingRun(FlyingObjectDetector()), truck_and_person()
    item = PosedScan(Scan(0, points.astype(np.float32)), np.eye(4))
    frame = run.detector.process(item)
    run.keep(item, replace(frame, point_class=np.full(len(points), PointClass.MOVING)), 1.0)
    kept = run.view("").moving
    assert len(kept) == flying_output.MOST_MOVING
    assert (kept[:, 0] > 11).sum() >= 2


def test_one_point_very_far_away_costs_no_other_one():
    points = np.concatenate([person_at(0, 0, 0, count=500), STRAY * 1e6])
    rows = spread(points, 100)
    assert len(rows) <= 100
    assert 500 in rows


def test_a_scan_of_many_points_is_drawn_with_its_person():
    axes = pytest.importorskip("matplotlib.figure").Figure().add_subplot()
    person, own = person_at(8, 3, 0), person_at(0, 0, 0)
    clouds = ((BACKGROUND, street()), (ShownClass.MOVING, person), (ShownClass.OWN_BODY, own))
    playback_picture._draw_points(axes, moment_of(*clouds), (0, 1), PLAN, (-9, 9), "scan")
    counts = {
        line.get_color(): len(line.get_xdata()) for line in axes.lines if len(line.get_xdata())
    }
    assert counts[BLUE] == len(person)
    assert counts[playback_picture.POINT_COLOURS[ShownClass.OWN_BODY]] == len(own)
    assert sum(counts.values()) <= playback_picture.MOST_POINTS


def test_a_picture_of_a_run_with_a_dense_last_scan_shows_every_moving_point(view):  # noqa: F811
    walks = moving_from(view)
    walks = replace(walks, cloud=street(), cloud_class=np.ones(120_000, np.uint8))
    above, *_ = drawn(walks)
    counts = [len(one.get_offsets()) for one in above.collections]
    assert len(walks.moving) in counts
    assert max(counts) <= flying_picture.MOST_POINTS


def test_a_report_holds_every_moving_point_and_its_limit(monkeypatch):
    monkeypatch.setattr(scene, "MOST_POINTS", 1000)
    person = person_at(8, 3, 0)
    moments = [moment_of((BACKGROUND, street(9000)), (ShownClass.MOVING, person))] * 2
    made = scene.scene_of(run_of(*moments), {}, start_ns=0, has_known_map=False)
    classes = [base64.b64decode(one["classes"]) for one in made["scans"]]
    assert [list(kept).count(ShownClass.MOVING) for kept in classes] == [len(person)] * 2
    assert sum(map(len, classes)) <= 1000


# Frames


def test_what_moves_on_the_ground_is_in_the_frame_beside_tracks():
    way, walk = np.array([[10.0, 10.0], [14.0, 11.0]]), np.array([[-9.0, 2.0], [-8.0, 3.0]])
    plain, both = window_around([way], 1.0), window_around([way], 1.0, movers=[walk])
    assert not plain.holds(walk[0])
    assert all(both.holds(place) for place in (*way, *walk))
    np.testing.assert_allclose(both.high - both.low, 23 * 2.0)
    near = window_around([way], 1.0, movers=[way + 0.1])
    np.testing.assert_allclose(near.high - near.low, plain.high - plain.low)
    alone = window_around([], 1.0, movers=[walk], also=[np.array([[-7.0, 5.0]])])
    np.testing.assert_allclose(alone.middle, [-8.5, 2.5])
    nobody = window_around([way], 1.0, movers=[np.empty((0, 2))])
    np.testing.assert_array_equal([nobody.low, nobody.high], [plain.low, plain.high])


def test_stray_points_belong_to_no_mover():
    person = person_at(8, 3, 0)
    box = box_of_movers(person)
    np.testing.assert_array_equal(box, [person.min(axis=0), person.max(axis=0)])
    np.testing.assert_array_equal(box_of_movers(np.concatenate([person, STRAY, -STRAY])), box)
    assert box_of_movers(np.concatenate([STRAY, -STRAY])).shape == (0, 3)
    assert box_of_movers(np.empty((0, 3), np.float32)).shape == (0, 3)
    two = box_of_movers(np.concatenate([person, person_at(-19, 0, 0, count=8)]))
    assert two[0, 0] < -18


@pytest.mark.parametrize("plane", [(0, 1), (0, 2)])
def test_the_picture_of_a_run_holds_who_walks_beside_what_flies(view, plane):  # noqa: F811
    person = person_at(-18, -40, 1)
    walks = replace(view, moving=person, moving_scan=np.zeros(len(person), np.int64))
    window = flying_picture._window(walks, plane, 0.8)
    assert all(window.holds(place) for place in person[:, plane])
    assert all(window.holds(way[-1, plane]) for way in (view.truth[1], view.tracks[-1].position))
    without = flying_picture._window(view, plane, 0.8)
    assert not all(without.holds(place) for place in person[:, plane]) or plane == (0, 2)
    strays = replace(walks, moving=np.concatenate([person, STRAY]))
    again = flying_picture._window(strays, plane, 0.8)
    np.testing.assert_array_equal([again.low, again.high], [window.low, window.high])
    alone = replace(view, moving=STRAY, moving_scan=np.zeros(1, np.int64))
    again = flying_picture._window(alone, plane, 0.8)
    np.testing.assert_array_equal([again.low, again.high], [without.low, without.high])


@pytest.mark.parametrize("objects", [0, 1])
@pytest.mark.parametrize("plane", [(0, 1), (0, 2)])
def test_pictures_and_films_of_scans_hold_who_walks(objects, plane):
    """In a cloud that fills 60 m, one person; and a drone, or none."""

    def window(*clouds):
        moment = moment_of((BACKGROUND, street(5000)), *clouds, objects=objects)
        run = run_of(moment)
        shown = playback_picture._Scene.of(run, [(moment, run.trails(moment, 9))])
        return shown.window(plane, 0.9)

    person = person_at(25, 40, 0)
    held = window((ShownClass.MOVING, person))
    assert all(held.holds(place) for place in person[:, plane])
    if objects:
        assert held.holds(np.array([0.0, 0.0, 5.0])[list(plane)])
    strayed = window((ShownClass.MOVING, np.concatenate([person, STRAY])))
    np.testing.assert_array_equal([strayed.low, strayed.high], [held.low, held.high])
    assert not window().holds(person[0, :2]) or plane == (0, 2)


def test_a_film_keeps_all_ways_of_a_person_in_its_frame():
    places = [(x, 12.0, 0.0) for x in np.linspace(-20, 20, 9)]
    moments = [moment_of((ShownClass.MOVING, person_at(*place))) for place in places]
    run = run_of(*moments)
    shown = playback_picture._Scene.of(run, [(moment, {}) for moment in moments])
    window = shown.window((0, 1), 1.0)
    assert all(window.holds(np.array(place[:2])) for place in places)


@pytest.mark.parametrize("side", [-1, 1])
def test_the_legend_hides_nothing_if_a_person_widens_the_frame(view, side):  # noqa: F811
    """Objects are then no longer in the middle third: here an upper corner is the object's."""
    person, drone = person_at(side * 20, -20, 0), (-side * 20.0, 20.0, 5.0)
    moment = moment_of(*((kind, person) for kind in ShownClass if kind), objects=1, at=drone)
    run, figure = run_of(moment), pytest.importorskip("matplotlib.figure").Figure()
    figure.set_size_inches(playback_picture.SIZE)
    shown = [(moment, run.trails(moment, 9))]
    made = playback_picture._Scene.of(run, shown)
    playback_picture._compose(figure, made, *shown[0], {0: "red"}, 0.0)
    track = tracks_at(0, [1], [drone])
    walks = replace(view, moving=person, moving_scan=np.zeros(60, np.int64), tracks=[track] * 20)
    for above in (figure.axes[0], drawn(walks)[0]):
        above.figure.canvas.draw()
        box = above.get_legend().get_window_extent()
        for place in above.transData.transform([drone[:2], *person[:, :2]]):
            assert above.get_window_extent().contains(*place)
            assert not box.contains(*place)


def test_the_view_of_a_report_begins_at_what_moves():
    person = person_at(8, 3, 0)
    clouds = ((BACKGROUND, street(500)), (ShownClass.MOVING, np.concatenate([person, STRAY])))
    made = scene.scene_of(run_of(moment_of(*clouds)), {}, start_ns=0, has_known_map=False)
    np.testing.assert_allclose(made["movers"], box_of_movers(person), atol=1e-3)
    still = run_of(moment_of((BACKGROUND, street(500))))
    assert scene.scene_of(still, {}, start_ns=0, has_known_map=False)["movers"] == []


@needs_rerun
def test_the_view_of_rerun_begins_at_what_moves(monkeypatch, tmp_path):
    framed = []
    monkeypatch.setattr(rerun_log.RerunLog, "frame", lambda log, places: framed.append(places))
    person = person_at(8, 3, 0)
    clouds = ((BACKGROUND, street(500)), (ShownClass.MOVING, person))
    rerun_log.write_rerun(run_of(moment_of(*clouds, objects=1)), tmp_path / "a.rrd")
    (places,) = framed
    np.testing.assert_allclose(places, [[0, 0, 5], *box_of_movers(person)], atol=1e-5)
    rerun_log.write_rerun(run_of(moment_of((BACKGROUND, street(500)))), tmp_path / "b.rrd")
    assert len(framed) == 1
