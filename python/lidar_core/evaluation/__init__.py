"""Quality of tracks and detections, compared with ground truth."""

from lidar_core.evaluation.bins import Bins, binned
from lidar_core.evaluation.config import EvaluationConfig
from lidar_core.evaluation.matching.assignment import Matches, assign, match
from lidar_core.evaluation.matching.overlap import overlap_warnings
from lidar_core.evaluation.matching.pairing import Pairing, counted, pair
from lidar_core.evaluation.matching.tables import (
    aligned,
    estimates_of_detections,
    estimates_of_tracks,
    joined,
    truth_of,
)
from lidar_core.evaluation.metric import Paired, register_metric
from lidar_core.evaluation.metrics.consistency import Consistency, consistency, nees
from lidar_core.evaluation.metrics.identity import IdentityScores, score_identities
from lidar_core.evaluation.metrics.latency import Latency
from lidar_core.evaluation.metrics.set_distance import Gospa, gospa, ospa
from lidar_core.evaluation.reading import Prediction, read_prediction, read_truth
from lidar_core.evaluation.report import Evaluation, evaluate
from lidar_core.evaluation.scoring import eligible, score_detections, score_tracks
from lidar_core.evaluation.spread import Spread
from lidar_core.evaluation.static_map import (
    StaticScores,
    read_labelled_cloud,
    read_static_map,
    score_static_map,
)
from lidar_core.evaluation.types import (
    DetectionScores,
    DistanceScores,
    Estimates,
    SetScores,
    TrackScores,
    Truth,
)

__all__ = [
    "Bins",
    "Consistency",
    "DetectionScores",
    "DistanceScores",
    "Estimates",
    "Evaluation",
    "EvaluationConfig",
    "Gospa",
    "IdentityScores",
    "Latency",
    "Matches",
    "Paired",
    "Pairing",
    "Prediction",
    "SetScores",
    "Spread",
    "StaticScores",
    "TrackScores",
    "Truth",
    "aligned",
    "assign",
    "binned",
    "consistency",
    "counted",
    "eligible",
    "estimates_of_detections",
    "estimates_of_tracks",
    "evaluate",
    "gospa",
    "joined",
    "match",
    "nees",
    "ospa",
    "overlap_warnings",
    "pair",
    "read_labelled_cloud",
    "read_prediction",
    "read_static_map",
    "read_truth",
    "register_metric",
    "score_detections",
    "score_identities",
    "score_static_map",
    "score_tracks",
    "truth_of",
]


def __dir__() -> list[str]:
    return __all__
