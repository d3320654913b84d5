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
    person_probability: np.ndarray | None = None
    seen_ns: np.ndarray | None = None
    existence: np.ndarray | None = None
    kind: np.ndarray | None = None
    kind_probability: np.ndarray | None = None

    def __post_init__(self):
        count = len(self.id)
        if self.person_probability is None:
            self.person_probability = np.linspace(0.0, 0.9, count)
        if self.existence is None:
            self.existence = np.linspace(0.5, 1.0, count)
        if self.kind is None:
            self.kind = np.full(count, 3, np.uint8)
        if self.kind_probability is None:
            self.kind_probability = np.tile([0.1, 0.0, 0.1, 0.8, 0.0], (count, 1))
        if self.seen_ns is None:
            self.seen_ns = np.full(count, self.stamp_ns)
