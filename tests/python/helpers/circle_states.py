"""Elements of a circle map, made by hand."""

from dataclasses import dataclass

import numpy as np


@dataclass
class Circles:
    """Elements at one time, as the pipeline gives them."""

    id: np.ndarray
    center: np.ndarray
    velocity: np.ndarray
    radius: np.ndarray
    covariance: np.ndarray
    age: np.ndarray
    visible: np.ndarray
    stamp_ns: int
