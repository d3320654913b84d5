"""Readers, writers and metrics of other packages, found by their entry points."""

import copy
import importlib.metadata
import runpy
import subprocess
import sys

import numpy as np
import pytest
from repository import ROOT
from typer.testing import CliRunner

import lidar_core as lc
from lidar_core.cli import app
from lidar_core.errors import ConfigError, FormatError, PluginError, PluginWarning
from lidar_core.evaluation.metric import METRICS
from lidar_core.evaluation.score_rows import detail_rows
from lidar_core.io.readers import READERS, known_formats
from lidar_core.io.writers import WRITERS, writer_of
from lidar_core.messages import Pose, Scan

READER = '''
import numpy as np
from lidar_core.io import Record, Recording, Topic, register_reader
from lidar_core.messages import Scan

@register_reader("Toy", [".toy"], folder="merged")
class ToyRecording(Recording):
    """A text file: a time [ns] and a point [m] in every line."""

    format = "Toy"

    def topics(self):
        return [Topic("toy", "text", "scan")]

    def records(self, kinds=None):
        (topic,) = self.topics()
        for line in self.path.read_text().splitlines():
            stamp, *point = line.split()
            scan = Scan(int(stamp), np.array([point], np.float32), "toy", topic="toy")
            yield Record(topic, scan.stamp_ns, lambda scan=scan: [scan])
'''
WRITER = """
from lidar_core.io import register_writer

@register_writer("Toy", [".toy"], takes="messages")
def write_toy(path, messages):
    lines = [f"{item.stamp_ns} {' '.join(map(str, item.points[0]))}" for item in messages]
    path.write_text("\\n".join(lines) + "\\n")

@register_writer("Toy", [".toyrun"], takes="objects")
def write_toy_run(path, objects):
    path.write_text(f"{objects.name} {len(objects.steps)}")
"""
GENERATOR = ROOT / "docs/generate_parameters.py"
STATE = ("_parts", "_loaded", "_broken", "_path")


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Make packages of modules and entry points that Python finds; all is forgotten afterwards."""
    held = []
    for registry in (READERS, WRITERS, METRICS):
        registry.parts()
        held.append((registry, {name: copy.copy(vars(registry)[name]) for name in STATE}))
    modules = set(sys.modules)

    def make(name, modules, entries):
        folder = tmp_path / f"site-{name}"
        package = folder / name.replace("-", "_")
        package.mkdir(parents=True)
        (package / "__init__.py").touch()
        for module, text in modules.items():
            (package / f"{module}.py").write_text(text)
        info = folder / f"{package.name}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(entries)
        monkeypatch.syspath_prepend(folder)

    yield make
    for registry, before in held:
        vars(registry).update(before)
    for name in set(sys.modules) - modules:
        if name.partition(".")[0].startswith(("toy_", "broken_")):
            del sys.modules[name]


def install_toy(install):
    install(
        "toy-lidar",
        {"reader": READER, "writer": WRITER},
        "[lidar_core.readers]\ntoy = toy_lidar.reader:ToyRecording\n"
        "[lidar_core.writers]\ntoy = toy_lidar.writer\n",
    )


def scan(stamp_ns, x):
    return Scan(stamp_ns, np.array([[x, 1, 2]], np.float32), "toy")


def test_a_package_adds_a_reader(install, tmp_path):
    file = tmp_path / "a.toy"
    file.write_text("5 1 2 3\n7 4 5 6\n")
    with pytest.raises(FormatError, match=r"unknown format '\.toy'"):
        lc.io.open_recording(file)
    install_toy(install)
    with lc.io.open_recording(file) as recording:
        found = list(recording)
        info = recording.info()
    assert [(one.stamp_ns, one.points.tolist()) for one in found] == [
        (5, [[1, 2, 3]]),
        (7, [[4, 5, 6]]),
    ]
    assert (info.format, info.topics[0].count) == ("Toy", 2)
    assert known_formats().endswith(", Toy (.toy)")
    told = CliRunner().invoke(app, ["info", "--formats"])
    assert ".toy" in told.output
    assert told.exit_code == 0


def test_files_of_its_format_in_a_folder_are_merged(install, tmp_path):
    install_toy(install)
    folder = tmp_path / "both"
    folder.mkdir()
    (folder / "a.toy").write_text("1 0 0 0\n3 0 0 0\n")
    (folder / "b.toy").write_text("2 0 0 0\n")
    with lc.io.open_recording(folder) as recording:
        assert [one.stamp_ns for one in recording] == [1, 2, 3]


def test_a_package_adds_writers(install, tmp_path):
    install_toy(install)
    messages = [scan(1, 1.0), scan(2, 3.5)]
    lc.io.write_npz(tmp_path / "a.npz", messages)
    done = CliRunner().invoke(
        app, ["convert", str(tmp_path / "a.npz"), str(tmp_path / "b.toy")], catch_exceptions=False
    )
    assert done.exit_code == 0
    with lc.io.open_recording(tmp_path / "b.toy") as recording:
        assert [one.points.tolist() for one in recording] == [
            one.points.tolist() for one in messages
        ]
    objects = lc.io.RunObjects([(1, None), (2, None)], "bird", ("lidar",), "world", {})
    writer_of(tmp_path / "run.toyrun", "objects")(tmp_path / "run.toyrun", objects)
    assert (tmp_path / "run.toyrun").read_text() == "bird 2"
    with pytest.raises(ConfigError, match=r"unknown suffix '\.x'; .*\.toyrun \(Toy\)"):
        writer_of(tmp_path / "a.x", "objects")


def test_a_broken_package_is_named_and_the_others_go_on(install, tmp_path):
    install(
        "broken-lidar",
        {
            "late": "from lidar_core.io import register_reader\n"
            "register_reader('Half', ['.half'])(object)\n1 / 0\n",
            "silent": "",
        },
        "[lidar_core.readers]\n"
        "gone = broken_lidar.missing\nlate = broken_lidar.late\nsilent = broken_lidar.silent\n",
    )
    install_toy(install)
    (tmp_path / "a.toy").write_text("5 1 2 3\n")
    with pytest.warns(PluginWarning) as told:
        recording = lc.io.open_recording(tmp_path / "a.toy")
    assert len(list(recording)) == 1
    texts = sorted(str(one.message) for one in told)
    assert [text.partition(":")[0] for text in texts] == [
        f"plugin {name!r} of the package 'broken-lidar'" for name in ("gone", "late", "silent")
    ]
    assert "ModuleNotFoundError: No module named 'broken_lidar.missing'" in texts[0]
    assert "ZeroDivisionError" in texts[1]
    assert "registers no reader" in texts[2]
    (tmp_path / "a.half").touch()
    (tmp_path / "a.half").write_text("x")
    with pytest.raises(FormatError, match=r"unknown format '\.half'.*'gone' of .* 'broken-lidar'"):
        lc.io.open_recording(tmp_path / "a.half")
    for name in ("gone", "late", "silent"):
        with pytest.raises(PluginError, match=f"plugin {name!r} of the package 'broken-lidar'"):
            READERS.get(name)


def test_what_a_plugin_raises_names_it(install, tmp_path):
    install(
        "broken-lidar",
        {
            "reader": "from lidar_core.io import register_reader\n"
            "def sniff(path, options):\n    return {}['sniffed']\n"
            "@register_reader('Broken', ['.broken'])\n"
            "def opened(path, options):\n    return {}['opened']\n"
            "@register_reader('Sniffs', ['.npz'], sniff)\n"
            "def never(path, options):\n    raise AssertionError\n"
        },
        "[lidar_core.readers]\nreader = broken_lidar.reader\n",
    )
    (tmp_path / "a.broken").write_text("x")
    with pytest.raises(PluginError, match=r"'broken-lidar': KeyError: 'opened'; update or uninst"):
        lc.io.open_recording(tmp_path / "a.broken")
    lc.io.write_npz(tmp_path / "a.npz", [scan(1, 2.0), Pose(1, "map", "toy", np.eye(4))])
    with pytest.warns(PluginWarning, match="KeyError: 'sniffed'"):
        recording = lc.io.open_recording(tmp_path / "a.npz")
    with recording:
        assert recording.format == "npz"


METRIC = """
from lidar_core.evaluation import register_metric

