"""`lidar-core export`: a trained network as ONNX."""

from pathlib import Path
from typing import Annotated

import typer

from lidar_core.cli.train import training
from lidar_core.files import check_regular


def command(
    run: Annotated[Path, typer.Argument(help="Folder of a finished run of `lidar-core train`.")],
    model: Annotated[Path, typer.Argument(help="ONNX file to write; its card comes beside it.")],
) -> None:
    """Write the best weights of RUN as MODEL, checked against torch, with a card (JSON)."""
    if not run.is_dir():
        check_regular(run)  # says what else it is
        raise NotADirectoryError(f"{run}: expected the folder of a run, got a file")
    card = training("export").export(run, model)
    print(
        f"{model}: {card['bytes']:,} bytes, {card['parameters']:,} parameters, at most"
        f" {card['largest_difference_from_torch']:.1e} from torch"
    )
