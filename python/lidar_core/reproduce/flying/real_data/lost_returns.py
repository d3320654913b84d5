"""Patches of surfaces whose returns are lost, as on dark, wet and glossy ones."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lidar_core.io import PosedScan
from lidar_core.messages import Scan
from lidar_core.reproduce.flying.real_data.inserted_targets import NEAREST, RealScan

PATCHES, RADII = 60, (0.4, 2.5)
"""Patches of a sequence, their radius [m]."""
GRAZING = 0.35
"""Cosine of the angle between ray and normal below which a glossy surface gives nothing."""
FEWEST = 12
"""Returns of a patch from which its normal is taken."""
FARTHEST = 30.0


@dataclass(frozen=True, slots=True)
class Patch:
    """A ball in the world around part of a surface.

    Attributes
    ----------
    place, normal : ndarray, shape (3,)
        Centre [m] and normal, world frame.
    radius : float
        Radius [m].
    dimmest : float
        Returns below this intensity are lost.
    """

    place: NDArray[np.float64]
    normal: NDArray[np.float64]
    radius: float
    dimmest: float


def drawn_patches(scans: Sequence[RealScan], rng: np.random.Generator) -> list[Patch]:
    """Draw patches around random returns of random scans; the shapes of the surfaces follow."""
    found: list[Patch] = []
    for _ in range(20 * PATCHES):
        scan = scans[int(rng.integers(len(scans)))]
        points, radius = scan.item.scan.points.reshape(-1, 3), rng.uniform(*RADII)
        anchor = points[rng.integers(len(points))].astype(np.float64)
        if not NEAREST < np.linalg.norm(anchor) < FARTHEST:
            continue
        rows = np.linalg.norm(points - anchor, axis=1) < radius
        if rows.sum() < FEWEST:
            continue
        around = points[rows] - points[rows].mean(axis=0)
        normal = np.linalg.svd(around.astype(np.float64), full_matrices=False)[2][2]
        intensity = scan.item.scan.intensity
        dimmest = -np.inf if intensity is None else float(np.nanmedian(intensity[rows]))
        place = scan.pose[:3, :3] @ anchor + scan.pose[:3, 3]
        found.append(Patch(place, scan.pose[:3, :3] @ normal, radius, dimmest))
        if len(found) == PATCHES:
            break
    return found


def with_losses(scans: Sequence[RealScan], patches: Sequence[Patch]) -> list[PosedScan[Scan]]:
    """Return scans without the returns of patches that are dim or hit at a grazing angle.

    A lost return looks as the driver gives it: as zeros where the sequence has them, else the row
    is dropped.
    """
    return [replace(scan.item, scan=_with_losses(scan, patches)) for scan in scans]


def _with_losses(scan: RealScan, patches: Sequence[Patch]) -> Scan:
    source = scan.item.scan
    points = source.points.reshape(-1, 3)
    lost = np.zeros(len(points), np.bool_)
    for patch in patches:
        centre = scan.to_sensor(patch.place).astype(np.float32)
        rows = np.flatnonzero(np.linalg.norm(points - centre, axis=1) < patch.radius)
        slant = np.abs(scan.directions[rows] @ (scan.pose[:3, :3].T @ patch.normal))
        is_lost = slant < GRAZING
        if source.intensity is not None:
            is_lost |= source.intensity[rows] < patch.dimmest
        lost[rows[is_lost]] = True
    if source.no_return is not None:
        changed = points.copy()
        changed[lost] = np.nan
        return replace(
            source, points=changed.reshape(source.points.shape), no_return=source.no_return | lost
        )
    kept = ~lost
    return replace(
        source,
        points=points[kept],
        intensity=None if source.intensity is None else source.intensity[kept],
        ring=None if source.ring is None else source.ring[kept],
    )
