"""How good a network is: Table III, split by hits and by what cuts the circles."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from lidar_core.circles import Samples, Scanner
from lidar_core.circles.samples import HITS
from lidar_core_training.tasks import Data, Task

_BATCH = 2048


@torch.no_grad()
def errors_of(
    network: nn.Module, task: Task, data: Data, numbers: NDArray[np.int64], device: torch.device
) -> tuple[float, NDArray[np.float64], NDArray[np.float64] | None]:
    """Mean loss, errors of x, y, radius (N, 3) [m], squared errors in deviations (N,)."""
    network.eval()
    losses, weights, errors, squares = [], [], [], []
    for start in range(0, len(numbers), _BATCH):
        batch = task.batch(data, numbers[start : start + _BATCH]).to(device)
        answer = network(*batch.inputs)
        losses.append(float(task.loss(answer, batch)))
        weights.append(len(answer))
        found, surprise = task.errors(answer, batch)
        errors.append(found.cpu().numpy().astype(np.float64))
        if surprise is not None:
            squares.append(surprise.cpu().numpy().astype(np.float64))
    network.train()
    nees = np.concatenate(squares) if squares else None
    return float(np.average(losses, weights=weights)), np.concatenate(errors), nees


def summary(errors: NDArray[np.float64], nees: NDArray[np.float64] | None) -> dict[str, float]:
    """MSE [m^2], MAE [m] and p99 [m] over the three outputs, and NEES of samples."""
    means = np.abs(errors).mean(axis=1)
    squares = [float(value) for value in np.square(errors).mean(axis=0)]
    values = {
        "samples": len(errors),
        "mse": float(np.square(errors).mean()),
        "mae": float(means.mean()),
        "p99": float(np.quantile(means, 0.99)),
        "mse_x": squares[0],
        "mse_y": squares[1],
        "mse_radius": squares[2],
    }
    return values if nees is None else values | {"nees": float(nees.mean())}


def breakdown(
    errors: NDArray[np.float64],
    nees: NDArray[np.float64] | None,
    scanner: Scanner,
    samples: Samples,
) -> dict[str, Any]:
    """Summaries of all samples, by number of hits, and of whole and cut circles."""
    hits, whole = samples.n_hits, samples.is_whole(scanner)
    groups = {
        "all": np.ones(len(samples), np.bool_),
        "whole": whole,
        "cut": ~whole,
        "whole, 4 hits or more": whole & (hits >= 4),
    }
    groups |= dict(_by_hits(hits))
    return {
        name: summary(errors[chosen], None if nees is None else nees[chosen])
        for name, chosen in groups.items()
        if chosen.any()
    }


def _by_hits(hits: NDArray[np.int64]) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    for low, high in HITS:
        name = f"{low} or more hits" if high is None else f"{low} to {high} hits"
        yield name, (hits >= low) & (hits <= (hits.max() if high is None else high))
