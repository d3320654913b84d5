"""What is in the air from the first scan on: known, and not flying before it moves."""

import numpy as np
import pytest

from lidar_core import sim
from lidar_core.flying import FlyingConfig, FlyingObjectDetector
from lidar_core.messages import TrackKind
from lidar_core.reproduce.flying import drivers
from lidar_core.reproduce.flying.situations import scenes
from lidar_core.sim import Scene, Simulator

KNOWN_S, FLIES_S = 2.0, 0.3
"""When it is known, and when it flies after it has moved by 0.1 m [s]."""
MOVED, NEAR = 0.1, 0.6
"""The target has moved [m]; distance of a track of it [m]."""


def _kinds(scene: Scene, seed: int, place: np.ndarray | None = None) -> list[tuple]:
    """Of each scan: time [s], way of the target [m], kind of the track there, None without one."""
    simulator, detector = Simulator(scene, seed=seed), FlyingObjectDetector(FlyingConfig())
    kinds, first = [], None
    for step in range(scene.scans):
        made = simulator.scan(step)
        tracks = detector.process(made).tracks
        at = place if place is not None else np.reshape(made.truth.position, (-1, 3))[0]
        first = at if first is None else first
        found = np.flatnonzero(np.linalg.norm(tracks.position - at, axis=1) <= NEAR)
        kind = TrackKind(tracks.kind[found[0]]) if len(found) else None
        kinds.append((0.1 * step, float(np.linalg.norm(at - first)), kind))
    return kinds


@pytest.mark.ci_cases("24")
@pytest.mark.parametrize("scans", [24, 48])
def test_what_hovers_before_the_sky_is_known_and_flies_soon_after_it_moves(scans: int) -> None:
    """The sky next to it is not trusted, so some voxels beside it are never free."""
    kinds = _kinds(scenes.scene("hovering", 1, 2, scans), 5)
    before = [kind for time, way, kind in kinds if time >= KNOWN_S and way == 0.0]
    assert len(before) >= 4
    assert set(before) == {TrackKind.UNKNOWN}
    if 0.1 * scans <= scenes.HOVERS:
        return
    moved = [(time, kind) for time, way, kind in kinds if way > MOVED]
    soon = [kind for time, kind in moved if time - moved[0][0] >= FLIES_S]
    assert len(soon) >= 2
    assert set(soon) == {TrackKind.FLYING}


@pytest.mark.ci_cases("livox-mid360-0-0-40", "livox-mid360-14-114-24")
@pytest.mark.parametrize(
    ("number", "seed", "scans"), [(0, 0, 40), (1, 1, 50), (2, 2, 50), (14, 114, 24), (20, 120, 50)]
)
@pytest.mark.parametrize("lidar", ["livox-mid360", "livox-avia"])
def test_what_hangs_before_the_sky_does_not_fly(
    lidar: str, number: int, seed: int, scans: int
) -> None:
    """Most rays of a sparse pattern pass it, and the map loses it, at once or for some scans."""
    rng = np.random.default_rng([7, number])
    distance, up = rng.uniform(4.0, 9.0), np.deg2rad(rng.uniform(0.0, 12.0))
    aside = np.deg2rad(rng.uniform(-20.0, 20.0))
    level = distance * np.cos(up)
    place = (level * np.cos(aside), level * np.sin(aside), drivers.HEIGHT + distance * np.sin(up))
    lamp = sim.Body(
        shape=sim.Sphere(radius=0.2 if number % 2 else 0.3),
        position=tuple(float(value) for value in place),
    )
    scene = drivers.scene(0, 1, scans, lidar)  # without targets
    scene = scene.model_copy(
        update={
            "bodies": (*scene.bodies, lamp),
            "sensor": sim.Hover(position=(0.0, 0.0, drivers.HEIGHT)),
        }
    )
    kinds = [kind for _, _, kind in _kinds(scene, seed, np.array(place))]
    assert kinds[12:].count(None) <= 3  # it is seen
    assert TrackKind.FLYING not in kinds
