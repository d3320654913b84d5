"""The report of a run: what is in it, that nothing in it runs or asks for anything else."""

import base64
import html
import json
import re
import time
from html.parser import HTMLParser
from urllib.parse import urlsplit

import numpy as np
import pytest
from chromium import CHROMIUM, Browser
from commands import invoke

import lidar_core as lc
from lidar_core import sim
from lidar_core.errors import FormatError
from lidar_core.viz import Playback, draw_film, draw_moment, write_report
from lidar_core.viz.drawing.thinning import evenly
from lidar_core.viz.report.charts import MOST_DRAWN
from lidar_core.viz.report.scene import MOST_MOMENTS, MOST_PLACES, MOST_VOXELS
from lidar_core.viz.report.seen import first_seen

SCANS = 15
FEW = 6
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium; on Debian: apt install chromium"
)
HOSTILE = "</script><script>document.title='broken'</script><img src=x onerror=alert(1)>"


def made(*arguments):
    done = invoke(*arguments)
    assert done.exit_code == 0, done.output


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "demo"
    made("demo", "-o", folder, "--scans", SCANS, "--no-picture")
    return folder


@pytest.fixture(scope="module")
def circles(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    made("simulate", "circles", "-o", folder / "a.npz", "--scans", SCANS)
    made("circles", folder / "a.npz", "-o", folder / "run")
    return folder / "run"


class Page(HTMLParser):
    """Elements of a page, with the text of each kind."""

    def __init__(self, path):
        super().__init__(convert_charrefs=True)
        self.elements, self.texts, self._open = [], {}, []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        self._open.append(tag)
        self.texts.setdefault(tag, []).append("")

    def handle_endtag(self, tag):
        while self._open and self._open.pop() != tag:
            pass

    def handle_data(self, data):
        for tag in self._open:
            self.texts[tag][-1] += data

    @property
    def scene(self):
        return json.loads(self.texts["script"][0])


def unpacked(scene, text):
    lattice = scene["lattice"]
    steps = np.frombuffer(base64.b64decode(text), "<u2").reshape(-1, 3)
    return np.array(lattice["origin"]) + lattice["step"] * steps


def test_a_demo_is_reported_with_its_errors_times_and_configuration(demo, tmp_path):
    path = write_report(demo, tmp_path / "a" / "demo.html")
    page = Page(path)
    heads = page.texts["h2"]
    assert heads[:3] == ["Warnings and notes", "View", "Picture"]
    for head in ("Errors", "Time per scan", "Summary", "Configuration and versions"):
        assert head in heads
    assert "Consistency" not in heads  # NIS is of fuse
    cells = page.texts["td"]
    summary = json.loads((demo / "summary.json").read_text())
    scores = summary["track_scores"]
    assert cells[cells.index("recall of tracks") + 1] == f"{scores['recall']:.3f}"
    assert cells[cells.index("false tracks") + 1] == str(len(scores["false_ids"]))
    assert cells[cells.index("cluster") + 1].endswith(" ms")
    assert page.texts["pre"] == [(demo / "run.toml").read_text()]
    assert f"Objects ({summary['tracks']})" in heads


def test_the_view_shows_what_the_run_holds(demo, tmp_path):
    scene = Page(write_report(demo, tmp_path / "demo.html")).scene
    run = Playback(demo)
    moments = list(run.moments())
    starts = next(run.steps())[0]
    assert scene["times"] == [
        pytest.approx((one.stamp_ns - starts) * 1e-9, abs=1e-4) for one in moments
    ]
    for moment, objects in zip(moments, scene["objects"], strict=True):
        assert [one["id"] for one in objects] == moment.objects.id.tolist()
        for row, one in enumerate(objects):
            np.testing.assert_allclose(one["position"], moment.objects.position[row], atol=1e-3)
            np.testing.assert_array_equal(
                np.reshape(one["covariance"], (3, 3)), moment.objects.covariance[row]
            )
    occupied = lc.VoxelMap.load(demo / "map.lcvm").occupied_points()
    shown = unpacked(scene, scene["voxels"])
    occupied = occupied[evenly(len(occupied), MOST_VOXELS)]
    np.testing.assert_allclose(shown, occupied, atol=scene["lattice"]["step"])
    assert len(scene["truth"]) == 2
    assert not scene["planar"]
    for moment, place in zip(moments, scene["sensors"], strict=True):
        np.testing.assert_allclose(place, moment.sensor, atol=1e-3)


def looped(centers, size, clouds):
    """Index of the first cloud with a point in each voxel, by comparing each with each."""
    found = []
    for center in centers:
        hits = [
            number
            for number, points in enumerate(clouds)
            if (np.abs(points - center) <= size / 2).all(axis=1).any()
        ]
        found.append(hits[0] if hits else None)
    return found


def test_places_of_the_map_appear_when_they_are_first_measured():
    rng, size = np.random.default_rng(1000), 0.25
    cells = np.unique(rng.integers(-40, 40, (300, 3)), axis=0)
    centers = (cells + 0.5) * size + [100.0, -20.0, 3.0]
    clouds = [
        centers[rng.integers(0, len(centers), 60)] + rng.uniform(-0.12, 0.12, (60, 3))
        for _ in range(6)
    ]
    expected, first = looped(centers, size, clouds), first_seen(centers, size, clouds)
    known = [row for row, index in enumerate(expected) if index is not None]
    assert 100 < len(known) < len(centers)
    assert first[known].tolist() == [expected[row] for row in known]


def test_places_that_no_shown_scan_measured_take_the_time_of_their_surroundings():
    size = 0.25
    centers = np.array([[0.125, 0.125, 0.125], [0.375, 0.125, 0.125], [50.0, 0.0, 0.0]])
    nothing, near = np.empty((0, 3)), centers[:1]
    assert first_seen(centers, size, [nothing, near]).tolist() == [1, 1, 0]
    assert first_seen(centers, size, []).tolist() == [0, 0, 0]
    assert first_seen(np.empty((0, 3)), size, [near]).tolist() == []


@pytest.mark.nightly
def test_the_map_of_a_view_grows_unless_the_run_began_with_it(tmp_path):
    made("simulate", "demo", "-o", tmp_path / "a.npz", "--scans", FEW)
    made("detect", tmp_path / "a.npz", "-o", tmp_path / "run", "--no-picture")
    page = Page(write_report(tmp_path / "run"))
    first = np.frombuffer(base64.b64decode(page.scene["seen"]), "<u2")
    assert len(first) == len(unpacked(page.scene, page.scene["voxels"]))
    assert (first == 0).any()
    assert (first > FEW // 2).any()
    assert first.max() < FEW
    assert any("appears with the first scan" in text for text in page.texts["p"])
    known = ("--map", tmp_path / "run" / "map.lcvm", "--no-picture")
    made("detect", tmp_path / "a.npz", "-o", tmp_path / "again", *known)
    page = Page(write_report(tmp_path / "again"))
    assert not any(base64.b64decode(page.scene["seen"]))
    assert any("at all times" in text for text in page.texts["p"])


def test_scans_of_a_recording_are_in_the_view(circles, tmp_path):
    scene = Page(write_report(circles, tmp_path / "a.html")).scene
    moments = [one for one in Playback(circles).moments() if len(one.points)]
    assert scene["planar"]
    assert len(scene["scans"]) == len(moments) == SCANS
    for moment, kept in zip(moments, scene["scans"], strict=True):
        np.testing.assert_allclose(
            unpacked(scene, kept["points"]), moment.points, atol=scene["lattice"]["step"]
        )


@pytest.mark.nightly
def test_a_long_run_is_thinned_to_its_end(tmp_path):
    rows = [f"L {x} {x} {int(1e6 * t)} {x} {x} 1 1" for t, x in _way(2 * MOST_MOMENTS)]
    (tmp_path / "a.txt").write_text("\n".join(rows) + "\n")
    made("fuse", tmp_path / "a.txt", "-o", tmp_path / "run", "--no-picture")
    scene = Page(write_report(tmp_path / "run")).scene
    assert len(scene["times"]) == MOST_MOMENTS
    stamps = [stamp for stamp, _ in Playback(tmp_path / "run").steps()]
    assert scene["times"][-1] == pytest.approx((stamps[-1] - stamps[0]) * 1e-9, abs=1e-4)


def _way(count):
    return [(0.05 * step, 0.05 * step) for step in range(count)]


def test_nis_of_fuse_is_reported(tmp_path):
    rows = [f"L {x} {x} {int(1e6 * t)} {x} {x} 1 1" for t, x in _way(40)]
    (tmp_path / "a.txt").write_text("\n".join(rows) + "\n")
    made("fuse", tmp_path / "a.txt", "-o", tmp_path / "run", "--no-picture")
    made("report", tmp_path / "run")
    page = Page(tmp_path / "run" / "report.html")
    assert {"Consistency", "Errors"} <= set(page.texts["h2"])
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    cells = page.texts["td"]
    assert cells[cells.index("NIS lidar") + 1] == f"{summary['nis']['lidar']['mean']:.2f}"
    rows = dict(zip(map(str.strip, cells), cells[1:], strict=False))
    assert rows["NEES of positions"] != "-"  # of x and y


def test_a_run_that_kept_no_scans_and_found_nothing_has_no_picture(tmp_path):
    scene = sim.scenes.dark_street(scans=FEW, sensor="vlp-16", drone=False)
    sim.record(scene, tmp_path / "a.npz", seed=1, scans=FEW)
    run = tmp_path / "run"
    lc.runs.detect(tmp_path / "a.npz", None, run, mcap=False, picture=False)
    page = Page(write_report(run))
    assert "None was found." in page.texts["p"]
    assert "Picture" not in page.texts["h2"]
    for draw, name in ((draw_moment, "a.png"), (draw_film, "a.gif")):
        with pytest.raises(FormatError, match=r"no objects to draw, and no scans.*\(mcap=True\)"):
            draw(Playback(run), tmp_path / name)


def test_a_run_without_truth_has_no_errors_and_takes_a_truth_that_is_given(circles, tmp_path):
    without = Page(write_report(circles, tmp_path / "a.html"))
    assert "Errors" not in without.texts["h2"]
    truth = circles.parent / "a.truth.csv"
    path = tmp_path / "b.html"
    made("report", circles, "-o", path, "--truth", truth)
    page = Page(path)
    assert "Errors" in page.texts["h2"]
    done = invoke("evaluate", circles, truth, "--json", tmp_path / "scores.json")
    assert done.exit_code == 0, done.output
    scores = json.loads((tmp_path / "scores.json").read_text())["track_scores"]
    cells = page.texts["td"]
    assert cells[cells.index("recall of tracks") + 1] == f"{scores['recall']:.3f}"
    assert page.scene["truth"]


def test_warnings_and_notes_of_the_run_are_shown_first(circles, tmp_path):
    path = circles / "summary.json"
    kept = path.read_text()
    page = Page(write_report(circles, tmp_path / "a.html"))
    assert "No warnings and no notes." in "".join(page.texts["p"])
    told = {
        **json.loads(kept),
        "warnings": [f"poses are late {HOSTILE}"],
        "notes": ["10 Hz assumed"],
    }
    try:
        path.write_text(json.dumps(told))
        page = Page(write_report(circles, tmp_path / "a.html"))
    finally:
        path.write_text(kept)
    warning = next(attrs for tag, attrs in page.elements if attrs.get("class") == "warning")
    assert warning
    first = "".join(page.texts["p"])
    assert HOSTILE in first
    assert "10 Hz assumed" in first
    assert "No warnings" not in first


def test_the_page_asks_for_nothing_and_runs_only_its_own_script(circles, tmp_path):
    path = write_report(circles, tmp_path / "a.html")
    page = Page(path)
    links = [
        value
        for _, attrs in page.elements
        for name, value in attrs.items()
        if name in ("src", "href", "action", "data", "srcset")
        and not value.startswith(("data:", "#"))
    ]
    assert links == []
    assert [attrs.get("type") for tag, attrs in page.elements if tag == "script"] == [
        "application/json",
        None,
    ]
    assert not [name for _, attrs in page.elements for name in attrs if name.startswith("on")]
    policy = next(
        attrs["content"] for tag, attrs in page.elements if attrs.get("http-equiv") is not None
    )
    rules = dict(part.strip().split(" ", 1) for part in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert re.fullmatch(r"'sha256-[\w+/]{43}='", rules["script-src"])
    assert rules["img-src"] == "data:"


def test_names_and_texts_of_a_run_cannot_add_elements(circles, tmp_path):
    """The command and the configuration hold whatever somebody typed."""
    run = tmp_path / "run"
    run.mkdir()
    for path in circles.iterdir():
        if path.is_file():
            (run / path.name).write_bytes(path.read_bytes())
    note = (run / "run.toml").read_text()
    (run / "run.toml").write_text(re.sub(r"(?m)^command = .*$", f'command = "{HOSTILE}"', note))
    plain, hostile = Page(write_report(circles)), Page(write_report(run))
    assert [tag for tag, _ in hostile.elements] == [tag for tag, _ in plain.elements]
    assert hostile.texts["code"] == [HOSTILE]
    assert html.escape(HOSTILE) in (run / "report.html").read_text()


def test_what_is_no_run_is_refused(tmp_path, circles):
    with pytest.raises(FileNotFoundError, match="no such folder"):
        write_report(tmp_path / "none")
    with pytest.raises(FormatError, match=r"run\.toml"):
        write_report(tmp_path)
    assert list(tmp_path.iterdir()) == []
    done = invoke("report", tmp_path)
    assert isinstance(done.exception, FormatError)
    path = circles / "summary.json"
    kept = path.read_text()
    try:
        path.write_text("{")
        with pytest.raises(FormatError, match=r"summary\.json: expected JSON"):
            write_report(circles, tmp_path / "a.html")
    finally:
        path.write_text(kept)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.nightly
def test_a_next_run_replaces_the_report_of_the_one_before(circles):
    write_report(circles)
    assert (circles / "report.html").is_file()
    made("circles", circles.parent / "a.npz", "-o", circles, "--overwrite")
    assert not (circles / "report.html").exists()


@pytest.mark.nightly
@needs_chromium
def test_the_view_moves_in_a_browser_that_asks_nobody(demo, tmp_path):
    path = write_report(demo, tmp_path / "demo.html")
    with Browser(tmp_path) as browser:
        browser.open(path.as_uri())
        until = time.monotonic() + 60
        while not browser.value("document.getElementById('clock')?.textContent"):
            assert time.monotonic() < until, "the view does not start"
            time.sleep(0.2)
        assert "2 objects" in browser.value("document.getElementById('clock').textContent")
        last = browser.picture()
        browser.value(
            "const s = document.getElementById('time'); s.value = 0;"
            " s.dispatchEvent(new Event('input'))"
        )
        time.sleep(0.5)
        start = Page(path).scene["times"][0]
        shown = browser.value("document.getElementById('clock').textContent")
        assert shown.startswith(f"{start:.2f} s")
        first = browser.picture()
        assert (np.abs(first - last).max(axis=2) > 40).sum() > 100
        blue = np.abs(last - [3, 105, 161]).max(axis=2) < 30
        assert blue.sum() > 20  # number, box and trail of a track
        hosts = {urlsplit(one).hostname for one in browser.addresses() if "://" in one}
    assert not {host for host in hosts if host} - {"127.0.0.1"}


@needs_chromium
def test_the_view_names_what_it_draws(circles, tmp_path):
    """Scan and walls of a map in the plane; one object is no "1 objects"."""
    path = write_report(circles, tmp_path / "a.html")
    with Browser(tmp_path) as browser:
        browser.open(path.as_uri())
        until = time.monotonic() + 60
        while not (clock := browser.value("document.getElementById('clock')?.textContent")):
            assert time.monotonic() < until, "the view does not start"
            time.sleep(0.2)
        legend = browser.value("document.getElementById('legend').textContent")
    scene = Page(path).scene
    assert legend.startswith("scan ")
    assert ("wall or other shape" in legend) == any(scene["outlines"])
    assert clock.endswith(" object") == (len(scene["objects"][-1]) == 1)


@pytest.mark.parametrize("wrong", [{"run": None}, {"run": 3}, {"output": 1.5}, {"truth": True}])
def test_arguments_of_another_type_are_named(circles, wrong):
    (name,) = wrong
    with pytest.raises(lc.ConfigError, match=f"^{name}: expected"):
        write_report(**{"run": circles, **wrong})


def test_a_report_replaces_an_earlier_one_and_nothing_else(circles, tmp_path):
    page = tmp_path / "page.html"
    assert write_report(circles, page) == write_report(circles, page) == page
    kept = (circles / "summary.json").read_bytes()
    for place in (circles / "summary.json", tmp_path / "notes.txt"):
        if not place.exists():
            place.write_text("mine")
        with pytest.raises(FileExistsError, match="is no report"):
            write_report(circles, place)
    assert (circles / "summary.json").read_bytes() == kept
    assert (tmp_path / "notes.txt").read_text() == "mine"


@pytest.mark.nightly
def test_a_long_run_of_fuse_gives_a_small_page(tmp_path):
    """NIS of every measurement is in a picture, true places are thinned to their end."""
    count = MOST_DRAWN + MOST_DRAWN // 10
    rows = [f"L {x} {x} {int(1e6 * t)} {x} {x} 1 1" for t, x in _way(count)]
    (tmp_path / "long.txt").write_text("\n".join(rows) + "\n")
    made("fuse", tmp_path / "long.txt", "-o", tmp_path / "run", "--no-picture", "--no-mcap")
    path = write_report(tmp_path / "run")
    assert path.stat().st_size < 1e6
    page = Page(path)
    (way,) = page.scene["truth"]
    assert len(way) == MOST_PLACES
    assert [tag for tag, _ in page.elements if tag == "image"]
    times = [t for t, _ in _way(count)]
    assert [way[0][0], way[-1][0]] == pytest.approx([0, times[-1] - times[0]], abs=1e-3)
    (tmp_path / "short.txt").write_text("\n".join(rows[:100]) + "\n")
    made("fuse", tmp_path / "short.txt", "-o", tmp_path / "few", "--no-picture", "--no-mcap")
    assert "image" not in {tag for tag, _ in Page(write_report(tmp_path / "few")).elements}
