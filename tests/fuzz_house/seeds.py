"""First inputs of the Rust targets: contents of valid states and maps, and plain bytes."""

import struct
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from fuzz_house.rust import CORPUS, LONGEST, USUAL, targets
from lidar_core import _core
from lidar_core.errors import FormatError
from lidar_core.flying import VoxelMapConfig

_CHECKSUM_BYTES = 4
MOST_BYTES = 8192
"""Longest content that is written; longer ones are made by the target itself."""


Owner: TypeAlias = tuple[Any, Callable[[bytes], object]]
"""An object with `to_state`, and what makes it again from a state."""


def owners() -> dict[str, Owner]:
    """Objects that have met a few scans, by the target that reads their states."""
    from lidar_core.circles import CircleMap, CirclePipeline
    from lidar_core.flying import FlyingConfig, FlyingObjectDetector
    from lidar_core.flying.tracker import PointCloudTracker
    from lidar_core.fusion import Measurement, MultiTargetTracker, TargetFilter

    detector, tracker, pipeline = FlyingObjectDetector(), PointCloudTracker(), CirclePipeline()
    one, many, circles = TargetFilter(), MultiTargetTracker(), CircleMap()
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
    in_flight = {"threads": 1}
    return {
        "state_map": (
            _map(FlyingConfig().voxel_map),
            partial(_core.VoxelMap.from_state, threads=1),
        ),
        "state_tracker": _owner(tracker._tracker, tracker.config, **in_flight),
        "state_detector": _owner(detector._detector, detector.config, **in_flight),
        "state_filter": _owner(one._filter, one.config),
        "state_many": _owner(many._tracker, many.config),
        "state_circle_map": _owner(circles._map, circles.config),
        "state_pipeline": _owner(pipeline._pipeline, pipeline.config, fit=pipeline._fit),
    }


def _owner(core: Any, config: object, **more: Any) -> Owner:
    return core, lambda state: type(core).from_state(config, state, **more)


CHOICES = {"state_filter": b"\x07", "state_circle_map": b"\0", "state_pipeline": b"\0"}
"""What chooses the default parameters, where a target has several."""


def prefix(target: str) -> bytes:
    """What stands before a content: the choice of parameters, and that the content follows."""
    if target == "lcvm":
        return b"\4"  # its checksum is mended, and it is only read
    return CHOICES.get(target, b"") + b"\0"


def states() -> dict[str, list[bytes]]:
    """What stands between header and checksum of valid states, and valid maps, by target."""
    inner = {
        name: [prefix(name) + _content(owner.to_state())] for name, (owner, _) in owners().items()
    }
    return inner | {"lcvm": [prefix("lcvm") + one for one in _maps()]}


def reads(owner: Owner, content: bytes) -> bool:
    """Whether a state with this content is read."""
    valid = owner[0].to_state()
    body = valid[: _head_bytes(valid)] + content
    try:
        owner[1](body + zlib.crc32(body).to_bytes(4, "little"))
    except FormatError:
        return False
    return True


def _map(config: VoxelMapConfig, *, is_empty: bool = False) -> _core.VoxelMap:
    world = _core.VoxelMap(config, threads=1, origin=np.zeros(3))
    if not is_empty:
        world.set_occupied(np.array([[1, 2, 3], [1.3, 2, 3]], np.float32))
    return world


def _maps() -> Iterator[bytes]:
    """Maps without checksum, of every unit, with and without bounds and further thresholds.

    Most are empty: in a long input a mutation seldom meets the few bytes that decide.
    """
    for unit in ("edges", "metres", "diagonals"):
        for bounds in (None, ((-9, -9, -9), (9, 9, 9))):
            for thresholds in ((), (-500.0,)):
                told = {"ray_unit": unit, "bounds": bounds, "extra_thresholds": thresholds}
                made = _map(VoxelMapConfig.load(told), is_empty=bool(thresholds))
                yield made.to_bytes()[:-_CHECKSUM_BYTES]


def _head_bytes(state: bytes) -> int:
    """Length of magic, version, kind and fingerprint."""
    return 9 + state[8] + 4


def _content(state: bytes) -> bytes:
    return state[_head_bytes(state) : -_CHECKSUM_BYTES]


def _tracker_after(detections: np.ndarray[Any, Any]) -> bytes:
    """Content of a tracker that met detections, and an hour later one point; it has no tracks."""
    from lidar_core.flying.tracker import PointCloudTracker

    tracker = PointCloudTracker()
    tracker.new_detections(detections, 0)
    point, background = np.ones((1, 3), np.float32), np.empty((0, 3), np.float32)
    tracker.new_point_cloud(point, background, 3600 * 10**9)
    return _content(tracker._tracker.to_state())


