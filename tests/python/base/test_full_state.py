"""Saved states: what was saved goes on to the same bits; nothing else is accepted."""

import copy
import pickle
import struct
import subprocess
import sys
import zlib

import numpy as np
import pytest

import lidar_core as lc
from lidar_core.errors import ConfigError, FormatError

FILTERS = [
    {"model": "cv", "method": "kf"},
    {"model": "ca"},
    {"model": "ct", "method": "ukf"},
    {"model": "ctrv"},
    {"model": "ctra", "method": "ckf"},
    {"model": "ctrv-drone"},
    {"method": "imm"},
    {"model": "paper"},
    {"model": "ctrv", "buffer_time": 1.0},
]


def fusion_config(values):
    return lc.fusion.FusionConfig(**values)


def measurements(count=60, seed=0):
    rng = np.random.default_rng(seed)
    made = []
    for k in range(count):
        x, y = 5 + 0.1 * k, 3 - 0.05 * k
        noise = rng.normal(0, 0.05, 3)
        if k % 2:
            values = [np.hypot(x, y) + noise[0], np.arctan2(y, x) + 0.1 * noise[1], noise[2]]
            made.append(lc.fusion.Measurement(k * 50_000_000, "radar", values))
        else:
            made.append(
                lc.fusion.Measurement(k * 50_000_000, "lidar", np.array([x, y]) + noise[:2])
            )
    return made


def run(flt, rows):
    """Bits of what the filter says about each row."""
    out = []
    for m in rows:
        step = flt.step(m)
        out.append(
            (
                step.outcome,
                None if step.state is None else step.state.tobytes(),
                None if step.state is None else step.covariance.tobytes(),
            )
        )
    return out


def ways(thing, folder):
    """The object again, by every way there is."""
    thing.save(folder / "state")
    yield type(thing).load(folder / "state")
    yield type(thing).from_bytes(thing.to_bytes())
    yield copy.copy(thing)
    yield copy.deepcopy(thing)
    yield pickle.loads(pickle.dumps(thing))


@pytest.mark.parametrize("values", FILTERS, ids=str)
def test_a_filter_goes_on_to_the_same_bits(values, tmp_path):
    rows = measurements()
    flt = lc.fusion.TargetFilter(fusion_config(values))
    run(flt, rows[:30])
    again = list(ways(flt, tmp_path))
    expected = run(flt, [*rows[30:40], rows[35], rows[38], *rows[40:]])  # some are duplicates
    for other in again:
        assert run(other, [*rows[30:40], rows[35], rows[38], *rows[40:]]) == expected
    assert expected[0][1] is not None


def test_a_late_measurement_after_loading_is_put_where_it_belongs(tmp_path):
    rows = measurements()
    flt = lc.fusion.TargetFilter(lc.fusion.FusionConfig(buffer_time=1.0))
    run(flt, rows[:25] + rows[26:30])
    for other in ways(flt, tmp_path):
        assert run(other, [rows[25], rows[30]]) == run(copy.copy(flt), [rows[25], rows[30]])
    assert run(flt, [rows[25]])[0][0] == "updated"


def test_a_copy_is_on_its_own():
    rows = measurements()
    flt = lc.fusion.TargetFilter()
    run(flt, rows[:20])
    before = flt.to_bytes()
    run(copy.copy(flt), rows[20:])
    assert flt.to_bytes() == before


def scans(count=20):
    rng = np.random.default_rng(3)
    for k in range(count):
        stamp = k * 100_000_000
        places = [(3 + 0.1 * k, 2.0), (8.0, -1 + 0.1 * k), tuple(rng.uniform(-9, 9, 2))]
        yield stamp, [lc.fusion.Measurement(stamp, "lidar", place) for place in places]


def tracks_of(tracker, made, source):
    out = []
    for stamp, scan in made:
        result = tracker.process(stamp, scan, source=source)
        tracks = tracker.tracks_at(stamp, confirmed=False)
        parts = (result.id, result.nis, tracks.id, tracks.states, tracks.covariances, tracks.hits)
        out.append([part.tobytes() for part in parts])
    return out


