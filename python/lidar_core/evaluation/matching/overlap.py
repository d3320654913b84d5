"""Warnings about estimates and truth without common times or places: scores are meaningless."""

import numpy as np
from numpy.typing import NDArray

from lidar_core.config import as_config
from lidar_core.evaluation.config import EvaluationConfig
from lidar_core.evaluation.matching.pairing import pair
from lidar_core.evaluation.matching.tables import aligned
from lidar_core.evaluation.types import Estimates, Truth
from lidar_core.util.steps import nearest_row

BESIDE = 0.1
"""Largest offset of times that count as equal but shifted, as a share of the truth's interval."""


def overlap_warnings(
    estimates: Estimates, truth: Truth, *, what: str, config: EvaluationConfig | None = None
) -> list[str]:
    """Return warnings if estimates and truth do not overlap in time or space.

    Parameters
    ----------
    estimates : Estimates
        Estimates with their reported times, before `aligned`.
    truth : Truth
    what : str
        Name of the estimates in the text, such as "tracks".
    config : EvaluationConfig, optional
        `time_tolerance` and `gate`.

    Returns
    -------
    warnings : list of str
        Warnings: no common time, with both spans; times just outside the tolerance, with the
        typical offset; no estimate within the gate of any target, with the distances.
    """
    config = as_config(config, EvaluationConfig)
    if not (len(estimates.stamp_ns) and len(truth.stamp_ns)):
        return []
    found = _of_times(estimates.stamp_ns, truth.stamp_ns, config.time_tolerance, what)
    place = _of_places(aligned(estimates, truth, config=config), truth, config, what)
    return [text for text in (found, place) if text]


def time_offsets(stamps: NDArray[np.int64], truth: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return every time minus the nearest time of the truth [s]."""
    when = np.unique(truth)
    offsets = (stamps - when[nearest_row(when, stamps)]).astype(np.float64)
    return offsets * 1e-9


def spans(stamps: NDArray[np.int64], truth: NDArray[np.int64]) -> str:
    """Return the time spans of estimates and truth."""
    texts = [
        f"{column.min() * 1e-9:.3f} to {column.max() * 1e-9:.3f} s" for column in (stamps, truth)
    ]
    return f"{texts[0]} and {texts[1]}"


def _of_times(
    stamps: NDArray[np.int64], truth: NDArray[np.int64], tolerance: float, what: str
) -> str:
    offsets = time_offsets(stamps, truth)
    outside = np.abs(offsets) > tolerance
    if not outside.any():
        return ""
    if outside.all() and (stamps.max() < truth.min() or stamps.min() > truth.max()):
        return (
            f"{what} and truth have no time in common: {spans(stamps, truth)};"
            " of the same recording?"
        )
    cure = wider_tolerance(stamps[outside], truth)
    if cure is None:
        return ""  # times between those of the truth, or beyond its ends: not a shifted clock
    return (
        f"{outside.sum()} of {len(stamps)} {what} are just outside the tolerance of"
        f" {1e3 * tolerance:g} ms, {typical_offset(offsets[outside])}, and have no truth;"
        f" set time_tolerance={cure:.2g} takes them in"
    )


def typical_offset(offsets: NDArray[np.float64]) -> str:
    """Return the typical signed offset to the nearest time of the truth as text."""
    middle = float(np.median(offsets))
    return f"typically {1e3 * abs(middle):.3g} ms {'after' if middle > 0 else 'before'} the truth"


def wider_tolerance(stamps: NDArray[np.int64], truth: NDArray[np.int64]) -> float | None:
    """Return a tolerance [s] for times just outside the present one; None if there are none."""
    offsets, when = np.abs(time_offsets(stamps, truth)), np.unique(truth)
    interval = float(np.median(np.diff(when))) * 1e-9 if len(when) > 1 else np.inf
    if np.median(offsets) > BESIDE * interval:
        return None
    return 1.1 * float(np.quantile(offsets, 0.95))


def _of_places(estimates: Estimates, truth: Truth, config: EvaluationConfig, what: str) -> str:
    nearest = pair(estimates, truth, config=config).nearest
    known = np.isfinite(nearest)
    if not known.any() or (nearest <= config.gate).any():
        return ""
    away = nearest[known]
    places = [
        ", ".join(f"{value:.1f}" for value in np.median(position, axis=0))
        for position in (estimates.position[known], truth.position)
    ]
    return (
        f"none of the {what} is within the gate of {config.gate:g} m of a target: the nearest is"
        f" {away.min():.3g} m away, {np.median(away):.3g} m are typical; {what} lie about"
        f" ({places[0]}), targets about ({places[1]}): are both in one frame? gate=METRES widens"
        " the gate"
    )


def sides(
    stamps: NDArray[np.int64], scan_ns: NDArray[np.int64] | None, tolerance: float
) -> NDArray[np.int64]:
    """Return -1 for times before the first scan, 1 for those after the last one, else 0.

    Parameters
    ----------
    stamps : ndarray, shape (K,), int64
        Times [ns].
    scan_ns : ndarray, shape (S,), int64, or None
        Times of the scans [ns], increasing; None or empty: unknown, no time is beyond them.
    tolerance : float
        A time at most this far from a scan is one of this scan [s].

    Returns
    -------
    sides : ndarray, shape (K,), int64
        All 0 if no time is between the scans: the times are those of another recording.
    """
    found = np.zeros(len(stamps), np.int64)
    if scan_ns is None or not len(scan_ns):
        return found
    reach = round(1e9 * tolerance)
    found[stamps < scan_ns[0] - reach] = -1
    found[stamps > scan_ns[-1] + reach] = 1
    return found if not found.all() else np.zeros(len(stamps), np.int64)
