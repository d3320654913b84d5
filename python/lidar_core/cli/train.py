"""`lidar-core train` and `export`: networks, trained by the distribution lidar-core-training."""

from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from lidar_core.cli.shared.common import INTERRUPTED, help_text
from lidar_core.errors import MissingExtraError
from lidar_core.extras import TRAIN, install_command
from lidar_core.files import check_regular

app = typer.Typer(name="train", no_args_is_help=True, help="Train neural networks.")

_SHOWN_EPOCHS = 12
_COLUMNS = ("epoch", "train_loss", "validation_loss", "validation_mse", "validation_mae")


def training(module: str) -> Any:
    """Import a module of the training distribution.

    Raises
    ------
    MissingExtraError
        The training distribution or torch is not installed.
    """
    try:
        return import_module(f"lidar_core_training.{module}")
    except ImportError as error:
        raise MissingExtraError(
            f"training needs the distribution lidar-core-training, which brings torch ({error}):"
            f" {install_command(TRAIN)}"
        ) from error


def circles(
    *,
    config: Annotated[Path, typer.Option("--config", "-c", help="TOML file of the training.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the run.")],
) -> None:
    """Train a circle detector as CONFIG states; the same command continues a stopped run.

    The folder gets data, checkpoints, metrics.csv after every epoch, curves.png, and test.json
    at the end.
    """
    from rich.console import Console
    from rich.live import Live

    model = training("config").TrainConfig.read(config)
    run = training("train")
    errors = Console(stderr=True)
    rows: list[dict[str, float]] = []
    try:
        with Live(console=errors, refresh_per_second=2) as live:

            def show(status: str) -> None:
                live.update(_table(rows, status))

            def on_epoch(metrics: dict[str, float]) -> None:
                rows.append(metrics)
                show(f"epoch {metrics['epoch']:.0f} done")

            results = run.train(
                model,
                output,
                on_data=lambda done, total: show(f"data: {done} of {total} shards"),
                on_step=lambda epoch, step, steps, loss: show(
                    f"epoch {epoch + 1} of {model.epochs}, step {step} of {steps}, loss {loss:.4g}"
                ),
                on_epoch=on_epoch,
            )
    except KeyboardInterrupt:
        errors.print("interrupted: run the same command to resume from the last checkpoint")
        raise typer.Exit(INTERRUPTED) from None
    _draw(output, errors)
    for part in ("validation", "test"):
        for number, measured in enumerate(results.get(part, ())):
            whole = measured["errors"]["all"]
            print(
                f"{part} of dataset {number}: loss {measured['loss']:.6g},"
                f" MSE {whole['mse']:.4g} m^2, MAE {whole['mae']:.4g} m"
            )


def _table(rows: list[dict[str, float]], status: str) -> Any:
    """Table of the last epochs, with the status below it."""
    from rich.table import Table

    table = Table(caption=status, caption_justify="left")
    for name in _COLUMNS:
        table.add_column(name.replace("_", " "), justify="right")
    for row in rows[-_SHOWN_EPOCHS:]:
        table.add_row(*(f"{row[name]:.5g}" if name in row else "-" for name in _COLUMNS))
    return table


def _draw(output: Path, console: Any) -> None:
    import csv

    with (output / "metrics.csv").open(encoding="utf-8") as file:
        metrics = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    try:
        training("curves").draw(metrics, output / "curves.png")
    except MissingExtraError as error:
        console.print(f"no curves: {error}", markup=False, soft_wrap=True)


def export(
    run: Annotated[Path, typer.Argument(help="Folder of a finished run of `lidar-core train`.")],
    model: Annotated[Path, typer.Argument(help="ONNX file to write; its card comes beside it.")],
) -> None:
    """Export the best weights of RUN as MODEL, checked against torch, with a card (JSON)."""
    write = training("export").export
    if not run.is_dir():
        check_regular(run)  # says what else it is
        raise NotADirectoryError(f"{run}: expected the folder of a run, got a file")
    card = write(run, model)
    from lidar_core.circles import trust_model

    listed = trust_model(model)
    print(
        f"{model}: {card['bytes']:,} bytes, {card['parameters']:,} parameters, at most"
        f" {card['largest_difference_from_torch']:.1e} from torch"
    )
    if listed is None:
        print("It runs with --trust-model or allow_untrusted=True: no list of trusted models here.")
    else:
        print(f"Trusted from now on by this user (listed in {listed}); others need --trust-model.")


app.command("circles", help=help_text(circles))(circles)