@pytest.mark.parametrize("association", ["integrated", "nearest", "joint"])
def test_many_targets_go_on_to_the_same_bits(association, tmp_path):
    made = list(scans())
    config = lc.fusion.MultiTargetConfig(
        association=association, target=lc.fusion.FusionConfig(buffer_time=0.5)
    )
    tracker = lc.fusion.MultiTargetTracker(config)
    tracks_of(tracker, made[:9] + made[10:12], "first")
    again = list(ways(tracker, tmp_path))
    rest = [made[9], *made[12:]]  # one comes late
    expected = tracks_of(tracker, rest, "second")
    for other in again:
        assert tracks_of(other, rest, "second") == expected


def sweeps(count=40):
    """Ranges of a scanner that passes two posts, one of which moves."""
    scanner = lc.circles.Scanner(-1.5, 0.01, 301, 0.1, 10.0)
    bearings, rng = scanner.bearings(), np.random.default_rng(1)
    for k in range(count):
        ranges = np.full(len(bearings), np.inf)
        for x, y, radius in ((4.0, 0.05 * k - 1, 0.3), (3.0, 1.5, 0.2)):
            aside = np.hypot(x, y) * np.sin(bearings - np.arctan2(y, x))
            root = np.sqrt(np.maximum(radius**2 - aside**2, 0))
            along = np.hypot(x, y) * np.cos(bearings - np.arctan2(y, x)) - root
            ranges = np.where(abs(aside) < radius, np.minimum(ranges, along), ranges)
        yield scanner, ranges + rng.normal(0, 0.01, len(ranges)), k * 50_000_000


def map_bits(pipeline, stamp):
    found, shapes = pipeline.map_at(stamp), pipeline.shapes_at(stamp)
    return [found.id.tobytes(), found.center.tobytes(), found.covariance.tobytes(), len(shapes.id)]


@pytest.mark.parametrize("mode", ["best", "paper filter", "late scans"])
def test_a_pipeline_of_circles_goes_on_to_the_same_bits(mode, tmp_path):
    made = list(sweeps())
    scanner = made[0][0]
    config = {
        "best": lc.circles.CirclesConfig(scanner=scanner),
        "paper filter": lc.circles.CirclesConfig(
            scanner=scanner, map=lc.circles.CircleMapConfig.paper()
        ),
        "late scans": lc.circles.CirclesConfig(
            scanner=scanner, map=lc.circles.CircleMapConfig(buffer_time=0.5)
        ),
    }[mode]
    late = mode == "late scans"
    pipeline = lc.circles.CirclePipeline(config)
    names = ["front", "rear"]
    for k, (_, ranges, stamp) in enumerate(made[:20]):
        if not (late and k == 18):
            pipeline.process(ranges, np.eye(4), stamp, scanner=names[k % 2])
    again = list(ways(pipeline, tmp_path))
    assert len(pipeline.map_at(made[19][2]).id)
    rest = [(k, *made[k][1:]) for k in ([18] if late else []) + list(range(20, 40))]

    def go_on(one):
        bits = []
        for k, ranges, stamp in rest:
            one.process(ranges, np.eye(4), stamp, scanner=names[k % 2])
            bits.append(map_bits(one, made[-1][2]))
        return bits, one.health()

    expected = go_on(pipeline)
    assert all(go_on(other) == expected for other in again)


@pytest.mark.parametrize(
    "config", [lc.circles.CircleMapConfig(), lc.circles.CircleMapConfig.paper()]
)
def test_a_map_of_circles_goes_on_to_the_same_bits(config, tmp_path):
    def update(circles, k):
        rows = [[3 + 0.05 * k, 0.0, 0.3], [0.0, 2.0 - 0.02 * k, 0.2]]
        circles.update(rows, [1e-4 * np.eye(3)] * 2, np.eye(4), k * 50_000_000)
        found = circles.map_at(k * 50_000_000)
        return found.id.tobytes() + found.center.tobytes() + found.covariance.tobytes()

    circles = lc.circles.CircleMap(config)
    for k in range(15):
        update(circles, k)
    again = list(ways(circles, tmp_path))
    expected = [update(circles, k) for k in range(15, 30)]
    assert len(circles.map_at(0).id) == 2
    for other in again:
        assert [update(other, k) for k in range(15, 30)] == expected


