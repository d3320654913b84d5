"""Samples and datasets of single circles."""

import json
import math
from dataclasses import fields

import numpy as np
import pytest

from lidar_core.circles import DatasetConfig, Samples, Scanner, dataset, make_samples
from lidar_core.errors import ConfigError, FormatError, InputError
from reference import circle_scan

SMALL = DatasetConfig.continuous(circles=3000).model_copy(update={"shard_size": 1024})
QUIET = SMALL.model_copy(update={"range_std": (0.0, 0.0)})


def same(first, second):
    return all(
        np.array_equal(getattr(first, f.name), getattr(second, f.name)) for f in fields(Samples)
    )


@pytest.mark.parametrize(
    "scanner",
    [Scanner(), Scanner(0.0, math.radians(1), 360, 0.1, 12.0), Scanner(3.0, -0.005, 900, 0.3, 8.0)],
)
def test_scans_are_those_of_the_oracle(scanner):
    config = QUIET.model_copy(update={"scanner": scanner})
    samples = make_samples(config, count=500, seed=11)
    scans = samples.scans(scanner)
    for circle, scan in zip(samples.circles.astype(float), scans, strict=True):
        expected = circle_scan.ranges(
            circle, scanner.bearings(), scanner.range_min, scanner.range_max
        )
        both = np.isfinite(scan) & np.isfinite(expected)
        assert np.abs(scan[both] - expected[both]).max(initial=0.0) < 1e-3  # steep at the flanks
        # float32 circles: rays that just touch may differ
        assert (np.isfinite(scan) != np.isfinite(expected)).sum() <= 2


def test_noise_has_the_deviation_that_was_asked_for():
    noisy = QUIET.model_copy(update={"range_std": (0.02, 0.02)})
    quiet = make_samples(QUIET, count=2000, seed=12)
    loud = make_samples(noisy, count=2000, seed=12)
    assert np.array_equal(quiet.circles, loud.circles)
    hits = np.isfinite(quiet.ranges)
    noise = (loud.ranges - quiet.ranges)[hits].astype(float)
    error = 1 / math.sqrt(2 * hits.sum())  # of a standard deviation
    assert abs(noise.std() / 0.02 - 1) < 4 * error
    assert abs(noise.mean()) < 4 * 0.02 / math.sqrt(hits.sum())


def test_hidden_parts_are_no_information_beside_the_window():
    config = QUIET.model_copy(update={"occluded_share": 1.0})
    samples = make_samples(config, count=300, seed=13)
    hidden = samples.sides == 1
    scans = samples.scans(config.scanner)
    assert 0.9 < hidden.any(axis=1).mean() <= 1.0
    assert np.isnan(scans).sum() == hidden.sum()


def test_samples_taken_are_the_samples():
    samples = make_samples(SMALL, count=50, seed=14)
    numbers = np.array([7, 3, 49])
    scans = samples.scans(SMALL.scanner)
    assert np.array_equal(samples.take(numbers).scans(SMALL.scanner), scans[numbers])
    assert np.array_equal(samples.n_hits, np.isfinite(scans).sum(axis=1))


def test_a_dataset_is_the_same_made_at_once_or_in_parts(tmp_path):
    whole = dataset.generate(SMALL, tmp_path / "whole", seed=5, threads=2)

    def stop(done, total):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        dataset.generate(SMALL, tmp_path / "parts", seed=5, on_shard=stop)
    assert not dataset.open_dataset(tmp_path / "parts").is_complete
    with pytest.raises(FormatError, match="the dataset is incomplete"):
        dataset.open_dataset(tmp_path / "parts").read()
    parts = dataset.generate(SMALL, tmp_path / "parts", seed=5)
    assert len(parts.shards) == 3
    assert same(whole.read(), parts.read())
    assert same(whole.read(), make_samples(SMALL, count=3000, seed=5))
    for name in parts.shards:
        assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "parts" / name).read_bytes()


def test_a_damaged_shard_is_found_and_made_again(tmp_path):
    made = dataset.generate(SMALL, tmp_path, seed=5)
    shard = tmp_path / made.shards[1]
    content = shard.read_bytes()
    shard.write_bytes(content[:-1000] + bytes(1000))
    with pytest.raises(FormatError, match=r"shard-00001.npz: expected SHA-256"):
        dataset.open_dataset(tmp_path, verify=True)
    dataset.generate(SMALL, tmp_path, seed=5)
    assert shard.read_bytes() == content


def test_another_dataset_is_never_mixed_in(tmp_path):
    dataset.generate(SMALL, tmp_path, seed=5)
    with pytest.raises(ConfigError, match="another configuration or seed"):
        dataset.generate(SMALL, tmp_path, seed=6)
    with pytest.raises(FormatError, match="no such file"):
        dataset.open_dataset(tmp_path / "nothing")
    (tmp_path / "dataset.json").write_text(json.dumps({"format": 99}))
    with pytest.raises(FormatError, match="expected format 1, got 99"):
        dataset.open_dataset(tmp_path)


