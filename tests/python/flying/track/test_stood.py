"""What gave returns at one place for seconds stands there, and what flies past it flies."""

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from lidar_core import TrackKind, sim
from lidar_core.flying import FlyingFrame, FlyingObjectDetector
from lidar_core.reproduce.common import simulator_seed
from lidar_core.reproduce.flying.situations.scenes import scene
from lidar_core.sim import Body, Hexacopter, Scene, Simulator, Target, Tree, Waypoints

SPARSE = sim.LidarModel.preset("livox-mid360")
SENSOR = sim.Hover(position=(0.0, 0.0, 4.0))
SEED = 1001
CROWN = np.array([-13.0, -3.5, 3.75])
"""Middle of a crown through which many rays pass [m]."""
REACH = 0.6

Place = NDArray[np.float64]


def _frames(bodies: tuple[Body, ...], scans: int, *targets: Target) -> Iterator[FlyingFrame]:
    """A Mid-360 at rest."""
    made = Scene(bodies=bodies, targets=targets, lidar=SPARSE, sensor=SENSOR, scans=scans)
    simulator, detector = Simulator(made, seed=simulator_seed(SEED, 0)), FlyingObjectDetector()
    return (detector.process(simulator.scan(step)) for step in range(scans))


def _with_drone(times: tuple[float, ...], *places: Place) -> Iterator[FlyingFrame]:
    """A drone that is at each of some places in turn, beside a tree in a street."""
    crown = Tree(
        trunk_radius=0.23, trunk_height=3.7, crown_radius=1.3, leaf_radius=0.12, leaves=128, seed=8
    )
    start, end = places[:2]
    sight = np.linspace(0.0, 1.2, 25)[:, None] * CROWN[:2]
    way = start + np.linspace(0.0, 1.0, 25)[:, None] * (end - start)
    clear = np.concatenate([sight, *(share * way[:, :2] for share in np.linspace(0.1, 1.2, 12))])
    street = sim.scenes.street(5, keep_clear=clear, clearance=2.5)
    motion = Waypoints(times=times, positions=tuple(tuple(place.tolist()) for place in places))
    drone = Target(shape=Hexacopter(radius=0.325), motion=motion)
    tree = Body(shape=crown, position=(float(CROWN[0]), float(CROWN[1]), 0.0))
    return _frames((*street, tree), round(10 * times[-1]), drone)


def _is_found(frame: FlyingFrame, place: Place) -> bool:
    away = np.linalg.norm(frame.tracks.flying.position - place, axis=1)
    return bool((away <= REACH).any())


@pytest.mark.parametrize(("name", "scans"), [("bird .3 m", 90), ("lamp", 50)])
def test_nothing_flies_in_a_crown_or_a_lamp_that_few_rays_hit(name: str, scans: int) -> None:
    kinds: list[TrackKind] = []
    for frame in _frames(scene(name, SEED, 0, scans).bodies, scans):
        kinds += frame.tracks.kind.tolist()
    # The map takes them for free space at times, so that there are tracks.
    assert len(kinds) >= 10
    assert TrackKind.FLYING not in kinds


@pytest.mark.ci_cases("3.0")
@pytest.mark.parametrize("wait", [0.0, 3.0])
def test_what_leaves_a_place_beside_a_crown_flies(wait: float) -> None:
    start, end = np.add(CROWN, (1.5, 1.0, 1.0)), np.add(CROWN, (6.0, 9.0, 1.0))
    found = []
    for number, frame in enumerate(_with_drone((wait, wait + 4.0), start, end)):
        share = (number * 0.1 - wait) / 4.0
        if share >= 0.25:
            found.append(_is_found(frame, start + share * (end - start)))
    assert len(found) >= 25
    assert np.mean(found) >= 0.9


@pytest.mark.ci_cases("0.5")
@pytest.mark.parametrize("speed", [0.5, 1.0])
def test_what_flies_slowly_from_the_first_scan_on_is_known_soon(speed: float) -> None:
    start = np.array([-9.0, 2.0, 5.5])
    end = np.add(start, (0.0, 6.0 * speed, 0.0))
    for number, frame in enumerate(_with_drone((0.0, 6.0), start, end)):
        if number >= 25:
            assert _is_found(frame, start + number / 60 * (end - start)), number


def test_what_comes_back_to_its_start_still_flies() -> None:
    # A quadcopter 5 m from a VLP-16 flies to and fro at 0.5 m/s from before the first report on.
    street = sim.scenes.dark_street(seed=7, scans=100, sensor="vlp-16", speed=0.0, drone=True)
    simulator, detector = Simulator(street, seed=simulator_seed(SEED, 0)), FlyingObjectDetector()
    found = []
    for step in range(street.scans):
        made = simulator.scan(step)
        frame = detector.process(made, sensor="vlp-16")
        if step >= 60 and made.truth.hits[0] >= 3:
            found.append(_is_found(frame, made.truth.position[0]))
    assert len(found) >= 10
    assert np.mean(found) >= 0.95
