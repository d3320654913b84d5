"""Evaluation of one run: all scores in one result."""

from dataclasses import dataclass
from typing import Any

from lidar_core.config import as_config
from lidar_core.evaluation.config import EvaluationConfig
from lidar_core.evaluation.matching.overlap import overlap_warnings
from lidar_core.evaluation.matching.tables import aligned
from lidar_core.evaluation.metrics.identity import IdentityScores, score_identities
from lidar_core.evaluation.metrics.latency import Latency
from lidar_core.evaluation.scoring import score_detections, score_tracks
from lidar_core.evaluation.types import DetectionScores, Estimates, TrackScores, Truth, plain


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Scores of a run; None for missing input.

    Attributes
    ----------
    tracks : TrackScores or None
        Scores of the tracks.
    detections : DetectionScores or None
        Scores of the detections.
    identities : IdentityScores or None
        HOTA, MOTA and IDF1 of the tracks.
    latency : Latency or None
        Time per scan.
    warnings : tuple of str
        Reasons why the scores are meaningless: no time or place in common with the truth.
    """

    tracks: TrackScores | None
    detections: DetectionScores | None
    identities: IdentityScores | None
    latency: Latency | None
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return every number as plain values, ready for JSON, without the arrays."""
        return {
            "track_scores": None if self.tracks is None else self.tracks.to_dict(),
            "detection_scores": None if self.detections is None else self.detections.to_dict(),
            "identity_scores": plain(self.identities),
            "latency_ms": plain(self.latency),
            "warnings": list(self.warnings),
        }


def evaluate(
    truth: Truth,
    *,
    tracks: Estimates | None = None,
    detections: Estimates | None = None,
    latency: Latency | None = None,
    with_identities: bool = False,
    config: EvaluationConfig | None = None,
) -> Evaluation:
    """Compare tracks and detections with the truth.

    Parameters
    ----------
    truth : Truth
        The targets.
    tracks, detections : Estimates, optional
        Reported objects. Times within `time_tolerance` of a time of the truth count as equal to it.
    latency : Latency, optional
        Times of the scans, which are passed on to the result.
    with_identities : bool
        Also compute HOTA, MOTA and IDF1 (extra `eval`).
    config : EvaluationConfig, optional
        Configuration of what counts as found.

    Raises
    ------
    InputError
        Tables whose columns differ in length, that hold an object twice at one time, or tracks
        without IDs.
    MissingExtraError
        `with_identities` without trackeval.
    """
    config = as_config(config, EvaluationConfig)
    track_scores = detection_scores = identities = None
    told = [
        text
        for what, table in (("tracks", tracks), ("detections", detections))
        if table is not None
        for text in overlap_warnings(table, truth, what=what, config=config)
    ]
    if tracks is not None:
        tracks = aligned(tracks, truth, config=config)
        track_scores = score_tracks(tracks, truth, config=config)
        if with_identities:
            identities = score_identities(tracks, truth, config=config)
    if detections is not None:
        detections = aligned(detections, truth, config=config)
        detection_scores = score_detections(detections, truth, config=config)
    return Evaluation(track_scores, detection_scores, identities, latency, tuple(told))
