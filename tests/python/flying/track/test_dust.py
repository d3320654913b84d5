"""Dense dust of the size of a drone is no drone: its rays hit and miss at random."""

from collections.abc import Iterator

import numpy as np
import pytest

from lidar_core import TrackKind, sim
from lidar_core.flying import FlyingFrame, FlyingObjectDetector
from lidar_core.reproduce.flying.situations.shapes import octocopter
from lidar_core.sim import Dust, Scene, Target, Waypoints

START, END = (7.0, -2.0, 4.5), (7.0, 0.4, 4.5)
SCANS = 40


def _frames(air: tuple[Dust, ...], targets: tuple[Target, ...]) -> Iterator[FlyingFrame]:
    """Frames of an OS1-128 at rest in a street, in front of houses."""
    clear = np.array([START[:2], (7.0, 2.0), (0.0, 0.0)])
    scene = Scene(
        bodies=sim.scenes.street(1, keep_clear=clear, clearance=2.5),
        air=air,
        targets=targets,
        lidar=sim.LidarModel.preset("os1-128"),
        sensor=sim.Hover(position=(0.0, 0.0, 4.0)),
        scans=SCANS,
    )
    detector = FlyingObjectDetector()
    return (detector.process(made) for made in sim.simulate(scene, seed=1))


@pytest.mark.parametrize("free_path", [2.0, 3.0])
def test_a_dense_puff_of_dust_is_tracked_but_does_not_fly(free_path: float) -> None:
    puff = Dust(center=START, velocity=(0.0, 0.6, 0.0), radius=0.7, free_path=free_path)
    kinds: list[TrackKind] = []
    for frame in _frames((puff,), ()):
        kinds += frame.tracks.kind.tolist()
    assert len(kinds) >= 20
    assert np.mean(np.equal(kinds, TrackKind.FLYING)) <= 0.1


def test_an_octocopter_of_that_size_flies() -> None:
    way = Waypoints(times=(0.0, SCANS * 0.1), positions=(START, END))
    frames = _frames((), (Target(shape=octocopter(1.5), motion=way),))
    found = [len(frame.tracks.flying) for frame in frames]
    assert np.mean(np.array(found[15:]) == 1) >= 0.95
