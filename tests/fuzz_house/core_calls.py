"""Calls of everything in `lidar_core._core` with arguments that its stub allows, and others.

Arguments are drawn by the annotations of the stub, so that a new callable has an entry at once. A
call may be refused with any error of Python or the package; it must not panic or abort.
"""

import ast
import inspect
import math
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import lidar_core
from lidar_core import _core

STUB = Path(lidar_core.__file__).with_name("_core.pyi")
REFUSED = (
    *(ValueError, TypeError, OverflowError, ArithmeticError, OSError, LookupError),
    *(AttributeError, MemoryError),
)
NUMBERS = (0.0, -0.0, 1.0, 0.5, -1.0, 1e-9, 1e9, 1e300, math.nan, math.inf, -math.inf)
WHOLE = (0, 1, 2, 3, -1, 100, 10**9, 2**31, 2**62, -(2**63), 2**63)
LEFT_OUT = {"PlantedPanic": "panics on purpose; tests of its own call it"}
SHAPES = ((), (0,), (3,), (4,), (1, 3), (5, 3), (4, 4), (2, 4, 4), (6, 6), (7,), (3, 3), (2, 2))


def stub_entries() -> dict[str, ast.FunctionDef]:
    """Every callable of the stub by its name."""
    found = {}
    for node in ast.parse(STUB.read_text()).body:
        if isinstance(node, ast.FunctionDef):
            found[node.name] = node
        elif isinstance(node, ast.ClassDef):
            inner = [part for part in node.body if isinstance(part, ast.FunctionDef)]
            found |= {f"{node.name}.{part.name}": part for part in inner}
    return {name: node for name, node in found.items() if name.split(".")[0] not in LEFT_OUT}


def callables() -> set[str]:
    """Every public callable of the module itself."""
    found = set()
    for name, value in vars(_core).items():
        if name.startswith("_") or name in LEFT_OUT:
            continue
        if inspect.isclass(value):
            inner = {part for part in vars(value) if not part.startswith("_")}
            found |= {f"{name}.{part}" for part in inner}
            if "__len__" in vars(value):
                found.add(f"{name}.__len__")
            if "__new__" in vars(value):
                found.add(f"{name}.__new__")
        elif callable(value):
            found.add(name)
    return found


