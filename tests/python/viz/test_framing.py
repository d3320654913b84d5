"""Pictures are framed on what moves: measured on the figures of the demo and of all tours."""

import re
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest
from commands import invoke
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image
from repository import ROOT

from lidar_core.viz import FusionView, PlanarLine, Playback
from lidar_core.viz import playback_picture as playback
from lidar_core.viz.drawing.frame import Window, window_around, window_over
from lidar_core.viz.drawing.labels import NUMBER, place_boxes
from lidar_core.viz.drawing.marks import RING, WAY, round_length
from lidar_core.viz.drawing.voxels import MOST_CELLS, draw_voxels
from lidar_core.viz.figure import write_figure
from lidar_core.viz.pictures import circles_picture, flying_picture, fusion_picture

LEAST = 20
"""Pixels that a way is long at least."""
MODULES = (circles_picture, flying_picture, fusion_picture, playback)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Figures of picture.png and `view --png`, by tour; they are drawn as the commands draw."""
    folder, figures = tmp_path_factory.mktemp("tours"), {}
    text = (ROOT / "docs/tour-circles.md").read_text(encoding="utf-8")
    (scene,) = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    tomllib.loads(scene)
    (folder / "hall.toml").write_text(scene, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        for module in MODULES:
            patch.setattr(module, "write_figure", kept_in(figures))
        for name, commands in {
            "demo": [("demo", "-o", "demo", "--scans", 40)],
            "flying": [
                ("simulate", "demo", "-o", "a.npz", "--seed", 3, "--scans", 30),
                ("detect", "a.npz", "-o", "flying"),
            ],
            "circles": [
                ("simulate", "hall.toml", "-o", "hall.npz"),
                ("circles", "hall.npz", "-o", "circles"),
            ],
            "fusion": [
                ("simulate", "overflight", "-o", "a.csv", "--seed", 1),
                ("fuse", "a.csv", "-o", "fusion"),
            ],
        }.items():
            patch.chdir(folder)
            for command in commands:
                done = invoke(*command)
                assert done.exit_code == 0, done.output
            figures[name, "picture"] = figures.pop("last")
            playback.draw_moment(Playback(folder / name), folder / "a.png")
            figures[name, "png"] = figures.pop("last")
    return figures


def kept_in(figures):
    def write(path, draw, *, size, dpi):
        def keep(figure):
            draw(figure)
            figure.canvas.draw()
            figures["last"] = figure

        return write_figure(path, keep, size=size, dpi=dpi)

    return write


def pixels_of(axes):
    """Corners of a panel, and those of each way in it."""
    box = axes.get_window_extent()
    ways = [
        axes.transData.transform(line.get_xydata())
        for line in axes.lines
        if line.get_gid() == WAY and len(line.get_xydata())
    ]
    return np.array([[box.x0, box.y0], [box.x1, box.y1]]), ways


def in_middle_third(panel, places):
    low, high = np.concatenate(places).min(axis=0), np.concatenate(places).max(axis=0)
    share = ((low + high) / 2 - panel[0]) / (panel[1] - panel[0])
    return bool(((share > 1 / 3) & (share < 2 / 3)).all())


CASES = [
    *((name, "picture") for name in ("demo", "flying", "circles", "fusion")),
    *((name, "png") for name in ("demo", "flying", "circles", "fusion")),
]


@pytest.mark.nightly
@pytest.mark.parametrize("case", CASES, ids="-".join)
def test_what_moves_is_in_the_middle_third_and_can_be_seen(drawn, case):
    figure = drawn[case]
    panels = figure.axes[:2] if case[0] in {"demo", "flying"} else figure.axes[:1]
    for axes in panels:
        panel, ways = pixels_of(axes)
        moving = [way for way in ways if np.ptp(way, axis=0).max() >= LEAST]
        assert in_middle_third(panel, moving)
        still = 1 if case[0] == "circles" else 0  # the post stands
        assert len(ways) - len(moving) == still
        for way in moving:
            assert (way >= panel[0] - 1).all()
            assert (way <= panel[1] + 1).all()


def legend_of(figure):
    return next(axes.get_legend() for axes in figure.axes if axes.get_legend() is not None)


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["circles", "fusion"])
def test_the_legend_of_a_picture_in_the_plane_lies_beside_it(drawn, name):
    """A map or a way may be everywhere in the panel: the eight of a sample was half covered."""
    figure = drawn[name, "png"]
    above = figure.axes[0].get_window_extent()
    assert not legend_of(figure).get_window_extent().overlaps(above)
    texts = [text for axes in figure.axes[1:] for text in axes.texts]
    assert texts
    for text in texts:
        assert not legend_of(figure).get_window_extent().overlaps(text.get_window_extent())


@pytest.mark.nightly
def test_a_fusion_picture_shows_measurements_in_the_world_and_the_way_of_the_sensor(drawn):
    """The tour's sensor flies 36 m: without its pose, a measurement would be metres off."""
    above = drawn["fusion", "picture"].axes[0]
    way = next(line.get_xydata() for line in above.lines if line.get_gid() == WAY)
    seen = {dots.get_label(): dots.get_offsets() for dots in above.collections}
    for sensor in ("lidar", "radar"):
        away = np.linalg.norm(seen[sensor][:, None] - way[None], axis=2).min(axis=1)
        assert len(away) > 50
        assert np.median(away) < 0.5
    (flown,) = (line.get_xydata() for line in above.lines if line.get_label() == "sensor")
    assert np.ptp(flown[:, 0]) > 5
    assert "measurement" in [t.get_text() for t in legend_of(drawn["fusion", "png"]).get_texts()]


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["demo", "flying"])
def test_the_legend_hides_nothing_of_the_way_of_the_sensor(drawn, name):
    figure = drawn[name, "picture"]
    above = figure.axes[0]
    box = above.get_legend().get_window_extent()
    (flown,) = (line for line in above.lines if line.get_label() == "sensor")
    places = above.transData.transform(flown.get_xydata())
    places = places[above.get_window_extent().padded(-1).extents[0] <= places[:, 0]]
    hidden = [place for place in places if box.contains(*place)]
    assert len(hidden) == 0


