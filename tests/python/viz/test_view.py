"""A run looked at: what playback gives, pictures, films, rerun's file, Foxglove's stream."""

import csv
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
from collections import Counter
from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np
import pytest
from commands import invoke, running
from matplotlib import rc_context
from mcap.reader import make_reader
from PIL import Image

import lidar_core as lc
import lidar_core.io
from lidar_core.errors import ConfigError, FormatError, LinkError, MissingExtraError
from lidar_core.viz import (
    Objects,
    Playback,
    draw_film,
    draw_moment,
    playback_picture,
    write_report,
)
from lidar_core.viz.drawing.frame import Window
from lidar_core.viz.drawing.marks import TRACK_COLOURS, colours_of
from lidar_core.viz.figure import write_figure
from lidar_core.viz.film import film_ending, write_film
from lidar_core.viz.playback import Moment
from lidar_core.viz.rerun_log import RerunLog

SCANS = 15
FEWER_RAYS = {"demo": ["--sensor", "os1-32"], "circles": []}
needs_rerun = pytest.mark.skipif(
    find_spec("rerun") is None and not os.environ.get("CI"), reason="rerun-sdk is not installed"
)


def run_of(folder, scene, command):
    source, output = folder / f"{command}.npz", folder / command
    few = [*FEWER_RAYS[scene], "--scans", SCANS]
    assert invoke("simulate", scene, "-o", source, *few).exit_code == 0
    done = invoke(command, source, "-o", output)
    assert done.exit_code == 0, done.output
    return output


@pytest.fixture(scope="module")
def circles(tmp_path_factory):
    return run_of(tmp_path_factory.mktemp("runs"), "circles", "circles")


@pytest.fixture(scope="module")
def flying(tmp_path_factory):
    return run_of(tmp_path_factory.mktemp("runs"), "demo", "detect")


def columns_of(folder, name):
    (path,) = folder.glob(f"{name}.*")
    return lc.io.read_columns(path)


def test_circles_are_played_as_the_table_says(circles):
    run = Playback(circles)
    assert run.capability == "circles"
    assert run.voxel_map is None
    table = columns_of(circles, "circles")
    moments = list(run.moments())
    assert [moment.stamp_ns for moment in moments] == sorted(
        {moment.stamp_ns for moment in moments}
    )
    assert len([moment for moment in moments if len(moment.points)]) == SCANS
    assert sum(len(moment.objects.id) for moment in moments) == len(table["t_ns"]) > 0
    for moment in moments:
        rows = table["t_ns"] == moment.stamp_ns
        np.testing.assert_array_equal(moment.objects.id, table["track_id"][rows])
        np.testing.assert_array_equal(moment.objects.position[:, 0], table["x"][rows])
        np.testing.assert_array_equal(moment.objects.size[:, 0], 2 * table["radius"][rows])
        np.testing.assert_array_equal(moment.objects.covariance[:, 0, 1], table["cov_x_y"][rows])
        np.testing.assert_array_equal(moment.objects.covariance[:, 1, 0], table["cov_x_y"][rows])


@pytest.mark.nightly
def test_walls_and_other_shapes_are_played_as_the_table_says(tmp_path):
    """A wall and a box, in a recording of a scanner that stands."""
    scanner = lc.circles.Scanner()
    bearings = scanner.bearings()
    ranges = np.full(len(bearings), np.inf, np.float32)
    ahead = np.abs(bearings) < 0.6
    ranges[ahead] = 5 / np.cos(bearings[ahead])
    scans = [
        lc.messages.LaserScan(
            number * 50_000_000,
            ranges,
            scanner.angle_min,
            scanner.angle_increment,
            0.1,
            10.0,
            "laser",
        )
        for number in range(SCANS)
    ]
    lc.io.write_npz(tmp_path / "a.npz", scans)
    done = invoke("circles", tmp_path / "a.npz", "-o", tmp_path / "run", "--pose", "static")
    assert done.exit_code == 0, done.output
    run = Playback(tmp_path / "run")
    table = columns_of(tmp_path / "run", "shapes")
    outlines = [one for moment in run.moments() for one in moment.outlines]
    assert [one.id for one in outlines] == table["track_id"].tolist() != []
    for one, row in zip(outlines, range(len(table["t_ns"])), strict=True):
        ends = [[table["x1"][row], table["y1"][row]], [table["x2"][row], table["y2"][row]]]
        np.testing.assert_array_equal(one.points, np.pad(np.array(ends, float), ((0, 0), (0, 1))))
        assert one.visible == bool(table["visible"][row])
    assert outlines[-1].points[:, 0] == pytest.approx(5, abs=0.01)
    path = draw_moment(run, tmp_path / "a.png")
    shown = np.asarray(Image.open(path).convert("RGB")).astype(int)
    assert (np.abs(shown - [15, 118, 110]).max(axis=2) < 40).sum() > 100
    if find_spec("rerun") is not None:
        done = invoke("view", tmp_path / "run", "--rrd", tmp_path / "a.rrd")
        assert done.exit_code == 0, done.output
        command = [sys.executable, "-m", "rerun", "rrd", "print", "-v", str(tmp_path / "a.rrd")]
        told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        assert "/world/shapes" in told


