"""Tables of measurements: partial radar rows, space, conventions, places on the Earth, times."""

import numpy as np
import pytest

from lidar_core.errors import ConfigError, FormatError, InputError
from lidar_core.fusion import FusionConfig, TableOptions, read_measurements, run
from lidar_core.fusion.recordings.columns.conventions import earth_fixed, local_places
from lidar_core.io.tables.columns import read_columns
from lidar_core.runs import fuse


def table(folder, text):
    path = folder / "table.csv"
    path.write_text(text)
    return path


def test_a_radar_row_measures_what_is_there(tmp_path):
    path = table(
        tmp_path,
        "t_ns,range,bearing,elevation,range_rate\n0,5,.1,.2,1\n1,5,.1,,\n2,,.1,.2,\n3,,,,1\n4,,,,\n",
    )
    log = read_measurements(path)
    assert [m.measures for m in log.measurements] == [
        ("range", "bearing", "elevation", "range_rate"),
        ("range", "bearing"),
        ("bearing", "elevation"),
        ("range_rate",),
    ]
    assert log.measurements[2].values.tolist() == [0.1, 0.2]
    flat = read_measurements(table(tmp_path, "t_ns,range,bearing,range_rate\n0,5,.1,1\n"))
    assert repr(flat.measurements[0]) == "Measurement(0, 'radar', [5.0, 0.1, 1.0])"


def test_a_row_of_a_sensor_without_values_is_refused_by_the_filter(tmp_path):
    path = table(tmp_path, "t_ns,sensor,range,bearing,x,y\n0,L,,,1,2\n1,R,5,.1,,\n2,R,,,,\n")
    log = read_measurements(path)
    assert run(log.measurements, FusionConfig(model="cv")).outcomes.tolist() == [
        "started",
        "updated",
        "invalid",
    ]


def test_places_and_poses_in_space(tmp_path):
    names = "t_ns,x,y,z,pose_x,pose_y,pose_z,pose_roll,pose_pitch,pose_yaw"
    path = table(tmp_path, f"{names}\n0,1,2,3,4,5,6,10,20,30\n1,1,2,,4,5,,,,30\n")
    log = read_measurements(path, TableOptions(angle_unit="deg"))
    pose, place, flat_pose, flat = log.measurements
    assert (pose.sensor, flat_pose.sensor) == ("pose-3d", "pose")
    np.testing.assert_allclose(pose.values, [4, 5, 6, *np.deg2rad([10, 20, 30])])
    np.testing.assert_allclose(flat_pose.values, [4, 5, np.deg2rad(30)])
    assert (place.values.tolist(), flat.values.tolist()) == ([1, 2, 3], [1, 2])


def test_angles_count_as_the_options_say(tmp_path):
    path = table(tmp_path, "t_ns,bearing,pose_x,pose_y,pose_yaw,turn_rate,x,y\n0,30,0,0,80,5,3,4\n")
    ways = {
        "bearing": "clockwise",
        "pose_yaw": "compass",
        "turn_rate": "compass",
        "lidar": "compass",
    }
    log = read_measurements(path, TableOptions(angle_unit="deg", azimuth=ways))
    found = {m.sensor: m.values.tolist() for m in log.measurements}
    assert found["radar"] == [pytest.approx(np.deg2rad(-30))]
    assert found["pose"][2] == pytest.approx(np.deg2rad(10))
    assert found["gyro"] == [pytest.approx(np.deg2rad(-5))]
    assert found["lidar"] == [4, 3]
    mirrored = read_measurements(path, TableOptions(azimuth={"lidar": "clockwise"}))
    assert mirrored.measurements[2].values.tolist() == [3, -4]
    with pytest.raises(ConfigError, match="azimuth"):
        TableOptions.load({"azimuth": {"range": "clockwise"}})


def test_times_may_be_texts_and_clocks_may_differ(tmp_path):
    path = table(
        tmp_path,
        "t_ns,x,y,bearing\n2026-11-26T08:00:00Z,1,2,.1\n2026-11-26T10:00:00.25+02:00,1,2,.1\n",
    )
    log = read_measurements(path, TableOptions(clock={"radar": 0.5}))
    stamps = [m.stamp_ns for m in log.measurements]
    start = 1_795_680_000_000_000_000
    assert stamps == [start, start - 5 * 10**8, start + 25 * 10**7, start - 25 * 10**7]
    with pytest.raises(FormatError, match="row 2: column t_ns: expected a time"):
        read_measurements(table(tmp_path, "t_ns,x,y\n2026-11-26T08:00:00Z,1,2\nsoon,1,2\n"))


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        ("26.11.2026 08:00:00,1,2", "row 1: column t_ns: .*ISO 8601 such as .*got '26.11.2026"),
        ("2026-11-26T08:00:00Z,1,2\n26.11.2026,1,2", "row 2: column t_ns: .*ISO 8601 such as"),
        ("0,1,2\nn/a,1,2", "row 2: column t_ns: .*ISO 8601 such as .*got 'n/a'$"),
        ("0,1,2\n,1,2", "row 2: column t_ns: .*ISO 8601 such as"),
        ("0,1,2\n1,n/a,2", "row 2: column x: expected a number, got 'n/a'; leave .* empty"),
    ],
)
def test_cells_that_hold_no_number_are_told_what_is_possible(tmp_path, rows, told):
    with pytest.raises(FormatError, match=told):
        read_measurements(table(tmp_path, f"t_ns,x,y\n{rows}\n"))


