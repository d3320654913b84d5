"""Units of single columns: range rates that are no m/s, and one length that is no metre."""

import numpy as np
import pytest

from lidar_core.fusion import (
    FusionConfig,
    Measurement,
    TableOptions,
    implausible,
    read_laser_radar,
    read_measurements,
    write_overflight,
)
from lidar_core.fusion.range_rates import rate_repairs
from lidar_core.fusion.repairs import lengths
from lidar_core.sim import Overflight, overfly

RECORDINGS = (
    "fusion/obj_pose-laser-radar-synthetic-input.txt",
    "fusion/sample-laser-radar-measurement-data-1.txt",
)
SPEEDS = {"km/h": 0.2778, "knots": 0.5144, "mph": 0.447, "ft/s": 0.3048}
SEED = 7300


def in_unit(seen, factor):
    """The same with range rates in a unit of this many m/s."""
    return [
        m.with_values([*m.values[:-1], m.values[-1] / factor]) if m.sensor == "radar" else m
        for m in seen
    ]


def driven(speed, noise, *, seed, rate=20, count=300, ranges=True):
    """A target that turns at random; noise of the sensors over that of the configuration."""
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.normal(0, 0.15, count)) + rng.uniform(0, 6)
    velocity = speed * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    place = np.cumsum(velocity, axis=0) / rate + rng.uniform(-20, 20, 2)
    away = np.hypot(*place.T)
    polar = np.stack(
        [away, np.arctan2(*place.T[::-1]), (place * velocity).sum(axis=1) / away], axis=1
    )
    polar += rng.normal(0, noise, polar.shape) * (0.3, 0.03, 0.3)
    found = []
    for k in range(count):
        stamp = round(1e9 * k / rate)
        if k % 2:
            found.append(Measurement(stamp, "lidar", place[k] + rng.normal(0, 0.15 * noise, 2)))
        elif ranges:
            found.append(Measurement(stamp, "radar", polar[k]))
        else:
            found.append(
                Measurement(stamp, "radar", polar[k, 1:], measures=["bearing", "range_rate"])
            )
    return found


@pytest.fixture(params=RECORDINGS)
def right(request, recordings):
    return read_laser_radar(recordings / request.param).measurements


@pytest.mark.parametrize("unit", SPEEDS)
def test_range_rates_in_another_unit_are_refused_with_the_option(right, unit):
    found = implausible(in_unit(right, SPEEDS[unit]))
    told = f'range rates are {unit}: they fit times {SPEEDS[unit]} (scale={{"range_rate": '
    assert found is not None
    assert found.shown == (f"{told}{SPEEDS[unit]}}})",)
    assert found.possible == ()
    assert "less if one mistake is corrected" in str(found)


def test_range_rates_in_another_unit_and_of_the_other_sign_are_named(right):
    (shown,) = implausible(in_unit(right, -SPEEDS["km/h"])).shown
    assert "km/h, positive when the range shrinks" in shown
    assert 'scale={"range_rate": -0.2778}' in shown


def test_distances_of_the_lidar_tell_where_the_radar_has_no_ranges():
    seen = driven(10, 1, seed=SEED, ranges=False)
    assert implausible(seen) is None
    assert 'scale={"range_rate": 0.2778}' in str(implausible(in_unit(seen, SPEEDS["km/h"])))


def test_a_unit_that_is_told_and_wrong_is_to_be_left_out(right):
    told = TableOptions(scale={"range_rate": 0.2778})
    found = implausible(in_unit(right, 1 / 0.2778), options=told)
    assert found.shown == (
        'range rates are m/s: they fit times 3.6 (leave out scale={"range_rate": 0.2778})',
    )
    assert implausible(right, options=told) is None  # the factor made them right