def test_points_lie_in_the_world_and_carry_their_class(flying):
    run = Playback(flying)
    assert run.capability == "flying"
    assert run.voxel_map == flying / "map.lcvm"
    moments = [moment for moment in run.moments() if len(moment.points)]
    assert len(moments) == SCANS
    ground = moments[-1].points[:, 2]
    assert np.quantile(ground, 0.05) == pytest.approx(0.0, abs=0.15)
    assert set(np.unique(moments[-1].point_class)) <= {1, 2, 3}
    assert np.isfinite(moments[-1].points).all()


def test_tracks_that_do_not_fly_are_not_played(flying, tmp_path):
    """The table has tracks of all kinds; pictures, films and viewers show those that fly."""
    columns = columns_of(flying, "tracks")
    ids = np.unique(columns["track_id"]).tolist()
    assert set(columns["kind"]) == {"flying"}
    columns["kind"] = np.where(columns["track_id"] == ids[0], "clutter", "flying")
    shutil.copytree(flying, tmp_path / "run")
    next((tmp_path / "run").glob("tracks.*")).unlink()
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    with (tmp_path / "run/tracks.csv").open("w", newline="") as file:
        csv.writer(file).writerows([list(columns), *rows])
    played = [objects.id.tolist() for _, objects in Playback(tmp_path / "run").steps()]
    assert {number for step in played for number in step} == set(ids[1:])
    played = [objects.id.tolist() for _, objects in Playback(flying).steps()]
    assert {number for step in played for number in step} == set(ids)


def test_a_run_without_a_recording_still_plays(circles, tmp_path):
    for path in circles.iterdir():
        if path.is_file() and path.suffix != ".mcap":
            (tmp_path / path.name).write_bytes(path.read_bytes())
    moments = list(Playback(tmp_path).moments())
    assert all(len(moment.points) == 0 for moment in moments)
    assert len(moments) == len(np.unique(columns_of(tmp_path, "circles")["t_ns"]))
    refused = invoke("view", tmp_path, "--foxglove")
    assert isinstance(refused.exception, FormatError)
    assert "no run.mcap; the extra viz makes runs write it" in str(refused.exception)


def test_outlines_are_circles_and_boxes():
    objects = Objects(
        id=np.array([1, 2]),
        position=np.array([[1.0, 2, 0], [3, 4, 5]]),
        velocity=np.zeros((2, 3)),
        covariance=np.zeros((2, 3, 3)),
        size=np.array([[2.0, 2, 0], [1, 2, 3]]),
    )
    around = objects.outline(0)
    np.testing.assert_allclose(np.linalg.norm(around - [1, 2, 0], axis=1), 1.0)
    np.testing.assert_allclose(around[0], around[-1], atol=1e-12)
    np.testing.assert_array_equal(objects.outline(1).min(axis=0), [2.5, 3, 5])
    np.testing.assert_array_equal(objects.outline(1).max(axis=0), [3.5, 5, 5])


