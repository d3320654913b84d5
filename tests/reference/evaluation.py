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
        "n_eligible": 0,
        "n_found": 0,
        "n_estimates": 0,
        "n_matched": 0,
        "n_false": 0,
        "n_switches": 0,
    }
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


def longest_segment(scans, gate):
    """Share of the sightings that the track with most of each target's sightings holds."""
    held, sightings = {}, 0
    for _, names, places, eligible, tracks, found in scans:
        sightings += sum(eligible)
        for estimate, target in pairs_of(found, places, gate):
            if eligible[target]:
                of_target = held.setdefault(names[target], {})
                of_target[tracks[estimate]] = of_target.get(tracks[estimate], 0) + 1
    return sum(max(counts.values()) for counts in held.values()) / sightings if sightings else None


def ospa(estimates, targets, cutoff, order):
    """OSPA by the formula: every injection of the smaller set into the larger one is tried."""
    small, large = sorted([list(estimates), list(targets)], key=len)
    if not large:
        return 0.0
    best = min(
        sum(min(np.linalg.norm(a - b), cutoff) ** order for a, b in zip(small, chosen, strict=True))
        for chosen in permutations(large, len(small))
    )
    return ((best + cutoff**order * (len(large) - len(small))) / len(large)) ** (1 / order)


def gospa(estimates, targets, cutoff, order):
    """GOSPA with alpha 2, over all sets of pairs: its p-th power."""
    best = np.inf
    for size in range(min(len(estimates), len(targets)) + 1):
        for chosen in combinations(range(len(estimates)), size):
            for others in permutations(range(len(targets)), size):
                pairs = zip(chosen, others, strict=True)
                total = sum(np.linalg.norm(estimates[a] - targets[b]) ** order for a, b in pairs)
                single = cutoff**order / 2
                total += single * (len(estimates) + len(targets) - 2 * size)
                best = min(best, total)
    return best


def nees(error, covariance):
    """Squared errors normalised by covariances, one by one, with the inverse."""
    return np.array([e @ np.linalg.inv(P) @ e for e, P in zip(error, covariance, strict=True)])


def fragmentations(wanted, found):
    """Times a target was found after a scan that lacked it, but for the first time."""
    flags = [is_found for is_wanted, is_found in zip(wanted, found, strict=True) if is_wanted]
    starts = sum(now and not before for before, now in zip([False, *flags], flags, strict=False))
    return max(0, starts - 1)


def line_of_sight(error, target, sensor):
    """Part of an error along the line of sight, and the length of the rest."""
    sight = (target - sensor) / np.linalg.norm(target - sensor)
    return float(error @ sight), float(np.linalg.norm(error - (error @ sight) * sight))
