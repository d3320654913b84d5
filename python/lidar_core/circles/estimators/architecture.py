"""Layers of the networks: Table I of the paper, and the small network on windows of rays."""

from typing import NamedTuple

CONVOLUTIONS = ((50, 7, 1), (50, 7, 2), (100, 7, 1), (100, 7, 2), (100, 7, 1), (100, 7, 2))
"""C1 to C6 of Table I: filters, length of their kernels, stride."""
NEURONS = (125, 3)
"""F1 and F2 of Table I."""
SLOTS, SLOT_NUMBERS, SLOT_FEATURES = 32, 4, 6
"""Of the network on windows: rays it is shown, numbers of each, and what it makes of them."""
CONTEXT, ANSWERS = 21, 9
"""Of the network on windows: numbers about the whole, and how many it answers."""


class Layer(NamedTuple):
    """One layer of a network.

    Attributes
    ----------
    name : str
        Name of the layer in Table I.
    length : int
        Number of positions, or rays, in the output of the layer.
    channels : int
        Values at each position.
    parameters : int
        Weights and biases.
    multiply_adds : int
        Multiply-add operations per object.
    """

    name: str
    length: int
    channels: int
    parameters: int
    multiply_adds: int


def paper_layers(n_beams: int) -> list[Layer]:
    """Layers of Table I for scans of `n_beams` rays.

    Without padding and without bias in the last layer the parameters are those of the paper.
    """
    layers, length, channels = [], n_beams, 1
    for number, (filters, kernel, stride) in enumerate(CONVOLUTIONS, start=1):
        length = (length - kernel) // stride + 1
        weights = channels * filters * kernel
        layers.append(Layer(f"C{number}", length, filters, weights + filters, weights * length))
        channels = filters
    inputs = length * channels
    for number, neurons in enumerate(NEURONS, start=1):
        weights = inputs * neurons
        bias = neurons if number < len(NEURONS) else 0
        layers.append(Layer(f"F{number}", 1, neurons, weights + bias, weights))
        inputs = neurons
    return layers


def window_layers(rays: int, trunk: int) -> list[Layer]:
    """Layers of the network on windows, with its widths per ray and on the whole."""
    half = rays // 2
    shapes = (
        ("ray", SLOTS, SLOT_FEATURES, rays, True),
        ("ray_context", 1, CONTEXT, rays, False),
        ("ray_mix", SLOTS, rays, rays, True),
        ("enter", 1, half + rays + CONTEXT, trunk, True),
        ("first", 1, trunk, trunk, True),
        ("second", 1, trunk, trunk, True),
        ("leave", 1, trunk, ANSWERS, True),
    )
    return [
        Layer(name, length, out, inputs * out + out * has_bias, inputs * out * length)
        for name, length, inputs, out, has_bias in shapes
    ]
