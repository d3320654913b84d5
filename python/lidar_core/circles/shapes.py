"""Shape of a group of rays: circle, ellipse, rectangle or line."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_core import _core
from lidar_core.circles.estimators.fit_config import FitConfig
from lidar_core.circles.preprocess import as_scan
from lidar_core.circles.scanner import Scanner
from lidar_core.circles.segmentation import Segments, arrays_of
from lidar_core.config import as_config
from lidar_core.messages import ShapeKind, ShortRepr


@dataclass(frozen=True, slots=True, repr=False)
class Shapes(ShortRepr):
    """Shapes seen in one frame, one row per segment.

    Attributes
    ----------
    kind : ndarray, shape (S,), uint8
        A `ShapeKind`.
    parameters : ndarray, shape (S, 5), float64
        Parameters in the order of `ShapeKind`; parameters that a shape does not have are 0.
    covariance : ndarray, shape (S, 5, 5), float64
        Covariance of the parameters, in their units ([m] and [rad]). A parameter that the rays do
        not determine has a standard deviation of 1 (m or rad).
    misfit : ndarray, shape (S,), float64
        Sum of squared residuals of the ranges over their variance (no unit).
    n_hits : ndarray, shape (S,), int64
        Rays that ended on the shape.
    """

    kind: NDArray[np.uint8]
    parameters: NDArray[np.float64]
    covariance: NDArray[np.float64]
    misfit: NDArray[np.float64]
    n_hits: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.kind)

    def ends(self) -> NDArray[np.float64]:
        """Both ends of every line [m], shape (S, 2, 2); NaN for other shapes."""
        angle, distance, *along = self.parameters[:, :4].T
        normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        tangent = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
        found = np.stack([distance[:, None] * normal + s[:, None] * tangent for s in along], axis=1)
        found[self.kind != ShapeKind.LINE] = np.nan
        return found


def fit_shapes(
    ranges: ArrayLike,
    bearings: ArrayLike,
    segments: Segments,
    *,
    config: FitConfig | None = None,
    scanner: Scanner | None = None,
) -> Shapes:
    """Estimate the shape of each segment of a scan, and its place.

    Parameters
    ----------
    ranges : array_like, shape (B,), float
        Range of every ray [m]; +inf is a miss, NaN no information.
    bearings : array_like, shape (B,), float
        Directions of the rays [rad] in the order of the sweep; need not be equally spaced.
    segments : Segments
        Result of `segment` for the same scan.
    config : FitConfig, optional
        None for the defaults. Its `method` is ignored: circles are fitted with "ml".
    scanner : Scanner, optional
        Scanner whose range limits apply; None for the defaults.

    Returns
    -------
    Shapes

    Raises
    ------
    InputError
        Wrong shape, dtype or value; a segment with a ray that did not end on anything.

    Notes
    -----
    Every shape is fitted to the ranges. The shape with the least misfit plus number of parameters
    times logarithm of the number of rays is chosen (Schwarz, "Estimating the dimension of a model",
    1978). Circles and ellipses must end where rays pass beside the object; the ends of lines are
    parameters. Segments of fewer than 6 rays are circles. Deterministic; releases the GIL.

    Examples
    --------
    >>> from lidar_core.circles import segment
    >>> bearings = np.radians(np.arange(-10, 10.25, 0.25))
    >>> ranges = 3.0 / np.cos(bearings)  # a wall
    >>> shapes = fit_shapes(ranges, bearings, segment(ranges, bearings))
    >>> [ShapeKind(kind).name for kind in shapes.kind]
    ['LINE']
    >>> shapes.ends().round(1).tolist()
    [[[3.0, -0.5], [3.0, 0.5]]]
    """
    fit, limits = as_config(config, FitConfig), as_config(scanner, Scanner)
    given = (*as_scan(ranges, bearings), arrays_of(segments))
    return Shapes(*_core.fit_shapes(*given, config=fit, scanner=limits))
