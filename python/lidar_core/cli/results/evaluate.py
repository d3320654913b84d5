"""`lidar-core evaluate`: compare the results of a run with the ground truth."""

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lidar_core.cli.shared.common import (
    JsonFile,
    as_options,
    consoles,
    given_options,
    result_table,
    write_json,
)
from lidar_core.errors import InputError
from lidar_core.util.rows import Row

if TYPE_CHECKING:
    from rich.console import Console

    from lidar_core.evaluation import (
        Evaluation,
        EvaluationConfig,
        Prediction,
        Truth,
    )

PREDICTED = (
    "Run folder of detect, circles, fuse or demo, or a table of tracks: CSV, Parquet, .npz, TUM,"
    " MCAP."
)
TRUE = (
    "Ground truth: NAME.truth.csv of simulate, the recording beside it, a demo's folder, or a"
    " table as for PRED."
)
GATE = "Largest distance between an estimate and its target \\[m]."
MAX_DISTANCE = "Ignore targets farther from the sensor \\[m]."
MIN_HITS = "Ignore targets with fewer points."
BURN_IN = "Ignore this many scans at the start; default: the burn-in of the run."
SET = "Set one value of the configuration, such as time_tolerance=0.05; may be repeated."
STATIC = (
    "Score a static map: labelled cloud (PCD with intensity 1 for moving points), or a folder"
    " with gt_cloud.pcd. PRED is the map: a run folder of detect, or .lcvm, .pcd, .ply."
)
IDENTITIES = "Compute HOTA, MOTA and IDF1; default: yes, if the extra `eval` is installed."


def command(
    predicted: Annotated[Path, typer.Argument(metavar="PRED", help=PREDICTED)],
    true: Annotated[Path | None, typer.Argument(metavar="TRUTH", help=TRUE)] = None,
    *,
    static: Annotated[Path | None, typer.Option(metavar="TRUTH", help=STATIC)] = None,
    gate: Annotated[float | None, typer.Option(help=GATE)] = None,
    max_distance: Annotated[float | None, typer.Option(help=MAX_DISTANCE)] = None,
    min_hits: Annotated[int | None, typer.Option(help=MIN_HITS)] = None,
    burn_in: Annotated[int | None, typer.Option(help=BURN_IN)] = None,
    values: Annotated[list[str], typer.Option("--set", help=SET)] = [],  # noqa: B006
    identities: Annotated[bool | None, typer.Option(help=IDENTITIES)] = None,
    json: JsonFile = None,
) -> None:
    """Score the tracks and detections in PRED against the targets in TRUTH, or a map with --static.

    The page "Evaluation" of the guide explains each value.
    """
    from lidar_core.evaluation import evaluate, read_prediction, read_truth

    if static is not None:
        _static(predicted, true, static, json)
        return
    if true is None:
        raise InputError("TRUTH: expected the targets, or --static with a labelled cloud")
    options = {
        "gate": gate,
        "max_distance": max_distance,
        "min_hits": min_hits,
        "burn_in_scans": burn_in,
    }
    prediction = read_prediction(predicted)
    config = _config(prediction, values, given_options(options))
    truth = read_truth(true, config=config, is_planar=prediction.is_planar, run=prediction)
    report = evaluate(
        truth,
        tracks=prediction.tracks,
        detections=prediction.detections,
        latency=prediction.latency,
        with_identities=find_spec("trackeval") is not None if identities is None else identities,
        config=config,
    )
    out, _ = consoles(json)
    without = _without_truth(prediction, truth, config, f"{predicted} and {true}")
    _print(out, report, config, f"{predicted} against {true}")
    interpolated = _print_interpolated(out, truth)
    outside = _print_outside(out, prediction, truth)
    warnings = _print_warnings(out, report, without)
    write_json(
        {
            "command": "evaluate",
            "prediction": str(predicted),
            "truth": str(true),
            "config": config.model_dump(mode="json"),
            "tracks_without_truth": without,
            "truth_interpolated": interpolated,
            "truth_before_run": truth.n_before,
            "truth_after_run": truth.n_after,
            "truth_outside_tracks": outside,
            **report.to_dict(),
            "warnings": warnings,
        },
        json,
    )


def _config(
    prediction: "Prediction", values: list[str], options: dict[str, Any]
) -> "EvaluationConfig":
    """Return the burn-in of the run, changed by --set, then by the options of the command."""
    from lidar_core.evaluation import EvaluationConfig
    from lidar_core.runs.settings import with_assignments

    of_run = given_options({"burn_in_scans": prediction.burn_in_scans})
    return EvaluationConfig.load(with_assignments(of_run, values) | options)


def _print_interpolated(out: "Console", truth: "Truth") -> int:
    """Print that the truth was interpolated to the scans; return the number of such positions."""
    if truth.is_interpolated is None:
        return 0
    count, known = int(truth.is_interpolated.sum()), len(truth.is_interpolated)
    out.print(
        f"note: the truth has other times than the scans; {count} of {known} true positions at the"
        " scans are interpolated",
        highlight=False,
    )
    return count


