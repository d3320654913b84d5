"""Hand-written stub of the compiled module, checked by stubtest."""

from collections.abc import Sequence
from os import PathLike
from typing import Any, Self, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "CIRCLE_CUT_MARGINS",
    "CircleMap",
    "CirclePipeline",
    "FlyingObjectDetector",
    "FusionStep",
    "Measurement",
    "Measurements",
    "Misses",
    "MultiTargetTracker",
    "PlantedPanic",
    "PointCloudTracker",
    "PreparedSweep",
    "SimScene",
    "SimShape",
    "SimTrajectory",
    "SweepTimes",
    "TargetFilter",
    "VoxelMap",
    "__version__",
    "assign_columns",
    "chi2_quantile",
    "circle_lattice",
    "circle_windows",
    "circles_from_answers",
    "cluster_points",
    "default_parameters",
    "detect_circles",
    "detection_probability",
    "fit_circles",
    "fit_shapes",
    "fusion_fit_noise",
    "fusion_models",
    "fusion_outcomes",
    "fusion_run",
    "fusion_run_batch",
    "fusion_smooth",
    "hit_probability",
    "limit_range",
    "make_circle_samples",
    "parameters_of",
    "point_covariance",
    "project_horizontal",
    "segment_scan",
    "target_center",
    "traverse",
    "vector_unit",
    "vector_units",
]

CIRCLE_CUT_MARGINS: list[float]
__version__: str

@final
class PlantedPanic:
    """Panics on purpose, for tests."""

    def __new__(cls) -> Self: ...
    def fall(self, place: str) -> None: ...
    def stand(self) -> int: ...

def vector_unit() -> str: ...
def vector_units() -> list[str]: ...
def traverse(
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    *,
    voxel_size: float,
    origin: NDArray[np.float64],
) -> tuple[NDArray[np.int32], NDArray[np.float64]]: ...
def cluster_points(
    points: NDArray[np.float32],
    *,
    max_distance: float,
    min_points: int,
    max_points: int | None,
    max_angle: float,
    origin: NDArray[np.float64],
) -> NDArray[np.int32]: ...
def target_center(
    points: NDArray[np.float64],
    sensor_origin: NDArray[np.float64],
    *,
    passing: NDArray[np.float64],
    range_std: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]: ...
def limit_range(
    ranges: NDArray[np.float64],
    bearings: NDArray[np.float64],
    world_from_lidar: NDArray[np.float64],
    *,
    planes: NDArray[np.float64],
    stamp_ns: int,
    ray_time_ns: NDArray[np.int64] | None,
    pose_stamps_ns: NDArray[np.int64] | None,
) -> NDArray[np.float64]: ...
def project_horizontal(
    ranges: NDArray[np.float64],
    bearings: NDArray[np.float64],
    world_from_lidar: NDArray[np.float64],
    *,
    mode: str,
    stamp_ns: int,
    ray_time_ns: NDArray[np.int64] | None,
    pose_stamps_ns: NDArray[np.int64] | None,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]: ...
def segment_scan(
    ranges: NDArray[np.float64],
    bearings: NDArray[np.float64],
    *,
    config: object,
    scanner: object,
) -> tuple[NDArray[np.int32], NDArray[np.uint32], NDArray[np.int64], NDArray[np.uint8]]: ...

_CircleArrays: TypeAlias = tuple[
    NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.bool_]
]

