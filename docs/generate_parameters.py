"""Write parts of the guide from the code: python docs/generate_parameters.py.

These are parameters.md, sensors.md and the table of formats in recordings.md.
"""

import math
import re
from pathlib import Path

from pydantic import BaseModel

from lidar_core.config import Config
from lidar_core.io.readers import READERS, Reader
from lidar_core.parameters import MODELS, Parameter, model_named, models_within, parameters_of
from lidar_core.sensors import SENSORS
from lidar_core.sim import LidarModel, Rosette, Spinning

PAGE = Path(__file__).parent / "parameters.md"
RECORDINGS = PAGE.with_name("recordings.md")
USED_BY = {
    "batch": "`lidar-core batch`",
    "circle_dataset": "`circles.dataset`, `circles.make_samples`",
    "circles": "`lidar_core.circles.CirclePipeline` and its parts",
    "evaluation": "`lidar-core demo`, `lidar_core.evaluation`",
    "flight": "`lidar_core.sim`: a target in a real scan",
    "flying": "`lidar-core detect --config`, `lidar_core.flying.FlyingObjectDetector`",
    "fusion": "`lidar-core fuse`, `lidar_core.fusion.TargetFilter`, `lidar_core.fusion.run`",
    "fusion_bag": "`lidar-core fuse`, `lidar_core.fusion.read_bag`",
    "fusion_many": "`lidar-core fuse`, `lidar_core.fusion.MultiTargetTracker`",
    "fusion_table": "`lidar-core fuse`, `lidar_core.fusion.read_measurements`",
    "live": "`lidar-core live --stream`, `lidar_core.live`",
    "overflight": "`lidar_core.sim.overfly`, `lidar-core reproduce`",
    "pose_noise": "`lidar_core.sim.NoisyPoses`, `lidar-core reproduce`",
    "poses": "`lidar-core detect`, `lidar_core.io.posed_scans`",
    "read": "`lidar-core info`, `lidar-core detect`, `lidar_core.io.open_recording`",
    "scene": "`lidar-core simulate`, `lidar_core.sim.simulate`",
    "span": "`lidar-core convert`, `lidar-core fuse`; part of `poses`",
    "steering": "`lidar_core.sim.SteeredSensor`, `lidar-core reproduce`",
}
INTRODUCTION = """\
# Parameters

This page is generated from the configuration models, which define defaults, ranges and units.
`lidar-core config init` writes a file with all parameters and their meaning,
`lidar-core config show FILE` prints what a file changes, and `lidar-core config schema` prints the
JSON Schema. In a file, a table such as `[voxel_map]` contains the parameters of the model that
belongs to the parameter `voxel_map`; `"none"` means no value.
"""
LONGEST_DEFAULT = 40
SENSORS_INTRODUCTION = """\
# Sensors

Presets exist for these LiDARs. Use a preset in one of these ways:

- `lidar = { preset = "vlp-16" }` in a scene, or `lidar-core simulate SCENE --sensor vlp-16`;
- `lidar-core config init --preset vlp-16`: a file for `detect`; with `--model circles` for
  `circles` (2D), with `--model scene` a scene to start from;
- `sensor.beams`, if the driver drops rays without return.

The numbers are rounded nominal values of the makers. They were not checked against every current
data sheet: compare them with the data sheet of your revision. Ranges are those on dark surfaces, if
the maker states them. Noise and shortest ranges are typical values, if the maker states none. Rows
are equally spaced between the outermost rows, unless the note says otherwise. The patterns of
Livox are not published: the simulated patterns have the same field of view and rate, and do not
repeat. [Choose your sensor](choose-your-sensor.md) describes how to use each sensor.

"""
SENSOR_COLUMNS = (
    "Name",
    "Sensor",
    "Rays per scan",
    "Elevation [deg]",
    "Azimuth [deg]",
    "Rate [Hz]",
    "Range [m]",
    "Noise [m]",
    "Note",
)


def page() -> str:
    """The whole page."""
    lines = [INTRODUCTION]
    for name in MODELS:
        lines += [f"## {name}", "", f"Used by {USED_BY[name]}.", ""]
        for model in models_within(model_named(name)):
            lines += _section(model)
    return "\n".join(lines)


def sensors_page() -> str:
    """The page of sensors."""
    head = [f"| {' | '.join(SENSOR_COLUMNS)} |", "|---" * len(SENSOR_COLUMNS) + "|"]
    return SENSORS_INTRODUCTION + "\n".join([*head, *map(_sensor, SENSORS)]) + "\n"


def formats_table() -> str:
    """The table of the recordings that can be read, as it stands in recordings.md."""
    rows = ["| Format | Files | Extra | |", "|---|---|---|---|", *map(_format, READERS.parts())]
    return "\n".join(rows) + "\n"


def _format(reader: Reader) -> str:
    files = ", ".join(f"`{end}`" for end in reader.suffixes)
    folders = {
        "single": "",
        "merged": "; folder of them, merged by time",
        "together": "; folder of them",
    }
    extra = f"`{reader.extra}`" if reader.extra else ""
    return f"| {reader.name} | {files}{folders[reader.folder]} | {extra} | {reader.note} |"


def with_formats(text: str) -> str:
    """The text of recordings.md with the table of formats renewed."""
    return re.sub(r"\| Format \| Files .*?\n(?=\n)", formats_table(), text, flags=re.DOTALL)


def _sensor(name: str) -> str:
    model, pattern = LidarModel.preset(name), SENSORS[name].pattern
    low = high = 0.0
    width = 360.0
    if isinstance(model.pattern, Spinning):
        low, high = min(pattern["elevations_deg"]), max(pattern["elevations_deg"])
    elif isinstance(model.pattern, Rosette):
        low, high = model.pattern.elevation_deg
        width = 2 * (model.pattern.azimuth_half_deg or 180.0)
    else:
        width = math.degrees(model.pattern.angle_increment) * (model.pattern.beams - 1)
    rays = " x ".join(f"{count:,}" for count in model.shape)
    cells = (
        f"`{name}`",
        SENSORS[name].title,
        rays,
        f"{low:g} to {high:g}" if high > low else "0",
        f"{width:.4g}",
        f"{model.scan_rate:g}",
        f"{model.range_min:g} to {model.range_max:g}",
        f"{model.range_std:g}",
        SENSORS[name].note,
    )
    return "| " + " | ".join(cells) + " |"


def _section(model: type[BaseModel]) -> list[str]:
    rows = [_row(parameter) for parameter in parameters_of(model)]
    head = ["| Parameter | Type | Default | Range | Meaning |", "|---|---|---|---|---|"]
    own_text = model.own_doc if issubclass(model, Config) else model.__doc__ or ""
    text = "\n".join(line.strip() for line in own_text.strip().splitlines())
    return [f"### {model.__name__}", "", text, "", *head, *rows, ""]


def _row(parameter: Parameter) -> str:
    default = parameter.default
    if len(default) > LONGEST_DEFAULT:
        default = f"{default[:LONGEST_DEFAULT].rstrip(', ')} ..."
    cells = (
        f"`{parameter.name}`",
        f"`{parameter.type}`",
        f"`{default}`",
        f"`{parameter.range}`" if parameter.range else "",
        parameter.description,
    )
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def main() -> None:
    """Write the pages."""
    PAGE.write_text(page(), encoding="utf-8")
    PAGE.with_name("sensors.md").write_text(sensors_page(), encoding="utf-8")
    text = RECORDINGS.read_text(encoding="utf-8")
    RECORDINGS.write_text(with_formats(text), encoding="utf-8")


if __name__ == "__main__":
    main()
