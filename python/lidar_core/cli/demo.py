"""`lidar-core demo`: simulate, detect, track, compare with the truth."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lidar_core.cli.shared.common import (
    JsonFile,
    Threads,
    consoles,
    map_rows,
    result_table,
    shown_progress,
    stage_rows,
    write_json,
)
from lidar_core.cli.shared.voice import tell

if TYPE_CHECKING:
    from rich.table import Table

    from lidar_core.evaluation import Evaluation, EvaluationConfig, Truth
    from lidar_core.flying import FlyingFrame
    from lidar_core.run_folder import RunFolder
    from lidar_core.runs.scans.flying_output import FlyingRun
    from lidar_core.sim import SimulatedScan, Simulator
    from lidar_core.viz import FlyingView


def command(
    *,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the street, the flights and the noise.")
    ] = 0,
    scans: Annotated[
        int, typer.Option(min=1, help="Number of scans, at 10 scans per second.")
    ] = 60,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder to write; an earlier run is replaced.")
    ] = Path("runs/demo"),
    threads: Threads,
    picture: Annotated[bool, typer.Option(help="Draw picture.png (extra `plot`).")] = True,
    json: JsonFile = None,
) -> None:
    """Find and track two drones in a simulated street, and compare the tracks with the truth.

    The simulated LiDAR has 128 lines and flies a loop at 3 m/s between houses, poles and trees.
    """
    from lidar_core.evaluation import EvaluationConfig
    from lidar_core.flying import FlyingConfig, FlyingObjectDetector
    from lidar_core.run_folder import RunFolder
    from lidar_core.runs.result import draw
    from lidar_core.runs.scans.flying_output import FlyingRun
    from lidar_core.sim import Simulator, scenes
    from lidar_core.viz import draw_flying

    out, errors = consoles(json)
    folder = RunFolder(output, overwrite=True)
    simulator = Simulator(scenes.demo(seed, scans=scans), seed=seed, threads=threads)
    run = FlyingRun(FlyingObjectDetector(FlyingConfig(), threads=threads))
    truth = _Truth()
    with shown_progress(errors) as on_progress:
        for number, made in enumerate(simulator, 1):
            truth.add(made, run.take(made.posed))
            on_progress("simulate and detect", number, scans)
    rule = EvaluationConfig(burn_in_scans=run.burn_in_scans)
    report = _compared(run, truth, rule)
    summary = {"command": "demo", "seed": seed, **report.to_dict(), **run.summary()}
    folder.begin()
    files = [*run.write(folder), *_write_rest(folder, simulator, run, truth, rule, summary)]
    view = _view(simulator, run, truth, report)
    if picture:
        path = output / "picture.png"
        drawn, notes = draw([(path, lambda _: draw_flying(view, path))])
        files += drawn
        for note in notes:
            tell(errors, note)
    out.print(_table(view.title, summary, report, rule))
    out.print(f"{output}: {', '.join(sorted(files))}", highlight=False, soft_wrap=True)
    write_json(summary, json)


@dataclass(slots=True)
class _Truth:
    """Collector of the truth of the scans, for the scores, the table and the picture."""

    parts: "list[Truth]" = field(default_factory=list)
    rows: list[tuple[Any, ...]] = field(default_factory=list)

    def add(self, made: "SimulatedScan", frame: "FlyingFrame") -> None:
        from lidar_core.evaluation import truth_of
        from lidar_core.sim.recording import truth_rows

        self.rows.extend(truth_rows(len(self.parts), made))
        self.parts.append(truth_of(made, is_burn_in=frame.status.is_burn_in))


def _compared(run: "FlyingRun", truth: _Truth, rule: "EvaluationConfig") -> "Evaluation":
    from lidar_core import evaluation

    return evaluation.evaluate(
        evaluation.joined(truth.parts),
        tracks=evaluation.estimates_of_tracks(run.tracks),
        detections=evaluation.estimates_of_detections(run.frames),
        latency=run.latency,
        config=rule,
    )


def _write_rest(
    folder: "RunFolder",
    simulator: "Simulator",
    run: "FlyingRun",
    truth: _Truth,
    rule: "EvaluationConfig",
    summary: dict[str, Any],
) -> list[str]:
    """Write truth, scene, summary and run.toml; return the names of the files."""
    from lidar_core.sim.recording import TRUTH_COLUMNS

    columns = list(zip(*truth.rows, strict=True)) or [()] * len(TRUTH_COLUMNS)
    name = folder.write_table("truth", dict(zip(TRUTH_COLUMNS, columns, strict=True))).name
    folder.write_text("scene.toml", simulator.scene.to_toml())
    folder.write_summary(summary)
    folder.write_note(
        {"scene": "scene.toml", "seed": simulator.seed, "scans": simulator.scans},
        {"flying": run.detector.config, "evaluation": rule},
    )
    return [name, "scene.toml", "summary.json", "run.toml"]


def _view(
    simulator: "Simulator", run: "FlyingRun", truth: _Truth, report: "Evaluation"
) -> "FlyingView":
    import numpy as np

    ways = np.array([part.position for part in truth.parts])
    scores = {"tracks": report.tracks, "detections": report.detections}
    return run.view(
        f"lidar-core demo, seed {simulator.seed}: {len(ways)} scans, {ways.shape[1]} drones",
        truth=dict(zip(truth.parts[0].id.tolist(), ways.swapaxes(0, 1), strict=True)),
        recall={
            what: (item.stamp_ns, item.recall_at)
            for what, item in scores.items()
            if item is not None
        },
    )


def _table(
    title: str, summary: dict[str, Any], report: "Evaluation", rule: "EvaluationConfig"
) -> "Table":
    from lidar_core.evaluation.score_rows import counted_caption, main_rows

    rows = (
        *main_rows(report),
        None,
        *stage_rows(summary["ms_per_scan"]),
        *map_rows(summary["map"]),
    )
    return result_table(title, rows, caption=counted_caption(rule))
