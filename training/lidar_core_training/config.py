"""Configuration of a training run: a TOML file, and nothing else, decides what comes out."""

from typing import Literal, Self

from pydantic import Field, model_validator

from lidar_core.circles import DatasetConfig
from lidar_core.config import Config


class TrainConfig(Config):
    """Training of one network on datasets of circles; defaults: the paper's network.

    Source: Sanchez-Lopez et al., sec. IV-C. The paper does not give the size of a batch.
    """

    network: Literal["paper-cnn", "cnn", "one-step"] = Field(
        default="paper-cnn",
        description="Table I on whole scans with the loss of eq. 7, or the network on windows"
        " with the likelihood of circle and covariance, or the experiment that finds all circles"
        " of a scan (no unit).",
    )
    start: str | None = Field(
        default=None,
        description="Weights to begin with: a network that comes with the package, or an .onnx"
        " file that `lidar-core export` wrote; none: random ones (no unit).",
    )
    datasets: tuple[DatasetConfig, ...] = Field(
        default=(DatasetConfig(),),
        min_length=1,
        description="What it learns from, all of them mixed.",
    )
    per_scan: int = Field(
        default=8, ge=1, description="one-step: circles that share a scan (count, no unit)."
    )
    walls: int = Field(default=3, ge=0, description="one-step: walls in a scan (count, no unit).")
    epochs: int = Field(
        default=106,
        ge=1,
        description="Passes over the training data, or parts of it (count, no unit).",
    )
    parts: int = Field(
        default=1,
        ge=1,
        le=10_000,
        description="Into how many epochs a pass over the training data is divided; each of them"
        " ends with a validation (count, no unit).",
    )
    validation_samples: int = Field(
        default=0,
        ge=0,
        description="How many samples of the validation data an epoch ends with, at even"
        " distances; 0: all (count, no unit).",
    )
    batch_size: int = Field(
        default=256,
        ge=1,
        description="Samples per step, of all processes together (count, no unit).",
    )
    optimiser: Literal["adam", "muon"] = Field(
        default="adam",
        description="Adam as published, or Muon for the hidden layers, which learns the same from"
        " fewer samples (no unit).",
    )
    learning_rate: float = Field(default=1e-4, gt=0, description="Of Adam, or its peak (no unit).")
    schedule: Literal["constant", "one-cycle"] = Field(
        default="constant",
        description="Learning rate: constant as published, or up to the peak and down to 0 along"
        " a cosine (no unit).",
    )
    warmup_share: float = Field(
        default=0.05,
        gt=0,
        lt=1,
        description="One-cycle: share of all steps on the way up (no unit).",
    )
    gradient_limit: float = Field(
        default=0.0,
        ge=0,
        description="Longest gradient, longer ones are shortened; 0: any (no unit).",
    )
    square_weight: float = Field(
        default=300.0,
        ge=0,
        description="cnn: weight of the squared error beside the likelihood [1/m^2].",
    )
    precision: Literal["float32", "mixed"] = Field(
        default="float32", description="Mixed: products in bfloat16, on a GPU only (no unit)."
    )
    device: Literal["auto", "cpu", "cuda"] = Field(
        default="auto", description="Where; auto takes a GPU if there is one (no unit)."
    )
    threads: int = Field(default=2, ge=1, le=256, description="Threads on a CPU (count, no unit).")
    checkpoint_minutes: float = Field(
        default=5.0, gt=0, description="Time between checkpoints [min]."
    )
    seed: int = Field(default=0, ge=0, description="Of data, first weights and order (no unit).")

    @model_validator(mode="after")
    def _is_one_scanner(self) -> Self:
        if self.network == "one-step" and len(self.datasets) > 1:
            raise ValueError("one-step: expected one dataset, whose circles share scans")
        beams = {dataset.scanner.n_beams for dataset in self.datasets}
        if self.network == "paper-cnn" and len(beams) > 1:
            raise ValueError(f"paper-cnn: expected scanners with the same rays, got {beams}")
        return self