def detect_circles(
    ranges: NDArray[np.float32],
    bearings: NDArray[np.float64],
    *,
    config: object,
    scanner: object,
) -> _CircleArrays: ...
def fit_circles(
    ranges: NDArray[np.float64],
    bearings: NDArray[np.float64],
    segments: tuple[NDArray[np.uint32], NDArray[np.int64], NDArray[np.uint8]],
    *,
    config: object,
    scanner: object,
) -> _CircleArrays: ...
def fit_shapes(
    ranges: NDArray[np.float64],
    bearings: NDArray[np.float64],
    segments: tuple[NDArray[np.uint32], NDArray[np.int64], NDArray[np.uint8]],
    *,
    config: object,
    scanner: object,
) -> tuple[
    NDArray[np.uint8],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.int64],
]: ...
def parameters_of(model: str, config: object) -> str: ...
def default_parameters(model: str, mode: str) -> str: ...
def assign_columns(
    cost: NDArray[np.float64], *, gate: float, unassigned: float
) -> NDArray[np.int64]: ...
def chi2_quantile(probability: float, *, degrees: int) -> float: ...
def circle_lattice(
    scanner: object,
    *,
    reach: float,
    spacing: float,
    radius_steps: tuple[int, int],
    radius_step: float,
) -> NDArray[np.float64]: ...
def point_covariance(
    points: NDArray[np.float32],
    world_from_lidar: NDArray[np.float64],
    *,
    pose_covariance: NDArray[np.float64],
    range_std: float,
) -> NDArray[np.float64]: ...
def fusion_outcomes() -> list[str]: ...

_RunArrays: TypeAlias = tuple[
    NDArray[np.int64],
    NDArray[np.uint8],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
]

_TargetArrays: TypeAlias = tuple[
    NDArray[np.int64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.int64],
    NDArray[np.int64],
    NDArray[np.int64],
    NDArray[np.bool_],
    NDArray[np.float64],
    tuple[NDArray[np.uint8], NDArray[np.float64]],
]

def fusion_run(config: object, measurements: Measurements) -> _RunArrays: ...
def fusion_smooth(
    config: object, measurements: Measurements, *, lag_ns: int | None
) -> _RunArrays: ...
def fusion_run_batch(
    config: object, targets: Sequence[Measurements], *, threads: int
) -> list[_RunArrays]: ...
def fusion_models() -> list[tuple[str, list[str], str, bool]]: ...
def fusion_fit_noise(
    config: object,
    targets: Sequence[Measurements],
    *,
    sensors: bool,
    least_rate: float,
    evaluations: int,
) -> tuple[list[float], NDArray[np.float64], NDArray[np.float64], float]: ...
def hit_probability(
    points: NDArray[np.float64],
    covariance: NDArray[np.float64],
    *,
    voxel_size: float,
    origin: NDArray[np.float64],
    threads: int,
) -> NDArray[np.float64]: ...
def circle_windows(
    bearings: NDArray[np.float64],
    ranges: NDArray[np.float64],
    starts: NDArray[np.int64],
    sides: NDArray[np.uint8],
    *,
    gaps: NDArray[np.float64],
    noise: NDArray[np.float64],
    range_limits: tuple[float, float],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float64]]: ...
def circles_from_answers(
    frames: NDArray[np.float64], answers: NDArray[np.float32]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
def make_circle_samples(
    config: object,
    *,
    circles: NDArray[np.float64] | None,
    draws: int,
    seed: int,
    start: int,
    count: int,
    threads: int,
) -> tuple[
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.uint32],
    NDArray[np.uint32],
    NDArray[np.uint8],
    NDArray[np.float32],
]: ...
def detection_probability(
    directions: NDArray[np.float64],
    *,
    radius: float,
    distances: NDArray[np.float64],
    field_of_view: tuple[float, float],
    threads: int,
) -> NDArray[np.float64]: ...

@final
class VoxelMap:
    def __new__(cls, config: object, *, threads: int, origin: NDArray[np.float64]) -> Self: ...
    @staticmethod
    def from_state(state: bytes, *, threads: int) -> VoxelMap: ...
    def to_state(self) -> bytes: ...
    def integrate(
        self,
        points: NDArray[np.float32],
        point_class: NDArray[np.uint8],
        sensor_origin: NDArray[np.float64],
        *,
        ray_directions: NDArray[np.float32] | None,
        no_return: NDArray[np.bool_] | None,
    ) -> tuple[
        tuple[int, int, int], tuple[int, int, int], tuple[int, int], tuple[int, int, int]
    ]: ...
    def state_at(self, points: NDArray[np.float32]) -> NDArray[np.uint8]: ...
    def values_at(self, points: NDArray[np.float32]) -> NDArray[np.float32]: ...
    def set_occupied(self, points: NDArray[np.float32]) -> None: ...
    def set_free(self, points: NDArray[np.float32]) -> None: ...
    def is_floating(self, points: NDArray[np.float32], *, search_distance: float) -> bool: ...
    def remove_separate(self, *, max_gap: float, min_confident: int) -> int: ...
    def classify(
        self,
        points: NDArray[np.float32],
        labels: NDArray[np.int32],
        sensor_origin: NDArray[np.float64],
        *,
        config: object,
    ) -> NDArray[np.uint8]: ...
    def occupied_points(self) -> NDArray[np.float64]: ...
    def save(self, path: str | PathLike[str]) -> None: ...
    @staticmethod
    def load(path: str | PathLike[str], *, threads: int) -> VoxelMap: ...
    def to_bytes(self) -> bytes: ...
    def origin(self) -> list[float]: ...
    def parameters(self) -> dict[str, Any]: ...
    def size(self) -> tuple[int, int, int]: ...

