"""Pictures of circle maps: drawn for any run, whole, and named when their package is missing."""

import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from circle_states import Circles
from matplotlib.image import imread

from lidar_core import MissingExtraError, TrackKind
from lidar_core.circles.movers import moved, moving_at_end
from lidar_core.extras import install_command
from lidar_core.viz import CirclesView, animate_circles, draw_circles
from lidar_core.viz.drawing.labels import NUMBER
from lidar_core.viz.pictures import circles_picture

SHAPE = (630, 1080)
COLOUR_STEP = 0.6 / 255
"""Less than one step of an 8-bit channel."""
FIRST = np.array([0x03, 0x69, 0xA1]) / 255
"""Of element 1."""
SCANS = 20


def map_at(number):
    ids = [1, 4] if number > 3 else [1]
    count = len(ids)
    return Circles(
        id=np.array(ids, np.int64),
        center=np.array([[3 + 0.05 * number, 1.0], [2.0, -1.0]])[:count],
        velocity=np.array([[0.5, 0.0], [0.0, 0.0]])[:count],
        radius=np.array([0.3, 0.5])[:count],
        covariance=np.tile(np.diag([0.002, 0.004, 0.01, 0.01, 1e-4]), (count, 1, 1)),
        age=np.ones(count),
        visible=np.array([True, False])[:count],
        kind=np.array([TrackKind.GROUND, TrackKind.STATIC], np.uint8)[:count],
        stamp_ns=number * 50_000_000,
    )


@pytest.fixture
def view():
    rng = np.random.default_rng(3900)
    way = np.stack([np.linspace(3, 4, SCANS), np.full(SCANS, 1.02)], axis=1)
    return CirclesView(
        title="a run",
        points=[rng.uniform(-5, 5, (200, 2)) for _ in range(SCANS)],
        sensor=np.stack([np.linspace(0, 1, SCANS), np.zeros(SCANS)], axis=1),
        stamp_ns=np.arange(SCANS, dtype=np.int64) * 50_000_000,
        maps=[map_at(number) for number in range(SCANS)],
        n_circles=np.full(SCANS, 3),
        truth={1: way, 2: np.full_like(way, np.nan)},
    )


def empty(view):
    none = np.empty((0, 2))
    return replace(
        view,
        points=[],
        sensor=none,
        stamp_ns=np.empty(0, np.int64),
        maps=[],
        n_circles=np.empty(0, np.int64),
        truth={},
    )


def share_of(path, colour):
    image = imread(path)[:, :, :3]
    return (np.abs(image - colour) < COLOUR_STEP).all(axis=2).mean()


def composed(view):
    figure = pytest.importorskip("matplotlib.figure").Figure(figsize=circles_picture.SIZE)
    circles_picture._compose(figure, view)
    return figure.axes


def numbers_in(axes):
    return {text.get_text() for text in axes.texts if text.get_gid() == NUMBER}


def keys_of(axes):
    return {text.get_text() for text in axes[1].get_legend().get_texts()}


def test_what_left_the_map_stays_in_the_picture(view):
    """People who passed are gone at the end."""
    first = replace(view, maps=[map_at(SCANS)] * 3 + [map_at(0)] * (SCANS - 3))
    axes = composed(first)
    assert {"4", "1 0.5 m/s"} == numbers_in(axes[0])
    assert "no longer in the map" in keys_of(axes)
    axes = composed(replace(view, maps=[map_at(0)] * SCANS))
    assert {"1 0.5 m/s"} == numbers_in(axes[0])
    assert "no longer in the map" not in keys_of(axes)


def test_what_is_out_of_sight_has_a_style_of_its_own(view):
    """Dark and dotted it looked like what is no longer in the map."""
    axes = composed(view)
    assert "in the map, out of sight" in keys_of(axes)
    styles = {}
    for disc in axes[0].patches:
        if hasattr(disc, "get_radius"):
            styles[disc.get_radius()] = disc.get_linestyle(), disc.get_linewidth()
    moves, hidden = styles[0.3], styles[0.5]
    assert (moves[0], hidden[0]) == ("-", ":")
    assert moves[1] > 2 * hidden[1]
    seen = [replace(state, visible=np.ones(len(state.id), bool)) for state in view.maps]
    assert "in the map, out of sight" not in keys_of(composed(replace(view, maps=seen)))


def test_speeds_are_shown_where_something_moves(view):
    titles = [axes.get_title() for axes in composed(view)]
    assert "speed of what moves" in titles
    (speeds,) = (axes for axes in composed(view) if "speed" in axes.get_title())
    (curve,) = speeds.lines
    assert curve.get_label() == "1"
    assert curve.get_ydata() == pytest.approx(np.full(SCANS, 0.5))
    kind = np.full(2, TrackKind.STATIC, np.uint8)
    still = [replace(one, kind=kind[: len(one.id)], velocity=0 * one.velocity) for one in view.maps]
    stands = composed(replace(view, maps=still))
    assert not [axes for axes in stands if "speed" in axes.get_title()]
    assert numbers_in(stands[0]) == {"1", "4 person"}


