"""`lidar-core convert`: a recording in another format."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lidar_core.cli.shared import completion
from lidar_core.cli.shared.common import (
    JsonFile,
    OverwriteFile,
    check_new,
    consoles,
    given_options,
    make_parents,
    printing,
    shown_progress,
    write_json,
)
from lidar_core.cli.shared.run_options import DecodingOptions, End, Start, with_options

if TYPE_CHECKING:
    from rich.console import Console

    from lidar_core.io import ReadOptions, Recording, Span
    from lidar_core.messages import Message


def _print_formats() -> None:
    from rich.console import Console
    from rich.table import Table

    from lidar_core.io.writers import WRITERS

    table = Table("Format", "Files", "Holds", "Extra")
    for one in WRITERS.parts():
        ends = " ".join(end or "(a new folder)" for end in one.suffixes)
        table.add_row(one.format, ends, one.takes, one.extra)
    Console().print(table)


@with_options(DecodingOptions)
def command(
    options: DecodingOptions,
    *,
    recording: Annotated[Path, typer.Argument(help="Recording, or folder of a run.")],
    output: Annotated[
        Path,
        typer.Argument(
            help="NAME.npz, NAME.mcap (Foxglove), NAME.bag (ROS 1), a new folder (ROS 2). For one"
            " cloud or map: NAME.pcd, NAME.ply, NAME.bt (OctoMap). For a run: NAME.json"
            " (nuScenes), NAME.txt (MOTChallenge), NAME.bag or a folder (ROS obstacles)."
        ),
    ],
    topic: Annotated[
        list[str] | None,
        typer.Option(
            help="Convert only the scans of this topic; may be repeated.",
            autocompletion=completion.ALL,
        ),
    ] = None,
    start: Start = 0.0,
    end: End = None,
    resolution: Annotated[
        float | None,
        typer.Option(help="Edge of the voxels of NAME.bt \\[m]; default: that of the input map."),
    ] = None,
    class_name: Annotated[
        str | None, typer.Option("--class", help="Class of a run's objects, such as pedestrian.")
    ] = None,
    overwrite: OverwriteFile = False,
    json_file: JsonFile = None,
    formats: Annotated[
        bool,
        typer.Option(
            "--formats",
            callback=printing(_print_formats),
            is_eager=True,
            help="List the output formats.",
        ),
    ] = False,
) -> None:
    """Convert RECORDING; the suffix of OUTPUT selects the format.

    Scans and poses of a recording are written, or the objects of a run.
    """
    from lidar_core.errors import InputError
    from lidar_core.io import ReadOptions, Span
    from lidar_core.io.maps.cloud_files import MAPS
    from lidar_core.io.writers import ending_of, writer_of, writers_of
    from lidar_core.runs.convert import convert_run, is_run

    if output.exists() and output.resolve() == recording.resolve():
        raise InputError(f"{output}: is also the input; choose another file to write")
    check_new(output, overwrite=overwrite)
    values = options.to_values()
    chosen = given_options({"topic": topic or None, "start": start or None, "end": end})
    of_run, of_map = given_options({"class": class_name}), given_options({"resolution": resolution})
    console, errors = consoles(json_file)
    if is_run(recording):
        _refuse(values | chosen | of_map, "the objects of a run")
        make_parents(output)
        result = convert_run(recording, output, name=class_name)
        write_json(result, json_file)
        console.print(_text_of_objects(result, output), markup=False, soft_wrap=True)
        return
    of_points = writers_of("points")
    writer = of_points.get(ending_of(output, of_points))
    if writer is not None:
        _refuse(
            chosen | of_run | ({} if writer.needs_resolution else of_map),
            f"one cloud or map as {output.suffix}",
        )
        count = _write_cloud(recording, output, ReadOptions.load(values), resolution)
        write_json({"input": str(recording), "output": str(output), "points": count}, json_file)
        console.print(f"{count} points in {output}", markup=False, soft_wrap=True)
        return
    if recording.is_file() and recording.suffix.lower() in MAPS:
        writer_of(output, "points")  # raises: names the endings for a map, it found none above
    _refuse(of_run | of_map, "a recording")
    span = Span.load({"start": start, "end": end})
    result = _write_recording(recording, output, ReadOptions.load(values), topic, span, errors)
    write_json(result, json_file)
    for line in _texts_of_messages(result, output):
        console.print(line, markup=False, soft_wrap=True)


def _text_of_objects(result: dict[str, Any], output: Path) -> str:
    return (
        f"{result['states']} states of {result['objects']} objects at {result['times']}"
        f" times in {output}"
    )


def _texts_of_messages(result: dict[str, Any], output: Path) -> list[str]:
    """Lines about a converted recording: messages per topic, and their sum."""
    written, left_out = result["written"], result["left_out"]
    return [
        *(f"{name}: {count}" for name, count in written.items()),
        *(
            f"{name}: {count} messages left out, no scans or poses"
            for name, count in left_out.items()
        ),
        f"{sum(written.values())} messages in {output}",
    ]


def _refuse(options: dict[str, Any], what: str) -> None:
    """Refuse options that have no effect on this kind of input."""
    from lidar_core.errors import ConfigError

    for name in options:
        raise ConfigError(f"--{name.replace('_', '-')}: does not apply to {what}")


def _write_recording(
    source: Path,
    output: Path,
    options: "ReadOptions",
    topics: list[str] | None,
    span: "Span",
    console: "Console",
) -> dict[str, Any]:
    """Write scans and poses; return counts of written and skipped messages as plain values."""
    from lidar_core.io import open_recording
    from lidar_core.io.poses.pose_topics import is_odometry
    from lidar_core.io.scan_topics import NAMELESS
    from lidar_core.io.write.recording import write_arrivals
    from lidar_core.io.writers import writer_of

    written: Counter[str] = Counter()
    with (
        open_recording(source, options) as opened,
        shown_progress(console, counts="messages") as on_progress,
    ):
        _check_topics(opened, topics)

        def counted() -> Iterator[tuple["Message", int | None]]:
            for message, arrival_ns in _chosen(opened, topics, span):
                written[message.topic or NAMELESS] += 1
                on_progress("convert", written.total(), None)
                yield message, arrival_ns

        writer_of(output, "messages")  # refuses another ending before anything is made
        make_parents(output)
        odometry = {topic.name for topic in opened.topics() if is_odometry(topic)}
        write_arrivals(output, counted(), odometry=odometry)
        left_out = {**opened.skipped, **opened.noticed().rejected}
    return {
        "input": str(source),
        "output": str(output),
        "written": dict(written),
        "left_out": left_out,
    }


def _write_cloud(
    source: Path, output: Path, options: "ReadOptions", resolution: float | None
) -> int:
    """Write the points of one file; return their number."""
    from lidar_core.io import read_cloud, write_cloud

    cloud = read_cloud(source, options=options)
    make_parents(output)
    write_cloud(output, cloud.points, resolution=resolution or cloud.resolution)
    return len(cloud.points)


def _check_topics(recording: "Recording", wanted: list[str] | None) -> None:
    from lidar_core.errors import ConfigError, did_you_mean
    from lidar_core.io.records import SCAN_KINDS

    known = [topic.name for topic in recording.topics() if topic.kind in SCAN_KINDS]
    for name in wanted or []:
        if name not in known:
            listed = ", ".join(known) or "none"
            raise ConfigError(
                f"topic: no scans on {name!r} in {recording.path}; found {listed}"
                f"{did_you_mean(name, known)}"
            )


def _chosen(
    recording: "Recording", topics: list[str] | None, span: "Span"
) -> Iterator[tuple["Message", int | None]]:
    """Yield the messages within the span, with their times of arrival, and all mountings.

    Raises
    ------
    InputError
        There are no messages except mountings.
    """
    from lidar_core.errors import InputError
    from lidar_core.messages import Pose

    first_ns = recording.first_stamp() or 0
    is_found = False
    for message, arrival_ns in recording.arrivals():
        if topics and not isinstance(message, Pose) and message.topic not in topics:
            continue
        if isinstance(message, Pose) and message.is_static:
            # Before a part, they arrived long before its first message.
            yield message, arrival_ns if span.is_whole else None
        elif span.holds(message.stamp_ns, first_ns):
            is_found = True
            yield message, arrival_ns
    if not is_found:
        # Notes tell what of the file was lost: this may be all of it.
        why = recording.noticed().notes if span.is_whole else [str(span)]
        part = f"{': ' if span.is_whole else ' '}{'; '.join(why)}" if why else ""
        raise InputError(f"{recording.path}: no scans or moving poses{part}")
