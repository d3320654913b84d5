"""First inputs of the Rust targets: contents of valid states and maps, and plain bytes."""

import struct

import numpy as np

from fuzz_house.rust import CORPUS, targets
from lidar_core import _core

MOST_BYTES = 8192
"""Longest content that is written; longer ones are made by the target itself."""


def states() -> dict[str, list[bytes]]:
    """What stands between header and checksum of valid states, by target."""
    from lidar_core.circles import CircleMap, CirclePipeline
    from lidar_core.flying import FlyingConfig, FlyingObjectDetector
    from lidar_core.flying.tracker import PointCloudTracker
    from lidar_core.fusion import Measurement, MultiTargetTracker, TargetFilter

    config = FlyingConfig().voxel_map
    world = _core.VoxelMap(config, threads=1, origin=np.zeros(3))
    world.set_occupied(np.array([[1, 2, 3], [1.3, 2, 3]], np.float32))
    detector, tracker, pipeline = FlyingObjectDetector(), PointCloudTracker(), CirclePipeline()
    one, many = TargetFilter(), MultiTargetTracker()
    rng = np.random.default_rng(0)
    ranges = np.full(pipeline.config.scanner.n_beams, 5.0, np.float32)
    ranges[100:140] = 3.0
    for step in range(4):
        stamp_ns = step * 100_000_000
        points = np.concatenate([rng.normal(0, 2, (40, 3)), rng.normal([4, 0, 2], 0.1, (9, 3))])
        detector.process(points.astype(np.float32), np.eye(4), stamp_ns)
        tracker.new_detections(np.array([[4.0, 0.1 * step, 2.0]]), stamp_ns)
        pipeline.process(ranges, np.eye(4), stamp_ns)
        measured = [Measurement(stamp_ns, "lidar", np.array([1.0 + 0.1 * step, 2.0]))]
        one.step(measured[0])
        many.process(stamp_ns, measured, source="lidar")
    found = {
        "state_map": world,
        "state_tracker": tracker._tracker,
        "state_filter": one._filter,
        "state_many": many._tracker,
        "state_circle_map": CircleMap()._map,
        "state_pipeline": pipeline._pipeline,
        "state_detector": detector._detector,
    }
    inner = {name: [_content(owner.to_state())] for name, owner in found.items()}
    # The first byte says that the content follows; two bytes before choose the filter.
    inner = {name: [b"\0" + one for one in some] for name, some in inner.items()}
    inner["state_filter"] = [b"\0\0" + one for one in inner["state_filter"]]
    return inner | {"lcvm": [b"\0" + one for one in _maps(world.to_bytes()[:-4])]}


def _maps(plain: bytes) -> list[bytes]:
    """A map without checksum, and the same with bounds and a further threshold."""
    at = 4 + 4 + 7 * 8 + 7 * 4 + 1 + 8  # of the byte that says whether there are bounds
    assert plain[at : at + 2] == b"\0\0"
    bounds = struct.pack("<B6dBf", 1, *3 * [-9.0], *3 * [9.0], 1, -500.0)
    return [plain, plain[:at] + bounds + plain[at + 2 :]]


def _content(state: bytes) -> bytes:
    return state[9 + state[8] + 4 : -4]


def write() -> None:
    """Write them for every target that has no corpus."""
    known = states()
    for target in targets():
        folder = CORPUS / target
        folder.mkdir(parents=True, exist_ok=True)
        rng = np.random.default_rng(1)
        contents = [one for one in known.get(target, []) if len(one) <= MOST_BYTES]
        plain = [
            bytes(rng.integers(0, 200, 64, np.uint8)),
            bytes(rng.integers(0, 256, 400, np.uint8)),
        ]
        for number, content in enumerate([*contents, *plain]):
            (folder / f"seed-{number}").write_bytes(content)


if __name__ == "__main__":
    write()
