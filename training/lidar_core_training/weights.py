"""Weights of exported networks: a run may begin with them."""

from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from lidar_core.circles.estimators.network import checked_model
from lidar_core.errors import FormatError

TURNED = "^T"
"""At the end of the name of weights that lie in a file transposed."""


def start_of(model: str) -> dict[str, Any]:
    """SHA-256 of an exported network, and the passes over training data that its card names."""
    _, content, card = checked_model(model)
    return {"sha256": sha256(content).hexdigest(), "passes": card.get("passes", 0.0)}


def take_weights(network: nn.Module, model: str) -> None:
    """Give a network the weights of an exported one, by name or file.

    Raises
    ------
    ConfigError
        There is no such model.
    FormatError
        It is no ONNX model of a circle detector, or of another network.
    """
    path = checked_model(model)[0]  # read, never run: so it needs no trust
    weights = _weights_of(path)
    expected = network.state_dict()
    for name, value in expected.items():
        if name not in weights or weights[name].shape != value.shape:
            raise FormatError(f"{path}: expected {name} of shape {tuple(value.shape)}")
    network.load_state_dict({name: weights[name] for name in expected})


def _weights_of(path: Path) -> dict[str, Tensor]:
    values = {one.name: numpy_helper.to_array(one) for one in onnx.load(path).graph.initializer}
    return {
        name.removesuffix(TURNED): torch.from_numpy(
            np.array(value.T if name.endswith(TURNED) else value)
        )
        for name, value in values.items()
    }
