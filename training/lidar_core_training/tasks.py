"""What each network is shown, and what its answers mean: two tasks with the same face."""

from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lidar_core.circles import Samples, Scanner
from lidar_core.circles.crowds import Crowds, crowds
from lidar_core.circles.estimators.windows import normalised, windows_of_samples
from lidar_core_training.config import TrainConfig
from lidar_core_training.losses import four_points, gaussian, whitened
from lidar_core_training.networks import PaperNet, WindowNet
from lidar_core_training.one_step import OneStepNet, loss_of, shown, truth_of

_PREPARED = 16_384  # samples that are prepared at a time


@dataclass(frozen=True)
class Batch:
    """Inputs of a network, and what it should answer."""

    inputs: tuple[Tensor, ...]
    truth: Tensor
    scale: Tensor

    def to(self, device: torch.device) -> "Batch":
        """The same on a device."""
        inputs = tuple(array.to(device) for array in self.inputs)
        return Batch(inputs, self.truth.to(device), self.scale.to(device))

    def rows(self, numbers: NDArray[np.int64]) -> "Batch":
        """Some of the samples, on the same device."""
        index = torch.from_numpy(numbers).to(self.truth.device)
        return Batch(
            tuple(array[index] for array in self.inputs), self.truth[index], self.scale[index]
        )

    @property
    def n_bytes(self) -> int:
        """Memory that the samples take."""
        return sum(array.nbytes for array in (*self.inputs, self.truth, self.scale))


Network: TypeAlias = PaperNet | WindowNet | OneStepNet


class Task(Protocol):
    """One network and its data."""

    normalisation: dict[str, float]

    def network(self) -> Network:
        """Return a fresh network."""

    def batch(self, data: "Data", numbers: NDArray[np.int64]) -> Batch:
        """Return samples as the network sees them."""

    def loss(self, answer: Tensor, batch: Batch) -> Tensor:
        """Return what training makes small."""

    def errors(self, answer: Tensor, batch: Batch) -> tuple[Tensor, Tensor | None]:
        """Return errors of x, y, radius in metres, and squared errors in deviations."""


@dataclass(frozen=True)
class Data:
    """Samples of several scanners, numbered through."""

    parts: tuple[tuple[Scanner, Samples], ...]
    starts: tuple[NDArray[np.int64], ...]
    first: NDArray[np.int64]

    @classmethod
    def of(cls, parts: list[tuple[Scanner, Samples]]) -> "Data":
        """Number the samples of `parts`."""
        counts = [len(samples) for _, samples in parts]
        starts = tuple(samples.starts for _, samples in parts)
        return cls(tuple(parts), starts, np.concatenate([[0], np.cumsum(counts)]))

    def __len__(self) -> int:
        return int(self.first[-1])

    def chosen(self, numbers: NDArray[np.int64]) -> list[tuple[Scanner, Samples]]:
        """Samples with these ascending numbers, by scanner."""
        found = []
        for index, (scanner, samples) in enumerate(self.parts):
            low, high = np.searchsorted(numbers, self.first[index : index + 2])
            if high > low:
                inside = numbers[low:high] - self.first[index]
                found.append((scanner, samples.take(inside, starts=self.starts[index])))
        return found


@dataclass
class PaperTask:
    """Whole scans, normalised to [0, 1], misses -1; sec. IV-A."""

    n_beams: int
    normalisation: dict[str, float]

    def network(self) -> PaperNet:
        """Table I."""
        return PaperNet(self.n_beams)

    def batch(self, data: Data, numbers: NDArray[np.int64]) -> Batch:
        """Whole scans."""
        chosen = data.chosen(numbers)
        low, high = self.normalisation["range_low"], self.normalisation["range_high"]
        scans = [normalised(samples.scans(scanner), low, high) for scanner, samples in chosen]
        circles = np.concatenate([samples.circles for _, samples in chosen])
        truth = torch.from_numpy(circles)
        return Batch((torch.from_numpy(np.concatenate(scans)),), truth, torch.ones(len(truth)))

    def loss(self, answer: Tensor, batch: Batch) -> Tensor:
        """Eq. 7."""
        return four_points(answer, batch.truth)

    def errors(self, answer: Tensor, batch: Batch) -> tuple[Tensor, Tensor | None]:
        """Answers are circles; how sure they are is not known."""
        return answer - batch.truth, None


