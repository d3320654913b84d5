"""Dense dust of the size of a drone is no drone: its rays hit and miss at random."""

from collections.abc import Iterator

import numpy as np
import pytest

from lidar_core import TrackKind, sim
from lidar_core.flying import FlyingFrame, FlyingObjectDetector
from lidar_core.reproduce.flying.situations.shapes import fixed_wing, octocopter
from lidar_core.sim import Dust, Scene, Target, Waypoints

START = (7.0, -2.0, 4.5)
PASS = (8.0, -6.0, 4.8), (8.0, 6.0, 4.8)
"""Way of the targets; wings cannot fly slowly."""
SCANS = 40


def _lidar(name: str, columns: int | None = None) -> sim.LidarModel:
    lidar = sim.LidarModel.preset(name)
    if columns is None:
        return lidar
    pattern = lidar.pattern.model_copy(update={"columns": columns})
    return lidar.model_copy(update={"pattern": pattern})


def _frames(
    air: tuple[Dust, ...], targets: tuple[Target, ...], lidar: sim.LidarModel
) -> Iterator[FlyingFrame]:
    """Frames of a sensor at rest in a street, in front of houses."""
    way = np.linspace(*PASS, 7)[:, :2] if targets else [START[:2], (7.0, 2.0)]
    clear = np.array([*way, (0.0, 0.0)])
    scene = Scene(
        bodies=sim.scenes.street(1, keep_clear=clear, clearance=2.5),
        air=air,
        targets=targets,
        lidar=lidar,
        sensor=sim.Hover(position=(0.0, 0.0, 4.0)),
        scans=SCANS,
    )
    detector = FlyingObjectDetector()
    return (detector.process(made) for made in sim.simulate(scene, seed=1))


@pytest.mark.parametrize("free_path", [2.0, 3.0])
def test_a_dense_puff_of_dust_is_tracked_but_does_not_fly(free_path: float) -> None:
    puff = Dust(center=START, velocity=(0.0, -0.6, 0.0), radius=0.7, free_path=free_path)
    kinds: list[TrackKind] = []
    for frame in _frames((puff,), (), _lidar("os1-128")):
        kinds += frame.tracks.kind.tolist()
    assert len(kinds) >= 10
    assert np.mean(np.equal(kinds, TrackKind.FLYING)) <= 0.1


@pytest.mark.ci_cases("octocopter-os1-128", "wing-rows closer")
@pytest.mark.parametrize(
    "lidar",
    [
        pytest.param(_lidar("os1-128"), id="os1-128"),
        pytest.param(_lidar("os1-128", columns=512), id="rows closer"),
        pytest.param(_lidar("os1-32"), id="columns closer"),
    ],
)
@pytest.mark.parametrize(
    "shape",
    [
        pytest.param(octocopter(1.5), id="octocopter"),
        pytest.param(fixed_wing(1.5), id="wing"),
        pytest.param(fixed_wing(2.2), id="long wing"),
    ],
)
def test_open_frames_and_wings_of_one_row_fly(shape: sim.Mesh, lidar: sim.LidarModel) -> None:
    way = Waypoints(times=(0.0, SCANS * 0.1), positions=PASS)
    frames = _frames((), (Target(shape=shape, motion=way),), lidar)
    found = [len(frame.tracks.flying) for frame in frames]
    assert np.mean(np.array(found[15:]) == 1) >= 0.95
