"""`lidar-core simulate`: a scene into a recording, with the truth beside it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from lidar_core.sim import Scene


def command(
    scene: Annotated[
        str,
        typer.Argument(
            help="Scene file (TOML), or a built-in: demo, performance-1, performance-2,"
            " circles, circles-room, circles-lab."
        ),
    ],
    *,
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="Recording to write: .npz, .mcap, .bag, or a folder."),
    ],
    seed: Annotated[int, typer.Option(min=0, help="Seed of noise and random motions.")] = 0,
    scans: Annotated[
        int | None, typer.Option(min=1, help="Length; without it as the scene says.")
    ] = None,
    threads: Annotated[int, typer.Option(min=1, help="Threads; the result is the same.")] = 1,
    json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Simulate SCENE into a recording; beside it truth.csv, scene.toml and run.toml."""
    from dataclasses import asdict
    from json import dumps

    from rich.console import Console
    from rich.progress import Progress

    from lidar_core.sim.recording import record

    model = _scene(scene, seed)
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("simulate", total=model.scans if scans is None else scans)
        done = record(
            model,
            output,
            seed=seed,
            scans=scans,
            threads=threads,
            on_scan=lambda made: progress.advance(task),
        )
    if json:
        print(dumps(asdict(done), default=str))
        return
    print(f"{done.scans} scans, {done.points} points, {done.target_hits} of them on targets")
    for path in (done.recording, done.truth, done.scene, done.run):
        print(f"  {path}")


def _scene(name: str, seed: int) -> "Scene":
    from lidar_core.sim import Scene, circle_scenes, scenes

    if name == "demo":
        return scenes.demo(seed)
    if name in ("performance-1", "performance-2"):
        return scenes.performance(scene=int(name[-1]))
    if name in ("circles", "circles-room"):
        return circle_scenes.several(seed, walls=name == "circles-room")
    if name == "circles-lab":
        return circle_scenes.lab(seed)
    return Scene.read(name)