@dataclass
class WindowTask:
    """Windows in their own frames; answers are circles and covariances."""

    square_weight: float
    normalisation: dict[str, float]

    def network(self) -> WindowNet:
        """A network on windows."""
        return WindowNet()

    def batch(self, data: Data, numbers: NDArray[np.int64]) -> Batch:
        """Windows; what is missing from the first guess is the truth, in units of the frame."""
        arrays = []
        for scanner, samples in data.chosen(numbers):
            slots, context, frames = windows_of_samples(samples, scanner)
            bearing, scale, distance, radius = frames[:, :4].T
            x, y, size = samples.circles.astype(np.float64).T
            cosine, sine = np.cos(bearing), np.sin(bearing)
            ahead, aside = cosine * x + sine * y, cosine * y - sine * x
            truth = np.stack([ahead - distance, aside, size - radius], axis=1) / scale[:, None]
            turn = np.stack([bearing, scale], axis=1)
            arrays.append((slots, context, truth.astype(np.float32), turn.astype(np.float32)))
        slots, context, truth, turn = (
            torch.from_numpy(np.concatenate(parts)) for parts in zip(*arrays, strict=True)
        )
        return Batch((slots, context), truth, turn)

    def loss(self, answer: Tensor, batch: Batch) -> Tensor:
        """Gaussian likelihood."""
        return gaussian(answer, batch.truth, batch.scale[:, 1], self.square_weight)

    def errors(self, answer: Tensor, batch: Batch) -> tuple[Tensor, Tensor | None]:
        """Back in the frame of the scanner."""
        bearing, scale = batch.scale.unbind(1)
        ahead, aside, size = ((answer[:, :3] - batch.truth) * scale[:, None]).unbind(1)
        cosine, sine = torch.cos(bearing), torch.sin(bearing)
        errors = torch.stack(
            [cosine * ahead - sine * aside, sine * ahead + cosine * aside, size], 1
        )
        return errors, whitened(answer, batch.truth)[0].square().sum(1)


@dataclass
class OneStepTask:
    """Scans of several circles and walls; `truth` and `scale` (hits) are per ray."""

    per_scan: int
    walls: int
    normalisation: dict[str, float]

    def network(self) -> OneStepNet:
        """A network from rays to votes."""
        return OneStepNet()

    def crowds(self, data: Data, numbers: NDArray[np.int64]) -> list[tuple[Scanner, Crowds]]:
        """Scans that these circles share, by scanner."""
        return [
            (
                scanner,
                crowds(
                    samples, scanner, per_scan=self.per_scan, walls=self.walls, seed=int(numbers[0])
                ),
            )
            for scanner, samples in data.chosen(numbers)
        ]

    def batch(self, data: Data, numbers: NDArray[np.int64]) -> Batch:
        """Scans, and what their rays met."""
        made = self.crowds(data, numbers)
        scans = np.concatenate([shown(one.scans, scanner) for scanner, one in made])
        truth = np.concatenate([truth_of(one, scanner) for scanner, one in made])
        inputs = torch.from_numpy(scans)
        return Batch((inputs,), torch.from_numpy(truth), inputs[:, 0])

    def loss(self, answer: Tensor, batch: Batch) -> Tensor:
        """Votes."""
        return loss_of(answer, batch.truth, batch.scale)

    def errors(self, answer: Tensor, batch: Batch) -> tuple[Tensor, Tensor | None]:
        """Of the votes of rays that met circles, along and across the ray."""
        is_circle = batch.truth[:, 0] > 0
        return (answer - batch.truth)[:, 1:].transpose(1, 2)[is_circle], None


def resident(task: Task, data: Data, device: torch.device, *, most_bytes: int) -> Batch | None:
    """All samples in the memory of a device, as the network sees them.

    A GPU learns faster than one CPU prepares scans, so each sample is prepared once and not once
    per pass. None where the samples do not fit, or differ from batch to batch.
    """
    if isinstance(task, OneStepTask) or not len(data):
        return None
    if task.batch(data, np.arange(1)).n_bytes * len(data) > most_bytes:
        return None
    parts = [
        task.batch(data, np.arange(start, min(start + _PREPARED, len(data)))).to(device)
        for start in range(0, len(data), _PREPARED)
    ]
    inputs = tuple(
        torch.cat(arrays) for arrays in zip(*(part.inputs for part in parts), strict=True)
    )
    return Batch(
        inputs, torch.cat([part.truth for part in parts]), torch.cat([part.scale for part in parts])
    )


def task_of(config: TrainConfig, data: Data) -> Task:
    """Return the task of a run; `data` is training and validation, of which it knows the limits."""
    if config.network == "cnn":
        return WindowTask(config.square_weight, {})
    if config.network == "one-step":
        return OneStepTask(config.per_scan, config.walls, {})
    finite = [samples.ranges[np.isfinite(samples.ranges)] for _, samples in data.parts]
    low, high = (float(end(np.concatenate(finite))) for end in (np.min, np.max))
    beams = config.datasets[0].scanner.n_beams
    return PaperTask(beams, {"range_low": low, "range_high": high})