@register_metric("toy_matched", "toy: matched", "%", of="tracks")
def toy_matched(paired):
    return 100 * (paired.pairing.target_of >= 0).mean()

@register_metric("toy_unknown", "toy: unknown")
def toy_unknown(paired):
    return None

@register_metric("toy_broken", "toy: broken", of="detections")
def toy_broken(paired):
    return float("nan")
"""


def estimates_and_truth():
    stamps = np.zeros(2, np.int64)
    places = np.array([[0, 0, 0], [5, 0, 0]], float)
    truth = lc.evaluation.Truth(stamps[:1], np.array([7]), places[:1], np.ones(1, bool))
    return lc.evaluation.Estimates(stamps, places, np.array([1, 2])), truth


def test_a_package_adds_metrics(install):
    estimates, truth = estimates_and_truth()
    before = lc.evaluation.evaluate(truth, tracks=estimates).to_dict()["track_scores"]
    install("toy-metric", {"metric": METRIC}, "[lidar_core.metrics]\ntoy = toy_metric.metric\n")
    report = lc.evaluation.evaluate(truth, tracks=estimates)
    scores = report.to_dict()["track_scores"]
    assert scores.pop("metrics") == before.pop("metrics") | {
        "toy_matched": 50.0,
        "toy_unknown": None,
    }
    assert scores == before
    rows = [row for row in detail_rows(report.tracks, "tracks") if row is not None]
    assert ("  toy: matched", "50.000 %") in [tuple(row)[:2] for row in rows]
    with pytest.warns(PluginWarning, match="'toy-metric': ValueError: toy_broken: expected a fin"):
        found = lc.evaluation.score_detections(estimates, truth)
    assert found.metrics == {"toy_unknown": None}


def test_a_broken_metric_is_named_and_the_others_go_on(install):
    estimates, truth = estimates_and_truth()
    install(
        "broken-metric",
        {"metric": "import no_such_module"},
        "[lidar_core.metrics]\nbad = broken_metric.metric\n",
    )
    with pytest.warns(PluginWarning, match="plugin 'bad' of the package 'broken-metric': ModuleNo"):
        found = lc.evaluation.score_tracks(estimates, truth)
    assert found.metrics["longest_segment"] == 1.0
    assert "bad" not in found.metrics
    with pytest.raises(PluginError, match="no_such_module"):
        METRICS.get("bad")
    with pytest.raises(ConfigError, match="metric 'two words': expected a name such as"):
        lc.evaluation.register_metric("two words", "")


def test_a_package_registers_what_others_wrote(install, tmp_path):
    install(
        "toy-parts",
        {
            "other": "def write(path, objects, end): path.write_text(end)\n",
            "part": "from functools import partial\nfrom operator import itemgetter\n"
            "from lidar_core.evaluation import register_metric\n"
            "from lidar_core.io import register_writer\n"
            "from toy_parts.other import write\n"
            "ends = ['.toy', '.toy.json']\n"
            "register_writer('Toy', ends, takes='objects')(partial(write, end='x'))\n"
            "register_metric('toy_item', 'toy')(itemgetter('toy'))\n",
        },
        "[lidar_core.writers]\npart = toy_parts.part\n"
        "[lidar_core.metrics]\npart = toy_parts.part\n",
    )
    writer = writer_of(tmp_path / "a.toy.json", "objects")
    assert writer.format == "Toy"
    writer(tmp_path / "a.toy.json", None)
    assert (tmp_path / "a.toy.json").read_text() == "x"
    assert WRITERS.plugin_of(writer).name == "part"
    with pytest.raises(PluginError, match="'toy-parts': TypeError"):
        writer(tmp_path / "a.toy.json")
    estimates, truth = estimates_and_truth()
    # The metrics are those of a module that the writers have loaded already.
    with pytest.warns(PluginWarning, match="'toy-parts': TypeError"):
        found = lc.evaluation.score_tracks(estimates, truth)
    assert "toy_item" not in found.metrics


def test_a_package_that_ends_the_program_is_broken(install, tmp_path):
    install(
        "broken-exit",
        {
            "part": "from lidar_core.io import register_writer\n"
            "@register_writer('Exit', ['.exit'], takes='objects')\n"
            "def write(path, objects): raise SystemExit(4)\n",
            "ends": "raise SystemExit(3)\n",
        },
        "[lidar_core.writers]\nends = broken_exit.ends\npart = broken_exit.part\n",
    )
    with pytest.warns(
        PluginWarning, match="plugin 'ends' of the package 'broken-exit': SystemExit"
    ):
        writer = writer_of(tmp_path / "a.exit", "objects")
    with pytest.raises(PluginError, match="SystemExit: 4"):
        writer(tmp_path / "a.exit", None)


def test_an_interrupt_leaves_packages_to_be_found_later(install, monkeypatch):
    install_toy(install)
    entry = importlib.metadata.EntryPoint
    with monkeypatch.context() as patch:
        patch.setattr(entry, "load", lambda self: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            READERS.parts()
    assert "Toy" in [one.name for one in READERS.parts()]


@pytest.mark.usefixtures("install")
def test_a_part_of_a_notebook_has_no_module(tmp_path):
    scope = {"__name__": None, "register_writer": lc.io.register_writer}
    exec(
        "@register_writer('Cell', ['.cell'], takes='objects')\n"
        "def write(path, objects): raise KeyError('cell')",
        scope,
    )
    writer = writer_of(tmp_path / "a.cell", "objects")
    assert WRITERS.plugin_of(writer) is None
    with pytest.raises(
        PluginError, match=r"writer 'Cell of objects' of a notebook: KeyError: 'cell"
    ):
        writer(tmp_path / "a.cell", None)


@pytest.mark.usefixtures("install")
def test_a_metric_of_a_script_that_fails_is_left_out():
    @lc.evaluation.register_metric("scripted", "scripted")
    def scripted(paired):
        raise KeyError("scripted")

    estimates, truth = estimates_and_truth()
    with pytest.warns(PluginWarning, match=r"metric 'scripted' of .*test_plugins: KeyError"):
        found = lc.evaluation.score_tracks(estimates, truth)
    assert found.metrics["longest_segment"] == 1.0
    assert "scripted" not in found.metrics


def test_a_choice_that_there_is_not_is_refused():
    with pytest.raises(ConfigError, match="writer 'x': takes: expected one of messages, objects"):
        lc.io.register_writer("x", [".x"], takes="object")
    with pytest.raises(ConfigError, match="reader 'x': folder: expected one of single, merged"):
        lc.io.register_reader("x", [".x"], folder="together?")
    with pytest.raises(ConfigError, match="metric 'x': of: expected one of tracks, detections"):
        lc.evaluation.register_metric("x", "", of="track")
    with pytest.raises(
        ConfigError,
        match=r"suffix '\.npz' is already registered by lidar_core\.io\.write\.npz",
    ):
        lc.io.register_writer("x", [".npz"], takes="messages")(print)


def test_a_name_belongs_to_one_part():
    with pytest.raises(
        ConfigError, match=r"reader 'PCD': already registered by lidar_core\.io\.formats\.pcd"
    ):
        lc.io.register_reader("PCD", [".pcd2"])(object)
    with pytest.raises(
        ConfigError, match=r"reader 'x': expected suffixes such as '\.toy', got 'x'"
    ):
        lc.io.register_reader("x", ["x"])
    with pytest.raises(ConfigError, match=r"reader 'x': expected at least one suffix"):
        lc.io.register_reader("x", [])
    with pytest.raises(
        ConfigError, match=r"writer 'x': expected suffixes such as '\.toy', got '.'"
    ):
        lc.io.register_writer("x", ["."], takes="points")
    with pytest.raises(ConfigError, match="did you mean PCD"):
        READERS.get("PCd")


def test_readers_are_imported_when_they_are_needed():
    code = (
        "import sys, lidar_core as lc; assert 'lidar_core.plugins' not in sys.modules;"
        "assert 'importlib.metadata' not in sys.modules; lc.io;"
        "assert 'lidar_core.io.formats.carmen' not in sys.modules;"
        "from lidar_core.io.readers import known_formats; known_formats();"
        "heavy = {'rosbags', 'mcap', 'pypcd4', 'laspy', 'trimesh', 'ouster', 'velodyne_decoder'};"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_guide_lists_every_reader():
    pages = runpy.run_path(str(GENERATOR))
    text = pages["RECORDINGS"].read_text(encoding="utf-8")
    assert pages["with_formats"](text) == text, "python docs/generate_parameters.py"
    assert all(f"| {reader.name} |" in text for reader in READERS.parts())
