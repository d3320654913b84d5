"""The network on windows: oracle, accuracy, honesty, and models that do not fit."""

import base64
import json
import math
import shutil

import numpy as np
import pytest

from lidar_core import _core
from lidar_core.circles import (
    CircleDetector,
    CircleNetwork,
    CirclePipeline,
    CirclesConfig,
    DatasetConfig,
    FitConfig,
    Scanner,
    make_samples,
    segment,
)
from lidar_core.circles.estimators.detector_name import MODELS, shipped
from lidar_core.circles.estimators.windows import windows_of_samples
from lidar_core.errors import ConfigError, FormatError, InputError
from reference import circle_window as reference

SCANNER = Scanner()
ANYWHERE = DatasetConfig.continuous(circles=1)
ROUND = Scanner(-math.pi, math.radians(0.5), 720, 0.1, 15.0)
FLOAT32 = 2e-6  # slots and context are float32, below about 10
LARGE_SAMPLE = 20_000
# A graph that passes on its input x (n, 3): onnx.helper.make_model of one Identity, onnx 1.23.2.
IDENTITY = (
    "CAg6QQoQCgF4EgF5IghJZGVudGl0eRIBZ1oUCgF4Eg8KDQgBEgkKAxIBbgoCCANiFAoBeRIPCg0IARIJCgMSAW4KAggD"
    "QgQKABAR"
)


def detected(config, seed, count, **options):
    samples = make_samples(config, count=count, seed=seed)
    fit = FitConfig(range_std=config.range_std[0], beam_half_width=config.beam_half_width[0])
    detector = CircleDetector("cnn", config=fit, scanner=config.scanner, **options)
    found = detector.detect(samples.scans(config.scanner), config.scanner.bearings())
    return samples, found


def nees(samples, found):
    error = np.asarray(found) - samples.circles
    return np.einsum(
        "ni,ni->n", error, np.linalg.solve(found.covariance, error[:, :, None])[..., 0]
    )


@pytest.mark.parametrize("scanner", [SCANNER, ROUND, Scanner(3.0, -0.005, 900, 0.3, 8.0)])
def test_windows_are_those_of_the_oracle(scanner):
    config = ANYWHERE.model_copy(
        update={"scanner": scanner, "occluded_share": 0.5, "beam_half_width": (0.0, 0.002)}
    )
    samples = make_samples(config, count=300, seed=31)
    slots, context, frames = windows_of_samples(samples, scanner)
    starts, bearings = samples.starts, scanner.bearings()
    for number in range(len(samples)):
        ranges = samples.ranges[starts[number] : starts[number + 1]].astype(float)
        rays = (int(samples.first_ray[number]) + np.arange(len(ranges))) % scanner.n_beams
        gaps = [scanner.angle_increment] * 2
        noise = float(samples.range_std[number]), float(samples.beam_half_width[number])
        limits = scanner.range_min, scanner.range_max
        expected = reference.shown(
            bearings[rays], ranges, samples.sides[number], gaps, *noise, limits
        )
        assert np.abs(slots[number] - expected[0]).max() < FLOAT32
        assert np.abs(context[number] - expected[1]).max() < FLOAT32
        apart = frames[number] - expected[2]
        apart[0] = np.angle(np.exp(1j * apart[0]))
        assert np.abs(apart).max() < 1e-9


def test_answers_mean_what_the_oracle_says():
    random = np.random.default_rng(32)
    frames = np.column_stack([random.uniform(-3, 3, 50), *random.uniform(0.1, 2, (4, 50))])
    answers = random.uniform(-1, 1, (50, 9)).astype(np.float32)
    circles, covariances = _core.circles_from_answers(frames, answers)
    for number, (frame, answer) in enumerate(zip(frames, answers.astype(float), strict=True)):
        circle, covariance = reference.circle(frame, answer)
        assert np.allclose(circles[number], circle, atol=1e-12)
        assert np.allclose(covariances[number], covariance, atol=1e-12)


def test_accuracy_on_circles_anywhere():
    samples, found = detected(ANYWHERE, 1033, LARGE_SAMPLE)
    errors = np.asarray(found) - samples.circles
    assert np.square(errors).mean() < 2.4e-4  # [m^2]; a fifth more or less from sample to sample
    assert np.abs(errors).mean() < 0.0051  # [m]
    assert 2.7 < nees(samples, found).mean() < 3.3