def _plain(target: str, longest: int) -> list[bytes]:
    """Bytes as long as they may be, from a few values and from all: short inputs end too soon."""
    rng = np.random.default_rng([1, *target.encode()])
    return [
        bytes(rng.integers(0, most, longest, np.uint8)) for most in (8, 64, 200, 256) for _ in "123"
    ]


SLOW = ("state_detector", "state_pipeline")
"""Targets of which a run takes milliseconds: fewer places of them are tried from the start."""


def _single_numbers(choice: bytes, places: int) -> list[bytes]:
    """Inputs that put one number into a state, after nothing and after one step, at every place."""
    kinds, number = (2, 5), (7).to_bytes(8, "little")
    signs = (0, 0x80)
    return [
        choice + bytes([kind, at, 0, sign]) + number
        for kind in kinds
        for at in range(places)
        for sign in signs
    ]


def _number(value: float) -> bytes:
    """As targets read a number (`Input::f64`)."""
    return b"\xef" + struct.pack("<d", value)


def _positive(value: float) -> bytes:
    """As `Input::positive` reads it: a multiple of 1/32."""
    return bytes([0, round(32 * value) - 1])


def _assignments() -> Iterator[bytes]:
    """Full square tables with any costs, of which all rows can be assigned."""
    rng = np.random.default_rng(1)
    for size in range(1, 9):
        costs = b"".join(bytes([0, cost]) for cost in rng.integers(0, 256, size * size))
        yield bytes([size, size, 1]) + costs + _number(2.0)


def _rooms() -> Iterator[bytes]:
    """A sensor in one room: at rest, and on its way."""
    for room in (0, 2):
        yield b"\0\x80" + 12 * bytes([10, 0, room, 0, 0])
        steps = (_number(0.1 * step) for step in range(12))
        ways = (bytes([10, 7, 0, 0]) + step + b"\xf0\xf0" for step in steps)
        yield b"\0\x80" + b"".join(way + bytes([room, 0, 0]) for way in ways)


def _scenes() -> Iterator[bytes]:
    """One body of each shape at the origin, which rays along the axes meet."""
    rays = b"".join(
        b"".join(_number(5.0 * side) for side in sides)
        + b"".join(_number(-side) for side in sides)
        + _number(0.0)
        + _positive(1.0)
        for sides in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1))
    )
    still = bytes([0, 0, 0]) + 3 * _number(0.0) + b"\0"
    for shape, sizes in enumerate((2, 3, 2, 3, 1)):
        yield bytes([0, 0, 1, shape]) + sizes * _positive(1.0) + still + b"\0" + rays


TYPICAL: dict[str, Callable[[], Iterator[bytes]]] = {
    "assignment": _assignments,
    "rooms": _rooms,
    "scenes": _scenes,
}
"""Inputs of ordinary use, where arbitrary bytes seldom are: a mutation of them goes deeper."""


def fresh(folder: Path) -> None:
    """Write those of states and maps into the corpus of a run: of the layout that is built now."""
    known = states()
    # As short as one with a scan can be; and with numbers that take several bytes.
    many = 20.0 * np.stack(np.meshgrid(*[np.arange(6.0)] * 3), axis=-1).reshape(-1, 3)
    for detections in (np.empty((0, 3)), many):
        known["state_tracker"].append(prefix("state_tracker") + _tracker_after(detections))
    for target in targets():
        if target not in known:
            typical = TYPICAL.get(target, lambda: iter(()))
            known[target] = [*typical(), *_plain(target, USUAL)]
    for target, contents in known.items():
        place = folder / "corpus" / target
        place.mkdir(parents=True, exist_ok=True)
        choice, places = CHOICES.get(target, b""), 24 if target in SLOW else 64
        short = _single_numbers(choice, places) if target.startswith("state_") else []
        longest = LONGEST.get(target, USUAL)
        fitting = [one for one in (*contents, *short) if len(one) <= longest]
        for number, content in enumerate(fitting):
            (place / f"fresh-{number}").write_bytes(content)


def write() -> None:
    """Write the corpus in git again: after a change of a layout, with which the old ones end."""
    known = states()
    for target in targets():
        folder = CORPUS / target
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.glob("seed-*"):
            old.unlink()
        rng = np.random.default_rng(1)
        longest = min(MOST_BYTES, LONGEST.get(target, USUAL))
        contents = [one for one in known.get(target, []) if len(one) <= longest]
        contents = contents[:1] + contents[1:][-1:]  # the plainest, and the richest
        plain = [
            bytes(rng.integers(0, 200, 64, np.uint8)),
            bytes(rng.integers(0, 256, 400, np.uint8)),
        ]
        for number, content in enumerate([*contents, *plain]):
            (folder / f"seed-{number}").write_bytes(content)


if __name__ == "__main__":
    write()