@pytest.mark.nightly
def test_time_counts_from_the_first_scan_also_where_none_was_kept(drawn):
    """The drones of the demo are found after 1 s; 40 scans are 3.9 s long."""
    assert drawn["demo", "png"].get_suptitle() == "demo: 3.90 s, 2 objects"
    assert drawn["flying", "png"].get_suptitle() == "flying: 2.90 s, 2 objects"


@pytest.mark.nightly
def test_objects_have_colours_of_their_own(drawn):
    above = drawn["flying", "png"].axes[0]
    colours = [line.get_color() for line in above.lines if line.get_gid() == WAY]
    assert len(set(colours)) == len(colours) == 2


@pytest.mark.nightly
@pytest.mark.parametrize("case", CASES, ids="-".join)
def test_pictures_have_a_legend_a_scale_a_time_and_sigmas(drawn, case):
    figure = drawn[case]
    above = figure.axes[0]
    names = [text.get_text() for text in legend_of(figure).get_texts()]
    assert "sensor" in names, names
    assert any("2σ" in name for name in names), names
    told = [text.get_text() for text in above.texts]
    assert any(re.fullmatch(r"[\d.]+ m", text) for text in told), told
    titles = f"{above.get_title(loc='left')}; {figure.get_suptitle()}"
    assert re.search(r"[\d.]+ s\b", titles), titles


@pytest.mark.nightly
@pytest.mark.parametrize("case", CASES, ids="-".join)
def test_numbers_do_not_lie_over_one_another(drawn, case):
    for axes in drawn[case].axes[:2]:
        boxes = [
            text.get_bbox_patch().get_window_extent()
            for text in axes.texts
            if text.get_gid() == NUMBER
        ]
        for order, one in enumerate(boxes):
            assert not any(one.overlaps(other) for other in boxes[:order])


@pytest.mark.nightly
@pytest.mark.parametrize("case", CASES, ids="-".join)
def test_the_map_fills_its_panel(drawn, case):
    """Half of the canvas empty was the complaint: an aspect must not shrink the panel."""
    figure = drawn[case]
    width, height = figure.get_size_inches() * figure.dpi
    box = figure.axes[0].get_window_extent()
    assert box.height > 0.75 * height
    assert box.width > 0.34 * width
    assert isinstance(figure.canvas, FigureCanvasAgg)


def test_twenty_numbers_at_one_place_are_all_readable():
    panel = np.array([[0.0, 0.0], [700.0, 700.0]])
    sizes = [np.array([20.0, 16.0])] * 20
    centres = place_boxes([np.array([350.0, 350.0])] * 20, sizes, np.empty((0, 2)), panel)
    apart = np.abs(np.array(centres)[:, None] - np.array(centres)[None]) - [20, 16]
    free = (apart > 0).any(axis=2) | np.eye(20, dtype=bool)
    assert free.all()
    assert np.hypot(*(np.array(centres) - 350).T).max() < 250


def test_numbers_avoid_ways_and_the_border():
    way = np.column_stack([np.linspace(0, 200, 100), np.linspace(0, 200, 100)])
    panel = np.array([[0.0, 0.0], [200.0, 200.0]])
    (centre,) = place_boxes([np.array([100.0, 100.0])], [np.array([16.0, 16.0])], way, panel)
    assert not (np.abs(way - centre) <= 8).all(axis=1).any()
    (corner,) = place_boxes([np.array([199.0, 199.0])], [np.array([16.0, 16.0])], way[:1], panel)
    assert (corner + 8 <= 200).all()