@pytest.mark.parametrize("factor", [1 / 3, 1, 3])
def test_right_range_rates_are_not_doubted_whatever_noise_is_told(right, factor):
    assert rate_repairs(right, TableOptions()) == []
    config = FusionConfig(
        lidar_std=(0.15 / factor,) * 2, radar_std=(0.3 / factor, 0.03 / factor, 0.3 / factor)
    )
    assert implausible(right, config) is None


@pytest.mark.parametrize("noise", [1 / 3, 1, 3])
@pytest.mark.parametrize("speed", [0, 0.3, 2, 20])
def test_simulated_range_rates_are_not_doubted(speed, noise):
    """Targets at rest, too: their range rates are noise, whose unit nothing tells."""
    for seed in range(SEED, SEED + 20):
        for rate in (2, 20):
            seen = driven(speed, noise, seed=seed, rate=rate)
            assert rate_repairs(seen, TableOptions()) == []


def test_the_right_unit_is_among_those_that_are_named():
    found = 0
    for seed in range(SEED, SEED + 20):
        seen = in_unit(driven(5, 1, seed=seed), SPEEDS["km/h"])
        texts = [text for text, _ in rate_repairs(seen, TableOptions())]
        assert not texts or any("km/h" in text for text in texts)
        found += bool(texts)
    assert found >= 19


def test_range_rates_from_a_platform_that_moves_are_not_doubted(tmp_path):
    write_overflight(tmp_path / "drone.csv", overfly(Overflight(), seed=1))
    seen = read_measurements(tmp_path / "drone.csv").measurements
    assert rate_repairs(seen, TableOptions()) == []
    found = implausible(in_unit(seen, SPEEDS["km/h"]))
    assert 'scale={"range_rate": 0.2778}' in str(found)


# Lengths


@pytest.mark.parametrize(
    ("column", "size", "unit"),
    [("x", 0.01, "centimetres"), ("y", 0.01, "centimetres"), ("y", 0.3048, "feet")],
)
def test_one_column_of_a_place_in_another_unit_is_named(right, column, size, unit):
    factors = 1 / np.array([size if name == column else 1.0 for name in "xy"])
    seen = [m.with_values(factors * m.values) if m.sensor == "lidar" else m for m in right]
    found = implausible(seen)
    assert found.shown == (
        f"{column} of the LiDAR alone is in {unit}: it fits times {size}"
        f' (scale={{"{column}": {size}}})',
    )


def test_all_columns_of_a_place_in_another_unit_are_named_together(right):
    seen = [m.with_values(100 * m.values) if m.sensor == "lidar" else m for m in right]
    (shown,) = implausible(seen).shown
    assert "places of the LiDAR are centimetres" in shown


def test_a_column_is_named_as_the_table_names_it_where_x_and_y_are_exchanged():
    place = Measurement(0, "lidar", [2.0, 3.0])
    for azimuth, expected in ({}, [2.0, 0.03]), ({"lidar": "compass"}, [0.02, 3.0]):
        (change,) = [
            change
            for _, text, change in lengths(TableOptions(azimuth=azimuth))
            if "y of the LiDAR alone is in centimetres" in text
        ]
        assert change(place).values.tolist() == pytest.approx(expected)


# How it is said


def test_causes_that_fit_equally_well_are_told_as_alternatives(right):
    """Sensors that stand still: a mirrored LiDAR and a mirrored radar look the same."""
    seen = [m.with_values([m.values[0], -m.values[1]]) if m.sensor == "lidar" else m for m in right]
    text = str(implausible(seen))
    assert "The data shows: either " in text
    assert ", or " in text
    assert text.endswith(": the data cannot tell which")
    assert "ikely" not in text  # no list of other causes beside those that the data shows
    assert "would still be accepted" in text


def test_without_a_cause_the_likely_ones_name_the_factor_of_a_column(right):
    found = implausible(right, FusionConfig(lidar_std=(1e-4, 1e-4), radar_std=(1e-4, 1e-5, 1e-3)))
    assert found.shown == ()
    assert 'a column in another unit, of lengths or speeds (scale={"COLUMN": FACTOR})' in str(found)
