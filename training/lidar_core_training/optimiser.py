"""Steps down the slope: Adam for all weights, or Muon for the hidden matrices.

Muon: K. Jordan et al., "Muon: An optimizer for hidden layers in neural networks", 2024. It takes
the momentum of a matrix with all its singular values set to about 1, so that rare directions learn
as fast as usual ones. Here its iteration runs on the products of rows, whose number is small.
"""

from typing import Any

import torch
from torch import Tensor, nn

_MOMENTUM = 0.95
_POLYNOMIAL = (3.4445, -4.7750, 2.0315)
_ITERATIONS = 5
_MUON_RATE = 20.0  # of a matrix, in learning rates of Adam


class Optimiser:
    """Adam, and Muon for `matrices`: weights of any shape whose first axis counts the outputs."""

    def __init__(self, network: nn.Module, matrices: list[nn.Parameter], rate: float) -> None:
        self.matrices = matrices
        others = {id(weight) for weight in matrices}
        self.momenta = [torch.zeros_like(weight) for weight in matrices]
        self.adam = torch.optim.Adam(
            [weight for weight in network.parameters() if id(weight) not in others],
            lr=rate,
            fused=True,
        )

    def zero_grad(self) -> None:
        """Forget the slopes."""
        self.adam.zero_grad()
        for weight in self.matrices:
            weight.grad = None

    @torch.no_grad()
    def step(self, rate: float) -> None:
        """Take a step with a learning rate."""
        for group in self.adam.param_groups:
            group["lr"] = rate
        self.adam.step()
        for weight, momentum in zip(self.matrices, self.momenta, strict=True):
            momentum.mul_(_MOMENTUM).add_(weight.grad)
            step = orthogonal((weight.grad + _MOMENTUM * momentum).flatten(1))
            weight.add_(step.view_as(weight), alpha=-_MUON_RATE * rate)

    def state_dict(self) -> dict[str, Any]:
        """All it remembers."""
        return {"adam": self.adam.state_dict(), "momenta": self.momenta}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go back to what it remembered."""
        self.adam.load_state_dict(state["adam"])
        for momentum, value in zip(self.momenta, state["momenta"], strict=True):
            momentum.copy_(value)


def orthogonal(matrix: Tensor) -> Tensor:
    """A matrix (R, C) with its singular values moved to about 1; small ones stay small.

    A tall matrix is made larger by sqrt(R/C), so that its outputs change as much as a wide one's.
    """
    rows, columns = matrix.shape
    if rows > columns:
        return orthogonal(matrix.T).T * (rows / columns) ** 0.5
    matrix = matrix / (torch.linalg.matrix_norm(matrix) + 1e-12)
    products, one = matrix @ matrix.T, torch.eye(rows, dtype=matrix.dtype, device=matrix.device)
    first, second, third = _POLYNOMIAL
    factor = one
    for _ in range(_ITERATIONS):
        step = first * one + second * products + third * products @ products
        factor, products = step @ factor, step @ step @ products
    return factor @ matrix
