"""Section IV of Vrba et al. the slow way: finite differences, quadrature, random targets."""

import numpy as np
from scipy.stats import multivariate_normal, norm


def rotation(alpha, beta, gamma):
    """Rz(gamma) Ry(beta) Rx(alpha), eq. 38."""
    (sa, sb, sc), (ca, cb, cc) = np.sin([alpha, beta, gamma]), np.cos([alpha, beta, gamma])
    about_x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    about_y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    about_z = np.array([[cc, -sc, 0], [sc, cc, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def point(noisy, direction):
    """Eq. 40; `noisy` is translation, angles, range."""
    return noisy[6] * rotation(*noisy[3:6]) @ direction + noisy[:3]


def jacobian(noisy, direction, step=1e-6):
    """Eq. 42 by central differences."""
    columns = [
        (point(noisy + shift, direction) - point(noisy - shift, direction)) / (2 * step)
        for shift in step * np.eye(7)
    ]
    return np.stack(columns, axis=-1)


def box(covariance, low, high):
    """Integral of a normal density over a box, eq. 46, by scipy: eight corners in and out."""
    normal = multivariate_normal(
        np.zeros(3), covariance, allow_singular=True, abseps=1e-10, releps=1e-10, maxpts=4_000_000
    )
    return float(normal.cdf(high, lower_limit=low))


def plane_box(a, b, low, high, steps=200_001):
    """The same for the variable `a y + b z`, y and z independent: the covariance is singular."""
    y = np.linspace(-8, 8, steps)
    with np.errstate(divide="ignore", invalid="ignore"):
        bounds = (np.stack([low, high])[:, :, None] - a[:, None] * y) / b[:, None]
    start, end = bounds.min(axis=0).max(axis=0), bounds.max(axis=0).min(axis=0)
    inside = np.maximum(norm.cdf(end) - norm.cdf(start), 0)
    return float(np.trapezoid(norm.pdf(y) * inside, y))


def met_share(directions, radius, distance, view, targets, seed):
    """Share of random balls that at least one ray meets, eq. 49."""
    rng = np.random.default_rng(seed)
    azimuth = rng.uniform(-np.pi, np.pi, targets)
    height = rng.uniform(np.sin(view[0]), np.sin(view[1]), targets)
    flat = np.sqrt(1 - height**2)
    centers = distance * np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), height], -1)
    rays = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    met = np.zeros(targets, bool)
    for part in np.array_split(np.arange(targets), max(1, targets // 500)):
        along = centers[part] @ rays.T
        beside = np.sum(centers[part] ** 2, axis=1)[:, None] - along**2
        met[part] = ((along > 0) & (beside <= radius**2)).any(axis=1)
    return float(met.mean())