@pytest.mark.nightly
@pytest.mark.parametrize(
    "changes",
    [
        {"range_std": (0.02, 0.02)},
        {"scanner": ROUND, "reach": 12.0},
        {"beam_half_width": (0.002, 0.002)},
        {"occluded_share": 1.0},
    ],
)
def test_covariances_are_honest_elsewhere_too(changes):
    samples, found = detected(ANYWHERE.model_copy(update=changes), 1034, LARGE_SAMPLE)
    assert 2.4 < nees(samples, found).mean() < 3.6


def test_segments_give_what_rows_give():
    config = ANYWHERE.model_copy(update={"scanner": ROUND})
    samples, rows = detected(config, 35, 40)
    cnn, fit = CircleNetwork("cnn"), FitConfig()
    compared = 0
    for scan, expected in zip(samples.scans(ROUND), np.asarray(rows), strict=True):
        ranges, bearings = scan.astype(float), ROUND.bearings()
        segments = segment(ranges, bearings, scanner=ROUND)
        if len(segments) != 1 or np.diff(segments.starts)[0] != np.isfinite(scan).sum():
            continue
        found = cnn.of_segments(ranges, bearings, segments, config=fit, scanner=ROUND)
        assert np.allclose(np.asarray(found)[0], expected, atol=1e-5)
        compared += 1
    assert compared > 25


def test_a_scan_without_hits_gives_no_circle():
    scans = np.full((2, 1081), np.inf, np.float32)
    scans[1, 500:520] = 4.0
    found = CircleDetector("cnn").detect(scans, SCANNER.bearings())
    assert found.n_hits.tolist() == [0, 20]
    assert np.isnan(np.asarray(found)).all(axis=1).tolist() == [True, False]
    with pytest.raises(InputError, match=r"ranges > 0, got -1\.0"):
        CircleDetector("cnn").detect(np.where(scans == 4.0, -1.0, scans), SCANNER.bearings())
    segments = segment(scans[0], SCANNER.bearings())
    nothing = CircleNetwork("cnn").of_segments(
        scans[0].astype(float), SCANNER.bearings(), segments, config=FitConfig(), scanner=SCANNER
    )
    assert len(nothing) == 0


def test_threads_do_not_matter():
    _, one = detected(ANYWHERE, 36, 500)
    _, two = detected(ANYWHERE, 36, 500, threads=2)
    assert np.allclose(np.asarray(one), np.asarray(two), atol=1e-6)


def test_the_pipeline_maps_circles_by_the_network():
    pipeline = CirclePipeline(CirclesConfig(detector="cnn"))
    config = ANYWHERE.model_copy(update={"draws": 6, "kind": "lattice"})
    samples = make_samples(config, count=6, seed=37, circles=np.array([[3.0, 1.0, 0.3]]))
    for number, scan in enumerate(samples.scans(SCANNER)):
        pipeline.process(scan, np.eye(4), number * 50_000_000)
    found = pipeline.map_at(250_000_000)
    assert np.allclose(found.center, [[3.0, 1.0]], atol=0.02)
    assert np.allclose(found.radius, [0.3], atol=0.02)


def test_the_model_is_small_and_has_its_card():
    cnn = CircleNetwork("cnn")
    assert cnn.path.stat().st_size <= 1_000_000
    assert cnn.card["parameters"] <= 200_000
    assert cnn.card["training"]["network"] == "cnn"
    assert "cnn" in shipped()


def test_a_model_that_is_not_the_one_of_its_card_is_refused(tmp_path):
    for suffix in (".onnx", ".json"):
        shutil.copy(MODELS / f"cnn{suffix}", tmp_path / f"mine{suffix}")
    CircleNetwork(tmp_path / "mine.onnx")  # the content is the shipped model's
    card = json.loads((tmp_path / "mine.json").read_text()) | {"sha256": "0" * 64}
    (tmp_path / "mine.json").write_text(json.dumps(card))
    with pytest.raises(FormatError, match="expected SHA-256 0000"):
        CircleNetwork(tmp_path / "mine.onnx")
    (tmp_path / "mine.json").write_text("[]")
    with pytest.raises(FormatError, match="expected a model card"):
        CircleNetwork(tmp_path / "mine.onnx")
    (tmp_path / "mine.json").unlink()
    assert CircleNetwork(tmp_path / "mine.onnx").card == {}