def test_parts_are_disjoint_and_of_the_published_shares(tmp_path):
    made = dataset.generate(SMALL, tmp_path, seed=5)
    parts = [made.numbers(part) for part in ("train", "validation", "test")]
    assert [len(part) for part in parts] == [1920, 480, 600]
    assert np.array_equal(np.sort(np.concatenate(parts)), made.numbers("all"))
    assert len(made.read("test")) == 600


def test_table_2_has_the_published_counts():
    published = dataset.CircleDataset(None, DatasetConfig(), 0, 2_011_494, ())
    counts = [len(published.numbers(part)) for part in ("train", "validation", "test")]
    assert counts == [1_287_356, 321_839, 402_299]


def test_draws_of_one_circle_stay_together_if_asked_to():
    config = DatasetConfig(split_by="circle")
    numbers = dataset.CircleDataset(None, config, 0, 1000, ()).numbers("test")
    assert np.array_equal(numbers[1::2], numbers[::2] + 1)
    assert (numbers[::2] % 2 == 0).all()


def test_the_lattice_holds_the_circles_that_are_seen():
    config = DatasetConfig(reach=1.0, spacing=0.25, radius=(0.1, 0.3), radius_step=0.1)
    circles = dataset.lattice(config)
    scanner = config.scanner
    grid = np.arange(-4, 5) * 0.25
    expected = [
        (x, y, radius)
        for radius in (0.1, 0.2, 0.3)
        for x in grid
        for y in grid
        if math.hypot(x, y) > radius
        and np.isfinite(circle_scan.ranges((x, y, radius), scanner.bearings(), 0.1, 10.0)).any()
    ]
    assert np.allclose(circles, expected)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"radius": (0.5, 0.1)}, "radius"),
        ({"range_std": (0.02, 0.01)}, "range_std"),
        ({"validation_share": 0.6, "test_share": 0.4}, "< 1"),
        ({"kind": "continuous", "draws": 2}, "draws = 1"),
    ],
)
def test_configurations_that_mean_nothing_are_refused(changes, text):
    with pytest.raises(ConfigError, match=text):
        DatasetConfig(**changes)


def test_a_circle_that_is_not_seen_is_refused():
    with pytest.raises(InputError, match=r"circles\[1\]: expected a circle that the scanner sees"):
        make_samples(
            DatasetConfig(), count=4, seed=0, circles=np.array([[5.0, 0, 0.3], [-5.0, 0, 0.3]])
        )


def test_a_shard_whose_columns_do_not_fit_together_is_refused(tmp_path):
    config = DatasetConfig(kind="continuous", circles=20, draws=1)
    dataset.generate(config, tmp_path, seed=1)
    (path,) = tmp_path.glob("*.npz")
    with np.load(path) as shard:
        good = dict(shard)
    broken = {
        "circles": good["circles"][:, :2],
        "n_rays": good["n_rays"][:, None].repeat(2, axis=1),
        "first_ray": good["first_ray"] + np.uint32(100_000),
        "ranges": good["ranges"][:-1],
        "sides": good["sides"] + np.uint8(9),
        "range_std": good["range_std"].astype(np.float64),
    }
    for name, values in broken.items():
        np.savez(path, **{**good, name: values})
        with pytest.raises(FormatError, match=r"shard-00000\.npz"):
            dataset.open_dataset(tmp_path).read()
    np.savez(path, **{name: values[:-1] for name, values in good.items()})
    with pytest.raises(FormatError, match=r"shard-00000\.npz"):
        dataset.open_dataset(tmp_path).read()
    np.savez(path, **good)
    assert len(dataset.open_dataset(tmp_path).read()) == 20


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *[("samples", "9"), ("samples", -1), ("samples", 10**12), ("seed", None)],
        *[("shards", []), ("shards", {"../shard-00000.npz": ""}), ("config", 3)],
    ],
)
def test_a_note_of_a_dataset_with_wrong_values_is_refused(tmp_path, name, value):
    dataset.generate(DatasetConfig(kind="continuous", circles=20, draws=1), tmp_path, seed=1)
    note = json.loads((tmp_path / "dataset.json").read_text())
    (tmp_path / "dataset.json").write_text(json.dumps(note | {name: value}))
    with pytest.raises(FormatError, match=r"dataset\.json"):
        dataset.open_dataset(tmp_path)


def test_a_scanner_that_turns_more_than_once_is_refused():
    with pytest.raises(ConfigError, match=r"at most one turn in all, got a sweep of 12\.53 rad"):
        Scanner(0.0, math.radians(2), 360, 0.1, 12.0)
