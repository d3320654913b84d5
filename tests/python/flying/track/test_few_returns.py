"""Targets of one or two returns per scan, and beyond the range of the map."""

from collections.abc import Iterator

import numpy as np
import pytest

from lidar_core import sim
from lidar_core.flying import FlyingConfig, FlyingFrame, FlyingObjectDetector
from lidar_core.sim import Scene, SimulatedScan, Simulator
from lidar_core.sim.motion.motions import Scripted

FIRST_S = 2.1
"""The burn-in, and one second [s]."""
SCANS = 42
"""As many scans after `FIRST_S` as before; `DRIVES` goes from one end to the other."""


def _scene(
    target: sim.Target | None,
    sensor: Scripted,
    lidar: str = "livox-mid360",
    scans: int = SCANS,
) -> Scene:
    """A street with open sky, seen by a sensor that reaches 90 m."""
    model = sim.LidarModel.preset(lidar).model_copy(update={"range_max": 90.0})
    along = np.linspace(0.0, 70.0, 71)[:, None]
    clear = np.concatenate([along * (1.0, 0.0), along * (0.94, 0.34), along * (0.94, -0.34)])
    return Scene(
        bodies=sim.scenes.street(3, keep_clear=clear, clearance=5.0),
        targets=() if target is None else (target,),
        lidar=model,
        sensor=sensor,
        scans=scans,
    )


def _far(distance: float, span: float) -> sim.Target:
    """A ball that flies to and fro across the line of sight at 4 m/s."""
    height = distance * np.sin(np.deg2rad(15.0))
    level = distance * np.cos(np.deg2rad(15.0))
    ends = ((level, -6.0, height), (level, 6.0, height + 1.0))
    motion = sim.Shuttle(start=ends[0], end=ends[1], speed=4.0, acceleration=4.0)
    return sim.Target(shape=sim.Sphere(radius=span / 2), motion=motion)


def _frames(
    scene: Scene, config: FlyingConfig | None = None
) -> Iterator[tuple[SimulatedScan, FlyingFrame]]:
    simulator, detector = Simulator(scene, seed=11), FlyingObjectDetector(config or FlyingConfig())
    for step in range(scene.scans):
        made = simulator.scan(step)
        yield made, detector.process(made)


def _recall(scene: Scene, reach: float, config: FlyingConfig | None = None) -> tuple[float, int]:
    """Share of scans with a flying track on the target, and number of other flying tracks."""
    found, others = [], set()
    for made, frame in _frames(scene, config):
        flying = frame.tracks.flying
        away = np.linalg.norm(flying.position - made.truth.position, axis=1)
        others |= set(flying.id[away > reach].tolist())
        if (made.scan.stamp_ns - scene.start_ns) * 1e-9 >= FIRST_S:
            found.append(bool((away <= reach).any()))
    return float(np.mean(found)), len(others)


AT_REST = sim.Hover(position=(0.0, 0.0, 2.0))
DRIVES = sim.Shuttle(start=(-8.0, 0.0, 2.0), end=(8.0, 0.0, 2.0), speed=4.0, acceleration=2.0)


@pytest.mark.ci_cases("at rest-25.0-0.6")
@pytest.mark.parametrize(("distance", "span"), [(25.0, 0.6), (60.0, 1.4)])
@pytest.mark.parametrize("sensor", [AT_REST, DRIVES], ids=["at rest", "driving"])
def test_a_target_of_one_or_two_returns_has_a_track(
    distance: float, span: float, sensor: Scripted
) -> None:
    recall, others = _recall(_scene(_far(distance, span), sensor), max(1.0, span))
    assert recall >= 0.85
    assert others == 0


def test_a_target_of_less_than_a_return_per_scan_has_a_track_within_the_range_of_the_map() -> None:
    """Rays are 0.15 m apart there, and the ball has 0.14 m."""
    shown = [
        bool((np.linalg.norm(frame.tracks.flying.position - made.truth.position, axis=1) < 1).any())
        for made, frame in _frames(_scene(_far(9.0, 0.14), AT_REST))
    ]
    assert np.mean(shown[26:]) >= 0.9


@pytest.mark.ci_cases("None")
@pytest.mark.parametrize("distance", [None, 20.0])
def test_without_it_such_a_target_has_none(distance: float | None) -> None:
    config = FlyingConfig(few_returns_distance=distance)
    assert _recall(_scene(_far(25.0, 0.6), AT_REST), 1.0, config) == (0.0, 0)


@pytest.mark.ci_cases("driving")
@pytest.mark.parametrize("sensor", [AT_REST, DRIVES], ids=["at rest", "driving"])
def test_what_hangs_far_away_does_not_fly(sensor: Scripted) -> None:
    ball = sim.Body(shape=sim.Sphere(radius=0.4), position=(24.0, 0.0, 8.0))
    scene = _scene(None, sensor)
    scene = scene.model_copy(update={"bodies": (*scene.bodies, ball)})
    assert not any(len(frame.tracks.flying) for _, frame in _frames(scene))


@pytest.mark.ci_cases("vlp-16")
@pytest.mark.parametrize("lidar", ["vlp-16", "hdl-32e"])
def test_poles_and_cables_passed_by_rows_do_not_fly(lidar: str) -> None:
    poles = [
        sim.Body(shape=sim.Box(size=(0.15, 0.15, 14.0)), position=(x, y, 7.0))
        for x, y in ((58.0, 3.0), (50.0, -4.0), (66.0, 0.5))
    ]
    tilt = np.deg2rad(30.0) / 2
    cable = sim.Body(
        shape=sim.Box(size=(0.1, 40.0, 0.1)),
        position=(62.0, 0.0, 10.0),
        rotation=(float(np.sin(tilt)), 0.0, 0.0, float(np.cos(tilt))),
    )
    drives = sim.Shuttle(start=(0.0, 0.0, 2.0), end=(40.0, 0.0, 2.0), speed=9.0, acceleration=4.0)
    scene = _scene(None, drives, lidar, scans=52)
    scene = scene.model_copy(update={"bodies": (*scene.bodies, *poles, cable)})
    assert not any(len(frame.tracks.flying) for _, frame in _frames(scene))


def test_a_restored_detector_goes_on_with_the_same_bits() -> None:
    scene = _scene(_far(25.0, 0.6), DRIVES)
    simulator, detector = Simulator(scene, seed=11), FlyingObjectDetector(FlyingConfig())
    scans = [simulator.scan(step) for step in range(24)]
    for made in scans[:14]:  # hypotheses are there, and no track yet
        detector.process(made)
    other = FlyingObjectDetector.from_bytes(detector.to_bytes())
    for made in scans[14:]:
        one, two = detector.process(made), other.process(made)
        assert np.array_equal(one.tracks.id, two.tracks.id)
        assert np.array_equal(one.tracks.position, two.tracks.position)
    assert len(detector.tracks_at(scans[-1].scan.stamp_ns)) == 1
    assert detector.to_bytes() == other.to_bytes()