@final
class CircleMap:
    def __new__(cls, config: object) -> Self: ...
    @staticmethod
    def from_state(config: object, state: bytes) -> CircleMap: ...
    def to_state(self) -> bytes: ...
    def update(
        self,
        circles: NDArray[np.float64],
        covariance: NDArray[np.float64],
        world_from_lidar: NDArray[np.float64],
        stamp_ns: int,
        *,
        sensor: int,
        pose_covariance: NDArray[np.float64] | None,
        delays: NDArray[np.float64] | None,
        view: tuple[NDArray[np.float64], NDArray[np.float64], tuple[float, float]] | None,
    ) -> tuple[
        bool,
        NDArray[np.int64],
        NDArray[np.int64],
        NDArray[np.int64],
        NDArray[np.int64],
        NDArray[np.int64],
    ]: ...
    def map_at(
        self, stamp_ns: int
    ) -> tuple[
        NDArray[np.int64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.int64],
        NDArray[np.bool_],
        NDArray[np.bool_],
        NDArray[np.float64],
        NDArray[np.float64],
        tuple[NDArray[np.uint8], NDArray[np.float64]],
    ]: ...
    def reset(self) -> None: ...

@final
class PreparedSweep:
    def scan(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]: ...
    def segments(
        self,
    ) -> tuple[NDArray[np.int32], NDArray[np.uint32], NDArray[np.int64], NDArray[np.uint8]]: ...

@final
class Misses:
    def __new__(cls) -> Self: ...
    def marked(
        self, ranges: NDArray[np.float32], *, range_min: float, range_max: float, nearest: float
    ) -> tuple[NDArray[np.float64], str]: ...

@final
class CirclePipeline:
    def __new__(cls, config: object, *, fit: object) -> Self: ...
    @staticmethod
    def from_state(config: object, state: bytes, *, fit: object) -> CirclePipeline: ...
    def to_state(self) -> bytes: ...
    def process(
        self,
        ranges: NDArray[np.float32],
        world_from_lidar: NDArray[np.float64],
        *,
        stamp_ns: int,
        scanner: str,
        pose_covariance: NDArray[np.float64] | None,
        ray_time_ns: NDArray[np.int64] | None,
        pose_stamps_ns: NDArray[np.int64] | None,
    ) -> dict[str, Any]: ...
    def prepare(
        self,
        ranges: NDArray[np.float32],
        world_from_lidar: NDArray[np.float64],
        *,
        stamp_ns: int,
        scanner: str,
        pose_covariance: NDArray[np.float64] | None,
        ray_time_ns: NDArray[np.int64] | None,
        pose_stamps_ns: NDArray[np.int64] | None,
    ) -> PreparedSweep: ...
    def integrate(
        self,
        prepared: PreparedSweep,
        circles: NDArray[np.float64],
        covariance: NDArray[np.float64],
        n_hits: NDArray[np.int64],
        is_fallback: NDArray[np.bool_],
    ) -> dict[str, Any]: ...
    def map_at(
        self, stamp_ns: int
    ) -> tuple[
        NDArray[np.int64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.int64],
        NDArray[np.bool_],
        NDArray[np.bool_],
        NDArray[np.float64],
        NDArray[np.float64],
        tuple[NDArray[np.uint8], NDArray[np.float64]],
    ]: ...
    def shapes_at(
        self, stamp_ns: int
    ) -> tuple[
        NDArray[np.int64],
        NDArray[np.uint8],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.int64],
        NDArray[np.bool_],
        NDArray[np.bool_],
    ]: ...
    def reset(self) -> None: ...

