"""Share of the time of the targets that is covered by their longest track."""

import numpy as np

from lidar_core.evaluation.metric import Paired, register_metric
from lidar_core.evaluation.metrics.continuity import histories


@register_metric("longest_segment", "longest track segment", of="tracks")
def longest_segment(paired: Paired) -> float | None:
    """Return the share of sightings that belong to the most frequent track of each target.

    1 if every target is one track from its first sighting to its last; ID switches and gaps
    lower it. None without sightings or IDs of tracks.

    Notes
    -----
    Source: Votruba et al., "Single Integrated Air Picture (SIAP) Metrics Implementation", 2001,
    longest track segment; here over the scans in which a target has to be found.
    """
    numbers, truth = paired.estimates.id, paired.truth
    if numbers is None or not truth.is_eligible.any():
        return None
    held = 0
    for _, rows in histories(truth):
        partners = paired.pairing.estimate_of[rows[truth.is_eligible[rows]]]
        _, counts = np.unique(numbers[partners[partners >= 0]], return_counts=True)
        held += int(counts.max(initial=0))
    return held / int(truth.is_eligible.sum())
