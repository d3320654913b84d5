"""HOTA, MOTA and IDF1 through the library trackeval, on 3D distances between centres."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from lidar_core.config import as_config
from lidar_core.evaluation.config import EvaluationConfig
from lidar_core.evaluation.matching.pairing import counted, distances_at, numbers_of, scans
from lidar_core.evaluation.types import Estimates, Truth
from lidar_core.extras import require

LEAST_SIMILARITY = 1e-6
"""Smallest similarity of a pair, for any distance below the gate; the library would also pair 0."""


@dataclass(frozen=True, slots=True)
class IdentityScores:
    """Scores of tracks and their identities as the library computes them, no unit.

    Attributes
    ----------
    hota, deta, assa, loca : float
        Higher order tracking accuracy and its detection, association and localisation parts;
        means over the thresholds 0.05 to 0.95 of the similarity.
    mota : float
        Multiple object tracking accuracy: 1 - (missed + false + switches) / targets.
    idf1, id_recall, id_precision : float
        Under the best assignment of whole tracks to whole targets.
    n_switches, n_fragmentations : int
        Numbers as defined by CLEAR MOT.
    mostly_tracked, mostly_lost : int
        Targets found in more than 80 % and in less than 20 % of the scans.
    """

    hota: float
    deta: float
    assa: float
    loca: float
    mota: float
    idf1: float
    id_recall: float
    id_precision: float
    n_switches: int
    n_fragmentations: int
    mostly_tracked: int
    mostly_lost: int


def score_identities(
    tracks: Estimates, truth: Truth, *, config: EvaluationConfig | None = None
) -> IdentityScores | None:
    """Compute HOTA, MOTA and IDF1; the similarity of a pair is 1 - distance / gate, at least 0.

    Only rows that count take part (`counted`).

    Returns
    -------
    IdentityScores or None
        None if no target had to be found.

    Raises
    ------
    MissingExtraError
        trackeval is not installed.
    InputError
        Tracks without IDs, or tables whose columns differ in length.

    Notes
    -----
    Sources: Luiten et al., "HOTA: A Higher Order Metric for Evaluating Multi-Object Tracking",
    IJCV 129, 2021; Bernardin & Stiefelhagen, "Evaluating Multiple Object Tracking Performance: The
    CLEAR MOT Metrics", 2008; Ristani et al., "Performance Measures and a Data Set for Multi-Target,
    Multi-Camera Tracking", 2016.
    """
    metrics = require("trackeval.metrics", extra="eval", purpose="scoring HOTA, MOTA and IDF1")
    config = as_config(config, EvaluationConfig)
    tracks, truth = counted(tracks, truth, config=config)
    if not len(truth.stamp_ns):
        return None
    data = _trackeval_data(tracks, truth, config.gate)
    quiet = {"THRESHOLD": LEAST_SIMILARITY, "PRINT_CONFIG": False}
    hota = metrics.HOTA().eval_sequence(data)
    clear = metrics.CLEAR(dict(quiet)).eval_sequence(data)
    identity = metrics.Identity(dict(quiet)).eval_sequence(data)
    return IdentityScores(
        hota=float(np.mean(hota["HOTA"])),
        deta=float(np.mean(hota["DetA"])),
        assa=float(np.mean(hota["AssA"])),
        loca=float(np.mean(hota["LocA"])),
        mota=float(clear["MOTA"]),
        idf1=float(identity["IDF1"]),
        id_recall=float(identity["IDR"]),
        id_precision=float(identity["IDP"]),
        n_switches=int(clear["IDSW"]),
        n_fragmentations=int(clear["Frag"]),
        mostly_tracked=int(clear["MT"]),
        mostly_lost=int(clear["ML"]),
    )


def _trackeval_data(tracks: Estimates, truth: Truth, gate: float) -> dict[str, Any]:
    """Convert the tables for the library: IDs from 0 and similarities for every scan."""
    track_ids, track_of = np.unique(numbers_of(tracks), return_inverse=True)
    target_ids, target_of = np.unique(truth.id, return_inverse=True)
    rows = list(scans(tracks, truth))
    return {
        "num_timesteps": len(rows),
        "num_gt_ids": len(target_ids),
        "num_tracker_ids": len(track_ids),
        "num_gt_dets": len(truth.id),
        "num_tracker_dets": len(track_of),
        "gt_ids": [target_of[there] for _, there in rows],
        "tracker_ids": [track_of[here] for here, _ in rows],
        "similarity_scores": [
            np.clip(1 - distances_at(tracks, here, truth, there).T / gate, 0, 1)
            for here, there in rows
        ],
    }