def test_windows_grow_for_the_sensor_only_while_what_moves_stays_visible():
    way = np.array([[10.0, 10.0], [14.0, 11.0]])
    plain = window_around([way], 1.0)
    np.testing.assert_allclose(plain.high - plain.low, 12.0)
    near = window_around([way], 1.0, also=[np.array([[5.0, 10.0]])])
    assert near.holds(np.array([5.0, 10.0]))
    np.testing.assert_allclose(near.middle, [12.0, 10.5])
    far = window_around([way], 1.0, also=[np.array([[-500.0, 0.0]])])
    assert not far.holds(np.array([-500.0, 0.0]))
    np.testing.assert_allclose(far.high - far.low, 20.0)
    unknown = window_around([np.full((3, 2), np.nan)], 0.5)
    np.testing.assert_allclose(unknown.middle, 0.0)
    over = window_over([way, np.array([[np.inf, 0.0]])], 1.0, smallest=1.0)
    np.testing.assert_allclose(over.high - over.low, 4.48)


@pytest.mark.parametrize(("most", "length"), [(9.9, 5.0), (10.0, 10.0), (0.03, 0.02), (2.4, 2.0)])
def test_bars_have_round_lengths(most, length):
    assert round_length(most) == pytest.approx(length)


def test_a_ring_has_its_size_in_pixels(tmp_path):
    from lidar_core.viz.drawing.marks import ring

    def draw(figure):
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        axes.set(xlim=(0, 1), ylim=(0, 1))
        ring(axes, np.array([0.5, 0.5]), "#ff0000")

    path = write_figure(tmp_path / "a.png", draw, size=(2, 2), dpi=100)
    red = np.asarray(Image.open(path).convert("RGB")).astype(int)
    rows, columns = np.nonzero(red[..., 1] < 128)
    assert abs(np.ptp(rows) + 1 - RING) <= 3
    assert abs(np.ptp(columns) + 1 - RING) <= 3


def test_maps_grow_a_little_for_what_moves():
    """Until its centre is in the middle third, but a far corner does not empty the picture."""
    room = np.array([[0.0, 0.0], [10.0, 10.0]])
    walk = np.array([[7.0, 5.0], [9.0, 5.0]])
    window = window_over([room], 1.0, smallest=4.0, moving=[walk])
    share = (8.0 - window.low[0]) / (window.high[0] - window.low[0])
    assert 1 / 3 < share < 2 / 3
    assert window.holds(room[0])
    assert window.holds(room[1])
    corner = window_over([room], 1.0, smallest=4.0, moving=[np.array([[10.0, 10.0]])])
    assert (corner.high - corner.low < 1.7 * 10 * 1.12).all()
    plain = window_over([room], 1.0, smallest=4.0)
    np.testing.assert_allclose(plain.high - plain.low, 11.2)


def test_a_ring_marks_what_is_small_alone():
    """An object that its outline shows has no ring inside of it."""
    from matplotlib.figure import Figure

    from lidar_core.viz.drawing.marks import RING, ring

    axes = Figure(figsize=(4, 4), dpi=100).add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, 400), ylim=(0, 400))  # a metre is a pixel
    ring(axes, np.array([100.0, 100.0]), "red", size=RING + 1)
    assert not axes.lines
    ring(axes, np.array([100.0, 100.0]), "red", size=RING - 1)
    assert len(axes.lines) == 1


@pytest.mark.nightly
@pytest.mark.parametrize("case", CASES, ids="-".join)
def test_a_map_is_behind_flying_objects(drawn, case):
    for axes in drawn[case].axes[:2]:
        seen = len(axes.images)
        assert seen == (case[0] in {"demo", "flying"} and "from" in axes.get_title(loc="left"))


@pytest.mark.parametrize("ahead", [True, False])
def test_where_nothing_moves_the_measured_world_and_the_sensor_fill_the_picture(ahead):
    """A sensor that looks to one side left half of the picture empty; a room was a tenth of it."""
    rng = np.random.default_rng(1000)
    low, high = ([9.0, -10.0, -2.0], [60.0, 12.0, 8.0]) if ahead else ([-3.0] * 3, [3.0] * 3)
    cloud = rng.uniform(low, high, (3000, 3))
    cloud[:10] *= 40  # a few points far away
    none = np.empty((0, 3))
    view = SimpleNamespace(
        tracks=[], truth={}, sensor=np.zeros((1, 3)), cloud=cloud, occupied=none, moving=none
    )
    window = flying_picture._window(view, (0, 1), 1.0)
    assert window.holds(np.zeros(2))
    share = np.mean([window.holds(point[:2]) for point in cloud])
    assert share > 0.9
    extent = np.ptp([*np.quantile(cloud[:, :2], (0.02, 0.98), axis=0), np.zeros(2)], axis=0).max()
    assert window.high[0] - window.low[0] < 1.3 * extent


