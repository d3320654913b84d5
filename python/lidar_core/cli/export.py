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
    export = training("export").export
    if not run.is_dir():
        check_regular(run)  # says what else it is
        raise NotADirectoryError(f"{run}: expected the folder of a run, got a file")
    card = export(run, model)
    from lidar_core.circles import trust_model

    listed = trust_model(model)
    print(
        f"{model}: {card['bytes']:,} bytes, {card['parameters']:,} parameters, at most"
        f" {card['largest_difference_from_torch']:.1e} from torch"
    )
    if listed is None:
        print("It runs with --trust-model or allow_untrusted=True: no list of trusted models here.")
    else:
        print(f"Trusted from now on by this user, as {listed} says; others need --trust-model.")