@pytest.mark.parametrize("is_gone", [False, True])
def test_circles_at_the_border_lie_in_the_picture_as_a_whole(view, is_gone):
    """A circle that the points alone would cut, and one far away that is not shown at all."""
    state = map_at(SCANS)
    places = np.array([[5.1, 5.1], [60.0, 0.0]])
    other = replace(state, center=places, radius=np.array([1.2, 0.5]), id=np.array([7, 8]))
    maps = [other, *view.maps[1:]] if is_gone else [*view.maps[:-1], other]
    above = composed(replace(view, maps=maps))[0]
    low, high = np.array([above.get_xlim(), above.get_ylim()]).T
    assert (low <= places[0] - 1.2).all()
    assert (high >= places[0] + 1.2).all()
    assert high[0] < 30


def test_many_that_left_are_drawn_with_their_numbers_or_not_at_all(view):
    """The longest ways, as many as there is room for."""
    state, most = map_at(SCANS), circles_picture.MOST_GONE
    rows = np.zeros(most + 5, int)
    many = Circles(
        id=10 + np.arange(len(rows)),
        center=np.random.default_rng(1000).uniform(-4, 4, (len(rows), 2)),
        velocity=state.velocity[rows],
        radius=np.full(len(rows), 0.123),
        covariance=state.covariance[rows],
        age=state.age[rows],
        visible=state.visible[rows],
        stamp_ns=0,
    )
    axes = composed(replace(view, maps=[many, *view.maps[1:]]))
    discs = [disc for disc in axes[0].patches if getattr(disc, "radius", 0) == 0.123]
    assert len(discs) == most
    assert len(numbers_in(axes[0])) == most + 2
    assert f"no longer in the map, {most} of {most + 5}" in keys_of(axes)


def test_what_moved_is_ground_or_went_some_way():
    def states(kind, step):
        ways = [map_at(number) for number in range(3)]
        centers = [np.array([[number * step, 0.0]]) for number in range(3)]
        kinds = np.array([kind], np.uint8)
        return [
            replace(one, center=place, kind=kinds) for one, place in zip(ways, centers, strict=True)
        ]

    assert moved(states(TrackKind.GROUND, 0.0)) == {1}
    assert moved(states(TrackKind.STATIC, 1.0)) == set()
    assert moved(states(TrackKind.UNKNOWN, 1.0)) == {1}
    assert moved(states(TrackKind.UNKNOWN, 0.1)) == set()
    assert moving_at_end(states(TrackKind.GROUND, 0.0)) == {1: 0.5}
    assert moving_at_end(states(TrackKind.STATIC, 1.0)) == {}
    assert moving_at_end([]) == {}


def test_elements_are_drawn_in_their_colour(view, tmp_path):
    path = draw_circles(view, tmp_path / "picture.png")
    assert imread(path).shape[:2] == SHAPE
    without = replace(
        view,
        maps=[
            replace(
                state,
                id=state.id[:0],
                center=state.center[:0],
                velocity=state.velocity[:0],
                kind=state.kind[:0],
                radius=state.radius[:0],
                covariance=state.covariance[:0],
            )
            for state in view.maps
        ],
    )
    of_counts = share_of(draw_circles(without, tmp_path / "b.png"), FIRST)
    assert share_of(path, FIRST) > of_counts + 2e-4


def test_the_same_run_gives_the_same_bytes(view, tmp_path):
    first = draw_circles(view, tmp_path / "a.png").read_bytes()
    assert draw_circles(view, tmp_path / "b.png").read_bytes() == first


def test_a_run_without_scans_can_be_drawn(view, tmp_path):
    assert draw_circles(empty(view), tmp_path / "a.png").exists()
    assert animate_circles(empty(view), tmp_path / "a.gif", frames=5, rate=5.0).exists()


def test_scans_whose_points_were_not_kept_are_left_out_of_the_film(view, tmp_path):
    image = pytest.importorskip("PIL.Image")
    points = [rows if number % 5 == 0 else rows[:0] for number, rows in enumerate(view.points)]
    path = animate_circles(replace(view, points=points), tmp_path / "a.gif", frames=9, rate=5.0)
    with image.open(path) as made:
        assert (made.format, made.n_frames) == ("GIF", 4)
    told = []
    path = animate_circles(
        view, path, frames=3, rate=5.0, on_frame=lambda done, total: told.append((done, total))
    )
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]
    with image.open(path) as made:
        assert made.n_frames == 3
    assert [file.name for file in tmp_path.iterdir()] == ["a.gif"]


def film(view, path):
    return animate_circles(view, path.with_suffix(".gif"), frames=2, rate=1.0)


@pytest.mark.parametrize("draw", [draw_circles, film])
def test_without_matplotlib_the_extra_is_named(view, tmp_path, monkeypatch, draw):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=re.escape(install_command("plot"))):
        draw(view, tmp_path / "picture.png")
    assert list(tmp_path.iterdir()) == []