def sample():
    flt = lc.fusion.TargetFilter()
    run(flt, measurements(10))
    return flt.to_bytes()


def sealed(body):
    return body + struct.pack("<I", zlib.crc32(body))


def test_every_cut_and_every_damaged_byte_is_refused():
    content = sample()
    for length in range(len(content)):
        with pytest.raises(FormatError):
            lc.fusion.TargetFilter.from_bytes(content[:length])
    for place in range(len(content)):
        damaged = bytearray(content)
        damaged[place] ^= 0x41
        with pytest.raises(FormatError):
            lc.fusion.TargetFilter.from_bytes(bytes(damaged))


def test_damage_with_a_right_checksum_is_typed():
    """Whoever writes a file by hand gets an error or a filter, nothing else."""
    content, rng = sample(), np.random.default_rng(0)
    refused = 0
    for _ in range(300):
        damaged = bytearray(content[:-4])
        damaged[rng.integers(len(damaged))] = rng.integers(256)
        try:
            flt = lc.fusion.TargetFilter.from_bytes(sealed(bytes(damaged)))
        except (FormatError, ConfigError):
            refused += 1
        else:
            run(flt, measurements(3))
    assert refused > 250  # the core has a checksum of its own


def test_errors_name_the_file_and_the_kind(tmp_path):
    path = tmp_path / "tracker"
    lc.fusion.MultiTargetTracker().save(path)
    with pytest.raises(
        FormatError, match=r"tracker.*TargetFilter, got that of a MultiTargetTracker"
    ):
        lc.fusion.TargetFilter.load(path)
    path.write_bytes(b"LCVM and more")
    with pytest.raises(FormatError, match="byte 0: expected a saved state"):
        lc.fusion.TargetFilter.load(path)


def test_nothing_is_pickled_inside():
    """Pickle's own bytes hold ours; ours hold no pickle."""
    content = sample()
    assert content in pickle.dumps(lc.fusion.TargetFilter.from_bytes(content))
    assert not any(content[at:].startswith(b"\x80\x04\x95") for at in range(len(content)))


def test_a_pipeline_with_an_estimator_is_not_loaded_without_one(tmp_path):
    def estimator(ranges, bearings, segments):
        raise AssertionError("not called here")

    pipeline = lc.circles.CirclePipeline(estimator=estimator)
    pipeline.save(tmp_path / "state")
    with pytest.raises(ConfigError, match="pass it again"):
        lc.circles.CirclePipeline.load(tmp_path / "state")
    lc.circles.CirclePipeline.load(tmp_path / "state", estimator=estimator)


def test_a_source_is_a_name():
    tracker = lc.fusion.MultiTargetTracker()
    with pytest.raises(lc.errors.InputError, match="source: expected a name, got int"):
        tracker.process(0, [], source=0)


def test_other_content_and_unknown_arguments_are_refused():
    for content in (None, 3, "text"):
        with pytest.raises(lc.errors.InputError, match="content: expected bytes"):
            lc.fusion.TargetFilter.from_bytes(content)
    assert lc.fusion.TargetFilter.from_bytes(bytearray(sample())).to_bytes() == sample()
    with pytest.raises(TypeError, match="no argument 'threads'"):
        lc.fusion.TargetFilter.from_bytes(sample(), threads=2)


@pytest.mark.skipif(sys.platform != "linux", reason="limits as on Linux")
def test_a_small_state_needs_little_memory_to_load(tmp_path):
    lc.fusion.TargetFilter().save(tmp_path / "state")
    program = (
        "import resource, sys, lidar_core as lc; lc.fusion.TargetFilter\n"
        "resource.setrlimit(resource.RLIMIT_AS, (2**31, 2**31))\n"
        "lc.fusion.TargetFilter.load(sys.argv[1])"
    )
    subprocess.run([sys.executable, "-c", program, str(tmp_path / "state")], check=True)