@final
class SimShape:
    @staticmethod
    def plane(size: tuple[float, float]) -> SimShape: ...
    @staticmethod
    def cuboid(size: tuple[float, float, float]) -> SimShape: ...
    @staticmethod
    def cylinder(radius: float, height: float) -> SimShape: ...
    @staticmethod
    def elliptic_cylinder(half_axes: tuple[float, float], height: float) -> SimShape: ...
    @staticmethod
    def sphere(radius: float) -> SimShape: ...
    @staticmethod
    def mesh(vertices: NDArray[np.float64], faces: NDArray[np.uint32]) -> SimShape: ...
    @staticmethod
    def height_field(heights: NDArray[np.float64], cell: float) -> SimShape: ...
    @property
    def radius(self) -> float: ...

@final
class SimTrajectory:
    def __new__(cls, stamps_ns: NDArray[np.int64], poses: NDArray[np.float64]) -> Self: ...
    def poses_at(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]: ...
    def velocities_at(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]: ...

@final
class SimScene:
    def __new__(
        cls,
        bodies: list[tuple[SimShape, NDArray[np.float64], int]],
        movers: list[tuple[SimShape, SimTrajectory, int]],
        *,
        threads: int,
        sways: Sequence[tuple[Sequence[float], float, float] | None] = ...,
        air: Sequence[object] = ...,
        surfaces: Sequence[object | None] = ...,
        mover_surfaces: Sequence[object | None] = ...,
        carried: Sequence[tuple[SimShape, NDArray[np.float64]]] = ...,
    ) -> Self: ...
    def scan(
        self, lidar: object, sensor: SimTrajectory, *, start_ns: int, scan: int, seed: int
    ) -> tuple[
        NDArray[np.float32],
        NDArray[np.float32],
        NDArray[np.bool_],
        NDArray[np.int32],
        NDArray[np.int64],
        NDArray[np.uint32],
    ]: ...
    def sweep(
        self, lidar: object, sensor: SimTrajectory, *, start_ns: int, scan: int, seed: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.uint32]]: ...
    def cast(
        self,
        origins: NDArray[np.float64],
        directions: NDArray[np.float64],
        range_max: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.int32]]: ...
    def clearance(self, points: NDArray[np.float64], limit: float) -> NDArray[np.float64]: ...
    def random_motion(
        self,
        config: object,
        sensor: SimTrajectory,
        *,
        apart: list[tuple[SimTrajectory, float]],
        span_ns: tuple[int, int],
        seed: tuple[int, int],
    ) -> SimTrajectory: ...

_Numbers: TypeAlias = NDArray[np.int64]
_TrackEventArrays: TypeAlias = tuple[
    bool, _Numbers, _Numbers, _Numbers, _Numbers, NDArray[np.int64], int
]
_TrackArrays: TypeAlias = tuple[
    _Numbers,
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    _Numbers,
    NDArray[np.float64],
    NDArray[np.bool_],
    NDArray[np.float64],
    tuple[NDArray[np.uint8], NDArray[np.float64]],
]

@final
class SweepTimes:
    def __new__(cls) -> Self: ...
    def parts(
        self, points: NDArray[np.float32], motion: list[list[float]]
    ) -> NDArray[np.float64] | None: ...

@final
class PointCloudTracker:
    def __new__(cls, config: object, *, threads: int) -> Self: ...
    @staticmethod
    def from_state(config: object, state: bytes, *, threads: int) -> PointCloudTracker: ...
    def to_state(self) -> bytes: ...
    def new_point_cloud(
        self,
        points: NDArray[np.float32],
        occupied: NDArray[np.float32],
        stamp_ns: int,
        *,
        sensor_origin: NDArray[np.float64] | None,
        delays: NDArray[np.float32] | None,
    ) -> _TrackEventArrays: ...
    def new_detections(
        self,
        positions: NDArray[np.float64],
        occupied: NDArray[np.float32],
        stamp_ns: int,
        *,
        covariance: NDArray[np.float64] | None,
        extent: NDArray[np.float64] | None,
        delay: NDArray[np.float64] | None,
    ) -> _TrackEventArrays: ...
    def tracks_at(self, stamp_ns: int) -> _TrackArrays: ...
    def reset(self) -> None: ...

