"""The centre of a target in plain numpy: a ball against an open frame, weighed.

Written from the description in `lidar_core.flying.target_center` and the constants below.
"""

import numpy as np
from scipy.special import expit

MARGIN, NEAR = 0.4, 0.15
RADIUS_MEAN, RADIUS_STD, PLACE_STD = 0.3, 0.25, 0.5
PASSING_STD, LEAST_COSINE = 0.01, 0.3
ROWS_APART = 0.1  # rays this far apart in height are of several rows [m]
FEWEST_HITS, FEWEST_MISSED, MOST_COMPARED = 8, 4, 32  # whose neighbours are counted
FEWEST_ABOVE, BELOW_GAPS = 4, 0.5  # rays above, to miss those below; those pass by a share of a gap


class Rays:
    """Rays with their origins, and unit directions."""

    def __init__(self, origins, directions) -> None:
        directions = np.reshape(directions, (-1, 3)).astype(float)
        self.origins = np.broadcast_to(np.asarray(origins, float), directions.shape)
        self.directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)

    def along(self, point):
        return np.einsum("ij,ij->i", point - self.origins, self.directions)

    def aside(self, point):
        """Offsets of a point from the rays."""
        return point - self.origins - self.directions * self.along(point)[:, None]

    def distance(self, point):
        return np.linalg.norm(self.aside(point), axis=1)

    def those(self, chosen):
        return Rays(self.origins[chosen], self.directions[chosen])


def between(share, ends):
    """Values for solid shares of 0.3 and 0.6, on a line between."""
    return np.interp(share, [0.3, 0.6], ends)


def seen_from(points, origin, passing):
    """Unit vector of the sight; hits and passing rays across it, sideways and up, in a plane."""
    centroid = points.mean(axis=0)
    distance = np.linalg.norm(centroid - origin)
    sight = (centroid - origin) / distance
    across = np.array([-sight[1], sight[0], 0.0])
    across = across / np.linalg.norm(across) if np.linalg.norm(across) > 1e-9 else np.eye(3)[1]
    axes = np.stack([across, np.cross(sight, across)])
    ahead = passing.those(passing.directions @ sight > 0)
    lengths = distance / (ahead.directions @ sight)
    crossing = ahead.origins + ahead.directions * lengths[:, None]
    return sight, (points - centroid) @ axes.T, (crossing - centroid) @ axes.T


