"""`lidar-core simulate`: simulate a scene, and write a recording with its truth."""

from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lidar_core.cli.shared.common import (
    JsonFile,
    OverwriteFile,
    check_new,
    consoles,
    given_options,
    make_parents,
    shown_progress,
    write_json,
)
from lidar_core.errors import ConfigError, did_you_mean

if TYPE_CHECKING:
    from lidar_core.sim import Scene

BUILT_IN = (
    "demo",
    "performance-1",
    "performance-2",
    "circles",
    "circles-room",
    "circles-lab",
    "circles-trees",
)
OVERFLIGHT = "overflight"


def command(
    scene: Annotated[
        str,
        typer.Argument(
            help=f"Scene file (TOML), or a built-in: {', '.join(BUILT_IN)},"
            " overflight (LiDAR and radar)."
        ),
    ],
    *,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="Recording to write: .npz, .mcap, .bag, or a folder; .csv for overflight.",
        ),
    ],
    sensor: Annotated[
        str | None,
        typer.Option(help="LiDAR to use instead of that of the scene, such as vlp-16 or tim571."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of noise and random motions.")] = 0,
    scans: Annotated[
        int | None, typer.Option(min=1, help="Number of scans; default: that of the scene.")
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option(min=1, show_default="1", help="Number of threads; the result is the same."),
    ] = None,
    overwrite: OverwriteFile = False,
    json: JsonFile = None,
) -> None:
    """Simulate SCENE; write a recording and, beside it, NAME.truth.csv, .scene.toml and .run.toml.

    NAME is that of the recording without its ending: street.npz has street.truth.csv,
    street.scene.toml and street.run.toml. overflight writes one .csv, which holds the truth.
    """
    if scene == OVERFLIGHT:
        for name in given_options({"sensor": sensor, "threads": threads}):
            raise ConfigError(f"--{name}: does not apply to overflight")
        check_new(output, overwrite=overwrite)
        _overfly(output, seed, scans, json=json)
        return
    from dataclasses import asdict

    from lidar_core.sim.recording import files_beside, record

    check_new(output, *files_beside(output), overwrite=overwrite)
    model = scene_named(scene, seed)
    if sensor is not None:
        model = with_sensor(model, sensor)
    out, errors = consoles(json)
    total = model.scans if scans is None else scans
    made = count(1)
    with shown_progress(errors) as on_progress:
        done = record(
            model,
            output,
            seed=seed,
            scans=scans,
            threads=threads or 1,
            on_scan=lambda _: on_progress("simulate", next(made), total),
        )
    told = {
        name: str(value) if isinstance(value, Path) else value
        for name, value in asdict(done).items()
    }
    write_json(told, json)
    out.print(f"{done.scans} scans, {done.points} points, {done.target_hits} of them on targets")
    for path in (done.recording, done.truth, done.scene, done.run):
        out.print(f"  {path}", markup=False, highlight=False, soft_wrap=True)


def _overfly(output: Path, seed: int, rows: int | None, *, json: Path | None) -> None:
    """Write a table of LiDAR and radar of a drone above a target, with the truth."""
    from lidar_core.fusion import write_overflight
    from lidar_core.io.files.sole import sole_writer
    from lidar_core.sim import Overflight, overfly
    from lidar_core.sim.overflight import RATE

    if output.suffix != ".csv":
        raise ConfigError(f"--output: expected a .csv for overflight, got {output}")
    config = Overflight() if rows is None else Overflight(seconds=rows / RATE)
    make_parents(output)
    with sole_writer(output):
        made = overfly(config, seed=seed)
        write_overflight(output, made)
    out, _ = consoles(json)
    write_json({"rows": len(made.stamps_ns), "recording": str(output)}, json)
    out.print(f"{len(made.stamps_ns)} rows with the truth")
    out.print(f"  {output}", markup=False, highlight=False, soft_wrap=True)


def with_sensor(scene: "Scene", name: str) -> "Scene":
    """Return the scene with the LiDAR of a preset; an `ideal` one stays ideal."""
    from lidar_core.sim import LidarModel

    lidar = LidarModel.preset(name, ideal=scene.lidar.ideal)
    return scene.model_copy(update={"lidar": lidar})


def scene_named(name: str, seed: int) -> "Scene":
    """Return a built-in scene, or read that of a file.

    Raises
    ------
    FileNotFoundError
        `name` is neither.
    """
    from lidar_core.sim import Scene, circle_scenes, scenes

    if name == "demo":
        return scenes.demo(seed)
    if name in ("performance-1", "performance-2"):
        return scenes.performance(scene=int(name[-1]))
    if name in ("circles", "circles-room"):
        return circle_scenes.several(seed, walls=name == "circles-room")
    if name == "circles-lab":
        return circle_scenes.lab(seed)
    if name == "circles-trees":
        return circle_scenes.trees(seed)
    if not Path(name).exists():
        built_in = (*BUILT_IN, OVERFLIGHT)
        raise FileNotFoundError(
            f"{name}: no such scene file; built-in scenes are"
            f" {', '.join(built_in)}{did_you_mean(name, built_in)}"
        )
    return Scene.read(name)
