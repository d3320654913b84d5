"""One training run in a folder: data, checkpoints, metrics, curves; goes on where it stopped."""

import csv
import json
import math
import os
import subprocess
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.distributed as dist
from numpy.typing import NDArray
from torch import nn
from torch.nn.parallel import DistributedDataParallel

from lidar_core import __version__
from lidar_core.circles import dataset
from lidar_core.io.files.atomic import written_whole
from lidar_core_training import checkpoint
from lidar_core_training.checkpoint import Progress
from lidar_core_training.config import TrainConfig
from lidar_core_training.metrics import breakdown, errors_of, summary
from lidar_core_training.one_step import compared
from lidar_core_training.optimiser import Optimiser
from lidar_core_training.tasks import Data, OneStepTask, Task, resident, task_of
from lidar_core_training.weights import start_of, take_weights

METRICS = "metrics.csv"
TEST = "test.json"
NOTE = "train.toml"
ORIGIN = "origin.json"
_DETECTED = 8_000  # circles, at most, among which the one-step network has to find all


@dataclass(frozen=True)
class Group:
    """The processes that train together."""

    rank: int
    size: int
    device: torch.device

    @classmethod
    def joined(cls, config: TrainConfig) -> "Group":
        """Join the processes that torchrun started, if it did."""
        gpu = config.device == "cuda" or (config.device == "auto" and torch.cuda.is_available())
        size, rank = int(os.environ.get("WORLD_SIZE", "1")), int(os.environ.get("RANK", "0"))
        if gpu:
            torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")))
        if size > 1 and not dist.is_initialized():
            dist.init_process_group("nccl" if gpu else "gloo")
        return cls(rank, size, torch.device("cuda" if gpu else "cpu"))

    def wait(self) -> None:
        """Until all are here."""
        if self.size > 1:
            dist.barrier()

    def total(self, values: list[float]) -> list[float]:
        """Sums over all processes."""
        if self.size == 1:
            return values
        sums = torch.tensor(values, dtype=torch.float64, device=self.device)
        dist.all_reduce(sums)
        return [float(value) for value in sums]


def train(
    config: TrainConfig,
    folder: Path,
    *,
    on_data: Callable[[int, int], None] | None = None,
    on_step: Callable[[int, int, int, float], None] | None = None,
    on_epoch: Callable[[dict[str, float]], None] | None = None,
) -> dict[str, Any]:
    """Train, or go on training, in `folder`.

    Parameters
    ----------
    config : TrainConfig
        Everything that decides the result.
    folder : Path
        Of this run: data/, checkpoints, metrics.csv, curves.png, test.json.
    on_data, on_step, on_epoch : callable, optional
        Told shards done and all of them; epoch, steps done, all steps of it and loss; metrics.

    Returns
    -------
    results : dict
        Errors on training and validation data, and on the test data, by kind of circle.
    """
    group = Group.joined(config)
    torch.set_num_threads(config.threads)
    torch.manual_seed(config.seed)
    folder.mkdir(parents=True, exist_ok=True)
    if group.rank == 0:
        with written_whole(folder / NOTE) as temporary:
            temporary.write_text(config.to_toml(), encoding="utf-8")
        with written_whole(folder / ORIGIN) as temporary:
            temporary.write_text(json.dumps(_origin(config), indent=1) + "\n", encoding="utf-8")
        _datasets(config, folder, on_data)
    group.wait()
    run = Run(config, folder, group)
    run.go(on_step, on_epoch)
    return run.finish() if group.rank == 0 else {}


def _origin(config: TrainConfig) -> dict[str, Any]:
    """What trains: commit of the checkout ("unknown" outside of one), versions, first weights."""
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"]
    try:
        commit = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        commit = "unknown"
    origin = {"training_commit": commit, "torch": torch.__version__, "lidar_core": __version__}
    return origin if config.start is None else origin | {"start": start_of(config.start)}