class Caller:
    """Draws calls; objects that calls return are used by later ones."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.entries = stub_entries()
        self.objects: dict[str, list[Any]] = {}
        self.calls: dict[str, int] = dict.fromkeys(self.entries, 0)
        self.accepted: dict[str, int] = dict.fromkeys(self.entries, 0)
        self.configs = _configs()
        self.last = ""
        self.rows = 3

    def call(self, name: str) -> None:
        """One call of the entry `name`; an exception that is no refusal is a finding."""
        node, (head, _, method) = self.entries[name], name.partition(".")
        target: Callable[..., Any] = getattr(_core, head)
        is_static = any(
            isinstance(d, ast.Name) and d.id == "staticmethod" for d in node.decorator_list
        )
        is_value = any(isinstance(d, ast.Name) and d.id == "property" for d in node.decorator_list)
        if method and method != "__new__":
            if is_static:
                target = getattr(target, method)
            else:
                known = self.objects.get(head, [])
                if not known:
                    return
                owner = known[self.rng.integers(len(known))]
                target = (lambda: getattr(owner, method)) if is_value else getattr(owner, method)
        self.rows = int(self.rng.integers(1, 9))
        taken = [a for a in node.args.args if a.arg not in ("self", "cls")]
        given = [self._drawn(a.annotation, a.arg, name) for a in taken]
        named = {a.arg: self._drawn(a.annotation, a.arg, name) for a in node.args.kwonlyargs}
        self.last = f"{name}(*{given!r}, **{named!r})"[:2000]
        self.calls[name] += 1
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of numpy, about odd arrays
                result = target(*given, **named)
        except REFUSED:
            return
        self.accepted[name] += 1
        kind = type(result).__name__
        if type(result).__module__ == "lidar_core._core":
            pool = self.objects.setdefault(kind, [])
            pool.append(result)
            del pool[:-4]
        if method == "to_state" and isinstance(result, bytes):
            self.objects.setdefault(f"state {head}", []).append(result)

    def _drawn(self, annotation: ast.expr | None, argument: str, entry: str) -> Any:
        text = ast.unparse(annotation) if annotation is not None else "object"
        options = [part.strip() for part in text.split(" | ")]
        if "None" in options and self.rng.random() < 0.6:
            return None
        if self.rng.random() < 0.02:
            return [None, "text", b"", object(), [], {}, -1, 2**70][self.rng.integers(8)]
        return self._value(options[0], argument, entry)

    def _value(self, text: str, argument: str, entry: str) -> Any:
        pick = self._one_of
        if text.startswith("NDArray"):
            return self._array(text, argument)
        if text == "object":
            return self._config(argument, entry)
        if text in _core.__all__ if hasattr(_core, "__all__") else hasattr(_core, text):
            return pick(self.objects.get(text) or [None])
        if text.startswith(("tuple[", "list[", "Sequence[")):
            return self._sequence(text, argument, entry)
        if argument == "threads":
            return pick((1, 1, 1, 2, 0))
        simple: dict[str, Callable[[], Any]] = {
            "float": lambda: pick(NUMBERS) if self.rng.random() < 0.3 else float(self.rng.random()),
            "int": lambda: pick(WHOLE) if self.rng.random() < 0.5 else int(self.rng.integers(200)),
            "bool": lambda: bool(self.rng.integers(2)),
            "str": lambda: pick(_CHOICES.get(argument, _WORDS)),
            "bytes": lambda: self._state(entry),
        }
        return simple[text]() if text in simple else None

    def _one_of(self, values: Any) -> Any:
        return values[self.rng.integers(len(values))]

    def _state(self, entry: str) -> bytes:
        known = self.objects.get(f"state {entry.split('.', maxsplit=1)[0]}", [])
        state = bytearray(self._one_of(known)) if known else bytearray(self.rng.bytes(40))
        if state and self.rng.random() < 0.5:
            state[self.rng.integers(len(state))] ^= 1 << self.rng.integers(8)
        return bytes(state)

    def _sequence(self, text: str, argument: str, entry: str) -> Any:
        inner = text[text.index("[") + 1 : -1]
        if text.startswith("tuple["):
            parts = [part for part in _split(inner) if part != "..."]
            return tuple(self._value(part, argument, entry) for part in parts)
        count = int(self.rng.integers(4))
        return [
            self._value(_split(inner)[0].split(" | ")[0], argument, entry) for _ in range(count)
        ]

    def _array(self, text: str, argument: str) -> Any:
        kind = np.dtype(text.split("np.")[1].rstrip("]").rstrip("_"))
        shape = _ROW.get(argument, (-1,))
        shape = tuple(self.rows if size < 0 else size for size in shape)
        if self.rng.random() < 0.08:
            shape = self._one_of(SHAPES)
        if shape == (4, 4) and self.rng.random() < 0.8:
            return np.eye(4)
        if len(shape) > 1 and shape[-2:] in {(3, 3), (4, 4), (6, 6)} and self.rng.random() < 0.8:
            return np.broadcast_to(np.eye(shape[-1]), shape).astype(kind)
        if argument in _RISING and self.rng.random() < 0.8:
            return np.arange(self.rows).astype(kind)
        values = self.rng.normal(size=shape) * self._one_of((1.0, 1.0, 10.0, 1e6))
        if kind.kind in "iub":
            values = np.abs(values) * self._one_of((1.0, 1e8))
        with np.errstate(all="ignore"):
            made = np.asarray(values).astype(kind)
        if kind.kind == "f" and made.size and self.rng.random() < 0.2:
            with np.errstate(all="ignore"):
                odd_one = np.float64(self._one_of(NUMBERS)).astype(kind)
            made.flat[self.rng.integers(made.size)] = odd_one
        odd = self.rng.random()
        if odd < 0.03:
            made = made.astype(made.dtype.newbyteorder())
        elif odd < 0.06:
            made = np.asfortranarray(made)
        elif odd < 0.09 and made.ndim:
            made = made[::-1]
        elif odd < 0.11:
            with np.errstate(all="ignore"):
                made = made.astype(self._one_of(("f2", "i2", "c8", "U3", "O")))
        return made

    def _config(self, argument: str, entry: str) -> Any:
        head = entry.split(".", maxsplit=1)[0]
        keys = (entry, f"{head} {argument}", head)
        known = next((self.configs[key] for key in keys if key in self.configs), None)
        if known is None or self.rng.random() < 0.05:
            known = [None, *(one for several in self.configs.values() for one in several)]
        return self._one_of(known)


_WORDS = (
    *("lidar", "radar", "gyro", "pose", "exact", "paper", "best", "", "\0", "\ud800", "x" * 9),
    *("/nonexistent/file", "/dev/null", "expected", "FlyingConfig", "kasa", "space_pose"),
)
_CHOICES = {
    "scanner": ("lidar", "lidar", "rear", "\ud800"),
    "mode": ("exact", "paper", "best", "x"),
    "model": ("FlyingConfig", "CirclesConfig", "FusionConfig", "x"),
    "sensor": ("lidar", "radar", "gyro", "pose", "x"),
}
_ROW: dict[str, tuple[int, ...]] = {
    **dict.fromkeys(("origin", "start", "end", "sensor_origin"), (3,)),
    **dict.fromkeys(("world_from_lidar", "bodies", "carried"), (4, 4)),
    **dict.fromkeys(("points", "positions", "directions", "origins", "vertices", "faces"), (-1, 3)),
    **dict.fromkeys(("occupied", "passing", "extent", "circles", "ray_directions"), (-1, 3)),
    **dict.fromkeys(("covariance",), (-1, 3, 3)),
    **dict.fromkeys(("cost", "heights"), (-1, 4)),
    "poses": (-1, 4, 4),
    "planes": (-1, 4),
    "pose_covariance": (6, 6),
    "frames": (-1, 5),
    "answers": (-1, 9),
    "sides": (-1, 2),
    "gaps": (-1, 2),
    "noise": (-1, 2),
    "view": (-1,),
}
"""Shapes of arrays by argument, -1 for the rows of the call; others have one dimension."""
_RISING = ("stamps_ns", "pose_stamps_ns", "bearings", "starts")


def _split(text: str) -> list[str]:
    """The parts of a list of types."""
    parts, depth, start = [], 0, 0
    for place, letter in enumerate(text):
        depth += (letter == "[") - (letter == "]")
        if letter == "," and depth == 0:
            parts.append(text[start:place].strip())
            start = place + 1
    return [*parts, text[start:].strip()]


def _configs() -> dict[str, list[Any]]:
    """Configurations by class of the module, or by function and argument."""
    from lidar_core.circles import CircleMap, CirclePipeline, CirclesConfig, DatasetConfig
    from lidar_core.flying import FlyingConfig
    from lidar_core.flying.tracker import PointCloudTracker
    from lidar_core.fusion import FusionConfig, MultiTargetTracker

    flying, circles, fusion = FlyingConfig(), CirclesConfig(), FusionConfig()
    known: dict[str, list[Any]] = {
        "FlyingObjectDetector": [flying, FlyingConfig.paper()],
        "VoxelMap": [flying.voxel_map],
        "VoxelMap.classify": [getattr(flying, "classification", flying)],
        "PointCloudTracker": [PointCloudTracker().config],
        "CirclePipeline config": [circles, CirclesConfig.paper()],
        "CirclePipeline fit": [CirclePipeline()._fit],
        "CircleMap": [CircleMap().config],
        "TargetFilter": [fusion, FusionConfig.paper()],
        "MultiTargetTracker": [MultiTargetTracker().config],
        "circle_lattice scanner": [DatasetConfig().scanner],
        "make_circle_samples": [DatasetConfig()],
    }
    known |= {f"{name} scanner": [circles.scanner] for name in _OF_SCANS}
    known |= {f"{name} config": [circles.segment, circles.fit] for name in _OF_SCANS}
    known |= {f"fusion_{name}": [fusion] for name in ("run", "smooth", "run_batch", "fit_noise")}
    for config in (flying, circles, fusion):
        for name in type(config).model_fields:
            known.setdefault(name, []).append(getattr(config, name))
    return known


_OF_SCANS = ("segment_scan", "detect_circles", "fit_circles", "fit_shapes")