def test_models_that_are_none_are_refused(tmp_path):
    path = tmp_path / "a.onnx"
    path.write_bytes(b"nonsense")
    with pytest.raises(FormatError, match=r"a\.onnx: expected an ONNX model"):
        CircleDetector(path)
    path.write_bytes(base64.b64decode(IDENTITY))
    with pytest.raises(FormatError, match=r"expected inputs slots .* got {'x': \('n', 3\)}"):
        CircleDetector(path, allow_untrusted=True)
    with pytest.raises(ConfigError, match=r"detector: there is no file '.*b\.onnx'"):
        CircleDetector(tmp_path / "b.onnx")
    with pytest.raises(ConfigError, match="detector"):
        CirclePipeline(CirclesConfig(detector="moon"))


@pytest.mark.parametrize("threads", ["x", 0, -1, 1.5, True, None])
def test_a_network_needs_a_number_of_threads(threads):
    with pytest.raises(ConfigError, match="threads: expected a whole number >= 1, got"):
        CircleDetector("cnn", threads=threads)


@pytest.mark.parametrize(("model", "passes"), [("paper-cnn", 47), ("cnn", 4)])
def test_cards_tell_passes_over_the_data_and_not_parts_of_them(model, passes):
    card = CircleNetwork(model).card
    own = len(card["metrics"]) / card["training"]["parts"]
    assert card["passes"] == passes == own + card.get("start", {}).get("passes", 0)
    assert "epochs" not in card


PAPERS = "1081 rays from -135.0 to 135.0 deg with ranges from 0.1 to 10 m"


def test_paper_mode_uses_the_network_of_the_paper():
    """Sec. IV: the same circles as `detector="paper-cnn"`, and not those of an algebraic fit."""
    assert CirclesConfig.paper().detector == "paper-cnn"
    samples = make_samples(ANYWHERE, count=40, seed=38)
    whole = np.flatnonzero((samples.n_hits >= 10) & samples.is_whole(SCANNER))[:1]
    (scan,) = samples.take(whole).scans(SCANNER)
    frame, fitted = (
        CirclePipeline(CirclesConfig.paper(**changes)).process(scan, np.eye(4), 0)
        for changes in ({}, {"detector": "taubin"})
    )
    expected = CircleDetector("paper-cnn").detect([scan], SCANNER.bearings())
    assert np.allclose(np.asarray(frame.circles), np.asarray(expected), atol=1e-5)
    assert not np.allclose(np.asarray(frame.circles), np.asarray(fitted.circles), atol=1e-5)


@pytest.mark.parametrize(
    ("scanner", "told"),
    [
        (ROUND, "720 rays from -180.0 to 179.5 deg with ranges from 0.1 to 15 m"),
        (SCANNER.model_copy(update={"range_max": 30.0}), "ranges from 0.1 to 30 m"),
        (SCANNER.model_copy(update={"range_min": 0.02}), "ranges from 0.02 to 10 m"),
        (SCANNER.model_copy(update={"angle_min": -2.3}), "1081 rays from -131.8"),
    ],
)
def test_the_network_of_the_paper_refuses_another_scanner(scanner, told):
    for changes, place in (
        ({"scanner": scanner}, "scanner"),
        ({"scanners": {"front": scanner}}, "scanners.front"),
    ):
        with pytest.raises(ConfigError) as caught:
            CirclePipeline(CirclesConfig.paper(**changes))
        text = str(caught.value)
        assert text.startswith(f"{place}: the network paper-cnn was trained for")
        assert PAPERS in text
        assert told in text
        assert "set detector=taubin" in text
        CirclePipeline(CirclesConfig.paper(detector="taubin", **changes))
        CirclePipeline(CirclesConfig(detector="cnn", **changes))


def test_the_network_of_the_paper_takes_a_shorter_range_and_bearings_of_messages():
    message = Scanner(
        float(np.float32(SCANNER.angle_min)),
        float(np.float32(SCANNER.angle_increment)),
        1081,
        float(np.float32(0.1)),
        8.0,
    )
    CirclePipeline(CirclesConfig.paper(scanner=message))


def test_the_network_of_the_paper_refuses_rays_of_another_step():
    bearings = SCANNER.bearings()[::2]
    scan = np.full((1, len(bearings)), np.inf, np.float32)
    scan[0, 250:260] = 4.0
    with pytest.raises(InputError, match=r"bearings: paper-cnn\.onnx .*0\.25 deg; got .* 0\.5 deg"):
        CircleDetector("paper-cnn").detect(scan, bearings)
    part = CircleDetector("paper-cnn").detect(scan[:, 240:270], SCANNER.bearings()[500:530])
    assert np.isfinite(np.asarray(part)).all()
