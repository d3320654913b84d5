"""Foreign ONNX models: run only when the user says so, and never with loops or other files."""

import json
import shutil
from hashlib import sha256

import numpy as np
import pytest
from typer.testing import CliRunner

from lidar_core.circles import (
    CircleDetector,
    CircleNetwork,
    CirclePipeline,
    CirclesConfig,
    Scanner,
    trust_model,
)
from lidar_core.circles.estimators.detector_name import MODELS
from lidar_core.circles.estimators.onnx_graph import check_graph
from lidar_core.cli import app
from lidar_core.errors import ConfigError, FormatError, LimitError
from lidar_core.live.pipelines import CirclesLive

NAMES_OPTIONS = r"allow_untrusted=True"


def number(value):
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def entry(field, value):
    """One field of a protocol buffer: bytes, text or a number."""
    if isinstance(value, int):
        return number(field << 3) + number(value)
    data = value.encode() if isinstance(value, str) else value
    return number(field << 3 | 2) + number(len(data)) + data


def node(operator, *attributes, domain=""):
    told = entry(1, "x") + entry(2, "y") + entry(4, operator)
    return told + b"".join(entry(5, one) for one in attributes) + entry(7, domain)


def model(*nodes, tensors=(), more=b""):
    graph = b"".join(entry(1, one) for one in nodes) + b"".join(entry(5, one) for one in tensors)
    return entry(1, 8) + entry(7, graph) + more


@pytest.fixture
def settings(tmp_path, monkeypatch):
    """A folder of settings of its own."""
    folder = tmp_path / "settings"
    monkeypatch.setenv("XDG_CONFIG_HOME", str(folder))
    monkeypatch.setenv("APPDATA", str(folder))
    return folder


@pytest.fixture
def foreign(tmp_path):
    """The small network with one more word in its metadata, and a card that fits: somebody's."""
    path = tmp_path / "foreign.onnx"
    words = entry(14, entry(1, "from") + entry(2, "somewhere"))
    path.write_bytes((MODELS / "cnn.onnx").read_bytes() + words)
    card = {"sha256": sha256(path.read_bytes()).hexdigest()}
    path.with_suffix(".json").write_text(json.dumps(card))
    return path


def test_a_foreign_model_is_refused_although_it_brings_a_card(foreign, settings):
    """Whoever makes a model can write its card: it ran without a word before."""
    config = CirclesConfig(detector=str(foreign))
    for attempt in (
        lambda: CircleNetwork(foreign),
        lambda: CircleDetector(foreign),
        lambda: CirclePipeline(config),
    ):
        with pytest.raises(ConfigError, match=rf"foreign\.onnx: .*{NAMES_OPTIONS}"):
            attempt()
    assert not settings.exists()


def test_a_foreign_model_runs_with_allow_untrusted(foreign, settings):
    scan = np.full((1, 1081), np.inf, np.float32)
    scan[0, 500:560] = 3.0
    bearings = Scanner().bearings()
    shipped = CircleDetector("cnn").detect(scan, bearings)
    found = CircleDetector(foreign, allow_untrusted=True).detect(scan, bearings)
    np.testing.assert_array_equal(np.asarray(found), np.asarray(shipped))
    CirclePipeline(CirclesConfig(detector=str(foreign)), allow_untrusted=True)


def test_a_copy_of_a_shipped_model_is_known_by_its_content(tmp_path, settings):
    shutil.copy(MODELS / "cnn.onnx", tmp_path / "copy.onnx")
    assert CircleNetwork(tmp_path / "copy.onnx").card == {}


def test_a_model_that_the_user_trusts_runs_until_it_changes(foreign, settings):
    place = trust_model(foreign)
    assert place is not None
    assert place.is_relative_to(settings)
    assert trust_model(foreign) == place
    assert place.read_text().split() == [sha256(foreign.read_bytes()).hexdigest()]
    CircleNetwork(foreign)
    foreign.with_suffix(".json").unlink()
    CircleNetwork(foreign)
    with foreign.open("ab") as file:
        file.write(entry(6, "changed"))
    with pytest.raises(ConfigError, match=NAMES_OPTIONS):
        CircleNetwork(foreign)


def test_export_makes_the_model_trusted(foreign, settings, monkeypatch, tmp_path):
    """What the user exported runs without an option; torch is stood in for."""
    from types import SimpleNamespace

    from lidar_core.cli import train as command

    def export(run, target):
        shutil.copy(foreign, target)
        return {"bytes": 1, "parameters": 1, "largest_difference_from_torch": 0.0}

    monkeypatch.setattr(command, "training", lambda name: SimpleNamespace(export=export))
    done = CliRunner().invoke(app, ["export", str(tmp_path), str(tmp_path / "mine.onnx")])
    assert done.exit_code == 0, done.output
    assert "Trusted from now on by this user" in done.output
    CircleNetwork(tmp_path / "mine.onnx")


def test_without_a_folder_for_settings_nothing_is_trusted(foreign, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "file"))
    monkeypatch.setenv("APPDATA", str(tmp_path / "file"))
    assert trust_model(foreign) is None
    with pytest.raises(ConfigError, match=NAMES_OPTIONS):
        CircleNetwork(foreign)


