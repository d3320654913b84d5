"""Write circle_fits.json: python tests/golden/circle_fits.py, with circle-fit installed."""

import json
from pathlib import Path

import circle_fit
import numpy as np

CIRCLES = [(3.0, -1.0, 0.3), (2.0, 2.0, 0.1), (5.0, 0.0, 0.5), (1.5, 1.0, 0.2), (7.0, 3.0, 0.25)]
STD = 0.01


def main() -> None:
    """Noisy scans of circles, and what the package makes of them."""
    rng = np.random.default_rng(3)
    cases = []
    for x, y, radius in CIRCLES:
        middle, half = np.arctan2(y, x), np.arcsin(radius / np.hypot(x, y))
        bearings = np.linspace(middle - 0.95 * half, middle + 0.95 * half, 15)
        along = x * np.cos(bearings) + y * np.sin(bearings)
        across = x * np.sin(bearings) - y * np.cos(bearings)
        exact = along - np.sqrt(radius**2 - across**2)
        ranges = (exact + STD * rng.standard_normal(len(bearings))).astype(np.float32).astype(float)
        points = np.stack([ranges * np.cos(bearings), ranges * np.sin(bearings)], axis=1)
        fits = {"taubin": circle_fit.taubinSVD, "pratt": circle_fit.prattSVD}
        found = {name: [float(value) for value in fit(points)[:3]] for name, fit in fits.items()}
        cases.append({"bearings": bearings.tolist(), "ranges": ranges.tolist(), **found})
    path = Path(__file__).with_name("circle_fits.json")
    path.write_text(json.dumps(cases, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
