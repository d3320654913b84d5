"""`fuse` on measurements that cannot be what it takes them for: refused, with what is wrong."""

import csv
import subprocess
import sys

import numpy as np
import pytest

import lidar_core as lc
from lidar_core.errors import ConfigError, InputError
from lidar_core.estimation import chi2_quantile
from lidar_core.fusion import (
    FusionConfig,
    Measurement,
    TableOptions,
    read_autoferry,
    read_laser_radar,
    read_measurements,
    write_overflight,
)
from lidar_core.fusion.places import geographic_poses
from lidar_core.fusion.plausibility import (
    FACTOR,
    KEPT,
    KEPT_SPREAD,
    KEPT_SUM,
    PROBABILITY,
    implausible,
)
from lidar_core.fusion.repairs import lengths, repairs
from lidar_core.sim import Overflight, overfly

OBJ_POSE = "fusion/obj_pose-laser-radar-synthetic-input.txt"
SAMPLE_1 = "fusion/sample-laser-radar-measurement-data-1.txt"
SCENARIOS = (2, 3, 4, 5, 13, 17)
SEED = 6300
WAYS = (None, "clockwise", "compass")


def changed(seen, sensor, new):
    return [
        Measurement(m.stamp_ns, m.sensor, new(m.values), m.covariance) if m.sensor == sensor else m
        for m in seen
    ]


def geographic(place):
    """Metres east and north as latitude and longitude."""
    return [59.3 + place[1] / 111_200, 10.7 + place[0] / 56_800]


def beside(m, offset):
    """The same measurement of a target that is this far beside."""
    if m.sensor not in ("lidar", "radar"):
        return m
    if m.sensor == "lidar":
        return Measurement(m.stamp_ns, "lidar", m.values + offset, m.covariance)
    distance, bearing, rate = m.values
    x, y = distance * np.array([np.cos(bearing), np.sin(bearing)]) + offset
    return Measurement(m.stamp_ns, "radar", [np.hypot(x, y), np.arctan2(y, x), rate], m.covariance)


def mixed(seen):
    """Two targets, 6 m apart, one or the other at every time."""
    rng = np.random.default_rng(SEED)
    return [beside(m, np.array([5.0, 3.3]) * (rng.random() < 0.5)) for m in seen]


def late(seen, sensor, seconds):
    """The same with a clock of one sensor that is ahead, in the order of its times."""
    ahead = round(seconds * 1e9)
    moved = [
        m.with_values(m.values, stamp_ns=m.stamp_ns + ahead * (m.sensor == sensor)) for m in seen
    ]
    return sorted(moved, key=lambda m: m.stamp_ns)


WRONG = {
    "clockwise bearings": (
        lambda seen: changed(seen, "radar", lambda v: [v[0], -v[1], v[2]]),
        "bearings are clockwise",
    ),
    "compass bearings": (
        lambda seen: changed(seen, "radar", lambda v: [v[0], np.pi / 2 - v[1], v[2]]),
        "compass",
    ),
    "degrees": (
        lambda seen: changed(seen, "radar", lambda v: [v[0], np.degrees(v[1]), v[2]]),
        "bearings are degrees",
    ),
    "mirrored": (lambda seen: changed(seen, "lidar", lambda v: [v[0], -v[1]]), "mirrored"),
    "geographic": (lambda seen: changed(seen, "lidar", geographic), "latitude and longitude"),
    "geographic, LiDAR alone": (
        lambda seen: changed(
            [m for m in seen if m.sensor in ("lidar", "pose")], "lidar", geographic
        ),
        "latitude and longitude",
    ),
    "exchanged": (lambda seen: changed(seen, "lidar", lambda v: v[::-1]), "exchanged"),
    "feet": (
        lambda seen: changed(seen, "radar", lambda v: [v[0] / 0.3048, v[1], v[2]]),
        'ranges are feet: they fit times 0.3048 (scale={"range": 0.3048})',
    ),
    "millimetres": (
        lambda seen: changed(seen, "lidar", lambda v: 1000 * v),
        "places of the LiDAR are millimetres",
    ),
    "kilometres": (
        lambda seen: changed(seen, "lidar", lambda v: v / 1000),
        "places of the LiDAR are kilometres: they fit times 1000"
        ' (scale={"x": 1000, "y": 1000}; a column z likewise)',
    ),
    "late radar": (
        lambda seen: late(seen, "radar", 1.0),
        r'the radar is 1 s ahead of the others (clock={"radar": 1})',
    ),
    "late LiDAR": (lambda seen: late(seen, "lidar", 1.0), 'clock={"radar": -1}'),
    "several": (mixed, "several targets in one table"),
}
"""How a recording goes wrong, and what has to be said of it."""


