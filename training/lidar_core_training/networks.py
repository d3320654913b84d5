"""The networks: Table I of the paper on whole scans, and a small one on windows."""

import torch
from torch import Tensor, nn

from lidar_core.circles.estimators.architecture import (
    ANSWERS,
    CONTEXT,
    CONVOLUTIONS,
    NEURONS,
    SLOT_FEATURES,
)
from lidar_core.circles.estimators.windows import MISSING

_LOG_NOISE = 12  # place in the context: log of the noise of a slot, in units of the window's frame


class PaperNet(nn.Module):
    """The network of Table I: 1,826,350 weights for 1081 rays, no padding, no bias at the end.

    Parameters
    ----------
    n_beams : int
        Rays of a scan.
    """

    def __init__(self, n_beams: int = 1081) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        length, channels, self.stride = n_beams, 1, 1
        for filters, kernel, stride in CONVOLUTIONS:
            layers += [nn.Conv1d(channels, filters, kernel, stride), nn.ReLU()]
            length, channels = (length - kernel) // stride + 1, filters
            self.stride *= stride
        if length < 1:
            raise ValueError(f"n_beams: expected enough for six convolutions, got {n_beams}")
        self.length = length
        self.features = nn.Sequential(*layers)
        hidden, outputs = NEURONS
        self.head = nn.Sequential(
            nn.Linear(channels * length, hidden), nn.ReLU(), nn.Linear(hidden, outputs, bias=False)
        )
        for layer in (*self.features[::2], *self.head[::2]):  # as Keras, which the paper used
            nn.init.xavier_uniform_(layer.weight)
            if layer.bias is not None:
                nn.init.zeros_(layer.bias)

    def hidden(self) -> list[nn.Parameter]:
        """Weights of the layers between the first and the last."""
        return [layer.weight for layer in (*self.features[2::2], self.head[0])]

    def forward(self, scans: Tensor) -> Tensor:
        """Circles (B, 3) of normalised scans (B, 1, n_beams).

        An object fills a small part of a scan, and the misses beside it give the same features
        everywhere. So convolutions run over the object and its surroundings only, on what differs
        from these features: the answer is that of one layer after the other on the whole scan,
        to rounding, for a tenth of the work.
        """
        sums = self._of_misses()
        first, sizes = _windows_of(scans[:, 0], self.stride)
        differences = nn.functional.pad(scans[:, 0] - MISSING, (0, int(sizes.max())))
        parts, order = [], []
        for size in sizes.unique().tolist():
            chosen = (sizes == size).nonzero()[:, 0]
            rays = first[chosen, None] + torch.arange(size, device=scans.device)
            window = differences[chosen[:, None], rays]
            parts.append(self._features(window, first[chosen] // self.stride, sums))
            order.append(chosen)
        usual = sums[-1].relu()[:, None].expand(-1, self.length)
        answers: Tensor = self.head((torch.cat(parts) + usual).flatten(1))
        return answers[torch.cat(order).argsort()]

    def _of_misses(self) -> list[Tensor]:
        """What every convolution gives, before its ReLU, where a scan has nothing but misses."""
        sums: list[Tensor] = []
        value = self.head[0].bias.new_full((1,), MISSING)
        for layer in self.features[::2]:
            sums.append(layer.weight.sum(2) @ value + layer.bias)
            value = sums[-1].relu()
        return sums

    def _features(self, window: Tensor, place: Tensor, sums: list[Tensor]) -> Tensor:
        """Differences from the features of misses (B, channels, length), given those of rays.

        `place` says at which position of the last convolution each window begins.
        """
        start, value = 0, window[:, None]  # a layer's first position that the window reaches
        for layer, misses in zip(self.features[::2], sums, strict=True):
            (kernel,), (stride,) = layer.kernel_size, layer.stride
            first, last = (start - kernel) // stride + 1, (start + value.shape[2] - 1) // stride
            value = nn.functional.conv1d(
                value, layer.weight, misses, stride, padding=start - stride * first
            )[:, :, : last - first + 1]
            value = value.relu() - misses.relu()[:, None]
            start = first
        positions = place[:, None] + start + torch.arange(value.shape[2], device=value.device)
        outside = (positions < 0) | (positions >= self.length)
        index = positions.masked_fill(outside, self.length)[:, None].expand_as(value)
        whole = value.new_zeros(*value.shape[:2], self.length + 1)
        return whole.scatter(2, index, value)[:, :, : self.length]


def _windows_of(scans: Tensor, stride: int) -> tuple[Tensor, Tensor]:
    """First ray and number of rays, few different ones, of what scans (B, n_beams) show.

    First rays are multiples of `stride`.
    """
    shown = (scans != MISSING).int()
    last = scans.shape[1] - 1 - shown.flip(1).argmax(1)
    first = shown.argmax(1) // stride * stride
    doubled = torch.log2((last - first + 1) / (2 * stride)).ceil().clamp_min(0)
    return first, 2 * stride * torch.exp2(doubled).long()


class WindowNet(nn.Module):
    """A small network on windows: a sum over rays, then a few layers on the whole.

    What a ray adds depends on where it is and on the context. One half of it is multiplied by the
    ray's difference from the first guess, so that small differences count exactly.

    Parameters
    ----------
    rays, trunk : int
        Widths of the layers per ray and of those on the whole.
    """

    def __init__(self, rays: int = 64, trunk: int = 128) -> None:
        super().__init__()
        self.register_buffer("context_mean", torch.zeros(CONTEXT))
        self.register_buffer("context_std", torch.ones(CONTEXT))
        self.half = rays // 2
        self.ray = nn.Linear(SLOT_FEATURES, rays)
        self.ray_context = nn.Linear(CONTEXT, rays, bias=False)
        self.ray_mix = nn.Linear(rays, rays)
        self.enter = nn.Linear(2 * self.half + (rays - self.half) + CONTEXT, trunk)
        self.first = nn.Linear(trunk, trunk)
        self.second = nn.Linear(trunk, trunk)
        self.leave = nn.Linear(trunk, ANSWERS)
        self.activation = nn.SiLU()
        with torch.no_grad():
            self.leave.weight.mul_(0.1)
            self.leave.bias.zero_()
            self.leave.bias[3:6] = -2.0  # first deviations: an eighth of the window's unit

    def set_normalisation(self, context: Tensor) -> None:
        """Take mean and deviation of the context from the training data."""
        self.context_mean.copy_(context.mean(0))
        self.context_std.copy_(context.std(0).clamp_min(0.2))

    def hidden(self) -> list[nn.Parameter]:
        """Weights of the layers between the first and the last."""
        return [layer.weight for layer in (self.ray_mix, self.enter, self.first, self.second)]

    def forward(self, slots: Tensor, context: Tensor) -> Tensor:
        """Answers (B, 9) to windows: slots (B, S, 4) and context (B, 21)."""
        difference, aside = slots[:, :, 0:1], slots[:, :, 1:2]
        depth, used = slots[:, :, 2:3], slots[:, :, 3:4]
        scaled = (context - self.context_mean) / self.context_std
        certainty = torch.exp(-context[:, _LOG_NOISE : _LOG_NOISE + 1])
        whitened = torch.asinh(difference * certainty.unsqueeze(1))
        features = torch.cat(
            [4 * difference, whitened, aside, depth, aside * aside, whitened * aside], dim=2
        )
        hidden = self.ray(features) + self.ray_context(scaled).unsqueeze(1)
        hidden = self.ray_mix(self.activation(hidden))
        count = used.sum(1)
        linear = (hidden[:, :, : self.half] * difference).sum(1) / count
        general = (self.activation(hidden[:, :, self.half :]) * used).sum(1) / count
        whole = torch.cat([linear, torch.asinh(linear * certainty), general, scaled], dim=1)
        trunk = self.activation(self.enter(whole))
        trunk = trunk + self.activation(self.first(trunk))
        trunk = trunk + self.activation(self.second(trunk))
        answer: Tensor = self.leave(trunk)
        return answer


def parameter_count(network: nn.Module) -> int:
    """Weights that training changes."""
    return sum(weight.numel() for weight in network.parameters())
