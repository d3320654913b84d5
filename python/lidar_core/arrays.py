"""Array aliases, and the only check of arrays from users before the core reads them."""

from operator import index
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core.errors import InputError

__all__ = [
    "Points",
    "as_finite_rows",
    "as_mask",
    "as_points",
    "as_pose",
    "as_poses",
    "as_real",
    "as_rows",
    "as_stamp",
    "as_vector",
]

Points: TypeAlias = NDArray[np.float32]
"""Coordinates [m], shape (N, 3)."""


def as_points(points: ArrayLike, *, name: str = "points") -> Points:
    """Return rows of coordinates as a C-contiguous float32 array of shape (N, 3).

    Such an array passes uncopied; other real dtypes and layouts are copied once.
    An organised cloud (H, W, 3) is viewed as (H*W, 3), row-major.

    Raises
    ------
    InputError
        Wrong shape, or a dtype that holds no real numbers.
    """
    array = as_real(points, name=name)
    if array.ndim == 3 and array.shape[2] == 3:
        array = array.reshape(-1, 3)
    if array.ndim != 2 or array.shape[1] != 3:
        cure = _cure(array.shape, name)
        raise InputError(f"{name}: expected shape (N, 3), got {array.shape}{cure}")
    with np.errstate(over="ignore"):  # beyond float32 is infinite: no point
        return np.ascontiguousarray(array, dtype=np.float32)


def as_rows(
    values: ArrayLike, *, name: str, rows: int | None, shape: tuple[int, ...], dtype: type[Any]
) -> NDArray[Any]:
    """Return `values` as a C-contiguous array (rows, *shape); `rows` None means any number."""
    array = as_real(values, name=name)
    expected = ("N" if rows is None else rows, *shape)
    if array.shape[1:] != shape or array.ndim != 1 + len(shape) or rows not in (None, len(array)):
        text = "(" + ", ".join(map(str, expected)) + (",)" if len(expected) == 1 else ")")
        cure = _cure(array.shape, name) if expected == ("N", 3) else ""
        raise InputError(f"{name}: expected shape {text}, got {array.shape}{cure}")
    if np.issubdtype(dtype, np.integer) and not np.issubdtype(array.dtype, np.integer):
        raise InputError(f"{name}: expected integers, got dtype {array.dtype}")
    if np.issubdtype(dtype, np.integer) and array.size:
        low, high, range_of = array.min(), array.max(), np.iinfo(dtype)
        if low < range_of.min or high > range_of.max:
            raise InputError(f"{name}: expected values of {np.dtype(dtype)}, got {low} to {high}")
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array, dtype=dtype)


def as_finite_rows(
    values: ArrayLike, *, name: str, rows: int | None, shape: tuple[int, ...]
) -> NDArray[np.float64]:
    """Convert like `as_rows` to float64, and check that every number is finite."""
    array = as_rows(values, name=name, rows=rows, shape=shape, dtype=np.float64)
    finite = np.isfinite(array).all(axis=tuple(range(1, array.ndim)))
    if not finite.all():
        row = int(np.argmin(finite))
        raise InputError(f"{name}: expected finite values, got {array[row].tolist()} in row {row}")
    return array


def as_mask(values: ArrayLike, *, name: str, rows: int) -> NDArray[np.bool_]:
    """Return `values` as a C-contiguous boolean array of shape (rows,); (H, W) is flattened."""
    array = np.asarray(values)
    if array.dtype != np.bool_:
        raise InputError(f"{name}: expected dtype bool, got {array.dtype}")
    if array.size != rows or array.ndim not in (1, 2):
        raise InputError(f"{name}: expected shape ({rows},), got {array.shape}")
    return np.ascontiguousarray(array.reshape(-1))


def as_pose(matrix: ArrayLike, *, name: str = "world_from_lidar") -> NDArray[np.float64]:
    """Return a rigid transform as a (4, 4) float64 array; scale, shear and NaN are refused."""
    poses = as_poses(matrix, name=name)
    if len(poses) != 1 or np.ndim(matrix) != 2:
        raise InputError(f"{name}: expected shape (4, 4), got {np.shape(matrix)}")
    pose: NDArray[np.float64] = poses[0]
    return pose