def doubt(seen, config=None):
    config = config or FusionConfig()
    return implausible(seen, config)


def overflight(folder, seed):
    write_overflight(folder / "drone.csv", overfly(Overflight(), seed=seed))
    return read_measurements(folder / "drone.csv").measurements


@pytest.fixture(params=[OBJ_POSE, SAMPLE_1, "overflight 1", "overflight 2"])
def right(request, recordings, tmp_path):
    """Measurements as they should be."""
    if request.param.startswith("overflight"):
        return overflight(tmp_path, int(request.param[-1]))
    return read_laser_radar(recordings / request.param).measurements


def boats(recordings, number):
    """What was seen of each boat of an Autoferry scenario, nearest to the truth."""
    path = recordings / "2d/autoferry" / f"scenario{number}" / f"scenario{number}_detections.json"
    scans = read_autoferry(path)
    found = {}
    for scan in scans:
        for boat, place in scan.truth.items():
            far = [float(np.linalg.norm(m.values - place)) for m in scan.measurements]
            if far and min(far) < 15:
                found.setdefault(boat, []).append(scan.measurements[int(np.argmin(far))])
    return found, [m for scan in scans for m in scan.measurements]


# Right recordings


@pytest.mark.parametrize("model", ["cv", "ca", "ct", "ctrv", "ctra"])
def test_right_recordings_are_not_refused_with_any_model(right, model):
    assert doubt(right, FusionConfig(model=model)) is None


@pytest.mark.parametrize("method", ["ukf", "ckf", "imm"])
def test_right_recordings_are_not_refused_with_any_method(right, method):
    assert doubt(right, FusionConfig(method=method)) is None


@pytest.mark.parametrize("factor", [1 / 10, 1 / 3, 1 / 2, 2, 3])
def test_noise_may_be_told_three_times_too_small_or_ten_times_too_large(right, factor):
    config = FusionConfig(
        lidar_std=(0.15 / factor,) * 2, radar_std=(0.3 / factor, 0.03 / factor, 0.3 / factor)
    )
    assert doubt(right, config) is None


