"""The picture of a fusion: measurements can be seen and told apart, and its title has restarts."""

import numpy as np
import pytest

from lidar_core.fusion import FusionConfig, Measurement, MeasurementLog
from lidar_core.runs.targets.one import TargetRun
from lidar_core.viz import FusionView
from lidar_core.viz.drawing.marks import WAY
from lidar_core.viz.figure import figure_with_style
from lidar_core.viz.pictures import fusion_picture
from lidar_core.viz.views import PlanarLine

pytest.importorskip("matplotlib")
STEP = 10**8


@pytest.fixture
def picture(tmp_path, monkeypatch):
    """The figure of a view."""

    def drawn(view):
        figures = []

        def write(path, draw, *, size, dpi):
            with figure_with_style(size=size, dpi=dpi) as figure:
                draw(figure)
                figure.canvas.draw()
                figures.append(figure)
            return path

        monkeypatch.setattr(fusion_picture, "write_figure", write)
        fusion_picture.draw_fusion(view, tmp_path / "a.png")
        monkeypatch.undo()
        return figures[0]

    return drawn


def view_of(count):
    """Measurements of both sensors, this many of each."""
    rng = np.random.default_rng(7400)
    seen = {sensor: rng.normal(0, 10, (count, 2)) for sensor in ("lidar", "radar")}
    nis = {sensor: (STEP * np.arange(count), np.full(count, 0.5)) for sensor in seen}
    return FusionView("", seen, {}, {}, nis)


def dots(figure):
    return {one.get_label(): one for one in figure.axes[0].collections}


def darkness(colour):
    """0 for white, 1 for black."""
    return 1 - float(np.dot(colour[:3], (0.299, 0.587, 0.114)))


def test_measurements_are_dark_and_large_and_of_different_shape(picture):
    figure = picture(view_of(100))
    found = dots(figure)
    shapes = {sensor: one.get_paths()[0].vertices.shape for sensor, one in found.items()}
    assert shapes["lidar"] != shapes["radar"]
    for one in found.values():
        (area,) = one.get_sizes()
        assert np.sqrt(area) * figure.dpi / 72 >= 4.5  # pixels
        (colour,) = one.get_facecolors()
        assert colour[3] * darkness(colour) > 0.4
    handles = figure.axes[0].get_legend().legend_handles
    assert [one.get_paths()[0].vertices.shape for one in handles] == list(shapes.values())


def test_the_dots_of_the_nis_have_the_marks_of_the_measurements(picture):
    lines = [one for one in picture(view_of(100)).axes[-1].lines if len(one.get_xdata()) == 100]
    assert len({one.get_marker() for one in lines}) == 2
    assert {one.get_color() for one in lines} == {
        colour for colour, _ in fusion_picture.SENSORS.values()
    }


def test_many_measurements_have_smaller_marks_than_few(picture):
    areas = [dots(picture(view_of(count)))["lidar"].get_sizes()[0] for count in (50, 5000)]
    assert areas[1] < areas[0]


def title(jumps):
    """The title of a run whose target jumps far away this many times."""
    seen = [
        Measurement(STEP * k, "lidar", [0.1 * k + 1000 * (k * (jumps + 1) // 200), 2.0])
        for k in range(200)
    ]
    run = TargetRun.of(MeasurementLog(seen, None, ""), FusionConfig(), {}, lag=None)
    return run.view("a.csv").title


@pytest.mark.parametrize(
    ("jumps", "told"), [(0, "ekf"), (1, "ekf, 1 restart"), (3, "ekf, 3 restarts")]
)
def test_the_title_tells_how_often_the_filter_lost_the_target(jumps, told):
    assert title(jumps) == f"a.csv: ct, {told}"


def test_five_targets_have_five_colours_after_many_tracks_that_ended(picture):
    """Their numbers are equal modulo 7 and 12, the lengths of former palettes."""
    stamps, numbers = STEP * np.arange(10), [0, 84, 168, 252, 336]
    tracks = {
        number: PlanarLine(stamps if number in numbers else stamps[:5], np.full((10, 2), number))
        for number in range(340)
    }
    tracks = {
        number: PlanarLine(line.stamp_ns, line.position[: len(line.stamp_ns)])
        for number, line in tracks.items()
    }
    figure = picture(FusionView("", {}, tracks, {}, {}))
    colours = [line.get_color() for line in figure.axes[0].lines if line.get_gid() == WAY]
    assert len(set(colours)) == len(colours) == 5
