"""A live run that was killed goes on with the state of its last checkpoint."""

import numpy as np
import pytest
from commands import invoke
from flying_scenes import drone, yard

from lidar_core import ConfigError, InputError, runs, sim
from lidar_core.circles import CirclesConfig
from lidar_core.flying import FlyingConfig, FlyingObjectDetector
from lidar_core.io import PoseOptions, ReadOptions, open_recording, posed_scans
from lidar_core.live.pipelines import CirclesLive, FlyingLive
from lidar_core.messages import LaserScan, PosedScan
from lidar_core.run_folder import CHECKPOINT, RunFolder
from lidar_core.runs.streams.folder import LiveFolder


def laser_items(count):
    angles = np.linspace(-np.pi, np.pi, 360)
    ranges = (4.0 + np.sin(7 * angles)).astype(np.float32)
    for n in range(count):
        scan = LaserScan(n * 10**8, ranges, -np.pi, 2 * np.pi / 359, 0.1, 30.0)
        yield PosedScan(scan, np.eye(4))


@pytest.fixture(scope="module")
def flying_items(tmp_path_factory):
    path = tmp_path_factory.mktemp("flight") / "yard.npz"
    sim.record(yard(drone((6.0, 4.0, 3.5), (5.0, 6.0, 4.0)), scans=8), path, seed=0)
    with open_recording(path, ReadOptions()) as opened:
        return list(posed_scans(opened, PoseOptions()))


def opened(path, sort, *, resume=False, config=None, checkpoint=1e-6):
    """A folder and its pipeline, as `live` makes them."""

    def make(_sort):
        if sort == "flying":
            return FlyingLive(FlyingObjectDetector(config or FlyingConfig()))
        return CirclesLive(config or CirclesConfig(), n_scanners=1)

    folder = LiveFolder(
        RunFolder(path, overwrite=False, resume=resume), make, checkpoint=checkpoint, resume=resume
    )
    return folder, folder.pipeline(object)


def fed(folder, pipeline, items):
    for item in items:
        if pipeline.is_ready(item.scan):
            update = pipeline.take(item, "world")
            if not isinstance(update, str):
                folder.publish(update)


def state(pipeline):
    used = pipeline.detector if isinstance(pipeline, FlyingLive) else pipeline.pipeline
    return used.to_bytes()


def written(folder):
    told, files, _ = folder.write({"source": "test"}, {}, {})
    return told, files


@pytest.mark.parametrize("sort", ["flying", "circles"])
def test_the_state_and_the_tables_go_on(sort, flying_items, tmp_path):
    items = flying_items if sort == "flying" else list(laser_items(8))
    whole, pipeline = opened(tmp_path / "whole", sort, checkpoint=None)
    fed(whole, pipeline, items)
    expected = state(pipeline)
    written(whole)

    cut, first = opened(tmp_path / "run", sort)
    fed(cut, first, items[:5])  # and no more: it was killed
    assert (tmp_path / "run" / CHECKPOINT).exists()
    again, second = opened(tmp_path / "run", sort, resume=True)
    assert state(second) == state(first)
    fed(again, second, items[5:])
    assert state(second) == expected
    written(again)
    assert not list((tmp_path / "run").glob(".*"))
    assert not (tmp_path / "run" / CHECKPOINT).exists()
    for path in (tmp_path / "whole").rglob("*.*"):
        if path.suffix in (".csv", ".parquet", ".txt") and path.stem != "timing":
            other = tmp_path / "run" / path.relative_to(tmp_path / "whole")
            assert other.read_bytes() == path.read_bytes(), path


def test_a_checkpoint_of_another_configuration_is_refused(tmp_path):
    cut, pipeline = opened(tmp_path / "run", "circles")
    fed(cut, pipeline, laser_items(3))
    other = CirclesConfig.load({"map": {"gate_probability": 0.99}})
    with pytest.raises(InputError, match="another circles"):
        opened(tmp_path / "run", "circles", resume=True, config=other)


def test_options_of_live(tmp_path):
    with pytest.raises(ConfigError, match="expected an output folder"):
        runs.live(None, None, None, replay=tmp_path / "a.npz", resume=True)
    told = invoke("live", "--help").output
    assert "--checkpoint" in told
    assert "--resume" in told