def _datasets(
    config: TrainConfig, folder: Path, on_data: Callable[[int, int], None] | None = None
) -> list[dataset.CircleDataset]:
    """Make, or find, the data of a run: one seed per dataset."""
    return [
        dataset.generate(
            one,
            folder / f"data/{index}",
            seed=config.seed + index,
            threads=config.threads,
            on_shard=on_data,
        )
        for index, one in enumerate(config.datasets)
    ]


def key_of(config: TrainConfig) -> str:
    """What must not change while a run goes on; more epochs may follow at a constant rate."""
    free = {"threads", "device", "checkpoint_minutes", "precision"}
    if config.schedule == "constant":
        free.add("epochs")
    return sha256(config.model_dump_json(exclude=free).encode()).hexdigest()


class Run:
    """What a run holds in memory."""

    def __init__(self, config: TrainConfig, folder: Path, group: Group) -> None:
        self.config, self.folder, self.group = config, folder, group
        made = [dataset.open_dataset(folder / f"data/{i}") for i in range(len(config.datasets))]
        self.data = {
            part: Data.of([(one.config.scanner, one.read(part)) for one in made])
            for part in ("train", "validation", "test")
        }
        known = Data.of([*self.data["train"].parts, *self.data["validation"].parts])
        self.task: Task = task_of(config, known)
        self.network = self.task.network()
        self._normalise()
        if config.start is not None:
            take_weights(self.network, config.start)
        self.network.to(group.device)
        self.resident = None
        if group.device.type == "cuda":
            free = torch.cuda.mem_get_info(group.device)[0]  # a third, since joining takes it twice
            self.resident = resident(
                self.task, self.data["train"], group.device, most_bytes=free // 3
            )
        self.optimiser = Optimiser(
            self.network,
            self.network.hidden() if config.optimiser == "muon" else [],
            config.learning_rate,
        )
        self.key = key_of(config)
        self.progress = (
            checkpoint.load(folder, self.network, self.optimiser, self.key) or Progress()
        )
        self.model: nn.Module = (
            DistributedDataParallel(self.network) if group.size > 1 else self.network
        )

    def _normalise(self) -> None:
        """Let the network take what it needs to know of its inputs."""
        take = getattr(self.network, "set_normalisation", None)
        if take is not None:
            some = np.unique(np.linspace(0, len(self.data["train"]) - 1, 20_000).astype(np.int64))
            take(self.task.batch(self.data["train"], some).inputs[1])

    @property
    def steps(self) -> int:
        """Steps of one epoch; the last samples that fill no batch are left for another pass."""
        samples = self.config.batch_size * self.config.parts
        return max(len(self.data["train"]) // samples, 1)

    def rate(self, step: int) -> float:
        """Learning rate of the step with this number, counted over all epochs."""
        config = self.config
        if config.schedule == "constant":
            return config.learning_rate
        done = step / (self.steps * config.epochs)
        if done < config.warmup_share:
            return config.learning_rate * (done / config.warmup_share + 1e-3)
        turn = math.pi * (done - config.warmup_share) / (1 - config.warmup_share)
        return config.learning_rate * (0.5 * (1 + math.cos(turn)) + 1e-3)

    def go(
        self,
        on_step: Callable[[int, int, int, float], None] | None,
        on_epoch: Callable[[dict[str, float]], None] | None,
    ) -> None:
        """Train to the end."""
        saved = time.monotonic()
        while self.progress.epoch < self.config.epochs:
            order = self._order(self.progress.epoch)
            while self.progress.step < self.steps:
                loss = self._step(order)
                if on_step is not None and self.group.rank == 0:
                    on_step(self.progress.epoch, self.progress.step, self.steps, loss)
                if time.monotonic() - saved > 60 * self.config.checkpoint_minutes:
                    self._save()
                    saved = time.monotonic()
            metrics = self._end_epoch()
            if on_epoch is not None and self.group.rank == 0:
                on_epoch(metrics)

    def _order(self, epoch: int) -> NDArray[np.int64]:
        """Samples of an epoch: of its part of a pass."""
        number, part = divmod(epoch, self.config.parts)
        again = [] if self.config.start is None else [1]  # not what the start has seen first
        random = np.random.default_rng([self.config.seed, number, *again])
        order = random.permutation(len(self.data["train"]))
        return order[part * self.steps * self.config.batch_size :]

    def _step(self, order: NDArray[np.int64]) -> float:
        """One step on this process's share of a batch."""
        size, group, progress = self.config.batch_size, self.group, self.progress
        chosen = order[progress.step * size : (progress.step + 1) * size]
        rows = np.sort(chosen[group.rank :: group.size])
        batch = (
            self.task.batch(self.data["train"], rows).to(group.device)
            if self.resident is None
            else self.resident.rows(rows)
        )
        mixed = self.config.precision == "mixed" and group.device.type == "cuda"
        with torch.autocast("cuda", torch.bfloat16) if mixed else nullcontext():
            answer = self.model(*batch.inputs)
        loss = self.task.loss(answer.float(), batch)
        self.optimiser.zero_grad()
        loss.backward()
        if self.config.gradient_limit:
            nn.utils.clip_grad_norm_(self.network.parameters(), self.config.gradient_limit)
        self.optimiser.step(self.rate(progress.epoch * self.steps + progress.step))
        progress.step += 1
        value = float(loss.detach())
        progress.sums[0] += value * len(answer)
        progress.sums[1] += len(answer)
        return value

    def _end_epoch(self) -> dict[str, float]:
        progress, group = self.progress, self.group
        loss, samples = group.total(progress.sums)
        metrics = {"epoch": float(progress.epoch + 1), "train_loss": loss / samples}
        validation = self.data["validation"]
        if len(validation) and group.rank == 0:
            count = min(self.config.validation_samples or len(validation), len(validation))
            some = np.arange(count) * len(validation) // count
            value, errors, nees = errors_of(self.network, self.task, validation, some, group.device)
            metrics |= {"validation_loss": value}
            metrics |= {f"validation_{k}": v for k, v in summary(errors, nees).items()}
        metrics["rate"] = self.rate(progress.epoch * self.steps)
        progress.metrics.append(metrics)
        progress.epoch, progress.step, progress.sums = progress.epoch + 1, 0, [0.0, 0.0]
        if group.rank == 0 and (score := metrics.get("validation_loss", loss)) < progress.best:
            progress.best = score
            checkpoint.write_torch(self.folder / checkpoint.BEST, self.network.state_dict())
        self._save()
        return metrics

    def _save(self) -> None:
        if self.group.rank == 0:
            checkpoint.save(self.folder, self.progress, self.network, self.optimiser, self.key)
            _write_metrics(self.folder / METRICS, self.progress.metrics)
        self.group.wait()

    def finish(self) -> dict[str, Any]:
        """Measure the weights that validation prefers."""
        self.network.load_state_dict(checkpoint.read_torch(self.folder / checkpoint.BEST))
        results: dict[str, Any] = {"normalisation": self.task.normalisation}
        for part in ("validation", "test"):
            results[part] = [
                self._measured(Data.of([(scanner, samples)]))
                for scanner, samples in self.data[part].parts
                if len(samples)
            ]
        with written_whole(self.folder / TEST) as temporary:
            temporary.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
        return results

    def _measured(self, data: Data) -> dict[str, Any]:
        numbers = np.arange(len(data))
        loss, errors, nees = errors_of(self.network, self.task, data, numbers, self.group.device)
        if isinstance(self.task, OneStepTask):
            ((scanner, made),) = self.task.crowds(data, numbers[:_DETECTED])
            return {
                "loss": loss,
                "rays": summary(errors, nees),
                "circles": compared(self.network, made, scanner),
            }
        return {"loss": loss, "errors": breakdown(errors, nees, *data.parts[0])}


def _write_metrics(path: Path, metrics: list[dict[str, float]]) -> None:
    with written_whole(path) as temporary, temporary.open("w", newline="") as file:
        if metrics:
            writer = csv.DictWriter(file, list(metrics[0]))
            writer.writeheader()
            writer.writerows(metrics)
