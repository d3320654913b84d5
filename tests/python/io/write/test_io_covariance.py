"""Columns of covariances hold the whole matrix."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lidar_core.io.tables.covariance import (
    covariance_columns,
    covariance_titles,
    symmetric,
    upper_triangle,
)


@given(size=st.integers(1, 7), rows=st.integers(0, 3), seed=st.integers(0, 99))
def test_a_matrix_comes_back_from_its_columns(size, rows, seed):
    half = np.random.default_rng(seed).normal(size=(rows, size, size))
    matrices = half + half.swapaxes(1, 2)
    np.testing.assert_array_equal(symmetric(upper_triangle(matrices, size), size), matrices)


def test_titles_name_the_pairs_row_by_row():
    assert covariance_titles("xyz") == [
        "cov_x_x",
        "cov_x_y",
        "cov_x_z",
        "cov_y_y",
        "cov_y_z",
        "cov_z_z",
    ]


def test_columns_of_the_first_states_alone():
    matrix = np.arange(9.0).reshape(1, 3, 3)
    columns = covariance_columns(("x", "y"), matrix)
    assert {title: values.tolist() for title, values in columns.items()} == {
        "cov_x_x": [0.0],
        "cov_x_y": [1.0],
        "cov_y_y": [4.0],
    }
