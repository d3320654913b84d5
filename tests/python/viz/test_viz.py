"""Pictures: drawn for any run, whole, and named when their package is missing."""

import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread

from lidar_core import MissingExtraError, TrackKind
from lidar_core.extras import install_command
from lidar_core.flying import FlyingObjectDetector, Tracks
from lidar_core.runs.scans.flying_output import FlyingRun
from lidar_core.viz import FlyingView, draw_flying
from lidar_core.viz.pictures import flying_picture

SHAPE = (902, 1540)
FLYING = np.array([0xFB, 0x71, 0x85]) / 255
TRACK = np.array([0x03, 0x69, 0xA1]) / 255
COLOUR_STEP = 0.6 / 255
"""Less than one step of an 8-bit channel."""


def tracks_at(number, ids, position):
    count = len(ids)
    return Tracks(
        id=np.array(ids, np.int64),
        position=np.array(position, float).reshape(count, 3),
        velocity=np.zeros((count, 3)),
        acceleration=np.zeros((count, 3)),
        covariance=np.tile(np.eye(9) * 0.3, (count, 1, 1)),
        extent=np.ones((count, 3)),
        n_detections=np.ones(count, np.int64),
        age=np.ones(count),
        existence=np.ones(count),
        kind=np.full(count, TrackKind.FLYING, np.uint8),
        kind_probability=np.full((count, 5), 0.2),
        stamp_ns=number * 100_000_000,
    )


@pytest.fixture
def view():
    rng = np.random.default_rng(0)
    cloud = rng.uniform((-20, -20, 0), (20, 20, 8), (5000, 3))
    cloud[:10] = np.nan
    stamps = np.arange(20, dtype=np.int64) * 100_000_000
    way = np.stack([np.linspace(5, 9, 20), np.full(20, 4.0), np.full(20, 5.0)], axis=1)
    return FlyingView(
        title="a run",
        cloud=cloud,
        cloud_class=np.where(np.isnan(cloud[:, 0]), 0, rng.choice([1, 3], 5000)).astype(np.uint8),
        flying=way + np.array([0, 3, 0]),
        occupied=np.round(cloud[10:] / 0.25) * 0.25,
        voxel_size=0.25,
        sensor=np.stack([np.linspace(0, 4, 20), np.zeros(20), np.full(20, 2.0)], axis=1),
        stamp_ns=stamps,
        tracks=[tracks_at(n, [3, 9], [way[n], way[n] * [-1, 1, 1]]) for n in range(20)],
        n_detections=np.full(20, 2),
        truth={1: way, 2: np.full_like(way, np.nan)},
        recall={"tracks": (stamps[5:], np.ones(15)), "detections": (stamps[5:], np.full(15, 0.5))},
    )


def shares(path):
    """Share of the pixels of the colours of flying points and of the first track."""
    pixels = imread(path)[..., :3]
    return [
        np.mean(np.abs(pixels - colour).max(axis=-1) < COLOUR_STEP) for colour in (FLYING, TRACK)
    ]


def test_a_run_with_truth_shows_its_tracks(view, tmp_path):
    path = draw_flying(view, tmp_path / "picture.png")
    assert imread(path).shape[:2] == SHAPE
    assert min(shares(path)) > 1e-5
    assert [file.name for file in tmp_path.iterdir()] == ["picture.png"]


def test_a_run_without_truth_tracks_or_points_is_drawn(view, tmp_path):
    nothing = np.empty((0, 3))
    empty = replace(
        view,
        cloud=nothing,
        cloud_class=np.empty(0, np.uint8),
        flying=nothing,
        occupied=nothing,
        tracks=[tracks_at(n, [], []) for n in range(20)],
        truth={},
        recall={},
    )
    full = shares(draw_flying(view, tmp_path / "full.png"))
    assert shares(draw_flying(empty, tmp_path / "a.png"))[0] < full[0]
    no_scans = replace(
        empty,
        sensor=nothing,
        stamp_ns=np.empty(0, np.int64),
        tracks=[],
        n_detections=np.empty(0, np.int64),
    )
    assert imread(draw_flying(no_scans, tmp_path / "b.png")).shape[:2] == SHAPE


def test_the_same_view_gives_the_same_picture(view, tmp_path):
    first = draw_flying(view, tmp_path / "a.png").read_bytes()
    assert draw_flying(view, tmp_path / "b.png").read_bytes() == first


def test_without_matplotlib_the_extra_is_named(view, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=re.escape(install_command("plot"))):
        draw_flying(view, tmp_path / "picture.png")
    assert list(tmp_path.iterdir()) == []


def moving_from(view):
    """The view of a run in which nothing flies, and somebody walks."""
    walked = np.stack([np.linspace(-9, -6, 20), np.full(20, 8.0), np.ones(20)], axis=1)
    return replace(
        view,
        flying=view.flying[:0],
        tracks=[tracks_at(n, [], []) for n in range(20)],
        truth={},
        recall={},
        moving=walked,
        moving_scan=np.arange(20),
    )


def drawn(view):
    figure = pytest.importorskip("matplotlib.figure").Figure(figsize=flying_picture.SIZE)
    flying_picture._compose(figure, view)
    return figure.axes


def test_what_walks_is_shown_with_its_way_in_the_middle_and_its_distance(view):
    walks = moving_from(view)
    above, side, away, _ = drawn(walks)
    for axes, plane in ((above, [0, 1]), (side, [0, 2])):
        places = [one.get_offsets().data for one in axes.collections]
        assert any(np.array_equal(rows, walks.moving[:, plane]) for rows in places)
    middle = np.array([above.get_xlim(), above.get_ylim()]).mean(axis=1)
    assert np.abs(middle - [-7.5, 8.0]).max() < 0.5
    legend = [text.get_text() for text in above.get_legend().get_texts()]
    assert "moving on the ground, all scans" in legend
    assert "flying, all scans" not in legend
    time, distance = next(one.get_offsets().data.T for one in away.collections)
    assert time == pytest.approx(np.arange(20) * 0.1)
    assert distance == pytest.approx(np.linalg.norm(walks.moving - view.sensor, axis=1))
    assert not [text for text in away.texts if text.get_text() == "nothing moves"]


def test_a_picture_without_movers_says_so(view):
    still = moving_from(view)
    still = replace(still, moving=view.moving, moving_scan=view.moving_scan)
    above, _, away, _ = drawn(still)
    legend = [text.get_text() for text in above.get_legend().get_texts()]
    assert "moving on the ground, all scans" not in legend
    assert [text.get_text() for text in away.texts] == ["nothing moves"]


def test_tracks_that_end_on_the_ground_are_counted_beside_those_that_flew():
    run = FlyingRun(FlyingObjectDetector())
    ways = {
        1: [TrackKind.UNKNOWN, TrackKind.GROUND],
        2: [TrackKind.GROUND, TrackKind.STATIC],
        3: [TrackKind.FLYING, TrackKind.GROUND],
        4: [TrackKind.UNKNOWN, TrackKind.UNKNOWN],
    }
    for scan in range(2):
        tracks = tracks_at(scan, list(ways), np.zeros((len(ways), 3)))
        kinds = np.array([kinds[scan] for kinds in ways.values()], np.uint8)
        run.tracks.append(replace(tracks, kind=kinds))
    assert (run.track_ids, run.ground_ids) == ([3], [1])
