"""Hand-written stub of the compiled module, checked by stubtest."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["__version__", "traverse"]

__version__: str

def traverse(
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    *,
    voxel_size: float,
    origin: NDArray[np.float64],
) -> tuple[NDArray[np.int32], NDArray[np.float64]]: ...