def as_poses(matrices: ArrayLike, *, name: str = "world_from_lidar") -> NDArray[np.float64]:
    """Return one rigid transform (4, 4) or several (K, 4, 4) as a (K, 4, 4) float64 array."""
    array = as_real(matrices, name=name)
    if array.ndim not in (2, 3) or array.shape[-2:] != (4, 4) or not len(array):
        raise InputError(f"{name}: expected shape (4, 4) or (K, 4, 4), got {array.shape}")
    poses = np.ascontiguousarray(array, dtype=np.float64).reshape(-1, 4, 4)
    for pose in poses:
        rotation = pose[:3, :3]
        if not (
            np.isfinite(pose).all()
            and (np.abs(rotation) < 2).all()  # the product of larger ones may overflow
            and np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4)
            and np.linalg.det(rotation) > 0
            and np.array_equal(pose[3], [0, 0, 0, 1])
        ):
            raise InputError(
                f"{name}: expected a finite rotation and translation, last row 0 0 0 1,"
                f" got {pose.tolist()}"
            )
    return poses


def as_vector(values: ArrayLike, *, name: str, size: int) -> NDArray[np.float64]:
    """Return `values` as a finite float64 array of shape (size,)."""
    array = as_real(values, name=name)
    if array.shape != (size,):
        raise InputError(f"{name}: expected shape ({size},), got {array.shape}")
    vector = np.ascontiguousarray(array, dtype=np.float64)
    if not np.isfinite(vector).all():
        raise InputError(f"{name}: expected finite values, got {vector.tolist()}")
    return vector


def as_stamp(stamp_ns: int, *, name: str = "stamp_ns") -> int:
    """Return a time as an int64 count of nanoseconds."""
    try:
        stamp = index(stamp_ns)
    except TypeError as error:
        raise InputError(
            f"{name}: expected an integer [ns], got {type(stamp_ns).__name__}"
        ) from error
    if not -(2**63) <= stamp < 2**63:
        raise InputError(f"{name}: expected an int64 count of nanoseconds, got {stamp}")
    return stamp


def as_real(values: ArrayLike, *, name: str) -> NDArray[Any]:
    """Return `values` as an array of integers or floats; masked entries are refused."""
    if np.ma.is_masked(values):
        raise InputError(f"{name}: expected no masked entries; fill them with NaN first")
    try:
        array = np.asarray(values)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{name}: expected an array of numbers, got {type(values).__name__}: {error}"
        ) from error
    if array.dtype.kind not in "fiu":
        raise InputError(f"{name}: expected real numbers, got {_no_numbers(values, array, name)}")
    return array


def _no_numbers(values: object, array: NDArray[Any], name: str) -> str:
    """Error text about `values` that are no numbers, with a remedy for fields x, y, z."""
    if array.dtype.kind == "O" and array.ndim == 0:
        return f"a {type(values).__name__}"
    if {"x", "y", "z"} <= set(array.dtype.names or ()):
        return (
            f"the fields {', '.join(array.dtype.names or ())}; make rows of three numbers:"
            f' numpy.lib.recfunctions.structured_to_unstructured({name}[["x", "y", "z"]])'
        )
    return f"dtype {array.dtype}"


def _cure(shape: tuple[int, ...], name: str) -> str:
    """Remedy for an array whose shape is not (N, 3); empty if the intention is unclear."""
    if len(shape) < 2 or shape[-1] <= 3:
        return ""
    transpose, slice_it = f"transpose it: {name}.T", "slice the coordinates first"
    if len(shape) > 2 or shape[0] != 3:
        return f"; {slice_it}"
    # Three rows of four to six values are also three points with more columns.
    return f"; {transpose}" if shape[1] > 6 else f"; {transpose}, or {slice_it}"


def __dir__() -> list[str]:
    return __all__
