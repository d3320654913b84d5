"""How good tracks and detections are, held against the truth."""

from lidar_core.evaluation.assignment import Matches, assign, match
from lidar_core.evaluation.config import EvaluationConfig
from lidar_core.evaluation.scoring import eligible, score_detections, score_tracks
from lidar_core.evaluation.tables import (
    estimates_of_detections,
    estimates_of_tracks,
    joined,
    truth_of,
)
from lidar_core.evaluation.types import DetectionScores, Estimates, TrackScores, Truth

__all__ = [
    "DetectionScores",
    "Estimates",
    "EvaluationConfig",
    "Matches",
    "TrackScores",
    "Truth",
    "assign",
    "eligible",
    "estimates_of_detections",
    "estimates_of_tracks",
    "joined",
    "match",
    "score_detections",
    "score_tracks",
    "truth_of",
]
