"""Circles from scans that show one object each, sec. IV."""

from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from lidar_core import _core
from lidar_core.arrays import as_finite_rows, as_rows
from lidar_core.circles.estimators.detector_name import checked
from lidar_core.circles.estimators.fit_config import FitConfig, FitMethod
from lidar_core.circles.estimators.fitting import Circles
from lidar_core.circles.estimators.network import CircleNetwork
from lidar_core.circles.scanner import Scanner
from lidar_core.config import as_config
from lidar_core.errors import ConfigError, InputError


class CircleDetector:
    """Estimator of circles, each from a scan that shows one object only.

    Parameters
    ----------
    detector : str
        "ml" (best), "mode", "taubin", "pratt" or "kasa": `FitConfig.method`; the name of a network
        that comes with the package, "cnn" or "paper-cnn"; or an ONNX file that `lidar-core export`
        wrote.
    config : FitConfig, optional
        Other settings of the fit; `detector` replaces its `method`. A network uses `range_std` and
        `beam_half_width`.
    scanner : Scanner, optional
        Scanner that measures the ranges; only its range limits matter.
    threads : int
        Number of threads of a network, >= 1.
    allow_untrusted : bool
        Run an ONNX file that is neither shipped nor exported by this user. A model is a program.

    Raises
    ------
    ConfigError
        There is no such detector, its file is not trusted, or `threads` is not >= 1.
    FormatError
        The file is not a network for circles.

    Notes
    -----
    "ml" reports the mean of all possible circles, weighted by their probability given the ranges,
    the rays that passed beside the object, the edges of the field of view and the range limits. All
    centres have the same prior probability, and so have all radii up to `FitConfig.usual_radius`.
    The covariance is that of the same distribution. "mode" reports the circle with the largest
    likelihood.

    Networks that take the window of each object, in the window's own frame, also estimate the
    covariance. The paper's network (Table I) works with one scanner only, and gives all circles the
    same covariance.
    """

    def __init__(
        self,
        detector: str | Path = "ml",
        *,
        config: FitConfig | None = None,
        scanner: Scanner | None = None,
        threads: int = 1,
        allow_untrusted: bool = False,
    ) -> None:
        try:
            checked(detector)
        except ValueError as error:
            raise ConfigError(f"detector: {error}, got {detector!r}") from error
        fit = as_config(config, FitConfig)
        self.scanner = as_config(scanner, Scanner)
        self.network: CircleNetwork | None = None
        if detector in get_args(FitMethod):
            self.config = FitConfig.load(fit.model_dump() | {"method": detector})
        else:
            self.config = fit
            self.network = CircleNetwork(detector, threads=threads, allow_untrusted=allow_untrusted)

    def detect(self, ranges_batch: ArrayLike, bearings: ArrayLike) -> Circles:
        """Estimate one circle per scan.

        Parameters
        ----------
        ranges_batch : array_like, shape (B, n_beams), float32
            Distances [m], one scan per row; +inf is a miss, NaN no information. Must not be
            written to during the call.
        bearings : array_like, shape (n_beams,)
            Direction of every ray [rad], in the order of the sweep; any spacing.

        Returns
        -------
        Circles
            One per row; NaN, with 0 hits, where a row has no hit.

        Raises
        ------
        InputError
            Wrong shape or dtype, a bearing that is not finite, a range <= 0.

        Notes
        -----
        Deterministic; releases the GIL.

        Examples
        --------
        >>> bearings = np.radians(np.arange(-10, 10.25, 0.25))
        >>> miss = np.sin(bearings) * 4.0  # a circle of 0.3 m at (4, 0)
        >>> root = np.sqrt(np.maximum(0.3**2 - miss**2, 0))
        >>> ranges = np.where(abs(miss) < 0.3, np.cos(bearings) * 4.0 - root, np.inf)
        >>> circles = CircleDetector("ml").detect([ranges], bearings)
        >>> np.asarray(circles).round(2) + 0.0
        array([[4. , 0. , 0.3]])
        """
        angles = as_finite_rows(bearings, name="bearings", rows=None, shape=())
        rows = as_rows(
            ranges_batch,
            name="ranges_batch",
            rows=None,
            shape=(len(angles),),
            dtype=np.float32,
        )
        wrong = np.argwhere(rows <= 0)
        if len(wrong):
            row, ray = wrong[0]
            raise InputError(
                f"ranges_batch: expected ranges > 0, got {rows[row, ray]} in row {row}, ray {ray}"
            )
        if self.network is None:
            found = _core.detect_circles(rows, angles, config=self.config, scanner=self.scanner)
            return Circles(*found)
        return self.network.of_rows(rows, angles, config=self.config, scanner=self.scanner)
