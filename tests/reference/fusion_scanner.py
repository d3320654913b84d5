"""Oracle of what a tracker of many targets learns about a scanner."""

import numpy as np

SHARE, MEMORY = 0.05, 300
PRIORS = {"clutter": 1.0, "detection": 5.0, "share": 20.0}


def last_places(kept, scan):
    """The last 128 places, at most 32 of each scan."""
    taken = min(len(scan), 32)
    return (kept + [scan[k * len(scan) // taken] for k in range(taken)])[-128:]


def robust_box(places):
    """Least and largest coordinates without the outer twentieths, stretched by what is left out."""
    outer = max(len(places) // 20, 1)
    inner = np.sort(places, axis=0)[outer:-outer] if places else []
    if not len(inner):
        return None
    center, half = (inner[0] + inner[-1]) / 2, (inner[-1] - inner[0]) / 2 * len(places) / len(inner)
    return center - half, center + half


class Learnt:
    """What a scanner does: exponentially fading counts beside the configured values."""

    def __init__(self, config):
        self.config = config
        self.all, self.strays = [], []
        self.scans = self.clutter = self.first = self.looks = self.hits = self.arrivals = 0.0

    def area(self):
        boxes = [robust_box(kept) for kept in (self.all, self.strays)]
        boxes = np.array([box for box in boxes if box is not None]).reshape(-1, 2, 2)
        return np.prod(boxes[:, 1].max(axis=0) - boxes[:, 0].min(axis=0)) if len(boxes) else 0.0

    def density(self, told):
        exposure = PRIORS["clutter"] / told
        return (PRIORS["clutter"] + self.false_ones()) / (exposure + self.scans * self.area())

    def false_ones(self):
        """Of all unexplained measurements, less those with which tracks began that exist."""
        return max(self.clutter - self.first, 0.0)

    def detection(self):
        looks = PRIORS["detection"]
        told = looks * self.config.detection_probability
        return float(np.clip((told + self.hits) / (looks + self.looks), 0.05, 0.99))

    def count(self, left, places):
        """Take in the places of a scan, each with the probability that no track explains it."""
        for name in ("scans", "clutter", "looks", "hits", "arrivals"):
            setattr(self, name, getattr(self, name) * (1 - 1 / MEMORY))
        self.scans += 1
        self.clutter += sum(left)
        strays = [place for place, own in zip(places, left, strict=True) if own > 0.5]
        self.strays = last_places(self.strays, strays)

    def share(self):
        told = PRIORS["share"] * SHARE
        return (told + self.arrivals) / (PRIORS["share"] + self.false_ones() + self.arrivals)