def test_a_run_without_objects_says_so(tmp_path):
    scene = tmp_path / "a.npz"
    assert invoke("simulate", "demo", "-o", scene, "--scans", 2).exit_code == 0
    assert invoke("detect", scene, "-o", tmp_path / "run", "--no-picture").exit_code == 0
    figures = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(playback, "write_figure", kept_in(figures))
        playback.draw_moment(Playback(tmp_path / "run"), tmp_path / "a.png")
    told = [text.get_text() for axes in figures["last"].axes for text in axes.texts]
    assert "no objects at this time" in told


def test_legends_take_the_emptiest_corner():
    window = window_around([np.array([[-10.0, -10.0], [10.0, 10.0]])], 1.0, times=1.0)
    upper_left, upper_right = np.array([[-8.0, 8.0]]), np.array([[8.0, 8.0]])
    assert window.corner_away_from([]) == "upper left"
    assert window.corner_away_from([np.zeros((9, 2)), -upper_left, -upper_right]) == "upper left"
    assert window.corner_away_from([upper_left]) == "upper right"
    assert window.corner_away_from([upper_left, upper_right]) == "lower right"
    assert window.corner_away_from([100 * upper_left]) == "upper right"
    crowd = np.repeat(upper_left, 3, axis=0)
    assert window.corner_away_from([crowd, upper_right, -upper_left, -upper_left]) == "upper right"


@pytest.mark.parametrize(("span", "voxel"), [(40.0, 0.2), (50_000.0, 25.0)])
def test_the_image_of_voxels_has_a_bound_and_shows_all(span, voxel):
    """Points in millimetres span kilometres: an image of every voxel would take gigabytes."""
    centres = np.array([[0.1, 0.1, 1.0], [0.5, 0.5, 2.0], [1.0, 1.0, 3.0]]) * [
        0.9 * span,
        0.9 * span,
        1.0,
    ]
    axes = Figure().add_subplot()
    draw_voxels(axes, centres, 0.2, (0, 1), Window(np.zeros(2), np.full(2, span)), (0.0, 4.0))
    (image,) = axes.images
    shown = image.get_array().filled(np.nan)
    assert max(shown.shape) <= MOST_CELLS + 1
    assert shown.shape[0] == pytest.approx(span / voxel + 1, abs=1)
    assert sorted(shown[np.isfinite(shown)].tolist()) == [1.0, 2.0, 3.0]


def lines_over(*stamps):
    """Tracks with these last times, side by side; all begin at 0 s."""
    return {
        number: PlanarLine(
            np.arange(last + 1) * 10**9,
            np.stack([np.arange(last + 1.0), np.full(last + 1, 4.0 * number)], axis=1),
            np.tile(0.1 * np.eye(2), (last + 1, 1, 1)),
        )
        for number, last in enumerate(stamps)
    }


@pytest.mark.parametrize(
    ("last", "lasting"),
    [((9, 9, 9), [0, 1, 2]), ((4, 9, 2), [1]), ((4, 2), [0]), ((9,), [0]), ((), [])],
)
def test_rings_and_numbers_of_fusion_are_those_of_tracks_at_the_end(
    tmp_path, monkeypatch, last, lasting
):
    figures = {}
    monkeypatch.setattr(fusion_picture, "write_figure", kept_in(figures))
    tracks = lines_over(*last)
    fusion_picture.draw_fusion(FusionView("", {}, tracks, {}, {}), tmp_path / "a.png")
    above = figures["last"].axes[0]
    rings = [line.get_xydata()[0] for line in above.lines if line.get_marker() == "o"]
    assert [ring.tolist() for ring in rings] == [
        tracks[number].position[-1].tolist() for number in lasting
    ]
    numbers = [text.get_text() for text in above.texts if text.get_gid() == NUMBER]
    assert sorted(numbers) == [str(number) for number in lasting]
    ended = [line for line in above.lines if line.get_gid() == fusion_picture.TRAIL]
    assert len(ended) == len(tracks) - len(lasting)
    ways = [line for line in above.lines if line.get_gid() == WAY]
    assert all(trail.get_linewidth() < ways[0].get_linewidth() for trail in ended)
    legend = above.get_legend()
    texts = [text.get_text() for text in legend.get_texts()] if legend else []
    assert ("track that ended before" in texts) == bool(ended)
