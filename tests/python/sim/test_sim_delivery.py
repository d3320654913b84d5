"""Presets deliver what the sensor's driver delivers, unless the LiDAR is ideal."""

import numpy as np
import pytest

from lidar_core import ConfigError, sim
from lidar_core.io import open_recording, posed_scans
from lidar_core.sensors import SENSORS

DROPPED = ("vlp-16", "hdl-32e", "hdl-64e", "vls-128", "rs16", "xt32", "pandar64", "qt128")
ZEROS = ("livox-mid360", "livox-avia", "livox-hap", "livox-horizon")
ORGANISED = tuple(name for name in SENSORS if name.startswith("os"))
MOTION = sim.Waypoints(times=(0.0, 10.0), positions=((6, 0, 1), (6, 4, 1)))


def scene(name, **changes):
    """Ground and a wall below open sky, a ball."""
    return sim.Scene(
        bodies=(
            sim.Body(shape=sim.Plane(size=(40.0, 40.0)), position=(0, 0, -1.5)),
            sim.Body(shape=sim.Box(size=(1.0, 12.0, 6.0)), position=(12.0, 0.0, 1.5)),
        ),
        targets=(sim.Target(shape=sim.Sphere(radius=0.4), motion=MOTION),),
        lidar=sim.LidarModel.preset(name, **changes),
        sensor=sim.Hover(position=(0.0, 0.0, 0.0)),
        scans=2,
    )


def made_by(name, **changes):
    return next(sim.simulate(scene(name, **changes), seed=4))


def test_every_3d_preset_says_what_its_driver_delivers():
    known = {*DROPPED, *ZEROS, *ORGANISED}
    assert known == {name for name, sensor in SENSORS.items() if not sensor.is_planar}
    for names, delivery in ((DROPPED, "dropped"), (ZEROS, "zeros"), (ORGANISED, "organised")):
        for name in names:
            assert sim.LidarModel.preset(name).delivery == SENSORS[name].delivery == delivery
            assert not sim.LidarModel.preset(name).ideal


@pytest.mark.parametrize("name", ["vlp-16", "hdl-32e", "xt32", "rs16"])
def test_rows_without_return_are_dropped(name):
    ideal, made = made_by(name, ideal=True), made_by(name)
    scan, is_return = made.scan, ~np.isnan(ideal.scan.points.reshape(-1, 3)).any(axis=1)
    assert 0.1 < is_return.mean() < 0.9
    assert scan.no_return is None
    assert scan.directions is None
    np.testing.assert_array_equal(scan.points, ideal.scan.points.reshape(-1, 3)[is_return])
    np.testing.assert_array_equal(scan.point_time_ns, ideal.scan.point_time_ns[is_return])
    np.testing.assert_array_equal(scan.ring, ideal.scan.ring[is_return])
    np.testing.assert_array_equal(made.label, ideal.label[is_return])
    assert made.truth.hits[0] == (made.label == 2).sum() == ideal.truth.hits[0] > 3
    assert made.truth.rays[0] == ideal.truth.rays[0]


@pytest.mark.parametrize("name", ZEROS)
def test_rows_without_return_are_zeros(name):
    ideal, made = made_by(name, ideal=True), made_by(name)
    is_return = ~np.isnan(ideal.scan.points).any(axis=1)
    assert 0.1 < is_return.mean() < 0.95
    assert (made.scan.points[~is_return] == 0).all()
    np.testing.assert_array_equal(made.scan.points[is_return], ideal.scan.points[is_return])
    assert made.scan.no_return is None
    assert made.scan.directions is None
    assert len(made.scan.point_time_ns) == len(made.scan.points) == len(made.label)
    assert (made.label[~is_return] == -1).all()
    dropped = made_by(name, delivery="dropped")
    np.testing.assert_array_equal(dropped.scan.points, ideal.scan.points[is_return])


def test_rows_without_return_are_nan_of_an_organised_cloud():
    ideal, made = made_by("os1-32", ideal=True), made_by("os1-32")
    assert made.scan.points.shape == (32, 1024, 3)
    np.testing.assert_array_equal(made.scan.points, ideal.scan.points)
    assert ideal.scan.no_return.any()
    assert made.scan.no_return is None
    assert made.scan.directions is None


def test_near_and_lost_returns_are_rows_without_return_too():
    made = made_by("livox-mid360", range_min=3.0, dropout=0.3)
    lengths = np.linalg.norm(made.scan.points, axis=1)
    assert set((lengths[lengths < 2.9]).tolist()) == {0.0}
    more = made_by("livox-mid360")
    assert (made.scan.points == 0).all(axis=1).sum() > (more.scan.points == 0).all(axis=1).sum()


def test_a_driver_without_times_gives_none():
    assert made_by("vlp-16", point_times=False).scan.point_time_ns is None
    assert made_by("vlp-16", point_times=False, ideal=True).scan.point_time_ns is not None


def test_a_model_of_ones_own_knows_all_rays():
    pattern = sim.Spinning(elevations_deg=(10.0, 0.0, -10.0), columns=90)
    world = scene("vlp-16").model_copy(update={"lidar": sim.LidarModel(pattern=pattern)})
    scan = next(sim.simulate(world, seed=0)).scan
    assert scan.no_return.any()
    assert scan.directions.shape == (270, 3)


def test_a_scene_file_says_ideal(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text('[lidar]\npreset = "vlp-16"\nideal = true\n')
    assert sim.Scene.read(path).lidar == sim.LidarModel.preset("vlp-16", ideal=True)
    path.write_text(sim.Scene.read(path).to_toml())
    assert sim.Scene.read(path).lidar.ideal
    with pytest.raises(ConfigError, match="delivery"):
        sim.LidarModel.preset("vlp-16", delivery="thrown")


@pytest.mark.parametrize("suffix", [".npz", ".mcap"])
@pytest.mark.parametrize("name", ["vlp-16", "livox-mid360", "os1-32"])
def test_recordings_hold_what_the_driver_delivers(name, suffix, tmp_path):
    done = sim.record(scene(name), tmp_path / f"r{suffix}", seed=4)
    expected = made_by(name)
    with open_recording(done.recording) as recording:
        read = next(iter(posed_scans(recording))).scan
    given = expected.scan.points.reshape(-1, 3)
    is_return = expected.label >= 0
    assert len(read.points.reshape(-1, 3)) == len(given)
    np.testing.assert_array_equal(read.points.reshape(-1, 3)[is_return], given[is_return])
    assert read.directions is None
    np.testing.assert_array_equal(read.point_time_ns, expected.scan.point_time_ns)
