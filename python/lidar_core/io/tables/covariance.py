"""Covariances in tables: a column cov_A_B for every pair of the upper triangle, row by row."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def covariance_titles(names: Sequence[str]) -> list[str]:
    """Titles of the columns, as cov_x_x, cov_x_y, cov_y_y."""
    return [f"cov_{first}_{second}" for at, first in enumerate(names) for second in names[at:]]


def upper_triangle(covariances: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Upper triangles, shape (..., size (size + 1) / 2), of the first `size` states of matrices."""
    rows, columns = np.triu_indices(size)
    found: NDArray[np.float64] = covariances[..., rows, columns]
    return found


def symmetric(values: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Return symmetric matrices (..., size, size) from their upper triangles."""
    rows, columns = np.triu_indices(size)
    matrices = np.empty((*values.shape[:-1], size, size))
    matrices[..., rows, columns] = matrices[..., columns, rows] = values
    return matrices


def covariance_columns(
    names: Sequence[str], covariances: NDArray[np.float64]
) -> dict[str, NDArray[np.float64]]:
    """Columns of the first states of matrices (K, N, N)."""
    values = upper_triangle(covariances, len(names))
    return dict(zip(covariance_titles(names), values.T, strict=True))
