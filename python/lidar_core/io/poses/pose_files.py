"""Readers of poses in text files: KITTI (one matrix per line and scan), TUM (with times)."""

import warnings
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidar_core.arrays import as_pose
from lidar_core.errors import FormatError, InputError
from lidar_core.files import check_regular
from lidar_core.io.files.guard import check_size, reading
from lidar_core.io.options import LONGEST
from lidar_core.io.rotations import pose_matrix, unit_quaternion

KITTI_COLUMNS, TUM_COLUMNS = 12, 8
MAX_FILE_BYTES = 256 * 2**20


def read_matrices(path: Path) -> NDArray[np.float64]:
    """Read the poses (N, 4, 4) of a KITTI file.

    Raises
    ------
    FormatError
        A line does not have twelve numbers, or its matrix is no rotation.
    """
    rows = _numbers(path)
    if rows.shape[1] != KITTI_COLUMNS:
        raise FormatError(f"{path}: expected {KITTI_COLUMNS} numbers a line, got {rows.shape[1]}")
    return _matrices(path, rows)


def read_poses(path: Path) -> tuple[NDArray[np.int64] | None, NDArray[np.float64]]:
    """Read stamps [ns] and poses (N, 4, 4) of a TUM file; stamps are None for a KITTI file.

    Raises
    ------
    FormatError
        A line has neither eight nor twelve numbers, or no rotation.
    """
    rows = _numbers(path)
    if rows.shape[1] == KITTI_COLUMNS:
        return None, _matrices(path, rows)
    if rows.shape[1] != TUM_COLUMNS:
        raise FormatError(
            f"{path}: expected {KITTI_COLUMNS} (KITTI) or {TUM_COLUMNS} (TUM: t x y z qx qy qz qw)"
            f" numbers a line, got {rows.shape[1]}"
        )
    quaternions = np.array(
        [unit_quaternion(row[4:], place=f"{path}, pose {n}") for n, row in enumerate(rows)]
    )
    return _stamps(path, rows[:, 0]), pose_matrix(rows[:, 1:4], quaternions)


def _stamps(path: Path, seconds: NDArray[np.float64]) -> NDArray[np.int64]:
    """Read the first column as exact nanoseconds: float64 has epoch seconds only to 0.2 us."""
    late = np.flatnonzero(np.abs(seconds) > LONGEST)
    if len(late):
        raise FormatError(
            f"{path}, pose {late[0]}: expected a time in seconds, at most {LONGEST:.0f} s from"
            f" 1970, got {seconds[late[0]]:g}; divide milliseconds or nanoseconds first"
        )
    text = path.read_text("utf-8", "replace")
    rows = (line.partition("#")[0].split() for line in text.splitlines())
    stamps = [stamp_from_text(row[0]) for row in islice(filter(None, rows), len(seconds))]
    return np.array(stamps, np.int64)


def stamp_from_text(text: str) -> int:
    """Convert decimal seconds to nanoseconds, exactly (without float) where possible."""
    whole, _, fraction = text.partition(".")
    if whole.lstrip("-").isdigit() and (fraction.isdigit() or not fraction):
        part = int(fraction.ljust(9, "0")[:9])
        return int(whole) * 1_000_000_000 + (-part if whole.startswith("-") else part)
    return round(float(text) * 1e9)


def _numbers(path: Path) -> NDArray[np.float64]:
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such poses file")
    check_size(
        str(path),
        check_regular(path).stat().st_size,
        limit=MAX_FILE_BYTES,
        key="nothing",
        what="a file of bytes",
    )
    with reading(str(path)), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of an empty file: said below
        rows = np.loadtxt(path, ndmin=2)
    if rows.size == 0:
        raise FormatError(f"{path}: no poses in this file")
    if not np.isfinite(rows).all():
        raise FormatError(f"{path}: a number is not finite")
    return rows


def _matrices(path: Path, rows: NDArray[np.float64]) -> NDArray[np.float64]:
    matrices = np.tile(np.eye(4), (len(rows), 1, 1))
    matrices[:, :3, :] = rows.reshape(-1, 3, 4)
    for number, matrix in enumerate(matrices):
        try:
            as_pose(matrix)
        except InputError as error:
            raise FormatError(f"{path}, pose {number}: {error}") from error
    return matrices
