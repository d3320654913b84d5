"""What training makes small."""

import torch
from torch import Tensor

_LOG_RANGE = (-9.0, 4.0)  # of deviations: keeps a bad start finite
_MOST_SQUARES = 200.0  # half the squared error in deviations that one sample may count


def characteristic_points(circles: Tensor) -> Tensor:
    """Where the axes of circles (B, 3) cut them, (B, 4, 2); Fig. 4."""
    center, radius = circles[:, None, :2], circles[:, 2, None, None]
    axes = torch.tensor(
        [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]],
        dtype=circles.dtype,
        device=circles.device,
    )
    return center + radius * axes


def four_points(estimated: Tensor, true: Tensor) -> Tensor:
    """Mean squared distance of the characteristic points, eq. 7: three times the MSE."""
    apart = characteristic_points(estimated) - characteristic_points(true)
    return apart.square().sum(2).mean(1).mean()


def whitened(answer: Tensor, true: Tensor) -> tuple[Tensor, Tensor]:
    """Errors in deviations (B, 3), which should be standard normal, and log deviations (B, 3)."""
    log_std = answer[:, 3:6].clamp(*_LOG_RANGE)
    first, second, third = ((true - answer[:, :3]) * torch.exp(-log_std)).unbind(1)
    second = second - answer[:, 6] * first
    third = third - answer[:, 7] * first - answer[:, 8] * second
    return torch.stack([first, second, third], 1), log_std


def gaussian(answer: Tensor, true: Tensor, scale: Tensor, square_weight: float) -> Tensor:
    """Negative log likelihood, without its constant, and the squared error in metres."""
    errors, log_std = whitened(answer, true)
    halves = (0.5 * errors.square().sum(1)).clamp_max(_MOST_SQUARES)
    squares = ((answer[:, :3] - true) * scale[:, None]).square().sum(1)
    return (halves + log_std.sum(1) + square_weight * squares).mean()
