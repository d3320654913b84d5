"""An experiment: one network from the whole scan to all its circles, segmentation learnt, too.

Every ray says whether it met a circle, and which one: the centre, seen along the ray from where it
ended, and the radius. Rays whose centres lie together are one circle.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from lidar_core.circles import CirclePipeline, CirclesConfig, Scanner
from lidar_core.circles.crowds import Crowds
from lidar_core.evaluation.matching.assignment import match

CHANNELS, ANSWERS = 4, 4
_WIDTH, _KERNEL, _DILATIONS = 24, 5, (1, 2, 4, 8, 16, 32)
_STEP = 0.1  # difference of neighbouring ranges that counts 1 [m]
_WEIGHT = 10.0  # of an error of 1 m beside the probability
_VOTE = 0.5  # least probability of a ray with a vote
_TOGETHER = 0.25  # rays with centres this close are one circle [m]
LEAST_RAYS = 4
"""Circles with fewer rays are neither expected nor reported."""
GATE = 0.1
"""A circle is found if its centre is this close [m]."""


class OneStepNet(nn.Module):
    """Convolutions over rays, ever wider, 18,028 weights: four numbers per ray, for any scanner."""

    def __init__(self) -> None:
        super().__init__()
        self.enter = nn.Conv1d(CHANNELS, _WIDTH, _KERNEL, padding="same")
        self.layers = nn.ModuleList(
            nn.Conv1d(_WIDTH, _WIDTH, _KERNEL, padding="same", dilation=dilation)
            for dilation in _DILATIONS
        )
        self.leave = nn.Conv1d(_WIDTH, ANSWERS, 1)
        self.activation = nn.SiLU()

    def hidden(self) -> list[nn.Parameter]:
        """Weights of the layers between the first and the last."""
        return [layer.weight for layer in self.layers]

    def forward(self, shown: Tensor) -> Tensor:
        """Logit, centre beyond the end of the ray and to its left, radius: (B, 4, n_beams)."""
        value = self.enter(shown)
        for layer in self.layers:
            value = value + self.activation(layer(value))
        answer: Tensor = self.leave(value)
        return answer


def shown(scans: NDArray[np.float32], scanner: Scanner) -> NDArray[np.float32]:
    """What the network sees of scans: hits, ranges, steps to both neighbours; (B, 4, n_beams)."""
    hits = np.isfinite(scans)
    ranges = np.where(hits, scans, np.float32(scanner.range_max))
    steps = np.clip(np.diff(ranges, axis=1) / _STEP, -5, 5)
    before, after = np.pad(steps, ((0, 0), (1, 0))), np.pad(steps, ((0, 0), (0, 1)))
    return np.stack([hits, ranges / scanner.range_max, before, after], axis=1).astype(np.float32)


def truth_of(made: Crowds, scanner: Scanner) -> NDArray[np.float32]:
    """What the network should answer, with 1 and 0 for the logit; (B, 4, n_beams)."""
    is_circle = made.owner >= 0
    x, y, radius = np.moveaxis(made.circles[made.owner], 2, 0)  # of walls: not looked at
    bearings = scanner.bearings()
    along = x * np.cos(bearings) + y * np.sin(bearings) - np.where(is_circle, made.scans, 0)
    aside = y * np.cos(bearings) - x * np.sin(bearings)
    return np.stack([is_circle, along, aside, radius], axis=1).astype(np.float32)


def loss_of(answer: Tensor, truth: Tensor, hits: Tensor) -> Tensor:
    """Cross entropy of the rays that returned, and absolute errors of those that met circles."""
    entropy = nn.functional.binary_cross_entropy_with_logits(
        answer[:, 0], truth[:, 0], weight=hits, reduction="sum"
    )
    errors = ((answer[:, 1:] - truth[:, 1:]).abs().sum(1) * truth[:, 0]).sum()
    return (entropy + _WEIGHT * errors) / hits.sum().clamp_min(1)


def grouped(
    answer: NDArray[np.float32], scan: NDArray[np.float32], scanner: Scanner
) -> NDArray[np.float64]:
    """Circles (N, 3) of one scan: rays with a vote join the nearest circle, or begin one."""
    logit, along, aside, radius = answer.astype(np.float64)
    votes = np.flatnonzero((logit > np.log(_VOTE / (1 - _VOTE))) & np.isfinite(scan))
    bearing, reach = scanner.bearings()[votes], scan[votes] + along[votes]
    cosine, sine = np.cos(bearing), np.sin(bearing)
    centres = np.stack(
        [cosine * reach - sine * aside[votes], sine * reach + cosine * aside[votes]], axis=1
    )
    sums = np.zeros((0, 4))
    for vote in np.column_stack([centres, radius[votes], np.ones(len(votes))]):
        apart = np.linalg.norm(sums[:, :2] / sums[:, 3:] - vote[:2], axis=1)
        if len(apart) and apart.min() < _TOGETHER:
            sums[apart.argmin()] += vote
        else:
            sums = np.vstack([sums, vote])
    return (sums[:, :3] / sums[:, 3:])[sums[:, 3] >= LEAST_RAYS]


@dataclass
class Found:
    """What was found of what there is.

    Attributes
    ----------
    right, reported, expected : int
        Circles.
    errors : list of ndarray
        Of x, y, radius of those that are right [m].
    """

    right: int = 0
    reported: int = 0
    expected: int = 0
    errors: list[NDArray[np.float64]] = field(default_factory=list)

    def add(self, found: NDArray[np.float64], true: NDArray[np.float64]) -> None:
        """Count one scan."""
        flat = np.array([1.0, 1.0, 0.0])
        pairs = match(found * flat, true * flat, gate=GATE)
        self.errors.append(found[pairs.estimate] - true[pairs.target])
        self.right += len(pairs.estimate)
        self.reported += len(found)
        self.expected += len(true)

    def summary(self) -> dict[str, float]:
        """Precision, recall, and errors of what is right [m^2], [m]."""
        errors = np.concatenate([np.zeros((0, 3)), *self.errors])
        return {
            "precision": self.right / max(self.reported, 1),
            "recall": self.right / max(self.expected, 1),
            "mse": float(np.square(errors).mean()) if len(errors) else 0.0,
            "mae": float(np.abs(errors).mean()) if len(errors) else 0.0,
        }


@torch.no_grad()
def compared(network: nn.Module, made: Crowds, scanner: Scanner) -> dict[str, Any]:
    """What the network finds in scans, beside what the pipeline takes into its map."""
    pipeline = CirclePipeline(CirclesConfig(scanner=scanner))
    ours, usual = Found(), Found()
    device = next(network.parameters()).device
    given = torch.from_numpy(shown(made.scans, scanner)).to(device)
    answers = network(given).cpu().numpy()
    for scan, owner, answer in zip(made.scans, made.owner, answers, strict=True):
        rays = np.bincount(owner[owner >= 0], minlength=len(made.circles))
        true = made.circles[rays >= LEAST_RAYS].astype(np.float64)
        ours.add(grouped(answer, scan, scanner), true)
        pipeline.reset()
        frame = pipeline.process(scan, np.eye(4), 0)
        taken = (frame.element >= 0) & (np.diff(frame.segments.starts) >= LEAST_RAYS)
        usual.add(np.asarray(frame.circles)[taken], true)
    return {"scans": len(made.scans), "one-step": ours.summary(), "pipeline": usual.summary()}