def test_what_these_errors_advise_is_read(tmp_path):
    text = "t_ns,x,y\n2026-11-26T08:00:00Z,1,2\n2026-11-26T08:00:01Z,,\n"
    (only,) = read_measurements(table(tmp_path, text)).measurements
    assert only.values.tolist() == [1, 2]


def test_places_on_the_earth_become_metres(tmp_path):
    path = table(
        tmp_path,
        "t_ns,range,bearing,pose_lat,pose_lon,pose_yaw\n0,5,0,59,10,0\n1,5,0,59.01,10.02,0\n",
    )
    log = read_measurements(path)
    assert log.origin == (59.0, 10.0, 0.0)
    first, second = (m.values for m in log.measurements if m.sensor == "pose")
    np.testing.assert_allclose(first[:2], 0, atol=1e-9)
    # 0.01 degrees of the meridian and 0.02 of the parallel at 59 degrees, by their radii.
    square, phi = 0.0066943799901, np.deg2rad(59.005)
    across = 6378137 / np.sqrt(1 - square * np.sin(phi) ** 2)
    along = 6378137 * (1 - square) / (1 - square * np.sin(phi) ** 2) ** 1.5
    north, east = np.deg2rad(0.01) * along, np.deg2rad(0.02) * across * np.cos(np.deg2rad(59.01))
    np.testing.assert_allclose(second[:2], [east, north], atol=0.6)
    with pytest.raises(InputError, match="leave out lat and lon, or the poses"):
        read_measurements(table(tmp_path, "t_ns,lat,lon,pose_x,pose_y,pose_yaw\n0,59,10,0,0,0\n"))
    with pytest.raises(FormatError, match="row 1: expected a latitude within 90"):
        read_measurements(table(tmp_path, "t_ns,lat,lon\n0,159,10\n"))


def test_local_axes_are_east_north_and_up():
    origin = (59.0, 10.0, 100.0)
    higher = local_places(*(np.array([v]) for v in (59.0, 10.0, 101.0)), origin)
    np.testing.assert_allclose(higher, [[0, 0, 1]], atol=1e-8)
    pole = earth_fixed(np.array([90.0]), np.array([0.0]), np.array([0.0]))
    np.testing.assert_allclose(pole, [[0, 0, 6356752.3142]], atol=1e-3)


def test_several_targets_of_a_table_are_tracked_and_scored(tmp_path):
    rng = np.random.default_rng(9210)
    lines = ["t_ns,x,y,true_x,true_y,true_vx,true_vy,true_id"]
    for k in range(60):
        for number, start in ((3, (0.0, 0.0)), (7, (20.0, 5.0))):
            x, y = start[0] + 0.1 * k, start[1] - 0.05 * k
            seen = np.array([x, y]) + rng.normal(0, 0.1, 2)
            lines.append(f"{k * 10**8},{seen[0]},{seen[1]},{x},{y},1,-.5,{number}")
        lines.append(f"{k * 10**8},{rng.uniform(-40, 40)},{rng.uniform(-40, 40)},,,,,")
    path = table(tmp_path, "\n".join(lines) + "\n")
    result = fuse(path, None, tmp_path / "run", association="integrated", picture=False)
    targets = result.summary["targets"]
    assert sorted(targets) == ["3", "7"]
    assert all(one["share"] > 0.9 and one["rmse"] < 0.2 for one in targets.values())
    assert result.summary["gospa"]["distance"] < result.summary["gospa_empty"]["distance"] / 3
    with pytest.raises(InputError, match="several targets"):
        fuse(path, None, tmp_path / "one", picture=False)


def test_a_table_in_space_gives_tracks_with_heights(tmp_path):
    lines = ["t_ns,x,y,z"] + [
        f"{k * 10**8},{k * 0.2},{5 + k * 0.1},{2 + 0.05 * k}" for k in range(40)
    ]
    path = table(tmp_path, "\n".join(lines) + "\n")
    result = fuse(path, None, tmp_path / "run", model="ctrv-3d", picture=False)
    assert result.summary["states"] == ["x", "y", "z", "v", "theta", "w", "vz"]
    tracks = read_columns(next((tmp_path / "run").glob("tracks.*")))
    np.testing.assert_allclose(tracks["z"][20:], 2 + 0.05 * np.arange(20, 40), atol=0.1)
    np.testing.assert_allclose(tracks["vz"][30:], 0.5, atol=0.1)
    assert {"cov_x_z", "cov_z_z"} <= set(tracks)