def test_a_configuration_cannot_trust_a_model(foreign, settings, tmp_path):
    """Configurations are foreign, too: only an option of the command counts."""
    with pytest.raises(ConfigError, match="allow_untrusted"):
        CirclesConfig.load({"detector": str(foreign), "allow_untrusted": True})
    recording = tmp_path / "r.npz"
    made = CliRunner().invoke(app, ["simulate", "circles", "-o", str(recording), "--scans", "3"])
    assert made.exit_code == 0, made.output
    arguments = [
        "circles",
        str(recording),
        "--no-picture",
        "--no-mcap",
        "--set",
        f"detector={foreign}",
    ]
    done = CliRunner().invoke(app, [*arguments, "-o", str(tmp_path / "a")])
    assert isinstance(done.exception, ConfigError)
    assert "--trust-model" in str(done.exception)
    done = CliRunner().invoke(app, [*arguments, "-o", str(tmp_path / "b"), "--trust-model"])
    assert done.exit_code == 0, done.output


def test_live_refuses_a_foreign_model(foreign, settings):
    from lidar_core.messages import LaserScan

    scan = LaserScan(0, np.full(1081, 3.0, np.float32), -2.3, 0.004, 0.1, 10.0, "laser")
    config = CirclesConfig(detector=str(foreign))
    with pytest.raises(ConfigError, match=NAMES_OPTIONS):
        CirclesLive(config, n_scanners=1).is_ready(scan)
    assert CirclesLive(config, n_scanners=1, allow_untrusted=True).is_ready(scan)


@pytest.mark.parametrize("operator", ["Loop", "Scan", "If"])
def test_control_flow_is_refused_from_anybody(tmp_path, operator, settings):
    """A Loop of 2^62 turns ignored Ctrl-C."""
    body = entry(1, "body") + entry(6, entry(1, node("Identity")))
    path = tmp_path / "a.onnx"
    path.write_bytes(model(node("Identity"), node(operator, body)))
    with pytest.raises(FormatError, match=r"a\.onnx: control flow \(Loop, Scan, If\) is refused"):
        CircleNetwork(path, allow_untrusted=True)
    several = entry(1, "body") + entry(11, entry(1, node("Identity")))
    path.write_bytes(model(node(operator, several)))
    with pytest.raises(FormatError, match="control flow"):
        CircleNetwork(path, allow_untrusted=True)


@pytest.mark.parametrize("where", ["initialiser", "attribute", "sparse"])
def test_external_data_is_refused_from_anybody(tmp_path, where, settings):
    """Weights in other files were read from the working folder."""
    outside = entry(1, 3) + entry(2, 1) + entry(8, "w") + entry(13, entry(1, "location"))
    outside += entry(14, 1)
    broken = {
        "initialiser": model(node("Identity"), tensors=[outside]),
        "attribute": model(node("Constant", entry(1, "value") + entry(5, outside))),
        "sparse": entry(7, entry(1, node("Identity")) + entry(15, entry(1, outside))),
    }[where]
    path = tmp_path / "a.onnx"
    path.write_bytes(broken)
    with pytest.raises(FormatError, match=r"weights in another file \(external data\) are refused"):
        CircleNetwork(path, allow_untrusted=True)


def test_foreign_operators_and_functions_are_refused(tmp_path):
    path = tmp_path / "a.onnx"
    with pytest.raises(FormatError, match=r"operator Run of 'com\.evil' is not a standard"):
        check_graph(path, model(node("Run", domain="com.evil")))
    with pytest.raises(FormatError, match="expected only a graph, got also a function"):
        check_graph(path, model(node("Identity"), more=entry(25, entry(7, node("Loop")))))
    check_graph(path, model(node("Identity", domain="ai.onnx")))


def test_bytes_that_are_no_model_are_refused(tmp_path):
    path, good = tmp_path / "a.onnx", (MODELS / "cnn.onnx").read_bytes()
    check_graph(path, good)
    rng = np.random.default_rng(0)
    for content in (b"", b"\0" * 64, good[:1000], b"\x3a" + number(2**62), b"\xff" * 40):
        with pytest.raises(FormatError, match="expected an ONNX model"):
            check_graph(path, content)
    for _ in range(300):
        at = int(rng.integers(len(good)))
        broken = good[:at] + rng.bytes(1) + good[at + 1 :]
        try:
            check_graph(path, broken)
        except FormatError as error:
            assert "a.onnx" in str(error)  # noqa: PT017


def test_a_model_whose_names_are_no_text_is_refused(tmp_path):
    path, good = tmp_path / "a.onnx", (MODELS / "cnn.onnx").read_bytes()
    told = []
    for at in range(len(good) - 60, len(good), 2):  # here lie the names of the output
        path.write_bytes(good[:at] + b"\xff" + good[at + 1 :])
        try:
            CircleNetwork(path, allow_untrusted=True)
        except FormatError as error:
            told.append(str(error))
    assert [text for text in told if "a name in the model is not UTF-8" in text]


def test_a_model_is_not_larger_than_the_limit(tmp_path):
    path = tmp_path / "a.onnx"
    with path.open("wb") as file:
        file.truncate(256 * 2**20 + 1)
    with pytest.raises(LimitError, match=r"a\.onnx: a model of 268435457 bytes, limit 268435456"):
        CircleNetwork(path, allow_untrusted=True)
