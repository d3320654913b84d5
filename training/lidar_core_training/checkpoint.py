"""Checkpoints: weights and the state of the optimiser in files of their own, never half written."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import nn

from lidar_core.errors import FormatError
from lidar_core.io.files.atomic import written_whole
from lidar_core_training.optimiser import Optimiser

STATE = "state.json"
BEST = "best.pt"


@dataclass
class Progress:
    """How far a run is.

    Attributes
    ----------
    epoch, step : int
        Next epoch, and steps of it that are done.
    sums : list of float
        Loss and samples of these steps.
    best : float
        Smallest loss on the validation data so far.
    metrics : list
        One entry per finished epoch.
    """

    epoch: int = 0
    step: int = 0
    sums: list[float] = field(default_factory=lambda: [0.0, 0.0])
    best: float = float("inf")
    metrics: list[dict[str, float]] = field(default_factory=list)


def save(
    folder: Path, progress: Progress, network: nn.Module, optimiser: Optimiser, key: str
) -> None:
    """Write weights, optimiser and, last, the note that names both; then drop the ones before."""
    mark = f"{progress.epoch:05d}-{progress.step:07d}"
    names = {"weights": f"weights-{mark}.pt", "optimiser": f"optimiser-{mark}.pt"}
    write_torch(folder / names["weights"], network.state_dict())
    write_torch(folder / names["optimiser"], optimiser.state_dict())
    note = {"key": key, "files": names, "progress": asdict(progress)}
    with written_whole(folder / STATE) as temporary:
        temporary.write_text(json.dumps(note, indent=1) + "\n", encoding="utf-8")
    for kind, kept in names.items():
        for old in folder.glob(f"{kind}-*.pt"):
            if old.name != kept:
                old.unlink()


def load(folder: Path, network: nn.Module, optimiser: Optimiser, key: str) -> Progress | None:
    """Go back to the last checkpoint; None if there is none.

    Raises
    ------
    FormatError
        It is of another configuration.
    """
    path = folder / STATE
    if not path.exists():
        return None
    note = json.loads(path.read_text(encoding="utf-8"))
    if note["key"] != key:
        raise FormatError(f"{path}: the run was made with another configuration; choose a new one")
    network.load_state_dict(read_torch(folder / note["files"]["weights"]))
    optimiser.load_state_dict(read_torch(folder / note["files"]["optimiser"]))
    return Progress(**note["progress"])


def write_torch(path: Path, state: dict[str, Any]) -> None:
    """Write tensors, whole or not at all."""
    with written_whole(path) as temporary:
        torch.save(state, temporary)


def read_torch(path: Path) -> dict[str, Any]:
    """Read tensors, and nothing else that a file may hold."""
    state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    return state
