"""Pictures of circle maps: drawn for any run, whole, and named when their package is missing."""

import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from circle_states import Circles
from matplotlib.image import imread

from lidar_core import MissingExtraError
from lidar_core.extras import install_command
from lidar_core.viz import CirclesView, animate_circles, draw_circles

SHAPE = (630, 1080)
COLOUR_STEP = 0.6 / 255
"""Less than one step of an 8-bit channel."""
FIRST = np.array([0x15, 0x80, 0x3D]) / 255
"""Of element 1."""
FOURTH = np.array([0xBE, 0x18, 0x5D]) / 255
"""Of element 4."""
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


def test_what_left_the_map_stays_in_the_picture(view, tmp_path):
    """People who passed are gone at the end."""
    first = replace(view, maps=[map_at(SCANS)] * 3 + [map_at(0)] * (SCANS - 3))
    with_way = draw_circles(first, tmp_path / "a.png")
    without = draw_circles(replace(view, maps=[map_at(0)] * SCANS), tmp_path / "b.png")
    above = np.s_[60:, :600]  # left of the curves over time

    def purple(path):
        image = imread(path)[above][:, :, :3]
        return (np.abs(image - FOURTH) < COLOUR_STEP).all(axis=2).sum()

    assert purple(with_way) > 100  # its label
    assert purple(without) == 0


def test_elements_are_drawn_in_their_colour(view, tmp_path):
    path = draw_circles(view, tmp_path / "picture.png")
    assert imread(path).shape[:2] == SHAPE
    assert share_of(path, FIRST) > 2e-4
    without = replace(
        view,
        maps=[
            replace(
                state,
                id=state.id[:0],
                center=state.center[:0],
                radius=state.radius[:0],
                covariance=state.covariance[:0],
            )
            for state in view.maps
        ],
    )
    assert share_of(draw_circles(without, tmp_path / "b.png"), FIRST) == 0


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