def test_other_folders_are_refused_in_words(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such folder"):
        Playback(tmp_path / "none")
    with pytest.raises(FormatError, match=r"expected the folder of a run, with run\.toml"):
        Playback(tmp_path)
    (tmp_path / "run.toml").touch()
    with pytest.raises(FormatError, match=r"neither tracks nor circles in it, but run\.toml"):
        Playback(tmp_path)
    (tmp_path / "tracks.csv").write_text("t_ns,track_id,x,y,z\n")
    for draw, name in ((draw_moment, "a.png"), (draw_film, "a.gif")):
        with pytest.raises(
            FormatError, match=r"estimates to draw: no scan was processed\..*lacked"
        ):
            draw(Playback(tmp_path), tmp_path / name)
    with pytest.raises(FormatError, match=r"estimates to report: .*poses \(pose=FILE\)"):
        write_report(tmp_path)


@pytest.mark.ci_cases("circles")
@pytest.mark.parametrize("kind", ["circles", "flying"])
def test_pictures_show_points_and_objects(kind, request, tmp_path):
    folder = request.getfixturevalue(kind)
    done = invoke("view", folder, "--png", tmp_path / "a.png", "--at", "0.5")
    assert done.exit_code == 0, done.output
    early = np.asarray(Image.open(tmp_path / "a.png").convert("RGB")).astype(int)
    late = np.asarray(Image.open(draw_moment(Playback(folder), tmp_path / "b.png")).convert("RGB"))
    assert (early != late).any()
    grey = (np.abs(early - [148, 163, 184]).max(axis=2) < 30).sum()
    assert grey > 200
    if kind == "circles":  # outlines in the colour of the first object
        colour = np.array([int(TRACK_COLOURS[0][at : at + 2], 16) for at in (1, 3, 5)])
        assert (np.abs(early - colour).max(axis=2) < 40).sum() > 100


@pytest.mark.nightly
def test_films_have_a_frame_per_scan_or_fewer(circles, tmp_path):
    path = draw_film(Playback(circles), tmp_path / "a.gif", frames=5)
    with Image.open(path) as film:
        assert film.n_frames == 5
    with pytest.raises(ConfigError, match=r"expected a film that ends in \.gif or \.mp4"):
        draw_film(Playback(circles), tmp_path / "a.avi")
    assert [item.name for item in tmp_path.iterdir()] == ["a.gif"]


def test_what_is_small_keeps_its_colour_in_a_film(tmp_path):
    """256 colours: the many of a background must not displace those of marks and trails."""

    def paint(figure):
        grey = np.random.default_rng(0).uniform(0.4, 1, (200, 200, 1))
        figure.add_axes((0, 0, 1, 1)).imshow(grey ** [1.0, 1.1, 1.3], extent=(0, 200, 200, 0))
        yield
        for row, colour in enumerate(TRACK_COLOURS):
            figure.axes[0].plot([20, 26], [15 * row + 20] * 2, color=colour, lw=1.6)
        yield

    path = write_film(tmp_path / "a.gif", paint, size=(4, 4), dpi=100, rate=10)
    with Image.open(path) as film:
        film.seek(1)
        shown = np.asarray(film.convert("RGB")).astype(int)
    for text in TRACK_COLOURS:
        colour = np.array([int(text[at : at + 2], 16) for at in (1, 3, 5)])
        assert np.abs(shown - colour).max(axis=2).min() <= 16, text


def test_films_are_mp4_where_ffmpeg_is(circles, tmp_path):
    """A program that stands for ffmpeg: it takes the frames, and writes its last argument."""
    program = tmp_path / "ffmpeg"
    program.write_text(
        "#!/bin/sh\nfor last; do :; done\n"
        '[ "$last" = "-version" ] || { cat > "$last.frames"; mv "$last.frames" "$last"; }\n'
    )
    program.chmod(0o755)
    animation = pytest.importorskip("matplotlib.animation")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(animation.FFMpegWriter, "isAvailable", lambda: False)
        assert film_ending() == ".gif"
        with pytest.raises(MissingExtraError, match=r"\.mp4 needs the program ffmpeg"):
            draw_film(Playback(circles), tmp_path / "a.mp4")
    with rc_context({"animation.ffmpeg_path": str(program)}):
        assert film_ending() == ".mp4"
        path = draw_film(Playback(circles), tmp_path / "a.mp4", frames=3)
    assert path.stat().st_size == 3 * 840 * 420 * 4
    assert {item.name for item in tmp_path.iterdir()} == {"a.mp4", "ffmpeg"}


@pytest.mark.parametrize(
    ("at", "told"),
    [(None, None), (0.0, None), (0.43, None), (50.0, "where the run ends")],
)
def test_another_time_than_asked_for_is_told(circles, tmp_path, at, told):
    more = () if at is None else ("--at", at)
    done = invoke("view", circles, "--png", tmp_path / "a.png", *more)
    assert done.exit_code == 0, done.output
    assert ("note: --at 50: the picture shows" in done.stderr) == (told is not None)
    assert (told or "") in done.stderr


def test_a_gap_of_scans_is_told(monkeypatch, circles, tmp_path):
    """The run keeps no scan for a second: the nearest one is drawn."""
    run, told = Playback(circles), []
    times = run.times()
    monkeypatch.setattr(Playback, "times", lambda _: [times[0], *times[-3:]])
    first, last = times[0], times[-1]
    middle = (times[-3] - first) * 0.4e-9
    draw_moment(run, tmp_path / "a.png", at=middle, on_other_time=lambda *one: told.append(one))
    assert told == [pytest.approx((0.0, (last - first) * 1e-9))]


@pytest.mark.parametrize("name", ["a.jpg", "a", "a.png.txt"])
def test_a_picture_that_is_no_png_is_refused_by_name(circles, tmp_path, name):
    refused = invoke("view", circles, "--png", tmp_path / name)
    assert f"{name}: expected a picture that ends in .png" in str(refused.exception)
    assert not list(tmp_path.iterdir())
    with pytest.raises(ConfigError, match=re.escape(f"{name}: expected a picture that ends")):
        write_figure(tmp_path / name, lambda _: None, size=(1, 1))
    assert write_figure(tmp_path / "a.PNG", lambda _: None, size=(1, 1)).read_bytes()[1:4] == b"PNG"


@pytest.mark.parametrize(("size", "is_ringed"), [(0.05, True), (3.0, False)])
def test_rings_around_small_objects_are_in_the_legend(size, is_ringed):
    figure = pytest.importorskip("matplotlib.figure").Figure(figsize=(6, 6))
    panel = figure.add_subplot()
    objects = Objects(
        id=np.array([1]),
        position=np.zeros((1, 3)),
        covariance=np.eye(3)[None] * 1e-4,
        velocity=np.zeros((1, 3)),
        size=np.full((1, 3), size),
    )
    moment = Moment(0, np.empty((0, 3), np.float32), np.empty(0, np.uint8), objects)
    window, depth = Window(np.array([-8.0, -8.0]), np.array([8.0, 8.0])), (-9.0, 9.0)
    trails, colours = {1: np.zeros((2, 3))}, {1: "black"}
    playback_picture._panel(panel, moment, trails, colours, (0, 1), window, depth=depth)
    assert ("ring: small object" in panel.get_legend_handles_labels()[1]) == is_ringed


def test_one_way_to_look_at_a_time(circles, tmp_path):
    refused = invoke("view", circles, "--web", "--png", tmp_path / "a.png")
    assert "expected at most one viewer or file, got --web, --png" in str(refused.exception)
    refused = invoke("view", circles, "--at", "1")
    assert "selects the time of --png" in str(refused.exception)


def test_foxglove_gets_every_message_as_it_is_stored(circles, monkeypatch):
    """In their order, each once; what viewers get of it is in test_origin_check.py."""
    from lidar_core.viz import foxglove_server

    sent = []

    class Watched(foxglove_server.ServedChannel):
        def log(self, message, *, log_time):
            sent.append((self.description["topic"], log_time, message))
            super().log(message, log_time=log_time)

    monkeypatch.setattr(foxglove_server, "ServedChannel", Watched)
    ports = []
    foxglove_server.serve_foxglove(
        circles / "run.mcap", port=0, speed=1000.0, repeat=False, on_ready=ports.append
    )
    assert ports[0] > 0
    with (circles / "run.mcap").open("rb") as file:
        stored = [
            (channel.topic, message.log_time, message.data)
            for _, channel, message in make_reader(file).iter_messages()
        ]
    assert sorted(sent) == sorted(stored)
    assert [time for _, time, _ in sent] == sorted(time for _, time, _ in sent)


@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_and_sigterm_end_the_server(circles, by):
    with running("view", circles, "--foxglove", "--port", 0) as process:
        killer = threading.Timer(60, process.kill)
        killer.start()
        assert process.stdout.readline().startswith("ws://127.0.0.1:")
        process.send_signal(by)
        _, errors = process.communicate()
        killer.cancel()
    assert process.returncode == 0, errors


def test_a_port_in_use_is_an_error_with_its_cure(circles):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        refused = invoke("view", circles, "--foxglove", "--port", other.getsockname()[1])
    assert isinstance(refused.exception, LinkError)
    assert "stop the program that uses it, or choose another port: --port " in str(
        refused.exception
    )


@needs_rerun
def test_a_missing_folder_is_named_before_anything_is_played(circles, tmp_path):
    refused = invoke("view", circles, "--rrd", tmp_path / "nowhere" / "a.rrd")
    assert isinstance(refused.exception, FileNotFoundError)
    assert str(refused.exception) == f"{tmp_path / 'nowhere'}: no such folder, to write a.rrd in"


@needs_rerun
def test_rerun_clears_what_is_no_longer_there(monkeypatch):
    """Circles, then none; none once more logs nothing; a box is none of the circles."""
    log, logged = RerunLog("a test"), []
    monkeypatch.setattr(
        log.stream, "log", lambda place, shown, **more: logged.append((place, shown))
    )

    def moment(stamp_ns, *heights):
        count = len(heights)
        zeros, size = np.zeros((count, 3)), np.ones((count, 3))
        size[:, 2] = heights
        found = Objects(np.arange(count), zeros, zeros, np.zeros((count, 3, 3)), size)
        return Moment(stamp_ns, np.empty((0, 3), np.float32), np.empty(0, np.uint8), found)

    def told(place):
        return [len(shown.labels) for name, shown in logged if name == f"world/objects/{place}"]

    log.log(moment(1, 0, 0))
    log.log(moment(2))
    log.log(moment(3))
    assert told("outlines") == [2, 0]
    assert told("boxes") == []
    log.log(moment(4, 0, 2))
    log.log(moment(5, 2))
    assert told("outlines") == [2, 0, 1, 0]
    assert told("boxes") == [1, 1]


@pytest.mark.ci_cases("circles")
@needs_rerun
@pytest.mark.parametrize("kind", ["circles", "flying"])
def test_rerun_files_hold_everything_that_is_played(kind, request, tmp_path):
    folder = request.getfixturevalue(kind)
    path = tmp_path / "run.rrd"
    done = invoke("view", folder, "--rrd", path)
    assert done.exit_code == 0, done.output
    check = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert check.returncode == 0, check.stderr
    shown = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", "-v", str(path)],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    wanted = {
        "circles": ["/world/objects/outlines"],
        "flying": ["/world/objects/boxes", "/world/map"],
    }
    for entity in ["/world/points", "/world/objects/covariance", *wanted[kind]]:
        assert entity in shown