@final
class FlyingObjectDetector:
    def __new__(cls, config: object, *, threads: int) -> Self: ...
    @staticmethod
    def from_state(config: object, state: bytes, *, threads: int) -> FlyingObjectDetector: ...
    def to_state(self) -> bytes: ...
    def process(
        self,
        points: NDArray[np.float32],
        world_from_lidar: NDArray[np.float64],
        stamp_ns: int,
        *,
        no_return: NDArray[np.bool_] | None,
        directions: NDArray[np.float32] | None,
        point_time_ns: NDArray[np.int64] | None,
        pose_stamps_ns: NDArray[np.int64] | None,
        pose_covariance: NDArray[np.float64] | None,
        sensor: str,
        organised: bool,
    ) -> dict[str, Any]: ...
    def tracks_at(self, stamp_ns: int, confirmed: bool) -> _TrackArrays: ...
    def set_teammates(
        self, ids: NDArray[np.int64], positions: NDArray[np.float64], *, radius: float
    ) -> None: ...
    def set_known(self, points: NDArray[np.float64], *, occupied: bool) -> None: ...
    def state_at(self, points: NDArray[np.float64]) -> NDArray[np.uint8]: ...
    def occupied_points(self) -> NDArray[np.float64]: ...
    def save_map(self, path: str | PathLike[str]) -> None: ...
    def sky_rays(self) -> tuple[NDArray[np.float64], NDArray[np.float32]]: ...
    def load_map(self, path: str | PathLike[str]) -> None: ...
    def make_static_map(self) -> None: ...
    def static_points(self) -> NDArray[np.float64]: ...
    def save_static_map(self, path: str | PathLike[str]) -> None: ...
    def map_bytes(self) -> bytes: ...
    def map_size(self) -> tuple[int, int, int]: ...
    def reanchor(self) -> bool: ...
    def reset(self) -> None: ...

@final
class Measurement:
    def __new__(
        cls,
        stamp_ns: int,
        sensor: str,
        values: NDArray[np.float64],
        *,
        measures: Sequence[bool] | None,
        covariance: NDArray[np.float64] | None,
        seen_from: Sequence[float] | None,
    ) -> Self: ...

@final
class Measurements:
    def __new__(cls, measurements: Sequence[Measurement]) -> Self: ...
    @staticmethod
    def from_arrays(
        stamps_ns: NDArray[np.int64],
        sensors: NDArray[np.uint8],
        values: NDArray[np.float64],
        *,
        counts: NDArray[np.uint8],
        covariances: NDArray[np.float64],
    ) -> Measurements: ...
    def __len__(self) -> int: ...

@final
class FusionStep:
    @property
    def stamp_ns(self) -> int: ...
    @property
    def outcome(self) -> str: ...
    @property
    def accepted(self) -> bool: ...
    @property
    def state(self) -> NDArray[np.float64] | None: ...
    @property
    def covariance(self) -> NDArray[np.float64] | None: ...
    @property
    def innovation(self) -> NDArray[np.float64] | None: ...
    @property
    def nis(self) -> float | None: ...

@final
class MultiTargetTracker:
    def __new__(cls, config: object) -> Self: ...
    @staticmethod
    def from_state(config: object, state: bytes) -> MultiTargetTracker: ...
    def to_state(self) -> bytes: ...
    def process(
        self, stamp_ns: int, source: int, measurements: Measurements
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]: ...
    def work(self) -> tuple[int, int, int]: ...
    def tracks_at(self, stamp_ns: int) -> _TargetArrays: ...

@final
class TargetFilter:
    def __new__(cls, config: object) -> Self: ...
    @staticmethod
    def from_state(config: object, state: bytes) -> TargetFilter: ...
    def to_state(self) -> bytes: ...
    def step(self, measurement: Measurement) -> FusionStep: ...
    def sensor_stds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
    def state_at(self, stamp_ns: int) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None: ...