def coherence(hits, missed, gap):
    """Hits next to hits beyond chance, and how many there could be, in four directions."""
    found = np.zeros((2, 4))
    if len(hits) < FEWEST_HITS or len(missed) < FEWEST_MISSED:
        return found
    rays = np.concatenate([missed, hits])
    is_hit = np.arange(len(rays)) >= len(missed)
    chance = (len(hits) - 1) / (len(rays) - 1)
    for hit in hits[:: -(-len(hits) // MOST_COMPARED)]:
        off = rays - hit
        eighth = np.round(np.degrees(np.arctan2(off[:, 1], off[:, 0])) / 45) % 8
        squared = (off**2).sum(axis=1)
        for side in range(8):
            beside = (eighth == side) & (squared > 0) & (squared <= (2 * gap) ** 2)
            if beside.any():
                nearest = np.where(beside, squared, np.inf).argmin()
                found[:, side % 4] += is_hit[nearest] - chance, 1 - chance
    return found


def outline(points, origin, passing, hiding):
    """Share of the ellipse of the points that is hit, its coherence, and whether rays pass below.

    None: unknown.

    `hiding`: rays that end in front. With more of them below than rays that pass, none passes.
    """
    _, hits, rays = seen_from(points, origin, passing)
    middle = (hits.min(axis=0) + hits.max(axis=0)) / 2
    reach = np.linalg.norm(hits - middle, axis=1).max() + MARGIN
    window = (np.linalg.norm(rays - middle, axis=1) < reach).sum()
    gap = reach * np.sqrt(np.pi / (len(hits) + window))
    inverse = np.linalg.inv(
        (hits - hits.mean(axis=0)).T @ (hits - hits.mean(axis=0)) / len(hits)
        + np.eye(2) * gap**2 / 12
    )
    inside = [
        np.einsum("ij,jk,ik->i", off, inverse, off) <= 4
        for off in (hits - hits.mean(axis=0), rays - hits.mean(axis=0))
    ]
    count = [those.sum() for those in inside]
    filled = count[0] / sum(count) if sum(count) else 1.0
    in_order = np.lexsort(points.T[::-1])
    found = coherence(hits[in_order][inside[0][in_order]], rays[inside[1]], gap)
    half = max(np.ptp(hits[:, 0]) / 4, gap)  # the middle half, or what a gap leaves
    in_line = [
        those[np.abs(those[:, 0] - (hits[:, 0].min() + hits[:, 0].max()) / 2) <= half, 1]
        for those in (rays, seen_from(points, origin, hiding)[2])
    ]
    level, bottom = in_line[0], hits[:, 1].min()
    passes, hides = [
        ((ups >= bottom - MARGIN) & (ups < bottom - BELOW_GAPS * gap)).sum() for ups in in_line
    ]
    if 0 < passes < hides:
        return filled, found, False
    if (level < hits[:, 1].min() - BELOW_GAPS * gap).any():
        return filled, found, True
    above = level[level > hits[:, 1].max()]
    is_clear = len(above) >= FEWEST_ABOVE and np.ptp(above) >= ROWS_APART
    return filled, found, False if is_clear else None


def frame(points, origin, passing, std):
    """Centre, covariance, radius by rays, by points, too, and solid share; where a ball starts."""
    count, centroid = len(points), points.mean(axis=0)
    sight, flat, rays = seen_from(points, origin, passing)
    middle = (flat.min(axis=0) + flat.max(axis=0)) / 2
    reach = np.linalg.norm(flat - middle, axis=1).max()
    off = np.linalg.norm(rays - middle, axis=1)
    gap = (reach + MARGIN) * np.sqrt(np.pi / (count + (off < reach + MARGIN).sum()))
    share = count / (count + (off < reach + gap / 2).sum())
    radius = reach + between(share, [1.5, 0.75]) * gap
    root = np.sqrt(np.pi / count)
    own = reach * root / (1 - root / 2) if count >= 3 else gap
    least = reach + between(share, [1.5, 0.75]) * min(gap, own)
    scatter = np.cov(points.T, bias=True) if count > 1 else np.zeros((3, 3))
    level = max(0, 1 - abs(sight[2]) / 0.25)
    shift = between(share, [0.12 + 0.13 * level, 0.40]) * radius
    shift_std = min(0.5 / np.sqrt(count), 0.2) * radius
    lift = 0.06 * level * radius * (np.eye(3)[2] - sight[2] * sight)
    along = np.outer(sight, sight)
    depth = (points - centroid) @ sight
    half = max(reach, np.ptp(depth) / 2)
    large = np.interp(half, [0.45, 0.65], [0, 1])
    across = np.array([-sight[1], sight[0], 0.0])
    across = across / np.linalg.norm(across) if np.linalg.norm(across) > 1e-9 else np.eye(3)[1]
    axes = np.stack([across, np.cross(across, np.eye(3)[2]), np.eye(3)[2]])  # upright box
    boxed = (points - centroid) @ axes.T
    box = (boxed.min(axis=0) + boxed.max(axis=0)) / 2 @ axes
    box = box + max(0, shift - box @ sight) * sight  # the further of both
    behind = (1 - large) * (shift * sight + lift) + large * box
    covariance = (
        scatter / count
        + (np.eye(3) - along)
        * (gap**2 / (12 * np.sqrt(count)) + 0.02**2 + (0.03 * large * half) ** 2)
        + along * (shift_std**2 + (0.1 * large * half) ** 2 + std**2 / count)
    )
    size = max(reach, 0.05)
    return (
        centroid + behind,
        covariance,
        radius,
        least,
        share,
        (centroid + 0.66 * size * sight, size),
    )


def residuals(x, start, points, hits, passing, std):
    """Residuals of points, passing rays, place and radius, stacked, and their Jacobian."""
    center, radius = x[:3], x[3]
    offset = points - center
    distance = np.linalg.norm(offset, axis=1)
    incidence = hits.distance(center) / radius
    cosine = np.sqrt(np.maximum(1 - incidence**2, LEAST_COSINE**2))
    scale = 1 / (max(std, 1e-3) * cosine)
    hit = (distance - radius) * scale
    hit_slope = np.column_stack([-offset / distance[:, None], -np.ones(len(points))])
    away, passed = passing.aside(center), passing.distance(center)
    inside = (passed < radius) & (passing.along(center) > 0)
    away, passed = away[inside], passed[inside]
    intrusion = (radius - passed) / PASSING_STD
    slope = np.column_stack([-away / passed[:, None], np.ones(len(passed))]) / PASSING_STD
    known = np.append((center - start[0]) / PLACE_STD, (radius - RADIUS_MEAN) / RADIUS_STD)
    known_slope = np.diag([1 / PLACE_STD] * 3 + [1 / RADIUS_STD])
    jacobian = np.vstack([hit_slope * scale[:, None], slope, known_slope])
    return np.concatenate([hit, intrusion, known]), jacobian


def ball(points, hits, passing, std, start):
    """Centre, covariance, radius and squared residuals of the points for the best ball."""
    x = np.append(*start)
    e, J = residuals(x, start, points, hits, passing, std)
    damping = 1e-3
    for _ in range(20):
        H = J.T @ J
        y = x - np.linalg.solve(H + damping * np.diag(np.diag(H)), J.T @ e)
        y[3] = np.clip(y[3], 0.02, 2.0)
        f, K = residuals(y, start, points, hits, passing, std)
        if f @ f < e @ e:
            is_last = e @ e - f @ f < 1e-9 * (e @ e)
            x, e, J = y, f, K
            damping /= 10
            if is_last:
                break
        else:
            damping *= 10
    ahead = x[:3] - hits.origins.mean(axis=0)
    ahead /= np.linalg.norm(ahead)
    covariance = (
        np.linalg.inv(J.T @ J)[:3, :3]
        + np.eye(3) * (0.01 * x[3]) ** 2
        + np.outer(ahead, ahead) * (0.3 * std) ** 2
    )
    return x[:3], covariance, x[3], float(e[: len(points)] @ e[: len(points)])


def region(points):
    """Middle of the box around points, and half its diagonal."""
    low, high = points.min(axis=0), points.max(axis=0)
    return (low + high) / 2, np.linalg.norm(high - low) / 2


def ends_at_edge(points, origins, passing, hiding):
    """Whether in a sector the nearest ray, not below the points, ends in front, and another one."""
    middle, _ = region(points)
    first = np.lexsort(points.T[::-1])[0]
    sight = middle - np.broadcast_to(origins, points.shape)[first]
    sight = sight / np.linalg.norm(sight)
    left = np.cross([0, 0, 1], sight)
    left = left / np.linalg.norm(left)
    axes = np.stack([left, np.cross(sight, left)])

    def by_sector(places):
        flat = places @ axes.T
        turns = np.arctan2(flat[:, 1], flat[:, 0]) / (2 * np.pi) + 0.5
        return np.minimum((8 * turns).astype(int), 7), np.linalg.norm(flat, axis=1), flat[:, 1]

    own = Rays(origins, points - origins)
    sectors, away, up = by_sector(-own.aside(middle))
    lowest = up.min()
    reach = [away[sectors == sector].max(initial=0) for sector in range(8)]

    def beyond(rays, sector):
        sectors, away, up = by_sector(-rays.aside(middle))
        return np.sort(away[(sectors == sector) & (away > reach[sector]) & (up >= lowest)])

    for sector in range(8):
        hidden, open_ones = beyond(hiding, sector), beyond(passing, sector)
        if len(hidden) >= 2 and hidden[0] < open_ones.min(initial=np.inf):
            return True
    return False


def target_outline(points, origins, passing, hiding):
    """What `outline` says; `origins` of the hits, `passing` and `hiding` as `Rays`."""
    points = np.asarray(points, float)
    middle, reach = region(points)
    passing = passing.those(passing.distance(middle) <= reach + MARGIN)
    origin = np.mean(np.broadcast_to(origins, points.shape), axis=0)
    return outline(points, origin, passing, hiding)


def target_center(points, origins, passing, std):
    """Position, covariance, radius, and that by the spacing of the points.

    `origins` are of the hits, `passing` is `Rays`.
    """
    points = np.asarray(points, float)
    hits = Rays(origins, points - origins)
    middle, reach = region(points)
    passing = passing.those(passing.distance(middle) <= reach + MARGIN)
    near = passing.those(passing.distance(middle) <= reach + NEAR)
    position, covariance, radius, least, share, start = frame(
        points, hits.origins.mean(axis=0), passing, std
    )
    center, spread, size, squares = ball(points, hits, near, std, start)
    ratio = (squares + 4) / (max(len(points) - 4, 0) + 2)
    weight = np.clip((share - 0.4) / 0.15, 0, 1) * expit(3 * (2 - ratio))
    weight *= min(1, 1.5 * radius / size) ** 8
    offset = center - position
    mixed = weight * spread + (1 - weight) * covariance
    mixed += weight * (1 - weight) * np.outer(offset, offset)
    by_points = weight * min(size, 1.5 * least) + (1 - weight) * least
    return position + weight * offset, mixed, weight * size + (1 - weight) * radius, by_points
