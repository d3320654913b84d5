"""Slow, obvious versions of the evaluation: every assignment is tried."""

from itertools import combinations, permutations

import numpy as np


def best_pairs(cost, gate):
    """Number of pairs and sum of costs of the best assignment, over all of them."""
    rows, columns = cost.shape
    for size in range(min(rows, columns), 0, -1):
        sums = [
            sum(cost[row, column] for row, column in zip(chosen, order, strict=True))
            for chosen in combinations(range(rows), size)
            for order in permutations(range(columns), size)
            if all(cost[row, column] <= gate for row, column in zip(chosen, order, strict=True))
        ]
        if sums:
            return size, min(sums)
    return 0, 0.0


def pairs_of(estimates, targets, gate):
    """Estimate and target of the best assignment, over all of them."""
    distance = np.linalg.norm(estimates[:, None] - targets[None], axis=-1)
    size, total = best_pairs(distance, gate)
    for chosen in combinations(range(len(estimates)), size):
        for order in permutations(range(len(targets)), size):
            pairs = list(zip(chosen, order, strict=True))
            costs = [distance[pair] for pair in pairs]
            if all(cost <= gate for cost in costs) and sum(costs) == total:
                return pairs
    return []


def scores(scans, gate):
    """Scores of scans (stamp, truth ids, truth positions, eligible, track ids, positions)."""
    result = {
        "n_eligible": 0, "n_found": 0, "n_estimates": 0, "n_matched": 0, "n_false": 0,
        "n_switches": 0,
    }  # fmt: skip
    errors, false_ids, last_track, first, delay = [], set(), {}, {}, {}
    for stamp, names, places, eligible, tracks, found in scans:
        pairs = pairs_of(found, places, gate)
        result["n_estimates"] += len(found)
        result["n_matched"] += len(pairs)
        result["n_eligible"] += int(sum(eligible))
        for number, position in zip(tracks, found, strict=True):
            if all(np.linalg.norm(position - place) > gate for place in places):
                result["n_false"] += 1
                false_ids.add(number)
        tracked = {names[target]: tracks[estimate] for estimate, target in pairs}
        for estimate, target in pairs:
            if eligible[target]:
                result["n_found"] += 1
                errors.append(np.linalg.norm(found[estimate] - places[target]))
            name, track = names[target], tracks[estimate]
            result["n_switches"] += last_track.get(name, track) != track
            last_track[name] = track
        for name, counts in zip(names, eligible, strict=True):
            if counts and name not in first:
                first[name] = stamp
                delay[name] = None
            if name in first and name in tracked and delay[name] is None:
                delay[name] = (stamp - first[name]) * 1e-9
    result["mean_error"] = float(np.mean(errors)) if errors else None
    result["rmse"] = float(np.sqrt(np.mean(np.square(errors)))) if errors else None
    result["false_ids"] = tuple(sorted(false_ids))
    result["first_delay"] = delay
    return result
