"""`lidar-core demo`: simulate, detect, track, compare with the truth."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lidar_core.cli.common import (
    JsonFile,
    Row,
    Threads,
    consoles,
    draw,
    map_rows,
    number,
    progress_on,
    result_table,
    stage_rows,
    write_json,
)

if TYPE_CHECKING:
    from rich.table import Table

    from lidar_core.cli.flying_run import FlyingRun
    from lidar_core.evaluation import DetectionScores, TrackScores, Truth
    from lidar_core.run_folder import RunFolder
    from lidar_core.sim import SimulatedScan, Simulator
    from lidar_core.viz import FlyingView


def command(
    *,
    seed: Annotated[int, typer.Option(min=0, help="Street, flights and noise.")] = 0,
    scans: Annotated[int, typer.Option(min=1, help="Length, at 10 scans per second.")] = 60,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder to write; an earlier run is replaced.")
    ] = Path("runs/demo"),
    threads: Threads,
    picture: Annotated[bool, typer.Option(help="Draw picture.png (extra `plot`).")] = True,
    json: JsonFile = None,
) -> None:
    """Find and track two drones in a simulated street, and compare them with the truth.

    A 128-line LiDAR flies a loop at 3 m/s between houses, poles and trees. Needs no input.
    """
    from lidar_core.cli.flying_run import FlyingRun
    from lidar_core.flying import FlyingConfig, FlyingObjectDetector
    from lidar_core.run_folder import RunFolder
    from lidar_core.sim import Simulator, scenes

    out, errors = consoles(json)
    folder = RunFolder(output, overwrite=True)
    simulator = Simulator(scenes.demo(seed, scans=scans), seed=seed, threads=threads)
    run = FlyingRun(FlyingObjectDetector(FlyingConfig(), threads=threads))
    truth = _Truth()
    with progress_on(errors) as progress:
        task = progress.add_task("simulate and detect", total=scans)
        for number_of, made in enumerate(simulator):
            truth.add(made, is_burn_in=number_of < run.detector.config.seed.burn_in_scans)
            run.process(made.scan, made.poses, made.pose_stamps_ns)
            progress.advance(task)
    compared = _Compared.of(run, truth)
    summary = {
        "command": "demo",
        "seed": seed,
        "track_scores": compared.tracks.to_dict(),
        "detection_scores": compared.detections.to_dict(),
        **run.summary(),
    }
    folder.begin()
    files = [*run.write(folder), *_write_rest(folder, simulator, run, truth, summary)]
    view = _view(simulator, run, truth, compared)
    if picture and draw(view, output / "picture.png", errors):
        files.append("picture.png")
    out.print(_table(view.title, summary, compared))
    out.print(f"{output}: {', '.join(sorted(files))}", highlight=False, soft_wrap=True)
    write_json(summary, json)


@dataclass(slots=True)
class _Truth:
    """Truth of the scans so far: for the scores, the table and the picture."""

    parts: "list[Truth]" = field(default_factory=list)
    rows: list[tuple[Any, ...]] = field(default_factory=list)

    def add(self, made: "SimulatedScan", *, is_burn_in: bool) -> None:
        from lidar_core.evaluation import truth_of
        from lidar_core.sim.recording import truth_rows

        self.rows.extend(truth_rows(len(self.parts), made))
        self.parts.append(truth_of(made, is_burn_in=is_burn_in))


@dataclass(frozen=True, slots=True)
class _Compared:
    tracks: "TrackScores"
    detections: "DetectionScores"

    @classmethod
    def of(cls, run: "FlyingRun", truth: _Truth) -> "_Compared":
        from lidar_core import evaluation

        table = evaluation.joined(truth.parts)
        return cls(
            evaluation.score_tracks(evaluation.estimates_of_tracks(run.tracks), table),
            evaluation.score_detections(evaluation.estimates_of_detections(run.frames), table),
        )


def _write_rest(
    folder: "RunFolder",
    simulator: "Simulator",
    run: "FlyingRun",
    truth: _Truth,
    summary: dict[str, Any],
) -> list[str]:
    """Truth, scene, summary and run.toml."""
    from lidar_core.evaluation import EvaluationConfig
    from lidar_core.sim.recording import TRUTH_COLUMNS

    columns = list(zip(*truth.rows, strict=True)) or [()] * len(TRUTH_COLUMNS)
    name = folder.write_table("truth", dict(zip(TRUTH_COLUMNS, columns, strict=True))).name
    folder.write_text("scene.toml", simulator.scene.to_toml())
    folder.write_summary(summary)
    folder.write_note(
        {"scene": "scene.toml", "seed": simulator.seed, "scans": simulator.scans},
        {"flying": run.detector.config, "evaluation": EvaluationConfig()},
    )
    return [name, "scene.toml", "summary.json", "run.toml"]


def _view(
    simulator: "Simulator", run: "FlyingRun", truth: _Truth, compared: _Compared
) -> "FlyingView":
    import numpy as np

    ways = np.array([part.position for part in truth.parts])
    tracks, detections = compared.tracks, compared.detections
    return run.view(
        f"lidar-core demo, seed {simulator.seed}: {len(ways)} scans, {ways.shape[1]} drones",
        truth=dict(zip(truth.parts[0].id.tolist(), ways.swapaxes(0, 1), strict=True)),
        recall={
            "tracks": (tracks.stamp_ns, tracks.recall_at),
            "detections": (detections.stamp_ns, detections.recall_at),
        },
    )


def _table(title: str, summary: dict[str, Any], compared: _Compared) -> "Table":
    from lidar_core.evaluation import EvaluationConfig

    tracks, detections, rule = compared.tracks, compared.detections, EvaluationConfig()
    delays = [delay for delay in tracks.first_delay.values() if delay is not None]
    spread = f"RMSE {number(tracks.rmse, 2)}, largest {number(tracks.max_error, 2)}"
    of_all = f"of {len(tracks.track_ids)}; {tracks.n_switches} changes of identity"
    false = f"of {detections.n_estimates}"
    first = f"at the latest; {len(delays)} of {len(tracks.first_delay)} targets tracked"
    rows = (
        Row("recall of tracks", number(tracks.recall, 3), _found(tracks)),
        Row("recall of detections", number(detections.recall, 3), _found(detections)),
        Row("position error", number(tracks.mean_error, 2, " m"), f"mean of tracks; {spread}"),
        Row("false tracks", str(len(tracks.false_ids)), of_all),
        Row("false detections", str(detections.n_false), false),
        Row("first track after", number(max(delays, default=None), 1, " s"), first),
        None,
        *stage_rows(summary["ms_per_scan"]),
        *map_rows(summary["map"]),
    )
    return result_table(
        title,
        rows,
        caption=f"Sightings: target within {rule.max_distance:g} m, hit by {rule.min_hits} rays or"
        " more, after the burn-in.",
    )


def _found(scores: "DetectionScores") -> str:
    return f"{scores.n_found} of {scores.n_eligible} sightings"
