"""Data of pictures, as plain arrays."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lidar_core.objects import CircleElements, ShapeElements, Tracks


@dataclass(frozen=True, slots=True)
class FlyingView:
    """A run of the flying-object detector, world frame.

    Attributes
    ----------
    title : str
        Headline.
    cloud, cloud_class : ndarray, shapes (N, 3), float64, and (N,), uint8
        The last scan [m], and the `PointClass` of its points.
    flying : ndarray, shape (K, 3), float64
        Points classified as flying, of all scans [m].
    occupied : ndarray, shape (V, 3), float64
        Centres of occupied voxels [m].
    voxel_size : float
        Edge of a voxel [m].
    sensor : ndarray, shape (S, 3), float64
        Positions of the sensor, one per scan [m].
    stamp_ns : ndarray, shape (S,), int64
        Times of the scans [ns].
    tracks : sequence of Tracks
        Tracks, one per scan.
    n_detections : ndarray, shape (S,), int64
        Detections per scan.
    truth : mapping of int to ndarray, shape (S, 3), float64
        True positions of every target [m]; NaN where unknown. Empty without truth.
    recall : mapping of str to pair of ndarray
        Per name, times [ns] and share of targets found.
    moving, moving_scan : ndarray, shapes (M, 3), float64, and (M,), int64
        Points that move on the ground, of all scans [m], and the index of their scan, from 0.
    """

    title: str
    cloud: NDArray[np.float64]
    cloud_class: NDArray[np.uint8]
    flying: NDArray[np.float64]
    occupied: NDArray[np.float64]
    voxel_size: float
    sensor: NDArray[np.float64]
    stamp_ns: NDArray[np.int64]
    tracks: Sequence[Tracks]
    n_detections: NDArray[np.int64]
    truth: Mapping[int, NDArray[np.float64]] = field(default_factory=dict)
    recall: Mapping[str, tuple[NDArray[np.int64], NDArray[np.float64]]] = field(
        default_factory=dict
    )
    moving: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 3)))
    moving_scan: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))


@dataclass(frozen=True, slots=True)
class CirclesView:
    """A run of the circle pipeline, world frame, from above.

    Attributes
    ----------
    title : str
        Headline.
    points : sequence of ndarray, shape (N, 2), float64
        Points of every scan that can be shown [m]; empty for a scan whose points were not kept.
        The picture shows the last one and, pale, the others.
    sensor : ndarray, shape (S, 2), float64
        Positions of the sensor, one per scan [m].
    stamp_ns : ndarray, shape (S,), int64
        Times of the scans [ns].
    maps : sequence of map states
        Elements, one state per scan.
    n_circles : ndarray, shape (S,), int64
        Circles found per scan.
    shapes : sequence of map states
        Lines, ellipses and rectangles, one state per scan; empty: none are shown.
    truth : mapping of int to ndarray, shape (S, 2), float64
        True centres of every object [m]; NaN where unknown. Empty without truth.
    """

    title: str
    points: Sequence[NDArray[np.float64]]
    sensor: NDArray[np.float64]
    stamp_ns: NDArray[np.int64]
    maps: Sequence[CircleElements]
    n_circles: NDArray[np.int64]
    shapes: Sequence[ShapeElements] = ()
    truth: Mapping[int, NDArray[np.float64]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class PlanarLine:
    """Positions of one object over time, in the plane.

    Attributes
    ----------
    stamp_ns : ndarray, shape (K,), int64
        Times, ascending [ns].
    position : ndarray, shape (K, 2), float64
        Position [m].
    covariance : ndarray, shape (K, 2, 2), float64, or None
        Covariance of the position [m^2]; None for a truth.
    """

    stamp_ns: NDArray[np.int64]
    position: NDArray[np.float64]
    covariance: NDArray[np.float64] | None = None


@dataclass(frozen=True, slots=True)
class FusionView:
    """Targets fused from LiDAR and radar.

    Attributes
    ----------
    title : str
        Headline.
    seen : mapping of str to ndarray, shape (M, 2), float64
        Measured positions by sensor [m]; the radar's from range and bearing.
    tracks : mapping of int to PlanarLine
        Estimates by the ID of the track.
    truth : mapping of int to PlanarLine
        True positions by target; empty without truth.
    nis : mapping of str to pair of ndarray, shape (N,)
        By sensor: times [ns], and NIS divided by its 95 % limit. One value in twenty is expected
        above 1.
    sensor : ndarray, shape (S, 2), float64
        Path of a moving sensor [m]; empty for a sensor at rest.
    """

    title: str
    seen: Mapping[str, NDArray[np.float64]]
    tracks: Mapping[int, PlanarLine]
    truth: Mapping[int, PlanarLine]
    nis: Mapping[str, tuple[NDArray[np.int64], NDArray[np.float64]]]
    sensor: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