def test_a_window_without_a_display_is_refused_before_anything_is_written(circles, monkeypatch):
    from lidar_core.viz import rerun_log, rerun_process

    def refuse(*_):
        raise AssertionError("nothing may be started")

    monkeypatch.setattr(rerun_log, "write_rerun", refuse)
    monkeypatch.setattr(rerun_process, "sys", SimpleNamespace(platform="linux"))
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    error = invoke("view", circles).exception
    assert isinstance(error, ConfigError)
    assert "no display: use --web, --foxglove, --png FILE, --film FILE or --rrd FILE" in str(error)


@pytest.mark.parametrize(
    ("platform", "variable"),
    [("linux", "DISPLAY"), ("linux", "WAYLAND_DISPLAY"), ("darwin", None), ("win32", None)],
)
def test_a_window_with_a_display_is_opened(circles, monkeypatch, platform, variable):
    from lidar_core.viz import rerun_log, rerun_process

    opened = []
    monkeypatch.setattr(rerun_process, "sys", SimpleNamespace(platform=platform))
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    if variable is not None:
        monkeypatch.setenv(variable, ":0")
    monkeypatch.setattr(rerun_log, "write_rerun", lambda played, place: place)
    monkeypatch.setattr(rerun_log, "show_window", lambda place: opened.append(place) or 0)
    assert invoke("view", circles).exit_code == 0
    assert len(opened) == 1


def test_objects_of_one_picture_have_colours_that_differ():
    assert len(set(TRACK_COLOURS)) == len(TRACK_COLOURS) >= 10
    names = [0, 36, 7, 14, 25, 3, 11, 22, 33, 44]
    colours = colours_of(names)
    assert list(colours) == names
    assert len(set(colours.values())) == 10
    many = Counter(colours_of(range(2 * len(TRACK_COLOURS))).values())
    assert set(many.values()) == {2}


def test_objects_of_a_film_keep_colours_that_differ():
    """Of hundreds of objects, those that are in one frame differ."""
    frames = [range(start, start + 6) for start in range(0, 300, 2)]
    colours = colours_of(*frames)
    assert len(colours) == 304
    assert all(len({colours[name] for name in frame}) == 6 for frame in frames)
    gone_for_a_while = colours_of([0, 1], [1, 2], [0, 1, 2])
    assert len(set(gone_for_a_while.values())) == 3