def _print_outside(out: "Console", prediction: "Prediction", truth: "Truth") -> int:
    """Print what of the truth no scan or no track is near; return the positions that count missed.

    The scans of a run folder are known: what is before and after them is left out. Of a table only
    the times of tracks are known: a tracker may have lost its target.
    """
    if truth.n_before or truth.n_after:
        out.print(
            f"note: {truth.n_before} true positions before the first scan of the run and"
            f" {truth.n_after} after its last scan are left out",
            highlight=False,
            soft_wrap=True,
        )
    ours = prediction.tracks.stamp_ns
    if prediction.scan_ns is not None or not len(ours):
        return 0
    outside = (truth.stamp_ns < ours.min()) | (truth.stamp_ns > ours.max())
    count = int((outside & truth.is_eligible).sum())
    if count:
        out.print(
            f"note: {count} of {int(truth.is_eligible.sum())} true positions that count are before"
            " the first or after the last time of the tracks: they count as missed. The table does"
            " not tell whether there were scans; a run folder does",
            highlight=False,
            soft_wrap=True,
        )
    return count


def _print_warnings(out: "Console", report: "Evaluation", without: int) -> list[str]:
    """Print the warnings, and the number of tracks without truth; return the warnings."""
    from lidar_core.evaluation.score_rows import consistency_warnings

    warnings = consistency_warnings(report)
    for text in warnings:
        out.print(f"warning: {text}")
    if without:
        out.print(f"note: {without} tracks lie at times without truth, and count as false")
    of_report = [as_options(text) for text in report.warnings]
    for text in of_report:
        out.print(f"warning: {text}", markup=False, highlight=False, soft_wrap=True)
    return [*warnings, *of_report]


def _static(predicted: Path, true: Path | None, labelled: Path, json: Path | None) -> None:
    """Score a cleaned map."""
    from lidar_core.evaluation.static_map import (
        read_labelled_cloud,
        read_static_map,
        score_static_map,
    )

    if true is not None:
        raise InputError("--static: cannot be combined with TRUTH; give one of them")
    points, resolution = read_static_map(predicted)
    scores = score_static_map(points, *read_labelled_cloud(labelled), resolution=resolution)
    out, _ = consoles(json)
    shares = (
        ("static accuracy SA", scores.static_accuracy, f"of {scores.n_static} points kept"),
        ("dynamic accuracy DA", scores.dynamic_accuracy, f"of {scores.n_dynamic} points removed"),
        ("associated accuracy AA", scores.associated_accuracy, "geometric mean"),
    )
    rows = (Row(name, "-" if v is None else f"{v:.2f} %", what) for name, v, what in shares)
    out.print(result_table(f"{predicted} against {labelled}", tuple(rows)))
    write_json(
        {
            "command": "evaluate",
            "prediction": str(predicted),
            "static_truth": str(labelled),
            **scores.to_dict(),
        },
        json,
    )


def _without_truth(
    prediction: "Prediction", truth: "Truth", config: "EvaluationConfig", files: str
) -> int:
    """Return the number of rows of tracks at times that the truth does not have.

    Raises
    ------
    InputError
        All of them: the tables are of different recordings or clocks.
    """
    import numpy as np

    from lidar_core.evaluation import aligned
    from lidar_core.evaluation.matching.overlap import (
        spans,
        time_offsets,
        typical_offset,
        wider_tolerance,
    )

    ours, theirs = prediction.tracks.stamp_ns, truth.stamp_ns
    without = ~np.isin(aligned(prediction.tracks, truth, config=config).stamp_ns, theirs)
    if len(ours) and len(theirs) and without.all():
        cure = wider_tolerance(ours, theirs)
        allowed = f"{1e3 * config.time_tolerance:g} ms"
        if ours.max() < theirs.min() or theirs.max() < ours.min():
            what = f"one ends before the other begins ({spans(ours, theirs)})"
        else:
            what = (
                f"no track is within {allowed} of a time of the truth, though their spans overlap"
                f" ({spans(ours, theirs)}): tracks are {typical_offset(time_offsets(ours, theirs))}"
            )
            if cure is None:
                # A tolerance would compare positions of different times.
                raise InputError(
                    f"{files}: no time in common: {what}; give the truth at the times of the scans,"
                    " or at least as often as the scans: it is then interpolated"
                )
        raise InputError(
            f"{files}: no time in common: {what}; give the truth of the same recording, or allow"
            " for shifted clocks with"
            f" set time_tolerance={'SECONDS' if cure is None else f'{cure:.2g}'}"
        )
    return int(without.sum())


def _print(out: "Console", report: "Evaluation", config: "EvaluationConfig", title: str) -> None:
    from lidar_core.evaluation.score_rows import all_rows, counted_caption, distance_table

    out.print(result_table(title, all_rows(report), caption=counted_caption(config)))
    table = distance_table(report)
    if table is not None:
        out.print(table)
