"""Loss over epochs as a picture, Fig. 5."""

from pathlib import Path

from lidar_core.extras import require
from lidar_core.io.files.atomic import written_whole


def draw(metrics: list[dict[str, float]], path: Path) -> None:
    """Draw the loss on training and validation data over epochs.

    Raises
    ------
    MissingExtraError
        matplotlib is not installed.
    """
    figures = require("matplotlib.figure", extra="plot", purpose="drawing curves")
    figure = figures.Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot(xlabel="epoch", ylabel="loss")
    epochs = [row["epoch"] for row in metrics]
    for name, label in (("train_loss", "training"), ("validation_loss", "validation")):
        values = [row[name] for row in metrics if name in row]
        axes.plot(epochs[: len(values)], values, label=label)
    if all(row["train_loss"] > 0 for row in metrics):
        axes.set_yscale("log")
    axes.legend()
    axes.grid(alpha=0.3)
    with written_whole(path) as temporary:
        figure.savefig(temporary, format="png", dpi=120)