def test_dropouts_single_sensors_and_false_measurements_are_not_refused(right):
    rng = np.random.default_rng(SEED)
    assert doubt([m for k, m in enumerate(right) if (k // 60) % 3]) is None
    assert doubt([m for k, m in enumerate(right) if not 100 < k < 250]) is None
    for sensor in ("lidar", "radar"):
        assert doubt([m for m in right if m.sensor in (sensor, "pose")]) is None
    false = [beside(m, rng.normal(0, 20, 2) * (rng.random() < 0.1)) for m in right]
    assert doubt(false) is None


@pytest.mark.parametrize("number", SCENARIOS)
def test_boats_are_not_refused_and_all_of_them_in_one_table_are(recordings, number):
    of_boats, everything = boats(recordings, number)
    for seen in of_boats.values():
        for model in ("cv", "ctrv"):
            assert doubt(seen, FusionConfig(model=model)) is None
        one = doubt(changed(seen, "lidar", geographic))
        assert "latitude and longitude" in one.shown[0]
    assert any("several targets" in text for text in doubt(everything).shown)


def test_a_recording_without_noise_and_one_at_rest_are_not_refused():
    straight = [Measurement(k * 50_000_000, "lidar", [0.1 * k, 2.0]) for k in range(200)]
    rest = [Measurement(k * 50_000_000, "lidar", [59.3, 10.7]) for k in range(200)]
    assert doubt(straight) is None
    assert doubt(rest) is None


def test_the_published_model_and_short_recordings_are_not_judged(right):
    assert doubt(right, FusionConfig.paper()) is None
    wrong = WRONG["several"][0]([m for m in right if m.sensor == "lidar"])
    assert doubt(wrong[:20]) is None  # 19 are compared: the first one starts the filter
    assert doubt(wrong[:60]) is not None


def test_the_limit_is_not_passed_by_noise_three_times_too_large():
    """200,000 recordings of the shortest length and 20,000 longer ones, for 1 to 3 values."""
    rng = np.random.default_rng(SEED)
    for degrees in (1, 2, 3):
        for count, runs in ((20, 200_000), (200, 20_000)):
            nis = np.sort(FACTOR**2 * rng.chisquare(degrees, (runs, count)), axis=1)
            kept = nis[:, : round(KEPT * count)].sum(axis=1)
            effective = int(count * degrees / KEPT_SPREAD)
            limit = FACTOR**2 * chi2_quantile(1 - PROBABILITY, degrees=effective) / effective
            assert (kept / KEPT_SUM / (count * degrees) < limit).all()
            assert (kept / nis.sum(axis=1)).mean() < KEPT_SUM
            assert kept.var() / kept.mean() ** 2 < KEPT_SPREAD * 2 / (count * degrees)


# Wrong ones


@pytest.mark.ci_cases("overflight 2-*", "*sample*-late*", "*sample*-mirrored", "*obj_pose*-several")
@pytest.mark.parametrize("name", WRONG)
def test_wrong_recordings_are_refused_with_the_cause_that_the_data_shows(right, name):
    change, cause = WRONG[name]
    found = doubt(change(right))
    assert found is not None
    assert any(cause in text for text in found.shown), found
    assert cause in str(found)
    if name != "several":
        assert not any("several" in text for text in found.shown)  # angles explain the jumps


def test_range_rates_of_the_other_sign_are_named_with_the_option(recordings):
    right = read_laser_radar(recordings / SAMPLE_1).measurements  # it moves fast enough to tell
    found = doubt(changed(right, "radar", lambda v: [v[0], v[1], -v[2]]))
    assert '(scale={"range_rate": -1})' in str(found)


AS_TOLD = [(unit, way) for unit in ("rad", "deg") for way in WAYS]


@pytest.mark.parametrize("told", AS_TOLD)
@pytest.mark.parametrize("right", AS_TOLD)
def test_a_convention_that_is_told_wrongly_does_not_hide_the_right_one(
    recordings, tmp_path, right, told
):
    """Every unit and direction, told as any other; told rightly, nothing is refused."""
    unit, way = right
    sign, start = (1 if way is None else -1), np.pi / 2 * (way == "compass")
    scale = 180 / np.pi if unit == "deg" else 1.0
    seen = changed(
        read_laser_radar(recordings / SAMPLE_1).measurements[:400],
        "radar",
        lambda v: [v[0], scale * (start + sign * v[1]), v[2]],
    )
    azimuth = {} if told[1] is None else {"bearing": told[1]}
    options = TableOptions(angle_unit=told[0], azimuth=azimuth)
    log = read_measurements(table(tmp_path / "told.csv", seen), options)
    found = implausible(log.measurements, FusionConfig(), log.options)
    if told == right:
        assert found is None
        return
    (bearings,) = [text for text in found.shown if text.startswith("bearings are")]
    assert (f'angle_unit="{unit}"' in bearings) == (unit != told[0])
    if way is None and told[1] is not None:
        assert f'leave out azimuth={{"bearing": "{told[1]}"}}' in bearings
    else:
        assert (f'azimuth={{"bearing": "{way}"}}' in bearings) == (way != told[1])


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("told", WAYS[1:])
def test_places_and_turn_rates_that_are_told_wrongly_are_named(recordings, tmp_path, way, told):
    new = {None: lambda v: v, "clockwise": lambda v: [v[0], -v[1]], "compass": lambda v: v[::-1]}
    right = read_laser_radar(recordings / SAMPLE_1).measurements[:400]
    path = table(tmp_path / "told.csv", changed(right, "lidar", new[way]))
    log = read_measurements(path, TableOptions(azimuth={"lidar": told}))
    found = implausible(log.measurements, FusionConfig(), log.options)
    if way == told:
        assert found is None
    else:
        shown = f'leave out azimuth={{"lidar": "{told}"}}' if way is None else f'"lidar": "{way}"'
        assert shown in str(found)
    rates = [text for _, text, _ in repairs(TableOptions(azimuth={"turn_rate": told}))]
    assert any(f'leave out azimuth={{"turn_rate": "{told}"}}' in text for text in rates)


@pytest.mark.parametrize(
    ("ahead", "cure"),
    [(0.0, 'leave out clock={"radar": 1}'), (2.0, '2 s ahead of the others (clock={"radar": 2})')],
)
def test_a_clock_that_is_told_wrongly_is_named_by_its_whole_offset(
    recordings, tmp_path, ahead, cure
):
    seen = late(read_laser_radar(recordings / SAMPLE_1).measurements[:400], "radar", ahead)
    options = TableOptions(clock={"radar": 1.0})
    log = read_measurements(table(tmp_path / "late.csv", seen), options)
    ordered = sorted(log.measurements, key=lambda m: m.stamp_ns)
    assert cure in str(implausible(ordered, FusionConfig(), log.options))


def test_factors_are_named_together_with_those_that_were_told():
    texts = [text for _, text, _ in lengths(TableOptions(scale={"range": 10.0, "x": 2.0}))]
    assert any('scale={"range": 0.01}' in text for text in texts)
    assert any('scale={"x": 0.002, "y": 0.001}' in text for text in texts)


def test_noise_far_too_small_is_refused_and_all_likely_causes_are_named(right):
    config = FusionConfig(lidar_std=(1e-4, 1e-4), radar_std=(1e-4, 1e-5, 1e-3))
    found = doubt(right, config)
    assert found.ratio > found.limit
    for cause in (
        "clockwise or mirrored azimuth",
        "degrees instead of radians",
        "several targets in one table",
        "taken as metres",
        "noise",
    ):
        assert cause in str(found)


def test_yaws_of_the_platform_in_degrees_are_named(tmp_path):
    seen = overflight(tmp_path, 1)
    found = doubt(changed(seen, "pose", lambda v: [*v[:2], np.degrees(v[2]), *v[3:]]))
    assert "yaws of the platform are degrees" in found.shown[0]


def test_geographic_poses_are_told_and_not_refused(tmp_path):
    seen = overflight(tmp_path, 1)
    wrong = changed(seen, "pose", lambda v: [*geographic(v), *v[2:]])
    assert "poses of the platform stay within" in geographic_poses(wrong)
    assert geographic_poses(seen) is None


def test_the_public_check_takes_any_order_and_refuses_other_things(right):
    assert lc.fusion.implausible(iter(right[::-1])) is None
    wrong = WRONG["degrees"][0](right)
    found = lc.fusion.implausible(wrong[::-1])
    assert isinstance(found, lc.fusion.Implausible)
    assert found.shown == lc.fusion.implausible(wrong, FusionConfig(), TableOptions()).shown
    for things in ([*right, 5], lc.fusion.Measurements(right)):
        with pytest.raises(InputError, match="measurements"):
            lc.fusion.implausible(things)
    with pytest.raises(ConfigError, match="expected a FusionConfig, got TableOptions"):
        lc.fusion.implausible(right, TableOptions())


# The command


def fuse(*arguments):
    code = "from lidar_core.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, "fuse", *map(str, arguments), "--no-picture", "--no-mcap"],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


def table(path, seen):
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["t_ns", "sensor", "x", "y", "range", "bearing", "range_rate"])
        for m in seen:
            values = [*m.values, "", "", ""] if m.sensor == "lidar" else ["", "", *m.values]
            rows.writerow([m.stamp_ns, m.sensor, *values])
    return path


@pytest.mark.parametrize("function", ["fuse", "fit_config"])
def test_runs_name_the_option_that_replaces_a_told_one(recordings, tmp_path, function):
    right = read_laser_radar(recordings / SAMPLE_1).measurements[:400]
    path = table(tmp_path / "told.csv", WRONG["compass bearings"][0](right))
    arguments = (None, tmp_path / "run") if function == "fuse" else ()
    with pytest.raises(InputError, match=r'"bearing": "compass"'):
        getattr(lc.runs, function)(path, *arguments, azimuth={"bearing": "clockwise"})


@pytest.mark.nightly
def test_the_command_ends_with_status_2_and_force_goes_on(tmp_path, recordings):
    seen = read_laser_radar(recordings / OBJ_POSE).measurements
    wrong = table(tmp_path / "wrong.csv", WRONG["degrees"][0](seen))
    done = fuse(wrong, "-o", tmp_path / "a")
    assert done.returncode == 2, done.stderr
    told = " ".join(done.stderr.split())
    assert "wrong.csv: after 499 measurements the NIS is" in told
    assert "The data shows: bearings are degrees" in told
    assert "--angle-unit deg" in told
    assert "--force" in told
    assert not (tmp_path / "a").exists()
    forced = fuse(wrong, "-o", tmp_path / "a", "--force")
    assert forced.returncode == 0
    assert "note: after 499 measurements the NIS is" in " ".join(forced.stderr.split())
    assert (tmp_path / "a/summary.json").is_file()
    right = fuse(wrong, "-o", tmp_path / "b", "--angle-unit", "deg")
    assert right.returncode == 0, right.stderr
